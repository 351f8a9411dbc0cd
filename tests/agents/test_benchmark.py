"""Results files of the benchmark say what was played, and replaying a sample finds what is not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents.benchmark import episodes as tasks
from loose_agents.benchmark.episodes import rig_for, settings_for
from loose_agents.benchmark.leaderboard import (
    RESULTS,
    agent_rows,
    leaderboard,
    outside_table,
    stored_results,
    value_tables,
)
from loose_agents.benchmark.results import (
    Results,
    check_results,
    play_results,
    read_results,
    results_schema,
)

from loose_env.envs import EnvBatch, difficulty_named
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.rig import ReducedRig

TASK = "loose_env/ControlTier-v0"
TOLD: dict[str, Any] = {"entry": "blind", "about": "says healthy"}


@pytest.fixture(scope="module", autouse=True)
def few_episodes() -> Iterator[pytest.MonkeyPatch]:
    """Four episodes a set; those of the repository's files are read elsewhere."""
    few = {name: replace(each, episodes=4) for name, each in tasks.SETS.items()}
    with pytest.MonkeyPatch.context() as patch:
        for module in ("episodes", "results", "leaderboard"):
            patch.setattr(f"loose_agents.benchmark.{module}.SETS", few)
        yield patch


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shards")


@pytest.fixture(scope="module")
def results(shards: Path) -> Results:
    return play_results(TASK, "test", "amortised/random", told=TOLD, folder=shards)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_file_comes_back_and_is_replayed_bit_for_bit(tmp_path: Path, results: Results) -> None:
    path = tmp_path / "file.json"
    path.write_text(results.to_json())
    again = read_results(path)
    assert again == results and again.training_records is None
    schema, whole = results_schema(), json.loads(path.read_text())
    assert set(whole) == set(schema["properties"]) > set(schema["required"])
    said = check_results(again, episodes=9, rng=rng())
    assert said.startswith("4 of 4 episodes") and "by the agent" in said
    assert "by the agent" not in check_results(replace(again, agent=None), episodes=2, rng=rng())


def test_the_hidden_set_is_drawn_from_a_salt_that_was_committed_to(
    tmp_path: Path, results: Results, few_episodes: pytest.MonkeyPatch
) -> None:
    for name, salt in (("hidden", ""), ("test", "a salt")):
        with pytest.raises(InvalidSetting, match="drawn from a salt"):
            tasks.set_named(name, salt)
    told = {**TOLD, "entry": "hidden"}
    play: Any = partial(play_results, TASK, "hidden", "always_healthy", told=told, folder=tmp_path)
    first, other = play(salt="a salt"), play(salt="another")
    assert first.actions[0].split()[0] == other.actions[0].split()[0]  # the same blind agent
    assert first.reward != other.reward or first.truth != other.truth
    with pytest.raises(InvalidData, match="no round was committed"):
        check_results(first, episodes=4, rng=rng())
    committed = (tasks.commitment_of("a salt"),)
    few_episodes.setattr("loose_agents.benchmark.results.ROUNDS", committed)
    assert "4 of 4 episodes" in check_results(first, episodes=4, rng=rng())
    with pytest.raises(InvalidData, match="no round was committed"):
        check_results(other, episodes=4, rng=rng())
    table = leaderboard([results, first])
    assert "On the hidden set" in table and "| hidden | 4 |" in table


def test_an_agent_that_knows_the_public_arms_by_heart_knows_no_hidden_one(results: Results) -> None:
    problem = tasks.task_problem(TASK, results.episodes)
    batch = EnvBatch(problem.arm, problem.settings)

    def first_pose(seed: int, number: int) -> bytes:
        batch.start(0, seed=seed, number=number)
        return batch.observe(0).tobytes()

    public = results.episodes
    by_heart = {first_pose(public.seed, k): results.truth[k] for k in range(4)}
    assert all(first_pose(public.seed, k) in by_heart for k in range(4))
    hidden = tasks.set_named("hidden", "a salt")
    assert not any(first_pose(hidden.seed, k) in by_heart for k in range(4))


def test_what_was_played_is_not_played_again(shards: Path, results: Results) -> None:
    said: list[str] = []
    again = play_results(
        TASK, "test", "amortised/random", told=TOLD, folder=shards, say=said.append
    )
    assert said == [] and again == results


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: {"reward": (r.reward[0] + 1e-12, *r.reward[1:])}, "return"),
        (lambda r: {"truth": tuple((k + 1) % 5 for k in r.truth)}, "truth"),
        (lambda r: {"records": tuple(k + 1 for k in r.records)}, "records"),
        (lambda r: {"actions": ("zzzzzzzzz", *r.actions[1:])}, "not the number of an action"),
        (
            lambda r: {"actions": tuple(a.rpartition(" ")[0] for a in r.actions)},
            "without a verdict",
        ),
        (lambda r: {"confidence": (0.5, *r.confidence[1:])}, "confidence"),
        (lambda r: {"fingerprint": "0" * 16}, "another version"),
    ],
)
def test_changed_files_are_found_out(results: Results, change: Any, words: str) -> None:
    with pytest.raises(InvalidData, match=words):
        check_results(replace(results, **change(results)), episodes=4, rng=rng())


def test_an_agent_that_others_cannot_repeat_is_found_out(results: Results) -> None:
    other = replace(results, agent="always_healthy")
    with pytest.raises(InvalidData, match="says actions"):
        check_results(other, episodes=4, rng=rng())
    # Its recorded actions are what they are, whoever chose them.
    check_results(other, episodes=4, rng=rng(), by_agent=False)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"task": "loose_env/None-v0"}, "results.task"),
        ({"set": "none"}, "results.set"),
        ({"reward": [0.0]}, "1 episodes as in results.reward are needed, got 4"),
        ({"reward": [0.0] * 5}, "1 to 4 episodes, got 5"),
        ({"verdict": [99, 0, 0, 0]}, "indices run"),
        ({"verdict": [-2, 0, 0, 0]}, r"verdict\[0\]: .*-1"),
        ({"confidence": [2.0, None, None, None]}, r"confidence\[0\]: .*equal to 1"),
        ({"entry": " "}, "a name"),
        ({"speed": 1}, "unknown key 'speed'"),
        ({"format": "loose-benchmark/9"}, "loose-benchmark/1"),
    ],
)
def test_damaged_files_are_refused_in_words(
    tmp_path: Path, results: Results, change: dict[str, Any], words: str
) -> None:
    path = tmp_path / "file.json"
    path.write_text(json.dumps({**json.loads(results.to_json()), **change}))
    with pytest.raises(InvalidData, match=words) as error:
        read_results(path)
    assert str(path) in str(error.value)


def test_tables_pair_entries_on_the_same_arms(results: Results) -> None:
    def entry(name: str, *reward: float) -> Results:
        return replace(results, entry=name, reward=reward)

    own = [
        entry("greedy", 0.9, 0.5, 0.8, 0.8), entry("fixed", 0.6, 0.2, 0.5, 0.5),
        entry("fixed_1", 0.5, 0.1, 0.4, 0.4), entry("fixed_2", 0.0, 0.0, 0.0, 0.0),
    ]  # fmt: skip
    cells = [cell.strip() for cell in value_tables(own).split("\n")[-1].strip("|").split("|")]
    # Differences are alike on all arms: the paired errors are nil though the returns differ.
    assert cells[:3] == ["ControlTier-v0", "4", "greedy"]
    assert cells[4:] == ["+0.100 ± 0.000", "-", "+0.300 ± 0.000"]
    ahead = value_tables([*own, entry("look_ahead", 1.0, 0.6, 0.9, 0.9)])
    assert "| look_ahead |" in ahead and "| +0.400 ± 0.000 |" in ahead
    rows = agent_rows({each.entry: each for each in own})
    assert [row.split(" | ")[0] for row in rows] == [
        "| greedy",
        "| fixed",
        "| fixed_1",
        "| fixed_2",
    ]
    assert "-0.300 ± 0.000" in rows[1]
    assert f"### {TASK}" in leaderboard(own)


def test_what_is_out_of_distribution_stands_beside_what_is_not(results: Results) -> None:
    assert outside_table([results]) == ""
    entry = replace(results, entry="blind", reward=(0.5,) * 4)
    drifted = replace(entry, set="drift", reward=(0.25,) * 4)
    other = replace(entry, entry="greedy", set="noise_2x", reward=(0.75,) * 4)
    head, _, *rows = outside_table([entry, drifted, other]).split("\n")
    assert head == "| task | episodes | arms | greedy | blind |"
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[1] for row in cells] == [
        "as trained", "twice the sensor noise", "zeros and gains drift between records",
    ]  # fmt: skip
    assert cells[0][3] == "-" and cells[0][4].startswith("+0.500 ± 0.000")
    assert cells[1][3].startswith("+0.750") and cells[2][4].startswith("+0.250")


def test_kinds_change_what_they_name_and_nothing_else() -> None:
    problem = tasks.task_problem(TASK, tasks.SETS["test"])
    usual = difficulty_named(problem.settings.difficulty)
    for kind, name, factor in (("friction_2x", "friction", 2.0), ("small_play", "gap", 0.25)):
        changed = difficulty_named(settings_for(kind, problem).difficulty)
        low, high = getattr(usual, name)
        assert getattr(changed, name) == (factor * low, factor * high)
        before: dict[str, Any] = {name: (low, high)}
        assert replace(changed, **before) == usual
    rig = rig_for("noise_2x", problem, 1)
    assert isinstance(rig, ReducedRig)
    usual_sensors, after = problem.settings.sensors, rig.sensors
    assert after.encoder.noise == 2 * usual_sensors.encoder.noise
    assert after.accelerometer.noise_density == 2 * usual_sensors.accelerometer.noise_density
    assert after.rate == usual_sensors.rate
    assert settings_for("noise_2x", problem) == problem.settings


def test_unknown_tasks_and_sets_are_refused(tmp_path: Path) -> None:
    for task, name in ((TASK, "none"), ("loose_env/Arm-v1", "test")):
        with pytest.raises(UnknownName, match="unknown"):
            play_results(task, name, "random", told=TOLD, folder=tmp_path)


def test_the_repository_holds_replayable_files(few_episodes: pytest.MonkeyPatch) -> None:
    few_episodes.undo()  # the last test of this file
    stored = stored_results(RESULTS)
    assert len(stored) > 20
    for each in stored[:: len(stored) // 4]:
        check_results(each, episodes=2, rng=rng(), by_agent=False)
