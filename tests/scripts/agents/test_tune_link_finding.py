"""Tuning of the thesis's method from its command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts.agents import tune_link_finding

SMALL = [
    *("--env", "loose_env/Planar-v0", "--methods", "classical_literal", "--candidates", "2"),
    *("--episodes", "2"),
]
ARGUMENTS = {"n_links": 2, "durations": [0.2], "max_records": 2}


def test_the_best_settings_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tune_link_finding.main([*SMALL, "--arguments", json.dumps(ARGUMENTS), "--out", str(tmp_path)])
    found = json.loads((tmp_path / "planar2-classical_literal.json").read_text())
    assert found["order"] == "outward"
    assert found["joint"] in (1, 2)
    said = capsys.readouterr()
    assert said.out.startswith("planar2 classical_literal: return ")
    # No terminal: one line for each of the two candidates, none written over.
    assert "\r" not in said.err
    first, *rest = said.err.splitlines()
    assert first.split()[0] == "classical_literal"
    assert [line.split("|")[2].split()[0] for line in rest] == ["1/2", "2/2"]
    assert "best return" in said.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--arguments", "n_links:3"], "--arguments must be JSON"),
        (["--arguments", "[3]"], "--arguments must be a JSON object"),
        (
            ["--arguments", '{"durations": 0.2}'],
            "durations must be positive seconds, one or more; got 0.2",
        ),
        (["--arguments", '{"colour": 1}'], "unknown arguments"),
        (["--env", "CartPole-v1"], "no diagnosis environment"),
        (["--env", "loose_env/Vero-v0"], "Vero"),
        (["--candidates", "0"], "--candidates must be a whole number, 1 or more; got 0"),
        (["--episodes", "-1"], "--episodes must be a whole number, 1 or more; got -1"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path: Path, words: list[str], says: str) -> None:
    with pytest.raises(SystemExit) as caught:
        tune_link_finding.main([*SMALL, "--out", str(tmp_path), *words])
    message = str(caught.value)
    assert message.startswith("tune_link_finding: ")
    assert says in message
    assert "\n" not in message
    assert not list(tmp_path.iterdir())
