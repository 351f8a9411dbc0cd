"""The drawing of episodes of the classical method."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.dev import draw_classical


def test_every_record_has_a_line_and_a_panel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_classical.main(["--out", str(tmp_path)])
    said = capsys.readouterr().out
    for fault in draw_classical.FAULTS:
        told = said.split(f"hidden: {fault}\n")[1].split("\n\n")[0].splitlines()[1:]
        assert told[0].split()[0] == "1"
        assert told[-1].endswith(draw_classical.short(fault))
    assert (tmp_path / "classical_steps.svg").read_text("utf-8").startswith("<?xml")
