"""Training and playing by command: files, going on after a kill, refusals in one line."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")
pytest.importorskip("yaml")

from loose_agents.base import Problem
from loose_agents.rl.agents import model_agent
from loose_agents.rl.hyperparameters import HYPERPARAMETERS
from loose_agents.rl.training import CurvePoint, git_commit, read_curve, write_curve
from loose_agents.rl.training_env import evaluation_seed

from loose_env.envs import EnvBatch
from loose_env.errors import InvalidData
from loose_env.wrappers import vector
from scripts.agents import enjoy, learning_curves, train

ROOT = Path(__file__).resolve().parents[2]
TINY = [
    *("--env", "loose_env/Planar-v0"),
    *("--env-kwargs", "n_links:2", "durations:[0.2]", "max_records:4", "threads:1"),
    *("-params", "n_envs:4", "n_steps:4", "batch_size:8", "n_epochs:1", "policy_kwargs:dict()"),
]
NAME = "loose_env-Planar-v0_1"


def options(logs: Path, steps: int, *more: str) -> list[str]:
    return [*TINY, "-n", str(steps), "-f", str(logs), "--eval-freq", "-1", *more]


def steps_of(checkpoint: Path) -> int:
    with zipfile.ZipFile(checkpoint) as file:
        return int(json.loads(file.read("data"))["num_timesteps"])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "maskable_ppo"])
def test_a_run_leaves_a_policy_that_plays(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    algorithm: str,
) -> None:
    pytest.importorskip("matplotlib")
    export = tmp_path / "weights"
    command = options(tmp_path, 32, "--algo", algorithm, "--export", str(export))
    train.main([*command, "--eval-freq", "16", "--eval-episodes", "3"])
    assert "32 of 32 steps" in capsys.readouterr().out
    root = tmp_path / algorithm / NAME
    assert steps_of(root / "checkpoint.zip") == 32
    curve = read_curve(root / "curve.csv")
    assert [(point.steps, point.episodes) for point in curve] == [(16, 3), (32, 3)]
    described = json.loads((root / "configuration.json").read_text())
    assert described["algorithm"] == algorithm
    assert described["env_kwargs"]["n_links"] == 2
    assert described["hyperparameters"]["n_steps"] == 4
    assert {"torch", "mujoco", "loose_env"} <= set(described["versions"])
    assert described["git_commit"] == git_commit(ROOT)
    exported = json.loads((export / "configuration.json").read_text())
    best = max(point.mean_return for point in curve)
    assert exported["trained"]["mean_reward"] == pytest.approx(best, rel=1e-5)
    assert not list(tmp_path.rglob("*.part"))

    play = ["--algo", algorithm, "--env", "loose_env/Planar-v0", "--n-episodes", "2"]
    enjoy.main([*play, "-f", str(tmp_path), "--seed", "3"])
    words = capsys.readouterr().out
    assert len(re.findall(r"(?m)^   1  pose .* m/s² joint.* 0\.2 s .* %$", words)) == 2
    assert len(re.findall(r"verdict \S+, truth \S+: (right|wrong), return", words)) == 2
    pictures = tmp_path / "pictures"
    last = ["--n-episodes", "1", "--render", str(pictures)]
    enjoy.main([*play, "--weights", str(export), *last])
    assert "\n1 episodes: success" in capsys.readouterr().out
    assert (pictures / "episode1_record1.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(
        SystemExit, match=r"enjoy: .*durations must be positive seconds, .*got 0\.2"
    ):
        enjoy.main([*play, "--weights", str(export), "--env-kwargs", "durations:0.2"])


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, int]]]:
    """Seeds and numbers of the episodes that have begun."""
    found: list[tuple[int, int]] = []
    start = EnvBatch.start_all

    def spy(self: EnvBatch, slots: Any, **given: Any) -> None:
        found.extend(zip(given["seeds"], given["numbers"], strict=True))
        start(self, slots, **given)

    monkeypatch.setattr(EnvBatch, "start_all", spy)
    yield found


@pytest.mark.slow
def test_a_resumed_run_meets_new_faults_and_evaluations_the_same(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    begun: list[tuple[int, int]],
) -> None:
    command = ["--eval-freq", "16", "--eval-episodes", "3"]
    train.main(options(tmp_path, 32, *command))
    evaluated = [entry for entry in begun if entry[0] == evaluation_seed(1)]
    assert sorted(evaluated) == sorted([(evaluation_seed(1), k) for k in range(3)] * 2)
    first = set(begun) - set(evaluated)
    begun.clear()
    train.main(options(tmp_path, 64, *command))
    assert "at 32 steps" in capsys.readouterr().out
    second = set(begun) - set(evaluated)
    assert min(len(first), len(second)) >= 4
    assert not first & second
    assert steps_of(tmp_path / "ppo" / NAME / "checkpoint.zip") == 64
    begun.clear()
    train.main(options(tmp_path, 64, *command))
    assert "trained already, 64 steps" in capsys.readouterr().out
    assert not begun


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_checkpoint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [sys.executable, str(ROOT / "scripts" / "agents" / "train.py")]
    process = subprocess.Popen(
        [*command, *options(tmp_path, 10**6, "--forced-share", "0")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        seen = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGKILL)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    shown = int(seen[-1].split()[0])
    checkpoint = tmp_path / "ppo" / NAME / "checkpoint.zip"
    kept = steps_of(checkpoint)
    assert kept >= shown - 16  # one update is 16 steps; a line is shown after its checkpoint
    assert kept % 16 == 0
    train.main(options(tmp_path, kept + 32, "--forced-share", "0"))
    assert f"at {kept} steps" in capsys.readouterr().out
    assert steps_of(checkpoint) == kept + 32


@pytest.mark.slow
def test_a_run_of_another_configuration_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train.main(options(tmp_path, 16))
    checkpoint = tmp_path / "ppo" / NAME / "checkpoint.zip"
    before = checkpoint.read_bytes()
    with pytest.raises(SystemExit, match="other training; choose another folder"):
        train.main(options(tmp_path, 16, "--shaping", "0.2"))
    with pytest.raises(SystemExit, match="other env_kwargs, settings"):
        train.main([*options(tmp_path, 16), "--env-kwargs", "n_links:2", "durations:[0.4]"])
    assert checkpoint.read_bytes() == before
    train.main(options(tmp_path, 16, "--shaping", "0.2", "--restart"))
    assert "resumed" not in capsys.readouterr().out.splitlines()[-1]
    assert checkpoint.read_bytes() != before


SMALL = (
    *("--steps", "128", "--evaluations", "2", "--eval-episodes", "4", "--last-episodes", "6"),
    *("--hyperparams", "n_envs:4", "n_steps:8", "batch_size:16", "n_epochs:1"),
)


@pytest.mark.slow
def test_learning_curves_are_written_resume_and_their_checkpoints_play(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from sb3_contrib import MaskablePPO

    given = ["--learners", "maskable_ppo_set", "--seeds", "3", *SMALL, "--out", str(tmp_path)]
    learning_curves.main(given)
    (run,) = tmp_path.glob("*/maskable_ppo_set/seed_3")
    curve = read_curve(run / "curve.csv")
    assert [point.episodes for point in curve] == [4, 4, 6]
    assert [point.steps for point in curve] == [0, 64, 128]
    assert curve[-1].records > curve[0].records > 0
    first = (run / "curve.csv").read_text()
    learning_curves.main(given)
    assert (run / "curve.csv").read_text() == first
    assert "trained already" in capsys.readouterr().out
    env = gymnasium.make_vec("loose_env/Vera-v0", num_envs=4, engine="reduced")
    problem, path = Problem.of(env.arm, env.settings), run / "checkpoint.zip"
    agent, model = model_agent(path, problem), MaskablePPO.load(path, device="cpu")
    minus = vector.MeasuredMinusNominal(env)
    macros, every = vector.MacroActions(minus), np.arange(4)
    observation, infos = env.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(3):
        choices, _ = model.predict(
            minus.shown(observation, every),
            deterministic=True,
            action_masks=macros.masks(infos["action_mask"]),
        )
        wanted = macros.inner_actions(choices)
        np.testing.assert_array_equal(agent.predict(observation)[0], wanted)
        actions = rng.integers(0, env.single_action_space.nvec, size=(4, 6))
        actions[:, -1] = 0
        observation, _, _, _, infos = env.step(actions)
    other = gymnasium.make_vec("loose_env/Planar-v0", num_envs=1, engine="reduced")
    with pytest.raises(InvalidData, match="was trained on 'vera'"):
        model_agent(path, Problem.of(other.arm, other.settings))
    learning_curves.main([*given, "--steps", "192"])
    assert "at 128 steps" in capsys.readouterr().out
    assert read_curve(run / "curve.csv")[-1].steps == 192
    with pytest.raises(SystemExit, match="other env_kwargs, settings"):
        learning_curves.main([*given, "--env-kwargs", "max_records:6"])
    learning_curves.main([*given, "--restart"])
    assert read_curve(run / "curve.csv")[-1].steps == 128


def test_bands_and_table_of_curves_are_those_of_students_t(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def point(records: int, value: float) -> CurvePoint:
        return CurvePoint(
            steps=2 * records, records=records, seconds=1.0, episodes=10, mean_return=value,
            return_error=0.1, right=0.5, unsure=0.25, records_per_episode=2.0,
        )  # fmt: skip

    for seed, last in enumerate((0.1, 0.3)):
        folder = tmp_path / "curves" / "Vera" / "ppo" / f"seed_{seed}"
        folder.mkdir(parents=True)
        write_curve(folder / "curve.csv", [point(0, 0.0), point(1000, last)])
    curves = learning_curves.read_curves(tmp_path / "curves")
    grid, mean, half = learning_curves.band(curves["Vera"]["ppo"], "mean_return")
    np.testing.assert_allclose(mean, 0.2 * grid / 1000, atol=1e-12)
    assert half[-1] == pytest.approx(12.706 * 0.1, rel=1e-3)  # t of one degree of freedom
    figure = tmp_path / "curves.svg"
    drawn = ["--seeds", "--draw", str(figure), "--out"]
    learning_curves.main([*drawn, str(tmp_path / "curves")])
    said = capsys.readouterr().out
    assert "| Vera | ppo | 2 | 1000 | +0.200 ± 1.271 | 50.0 ± 0.0 | 25.0 ± 0.0 |" in said
    assert figure.stat().st_size > 1000
    with pytest.raises(SystemExit, match="holds no curves"):
        learning_curves.main([*drawn, str(tmp_path / "nothing")])


@pytest.mark.slow
def test_the_zoo_itself_trains_and_plays(tmp_path: Path) -> None:
    pytest.importorskip("rl_zoo3")
    shared = ["--algo", "ppo", "--env", "loose_env/Planar-v0", "--gym-packages", "loose_env"]
    shared += ["-f", str(tmp_path)]
    small = ["n_links:2", "durations:[0.2]", "threads:1"]
    shipped = ["--conf-file", str(HYPERPARAMETERS / "ppo.yml")]
    overrides = ["-params", "n_envs:2", "n_steps:8", "batch_size:8"]
    words = {
        "rl_zoo3.train": [
            *("-n", "16", "--eval-freq", "8", "--eval-episodes", "1"),
            *(*shipped, *overrides, "--env-kwargs", *small),
        ],
        "rl_zoo3.enjoy": ["-n", "4", "--no-render", "--load-best"],
    }
    # As `python -m` runs them, one after the other: loading the zoo takes longest.
    code = "import runpy, sys\n" + "".join(
        f"sys.argv = {[module, *shared, *more]!r}\n"
        f"runpy.run_module({module!r}, run_name='__main__')\n"
        for module, more in words.items()
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "best_model.zip" in done.stdout
    # the zoo seeds neighbours, of which the environments warn
    warned = [line for line in done.stderr.splitlines() if "Warning: " in line]
    assert all("share episodes" in line for line in warned), warned
