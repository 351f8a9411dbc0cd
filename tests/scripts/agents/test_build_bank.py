"""A bank from its command line says how large it is and how long it took."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from scripts.agents import build_bank

SMALL = [
    *("--env", "loose_env/Planar-v0", "--episodes", "3", "--directions", "4"),
    *("--workers", "1", "--backend", "threading", "--arguments"),
    '{"engine": "reduced", "n_links": 2, "durations": [0.2], "max_records": 2}',
]


def test_records_size_and_time_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    build_bank.main([*SMALL, "--out", str(tmp_path)])
    first, second = capsys.readouterr().out.splitlines()
    file = next((tmp_path / "records").glob("shard-*"))
    with np.load(file) as bank:
        count = int((bank["slots"][:, :, 0] > 0.5).sum())
    number = r"\d+\.\d"
    assert re.fullmatch(
        rf"3 episodes, {count} records, {file.stat().st_size / 1e6:.1f} MB in "
        rf"{re.escape(str(tmp_path / 'records'))}; this run took {number} s",
        first,
    )
    assert re.fullmatch(
        rf"Figures of {count} records, {number} MB in "
        rf"{re.escape(str(tmp_path / 'figures'))}; this run took {number} s",
        second,
    )
