"""The page on importing: its table, its mappings and its code run as they are printed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.importing.mapping.mapping_file import mapping_of
from loose_env.recording import read_recording
from tests.importing.sample_files import ARM, motion

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "importing.md").read_text("utf-8")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_page_s_files_become_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    time = np.arange(1000) / 1000
    signals = motion(time)
    printed = blocks("text")[0].splitlines()
    rows = np.stack([time * 1e3, np.degrees(signals["elbow"]), *(signals[a] for a in "xyz")], 1)
    lines = printed[:2] + [";".join(f"{v:.9f}".replace(".", ",") for v in row) for row in rows]
    Path("daq.csv").write_text("\n".join(lines) + "\n")
    Path("arm.xml").write_text(ARM)
    Path("mapping.toml").write_text(blocks("toml")[0])
    names: dict[str, object] = {}
    exec(compile(blocks("python")[0], "importing.md", "exec"), names)
    assert "pose-1.parquet 801" in capsys.readouterr().out
    run = read_recording("recording").runs[0]
    tool = 98.0665 * np.stack([signals["x"], signals["z"], -signals["y"]], 1)
    np.testing.assert_allclose(run.sensors["tool"], tool[100:901], atol=1e-6)
    # The printed table itself, its two rows, is recognised by --describe.
    Path("daq.csv").write_text(blocks("text")[0])
    assert main(["import", "--describe", "daq.csv"]) == 0
    found = tomllib.loads(capsys.readouterr().out)["sources"]["daq"]
    given = tomllib.loads(blocks("toml")[0])["sources"]["daq"]
    assert {key: found[key] for key in given} == given


def test_the_page_s_pieces_of_mappings_are_read() -> None:
    first, more_runs, align = blocks("toml")
    whole = tomllib.loads(first + more_runs)
    whole["sources"] |= tomllib.loads(align)["sources"] | {"robot": {}}
    for column in whole["columns"].values():
        column["source"] = "daq"
    found = mapping_of(whole, "mapping.toml")
    assert found.runs[1].pose == {"elbow": pytest.approx(np.pi / 6)}
    shift = found.sources["vibration"].align
    assert shift is not None
    assert shift.to == "robot"
