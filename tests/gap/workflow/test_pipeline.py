"""The search as a whole, on small recordings with and without something hidden."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.model.effects.friction import make_it_stick
from loose_env.gap.output.checkpoints import Stages, key_of
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.residuals.windows import SHORTEST
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import GapSolution, find_gap
from loose_env.recording import Recording, Run, write_recording
from tests.gap.cases.effect_arms import PLANAR

STEP, SECONDS, SHORT, RUNS = 0.001, 2.5, 1.5, 3
NOISE = np.array([5e-5] * 3 + [2e-3] + [0.03] * 3)


def record(
    folder: Path,
    edit: Callable[[mujoco.MjSpec], None],
    *,
    seed: int,
    runs: int = RUNS,
    seconds: float = SECONDS,
) -> Recording:
    """Record the planar arm, its figures 1 to 3 % off, with an edit of one's own."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(PLANAR)

    def off() -> float:
        return float(1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.03))

    for joint in spec.joints:
        joint.damping = np.asarray(joint.damping) * off()
    for actuator in spec.actuators:
        factor = off()
        actuator.gainprm = np.asarray(actuator.gainprm) * np.array([factor] + [1.0] * 9)
        actuator.biasprm = np.asarray(actuator.biasprm) * np.array([1.0, factor] + [1.0] * 8)
    edit(spec)
    spec.option.timestep, spec.option.integrator = STEP / 2, mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    time = np.arange(round(seconds / STEP)) * STEP
    found = []
    for k in range(runs):
        data = mujoco.MjData(model)
        controls = (
            sum(
                rng.uniform(0.1, 0.5, 3) * np.sin(np.outer(time, rng.uniform(2, 12, 3)))
                for _ in range(3)
            )
            * np.minimum(2 * time, 1.0)[:, None]
        )
        for _ in range(2000):
            mujoco.mj_step(model, data)
        shown = np.zeros((len(time), model.nsensordata))
        for row, command in zip(shown, controls, strict=True):
            data.ctrl[:3] = command
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
            mujoco.mj_step(model, data)
        shown += rng.normal(0, NOISE, shown.shape)
        names = ("encoder1", "encoder2", "encoder3", "rate3")
        found.append(
            Run(
                name=f"run-{k + 1:02d}.parquet",
                time=time,
                controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
                sensors={n: shown[:, j] for j, n in enumerate(names)} | {"shake": shown[:, 4:]},
            )
        )
    return write_recording(folder, model_xml=PLANAR, runs=found)


def test_nothing_is_named_where_nothing_is_missing(tmp_path: Path) -> None:
    recording = record(tmp_path / "r", lambda spec: None, seed=3, seconds=SHORT)
    found = find_gap(recording, GapSettings(threads=1))
    assert found.verdict == "no_gap"
    assert found.effects == ()
    assert 0.9 < found.best.held_out_rms < 1.15


def test_friction_is_named_with_its_place_and_its_torque(tmp_path: Path) -> None:
    def edit(spec: mujoco.MjSpec) -> None:
        spec.joint("joint2").frictionloss = 2.0
        make_it_stick(spec.joint("joint2"), STEP / 2)

    lines: list[str] = []
    recording = record(tmp_path / "r", edit, seed=4, seconds=SHORT)
    found = find_gap(recording, GapSettings(threads=1), say=lines.append)
    assert found.verdict == "named"
    assert [(e.kind, e.where) for e in found.effects] == [("coulomb_friction", "joint2")]
    effect = found.effects[0]
    assert effect.parameters["torque"] == pytest.approx(2.0, rel=0.05)
    low, high = effect.interval_95["torque"]
    assert low < effect.parameters["torque"] < high
    assert high - low < 0.5
    assert found.base.held_out_rms > 2 * found.best.held_out_rms
    assert found.best.held_out_rms < 1.15
    assert any("coulomb_friction@joint2" in line for line in lines)
    assert found.ranking[0].bic < 0


@pytest.fixture(scope="module")
def heavier(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Of an arm whose last link is heavier than its model has it."""

    def edit(spec: mujoco.MjSpec) -> None:
        spec.body("link3").mass += 0.4

    return record(tmp_path_factory.mktemp("heavier") / "r", edit, seed=5, seconds=SHORT)


MASSES = GapSettings(threads=1, kinds=("link_mass", "payload"))


@pytest.fixture(scope="module")
def mass(heavier: Recording) -> GapSolution:
    return find_gap(heavier, MASSES)


def test_the_same_recording_gives_the_same_result_on_any_number_of_threads(
    heavier: Recording, mass: GapSolution
) -> None:
    two = find_gap(heavier, replace(MASSES, threads=2))
    assert mass.verdict == "named"
    assert mass.effects == two.effects
    assert mass.ranking == two.ranking


def test_one_run_cannot_be_split(tmp_path: Path) -> None:
    recording = record(tmp_path / "r", lambda spec: None, seed=1, runs=1)
    with pytest.raises(InvalidData, match="at least two are needed"):
        prepare(recording, GapSettings())


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("tolerance", 0.0, "a share above 0 and below 0.5"),
        ("tolerance", 0.7, "a share above 0 and below 0.5"),
        ("tolerance", "0.1", "a share above 0 and below 0.5"),
        ("held_share", 1.0, "a share above 0 and below 1"),
        ("held_share", float("nan"), "a share above 0 and below 1"),
        ("most_effects", 0, "a whole number, 1 to 30"),
        ("most_effects", 2.5, "a whole number, 1 to 30"),
        ("search_seconds", -1.0, "a time above 0 s"),
        ("search_seconds", 0, "a time above 0 s"),
        ("fit_seconds", float("nan"), "a time above 0 s"),
        ("held_seconds", True, "a time above 0 s"),
        ("seed", -1, "a whole number, 0 or more"),
        ("seed", 2**63, "a whole number, 0 or more"),
        ("seed", 1.0, "a whole number, 0 or more"),
        ("threads", -1, "a whole number, 0 to 10000"),
        ("kinds", "backlash", "a tuple of words"),
        ("held_out", (3,), "a tuple of words"),
    ],
)
def test_settings_out_of_range_are_refused(name: str, wrong: object, words: str) -> None:
    with pytest.raises(
        InvalidSetting, match=rf"^{name} is {words}.*, got {re.escape(repr(wrong))}$"
    ):
        GapSettings(**{name: wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("seconds", [1e-3, 0.7])
def test_a_search_in_less_than_a_window_takes_a_window(tmp_path: Path, seconds: float) -> None:
    recording = record(tmp_path / "r", lambda spec: None, seed=1, runs=2)
    settings = GapSettings(threads=1, kinds=("viscous_friction",), search_seconds=seconds)
    search = prepare(recording, settings).search
    assert len(search) and search.trials[0].time[-1] >= SHORTEST


@pytest.mark.parametrize("form", ["forward", "inverse"])
def test_an_arm_that_stands_still_leaves_nothing_to_compare(tmp_path: Path, form: str) -> None:
    time, still = np.arange(1000) * 0.002, np.full(1000, 0.1)
    swing = 0.1 * np.sin(3 * time) * (form == "inverse")
    runs = [
        Run(
            name=f"run-{k}.csv",
            time=time,
            controls={f"servo{j}": still for j in (1, 2, 3)} if form == "forward" else {},
            torques={f"joint{j}": still for j in (1, 2, 3)} if form == "inverse" else {},
            sensors={f"encoder{j}": still + swing for j in (1, 2, 3)},
        )
        for k in range(2)
    ]
    recording = write_recording(tmp_path / "r", model_xml=PLANAR, runs=runs)
    settings = GapSettings(threads=1, kinds=("viscous_friction",))
    with pytest.raises(InvalidData, match=r"^nothing to compare .*\(run-0\.\w+\).*Record"):
        prepare(recording, settings)


@pytest.mark.slow
def test_an_interrupted_search_goes_on_where_it_was(
    heavier: Recording, mass: GapSolution, tmp_path: Path
) -> None:
    key = key_of(heavier, {})

    class Interrupted(Stages):
        def __call__(self, name: str, make: Callable[[], Any]) -> Any:
            if name == "effect-1":
                raise KeyboardInterrupt
            return super().__call__(name, make)

    with pytest.raises(KeyboardInterrupt):
        find_gap(heavier, MASSES, stages=Interrupted(tmp_path / "kept", key))
    stages = Stages(tmp_path / "kept", key)
    resumed = find_gap(heavier, MASSES, stages=stages)
    assert stages.taken_up == ["nominal"]
    again = Stages(tmp_path / "kept", key)
    assert find_gap(heavier, MASSES, stages=again).effects == mass.effects
    assert again.taken_up[:2] == ["nominal", "effect-1"]
    assert resumed.effects == mass.effects
    assert resumed.ranking == mass.ranking
