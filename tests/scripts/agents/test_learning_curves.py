from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("yaml")

from loose_agents.base import Problem
from loose_agents.rl.checkpoint import read_model
from loose_agents.rl.end_to_end.learning_curve import (
    Budget,
    BudgetSchedule,
    CurvePoint,
    write_curve,
)
from loose_agents.rl.hyperparameters import LinearSchedule
from loose_agents.rl.model_agent import model_agent

from loose_env.errors import InvalidData
from scripts.agents.learning_curves import main
from scripts.dev import draw_curves

SMALL = (
    *("--steps", "128", "--evaluations", "2", "--eval-episodes", "4", "--last-episodes", "6"),
    *("--hyperparams", "n_envs:4", "n_steps:8", "batch_size:16", "n_epochs:1"),
)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_runs_write_curves_and_configuration_and_resume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--learners", "ppo_joint", "maskable_ppo_set", "--seeds", "3", *SMALL]
    main([*given, "--out", str(tmp_path / "a")])
    runs = sorted((tmp_path / "a").glob("*/*/seed_3"))
    assert [run.parent.name for run in runs] == ["maskable_ppo_set", "ppo_joint"]
    for run in runs:
        curve = rows(run / "curve.csv")
        assert [int(row["episodes"]) for row in curve] == [4, 4, 6]
        assert [int(row["steps"]) for row in curve] == [0, 64, 128]
        assert int(curve[-1]["records"]) > int(curve[0]["records"]) > 0
        written = json.loads((run / "configuration.json").read_text())
        assert written["hyperparameters"]["n_envs"] == 4
        assert written["settings"]["max_records"] == 12
    first = (runs[0] / "curve.csv").read_text()
    main([*given, "--out", str(tmp_path / "a")])
    assert (runs[0] / "curve.csv").read_text() == first
    assert "trained already" in capsys.readouterr().out
    main([*given, "--out", str(tmp_path / "a"), "--steps", "192"])
    assert "resumed at 128 steps" in capsys.readouterr().out
    assert int(rows(runs[0] / "curve.csv")[-1]["steps"]) == 192
    with pytest.raises(SystemExit, match="other env_kwargs, settings"):
        main([*given, "--out", str(tmp_path / "a"), "--env-kwargs", "max_records:6"])


def test_a_run_begun_anew_forgets_the_earlier_one_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--learners", "ppo", "--seeds", "3", *SMALL, "--out", str(tmp_path)]
    main(given)
    (run,) = tmp_path.glob("*/ppo/seed_3")
    other = [*given, "--hyperparams", "n_envs:4", "n_steps:8", "batch_size:16", "gamma:0.5"]

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    evaluation = "loose_agents.rl.end_to_end.evaluation.evaluate_policy"
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(evaluation, interrupt)
        main([*other, "--restart"])
    assert not (run / "checkpoint.zip").exists()
    assert not (run / "curve.csv").exists()
    capsys.readouterr()
    main(other)
    assert "resumed" not in capsys.readouterr().out


def test_the_checkpoints_play_in_numpy_as_in_torch(tmp_path: Path) -> None:
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import PPO

    learners = ["--learners", "ppo_joint", "maskable_ppo_set"]
    main([*learners, *SMALL, "--seeds", "1", "--out", str(tmp_path)])
    env = gymnasium.make_vec("loose_env/Vera-v0", num_envs=4, engine="reduced")
    problem = Problem.of(env.arm, env.settings)
    rng = np.random.default_rng(0)
    for name, kind in (("ppo_joint", PPO), ("maskable_ppo_set", MaskablePPO)):
        path = next(tmp_path.glob(f"*/{name}/seed_1/checkpoint.zip"))
        agent, model = model_agent(path, problem), kind.load(path, device="cpu")
        observation, infos = env.reset(seed=2)
        for _ in range(3):
            masks = {"action_masks": infos["action_mask"]} if kind is MaskablePPO else {}
            wanted, _ = model.predict(observation, deterministic=True, **masks)
            np.testing.assert_array_equal(agent.predict(observation)[0], wanted)
            actions = rng.integers(0, env.single_action_space.nvec, size=(4, 6))
            actions[:, -1] = 0
            observation, _, _, _, infos = env.step(actions)
    six = gymnasium.make_vec("loose_env/Planar-v0", num_envs=1, engine="reduced")
    with pytest.raises(InvalidData, match="was trained on 'vera'"):
        model_agent(path, Problem.of(six.arm, six.settings))


def test_same_seed_same_curve_and_weights_for_any_number_of_workers(tmp_path: Path) -> None:
    curves, weights = [], []
    for workers in ("1", "2"):
        given = [
            "--learners",
            "ppo_joint",
            "maskable_ppo_set",
            "--seeds",
            "5",
            "--workers",
            workers,
        ]
        main([*given, *SMALL, "--out", str(tmp_path / workers)])
        runs = sorted((tmp_path / workers).glob("*/*/seed_5"))
        found = [row for run in runs for row in rows(run / "curve.csv")]
        curves.append([{k: v for k, v in row.items() if k != "seconds"} for row in found])
        stored = [read_model(run / "checkpoint.zip").parameters["policy"] for run in runs]
        weights.append({(k, n): v for k, each in enumerate(stored) for n, v in each.items()})
    assert curves[0] == curves[1]
    assert weights[0].keys() == weights[1].keys()
    assert all((weights[0][key] == weights[1][key]).all() for key in weights[0])


def test_unknown_learners_are_refused_in_one_line() -> None:
    with pytest.raises(SystemExit, match="unknown learners"):
        main(["--learners", "dqn"])


def test_the_budget_that_runs_out_first_decides_the_schedule() -> None:
    budget = Budget(steps=100, seconds=10.0)
    budget.spent = 8.0
    schedule = BudgetSchedule(LinearSchedule(1.0), budget)
    assert schedule(0.9) == pytest.approx(0.2)
    assert schedule(0.1) == pytest.approx(0.1)
    assert not budget.timed_out()
    budget.spent = 10.0
    assert budget.timed_out()
    assert BudgetSchedule(LinearSchedule(1.0), Budget(steps=100))(0.9) == 0.9


def point(records: int, value: float) -> CurvePoint:
    return CurvePoint(
        steps=2 * records,
        records=records,
        seconds=1.0,
        episodes=10,
        mean_return=value,
        return_error=0.1,
        right=0.5,
        unsure=0.25,
        records_per_episode=2.0,
    )


def test_bands_and_table_are_those_of_students_t(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed, last in enumerate((0.1, 0.3)):
        folder = tmp_path / "curves" / "Vera" / "ppo" / f"seed_{seed}"
        folder.mkdir(parents=True)
        write_curve(folder / "curve.csv", [point(0, 0.0), point(1000, last)])
    curves = draw_curves.read_curves(tmp_path / "curves")
    grid, mean, half = draw_curves.band(curves["Vera"]["ppo"], "mean_return")
    np.testing.assert_allclose(mean, 0.2 * grid / 1000, atol=1e-12)
    assert half[-1] == pytest.approx(12.706 * 0.1, rel=1e-3)  # t of one degree of freedom
    monkeypatch.setattr(sys, "argv", ["draw_curves"])
    draw_curves.main([str(tmp_path / "curves"), "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert "| Vera | ppo | 2 | 1000 | +0.200 ± 1.271 | 50.0 ± 0.0 | 25.0 ± 0.0 |" in said
    assert (tmp_path / "learning_curves.svg").stat().st_size > 1000
    with pytest.raises(SystemExit, match="--out writes them"):
        draw_curves.main([str(tmp_path / "nothing")])
