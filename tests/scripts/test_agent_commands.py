"""Commands of agents: what they cannot use, submissions to the benchmark, tuned link finding."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest
from loose_agents.policies.classical import ClassicalSettings

from scripts import submit
from scripts.agents import tune_link_finding

TASK = "loose_env/ControlTier-v0"
PLANAR = ["--env", "loose_env/Planar-v0"]
TUNE = [*PLANAR, "--methods", "classical_literal", "--candidates", "2", "--episodes", "2"]
OPTIONS = {
    "train": [*PLANAR, "-n", "16", "-f", "OUT"],
    "enjoy": ["-f", "OUT"],
    "compare": ["--agents", "classical", "--out", "OUT"],
    "submit": [],
    "tune_agents": [*PLANAR, "--agents", "random"],
    "tune_link_finding": [*TUNE, "--out", "OUT"],
}
MAKE = ["make", "--tasks", TASK, "--out", "OUT", "--shards", "OUT/shards"]
REFUSED = [
    ("train", ["--env", "CartPole-v1"], "CartPole-v1 does not take"),
    ("train", ["--env", "loose_env/Vero-v0"], "loose_env/Vera-v0"),
    ("train", ["--env-kwargs", "n_links"], "key:value"),
    ("train", ["--env-kwargs", "n_links:2", "colour:1"], "unknown arguments"),
    ("train", ["--env-kwargs", "n_links:__import__('os')"], "--env-kwargs n_links: cannot read"),
    ("train", ["--env-kwargs", "raw:True"], "leave raw out"),
    ("train", ["--env-kwargs", "durations:0.2"], "positive seconds, one or more; got 0.2"),
    ("train", ["-params", "gama:0.9"], "gama"),
    ("train", ["-params", "normalize:True"], "normalize"),
    ("train", ["-params", "policy:CnnPolicy"], "MlpPolicy"),
    ("train", ["-params", "learning_rate:'cos_1e-3'"], "lin_3e-4"),
    ("train", ["-params", "n_envs:1.5"], "whole number"),
    ("train", ["-params", "n_envs:1", "n_steps:1"], "hyperparameters refused by PPO"),
    ("train", ["-params", "policy_kwargs:3"], "dict"),
    ("train", ["--conf-file", "nowhere.yml"], "no hyperparameter file"),
    ("train", ["--conf-file", "OUT.yml"], "env_kwargs in a hyperparameter file is a mapping"),
    ("train", ["-n", "0"], "-n must be"),
    ("train", ["--eval-episodes", "0"], "must be a whole number, 1 or more"),
    ("train", ["--forced-share", "2"], "0 to 1"),
    ("train", ["--shaping", "-1"], "0 or more"),
    ("train", ["--seed", "4294967296"], "2^32"),
    ("enjoy", [], "scripts/agents/train.py makes one"),
    ("enjoy", ["--weights", "nowhere"], "nowhere"),
    ("compare", ["--agents", "nobody"], "unknown agent 'nobody'"),
    ("compare", ["--episodes", "0"], "--episodes must be a whole number, 1 or more; got 0"),
    ("compare", ["--seed", "-1"], "--seed must be a whole number, 0 or more; got -1"),
    ("compare", ["--reference", "random"], "does not play"),
    ("compare", ["--estimators", "posterior"], "give both or neither"),
    ("compare", ["--arguments", "["], "must be JSON"),
    ("compare", ["--rows", "csv"], "parquet or json"),
    ("compare", ["--curve", "14"], "--curve must be 1 to 12"),
    ("compare", ["--arguments", '{"difficulty": "grim"}'], "unknown difficulty 'grim'"),
    ("submit", [*MAKE, "--agents", "nobody"], "unknown agent"),
    ("submit", [*MAKE, "--agents", "random", "--episodes", "9999"], "1 to 320"),
    ("submit", [*MAKE, "--agents", "random", "fixed", "--entry", "mine"], "names one agent"),
    ("submit", ["check", "nowhere.json"], "nowhere.json"),
    ("tune_link_finding", ["--arguments", "[3]"], "--arguments must be a JSON object"),
    ("tune_link_finding", ["--arguments", '{"colour": 1}'], "unknown arguments"),
    ("tune_link_finding", ["--env", "CartPole-v1"], "no diagnosis environment"),
    ("tune_link_finding", [*PLANAR, "loose_env/Vera-v0"], "belong to one arm: tune"),
    ("tune_agents", ["--seed", "-1"], "--seed must be a whole number, 0 or more; got -1"),
    ("tune_link_finding", ["--candidates", "0"], "--candidates must be a whole number, 1 or more"),
]


@pytest.mark.parametrize(("name", "words", "says"), REFUSED)
def test_what_cannot_be_used_is_said_in_one_line_before_anything_is_played(
    name: str, words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("sb3_contrib")
    (tmp_path / "out.yml").write_text("default:\n  n_envs: 2\n  env_kwargs: [n_links]\n")
    given = [w.replace("OUT", str(tmp_path / "out")) for w in [*OPTIONS[name], *words]]
    module = importlib.import_module(
        "scripts" + (".agents" if name != "submit" else "") + f".{name}"
    )
    with pytest.raises(SystemExit) as caught:
        module.main(given)
    message = str(caught.value) if caught.value.code != 2 else capsys.readouterr().err.strip()
    assert message.startswith(name) and says in message and "\n" not in message
    left = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert left == ["out.yml"]


def test_a_submission_is_made_checked_and_refused_once_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["make", "--agents", "always_healthy", "--tasks", TASK, "--episodes", "3"]
    given += ["--out", str(tmp_path / "out"), "--shards", str(tmp_path / "shards")]
    submit.main(given)
    path = tmp_path / "out" / "ControlTier-v0" / "always_healthy.json"
    stored = path.read_bytes()
    assert json.loads(stored)["training_records"] == 0
    submit.main(given)
    assert "there already" in capsys.readouterr().out and path.read_bytes() == stored
    with pytest.raises(SystemExit, match="holds agent 'always_healthy'"):
        submit.main([*given, "--agents", "always_unsure", "--entry", "always_healthy"])
    submit.main(["check", str(path), "--seed", "0"])
    assert "3 of 3 episodes replayed from their actions and by the agent" in capsys.readouterr().out
    whole = json.loads(stored)
    whole["reward"][0] = 1.0
    path.write_text(json.dumps(whole))
    with pytest.raises(SystemExit) as ended:
        submit.main(["check", str(path)])
    said = str(ended.value)
    assert said.count("\n") == 0 and f"{path}: episode 0: the file says return 1.0" in said


def test_the_best_settings_are_written_for_one_arm_and_for_several(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = json.dumps(
        {"n_links": 2, "durations": [0.2], "max_records": 2, "engine": "reduced"}
    )
    tune_link_finding.main([*TUNE, "--arguments", arguments, "--out", str(tmp_path)])
    found = json.loads((tmp_path / "planar2-classical_literal.json").read_text())
    assert found["order"] == "outward" and found["joint"] in (1, 2)
    said = capsys.readouterr()
    assert said.out.splitlines()[0] == "classical_literal: 2 training episodes an arm"
    # No terminal: a line for each arm, none written over.
    first, line = said.err.splitlines()
    assert first == "classical_literal" and "2 candidates, 2 episodes" in line
    two = [*PLANAR, "loose_env/Scara-v1", "--methods", "classical", "--candidates", "9"]
    short = ["--arguments", '{"engine": "reduced", "max_records": 2}', "--episodes", "2"]
    tune_link_finding.main([*two, *short, "--out", str(tmp_path)])
    ClassicalSettings(**json.loads((tmp_path / "planar-spatial-classical.json").read_text()))
    table = capsys.readouterr().out.splitlines()
    # The better third plays on, on twice as many further episodes.
    assert table[0] == "classical: 6 training episodes an arm"
    assert [line.split()[0] for line in table[2:]] == ["planar4", "scara"]
    assert len(table[2].split()) == 4
