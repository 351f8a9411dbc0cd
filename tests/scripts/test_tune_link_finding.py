"""Tuning of the thesis's method from its command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from loose_agents.evaluation import evaluate
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings

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
    assert said.out.splitlines()[0] == "classical_literal: 2 training episodes an arm"
    assert said.out.splitlines()[2].split()[0] == "planar2"
    # No terminal: a line for each arm, none written over.
    assert "\r" not in said.err
    first, line = said.err.splitlines()
    assert first == "classical_literal"
    assert "1/1" in line
    assert "2 candidates, 2 episodes" in line


def test_settings_for_several_arms_are_one_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    two = ["--env", "loose_env/Planar-v0", "loose_env/Scara-v0", "--methods", "classical"]
    short = ["--arguments", '{"engine": "reduced", "max_records": 2}']
    more = ["--candidates", "9", "--episodes", "2", "--out", str(tmp_path)]
    tune_link_finding.main([*two, *short, *more])
    assert [path.name for path in tmp_path.iterdir()] == ["planar-spatial-classical.json"]
    ClassicalSettings(**json.loads((tmp_path / "planar-spatial-classical.json").read_text()))
    table = capsys.readouterr().out.splitlines()
    # The better third plays on, on twice as many further episodes.
    assert table[0] == "classical: 6 training episodes an arm"
    assert [line.split()[0] for line in table[2:]] == ["planar4", "scara"]
    assert len(table[2].split()) == 4


def test_of_settings_that_earn_alike_the_one_most_often_right_is_chosen() -> None:
    rng = np.random.default_rng(0)
    returns = rng.standard_normal((3, 2, 400)) * 0.1 + np.array([0.500, 0.499, 0.2])[:, None, None]
    right = np.array([0.8, 0.9, 1.0])[:, None, None] * np.ones((3, 2, 400))
    assert tune_link_finding.choose(returns, right) == 1


def test_what_is_remembered_is_what_is_played() -> None:
    bench = tune_link_finding.Bench("loose_env/Planar-v0", {"n_links": 2, "engine": "reduced"})
    agents = [ClassicalAgent(bench.problem, ClassicalSettings(clear=c)) for c in (5.0, 5.0, 2.0)]
    returns, right = bench.play(agents, 3, 6)
    rows = evaluate(
        ClassicalAgent(bench.problem, ClassicalSettings(clear=5.0)),
        "",
        bench.problem.arm,
        bench.problem.settings,
        episodes=6,
        first=3,
        seed=tune_link_finding.TRAINING_SEED,
    )
    for k in (0, 1):
        assert returns[k].tolist() == [row.reward for row in rows]
        assert right[k].tolist() == [row.success for row in rows]


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
        (
            ["--env", "loose_env/Planar-v0", "loose_env/Vera-v0"],
            "belong to one arm: tune",
        ),
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
