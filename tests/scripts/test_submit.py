"""The benchmark's command makes a file, checks it, and says in one line what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts import submit

TASK = "loose_env/ControlTier-v0"


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
    with pytest.raises(SystemExit) as ended:
        submit.main([*given, "--agents", "always_unsure", "--entry", "always_healthy"])
    assert "holds agent 'always_healthy'" in str(ended.value)
    submit.main(["check", str(path), "--seed", "0"])
    assert "3 of 3 episodes replayed from their actions and by the agent" in capsys.readouterr().out
    whole = json.loads(stored)
    whole["reward"][0] = 1.0
    path.write_text(json.dumps(whole))
    with pytest.raises(SystemExit) as ended:
        submit.main(["check", str(path)])
    said = str(ended.value)
    assert said.count("\n") == 0 and f"{path}: episode 0: the file says return 1.0" in said


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["make", "--agents", "nobody", "--tasks", TASK], "unknown agent"),
        (["make", "--agents", "random", "--tasks", TASK, "--episodes", "9999"], "1 to 320"),
        (["make", "--agents", "random", "--tasks", TASK, "--episodes", "0"], "got 0"),
        (["make", "--agents", "random", "fixed", "--entry", "mine"], "--entry names one agent"),
        (["check", "nowhere.json"], "nowhere.json"),
        (
            ["check", "nowhere.json", "--episodes", "0"],
            "must be a whole number, 1 or more",
        ),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(
    given: list[str], words: str, tmp_path: Path
) -> None:
    if given[0] == "make":
        given = [*given, "--out", str(tmp_path / "out"), "--shards", str(tmp_path / "shards")]
    with pytest.raises(SystemExit) as ended:
        submit.main(given)
    said = str(ended.value)
    assert words in said and said.count("\n") == 0
    assert not (tmp_path / "out").exists()
