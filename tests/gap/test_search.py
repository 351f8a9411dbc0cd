"""The search on small recordings with and without something hidden: in full, and a quick look."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from loose_env.cli.main import main
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    GapSettings,
    GapSolution,
    QuickLook,
    Stages,
    diagnose_residuals,
    explain_gap,
    find_gap,
    key_of,
    quick_look,
    result_of,
)
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.effects.friction import make_it_stick
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.residuals.progress import counted, reported, tick
from loose_env.gap.workflow.quick_look import FORMAT
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array
from tests.gap.cases import gap_case
from tests.gap.cases.effect_arms import PLANAR

STEP = 0.002


def record(folder: Path, edit: Callable[[mujoco.MjSpec], None], *, seed: int) -> Recording:
    """Record the planar arm, its parameters 1 to 3 % off, with an edit of one's own."""
    rng = np.random.default_rng(seed)

    def off() -> float:
        return float(1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.03))

    def change(spec: mujoco.MjSpec) -> None:
        for joint in spec.joints:
            joint.damping = np.asarray(joint.damping) * off()
        for actuator in spec.actuators:
            factor = off()
            actuator.gainprm = np.asarray(actuator.gainprm) * np.array([factor] + [1.0] * 9)
            actuator.biasprm = np.asarray(actuator.biasprm) * np.array([1.0, factor] + [1.0] * 8)
        edit(spec)

    return gap_case.record(folder, missing=False, edit=change)


def test_nothing_is_named_where_nothing_is_missing(tmp_path: Path) -> None:
    recording = record(tmp_path / "r", lambda spec: None, seed=3)
    found = find_gap(recording, GapSettings(threads=1))
    assert found.verdict == "no_gap"
    assert found.effects == ()
    assert 0.9 < found.best.held_out_rms < 1.15


def test_friction_is_named_with_its_place_and_its_torque(tmp_path: Path) -> None:
    def edit(spec: mujoco.MjSpec) -> None:
        spec.joint("joint2").frictionloss = 2.0
        make_it_stick(spec.joint("joint2"), STEP)

    lines: list[str] = []
    recording = record(tmp_path / "r", edit, seed=4)
    kinds = (
        "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag",
        "joint_spring", "rotor_inertia", "link_mass", "payload", "actuator_gain", "command_delay",
    )  # fmt: skip
    found = find_gap(recording, GapSettings(threads=1, kinds=kinds), say=lines.append)
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

    return record(tmp_path_factory.mktemp("heavier") / "r", edit, seed=5)


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


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("tolerance", 0.7, "a share above 0 and below 0.5"),
        ("tolerance", "0.1", "a share above 0 and below 0.5"),
        ("held_share", float("nan"), "a share above 0 and below 1"),
        ("most_effects", 0, "a whole number, 1 to 30"),
        ("most_effects", 2.5, "a whole number, 1 to 30"),
        ("search_seconds", 0, "a time above 0 s"),
        ("fit_seconds", float("nan"), "a time above 0 s"),
        ("held_seconds", True, "a time above 0 s"),
        ("seed", 2**63, "a whole number, 0 or more"),
        ("seed", 1.0, "a whole number, 0 or more"),
        ("threads", -1, "a whole number, 0 to 10000"),
        ("kinds", "backlash", "a tuple of words"),
        ("held_out", (3,), "a tuple of words"),
    ],
)
def test_settings_out_of_range_are_refused(name: str, wrong: object, words: str) -> None:
    message = rf"^{name} is {words}.*, got {re.escape(repr(wrong))}$"
    with pytest.raises(InvalidSetting, match=message):
        GapSettings(**{name: wrong})  # type: ignore[arg-type]


def test_a_long_stage_tells_every_ten_seconds_how_far_it_is_and_what_is_left() -> None:
    now, lines, times = 0.0, list[str](), list[float]()

    def keep(line: str) -> None:
        lines.append(line)
        times.append(now)

    with reported(keep, clock=lambda: now) as say:
        for _ in counted("starts", range(100)):
            now += 1.0
            tick()
        assert max(after - before for before, after in itertools.pairwise(times)) < 10
        assert all("starts: " in line and " of 100" in line for line in lines)
        done, left = (int(lines[-1].split(word)[0].split()[-1]) for word in (" of", " s left"))
        assert abs(left - (100 - done)) <= 2
        lines.clear()
        for item in range(5):  # silent while the search itself speaks
            now += 4.0
            say(f"fit {item}")
            tick()
        assert lines == [f"fit {item}" for item in range(5)]


KINDS = ("viscous_friction", "sensor_gain", "coulomb_friction", "link_mass")


@pytest.fixture(scope="module")
def two_missing(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return gap_case.record(tmp_path_factory.mktemp("gap") / "recording")


def test_a_quick_look_ranks_the_leading_hypothesis_first(two_missing: Recording) -> None:
    lines: list[str] = []
    look = quick_look(two_missing, GapSettings(kinds=KINDS, threads=1), say=lines.append)
    assert look.before > 3
    first, *others = look.candidates
    assert len(look.candidates) <= 3
    named = {effect.kind for effect in first.effects}
    assert named <= {"viscous_friction", "sensor_gain"} and named
    assert first.explained > 0.5 and first.held_out_z > 3 and first.held_out < look.before
    assert all(each.held_out > 0 for each in others)
    assert any("noise standard deviations" in words for words in look.location_words)
    assert any("screening" in line or "nominal model" in line for line in lines)
    values = dict(zip((effect.kind for effect in first.effects), first.parameters, strict=True))
    true = {"viscous_friction": gap_case.DAMPING, "sensor_gain": gap_case.GAIN}
    for kind, parameters in values.items():
        assert next(iter(parameters.values())) == pytest.approx(true[kind], rel=0.3)


def test_the_quick_command_writes_one_file_and_says_that_it_does_not_decide(
    two_missing: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["gap", str(two_missing.folder), "--quick", "--ignore-doctor", "--out"]
    refused = [*words, str(tmp_path / "none"), "--rerun", str(tmp_path / "motion.rrd")]
    assert main(refused) == 1
    assert "leave one of them out" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
    out = tmp_path / "out"
    assert main([*words, str(out), "--kinds", KINDS[0], "--threads", "1"]) == 0
    assert "does not decide" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir() if path.name != ".gap") == ["quick.json"]
    whole = json.loads((out / "quick.json").read_text(encoding="utf-8"))
    assert whole["format"] == FORMAT and whole["candidates"]


def test_nothing_is_ranked_where_the_residual_is_noise(tmp_path: Path) -> None:
    from loose_env.report import quick_text

    assert QuickLook(before=1.0).candidates == ()
    assert "it is white" in quick_text(QuickLook(before=1.0))
    recording = gap_case.record(tmp_path / "recording", missing=False)
    look = quick_look(recording, GapSettings(kinds=KINDS, threads=1))
    assert look.candidates == () and look.before < 1.25


PENDULUM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0025" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="rod">
      <joint name="pivot" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.0005"/>
    </body>
  </worldbody>
  <sensor><jointpos name="encoder" joint="pivot"/></sensor>
</mujoco>
"""
OIL, SEAL, AIR = 0.004, 0.012, 0.002
"""What slows a pendulum down: N·m·s/rad, N·m, N·m·s²/rad²."""


@pytest.mark.slow
def test_oil_seals_and_air_at_one_joint_are_told_apart(tmp_path: Path) -> None:
    def change(_: float, state: Array) -> list[float]:
        angle, speed = state
        friction = OIL * speed + SEAL * np.tanh(speed / 0.003) + AIR * speed * abs(speed)
        return [speed, (-0.5 * 9.81 * 0.3 * np.sin(angle) - friction) / (0.01 + 0.5 * 0.3**2)]

    time, rng, runs = np.arange(600) / 100, np.random.default_rng(6), []
    for k, start in enumerate((2.0, -1.2, 0.8, -1.7)):
        angle = solve_ivp(
            change, (0, time[-1]), (start, 0.0), t_eval=time, rtol=1e-8, atol=1e-10, method="LSODA"
        ).y[0]
        sensors = {"encoder": angle + rng.normal(0, 1e-3, len(time))}
        runs.append(Run(name=f"drop-{k}.parquet", time=time, sensors=sensors))
    recording = write_recording(tmp_path / "pendulum", model_xml=PENDULUM, runs=runs)
    found = explain_gap(recording, GapSettings(threads=1, held_out=("drop-3",)))
    values = {e.kind: next(iter(e.parameters.values())) for e in found.effects}
    assert found.verdict == "named"
    assert values == {
        "viscous_friction": pytest.approx(OIL, rel=0.1),
        "coulomb_friction": pytest.approx(SEAL, rel=0.1),
        "quadratic_drag": pytest.approx(AIR, rel=0.1),
    }
    assert found.gap.after < 1.25 and found.gap.before > 100


# The plane is level, so that nothing but the motion throws a slide to and fro.
LEVEL = PLANAR.replace('gravity="0 -9.81 0"', 'gravity="0 0 -9.81"')
FINE, EVERY = 2e-4, 5
"""Step [s], and steps from one sample to the next."""


def with_effect(kind: str, where: str, values: Sequence[float]) -> mujoco.MjSpec:
    """The level arm in fine steps, with an effect."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
    CATALOGUE[kind](machine, where).edit(spec, np.array(values))
    return spec


def shaken(folder: Path, spec: mujoco.MjSpec) -> Recording:
    """Poses that are kept while the first joint is shaken at random; readings have noise."""
    model, rng, count = spec.compile(), np.random.default_rng(4), 1800
    band = signal.butter(4, (10, 120), "bandpass", fs=1000, output="sos")
    runs = []
    for k, pose in enumerate(([0.3, 0.8, -0.5], [-0.4, 1.2, 0.6], [0.9, -0.9, 0.3])):
        shake = signal.sosfilt(band, rng.normal(size=count + 500))[500:]
        controls = np.tile(pose, (count, 1))
        controls[:, 0] += 0.02 * shake / shake.std() * np.minimum(np.arange(count) / 200, 1)
        data, shown = mujoco.MjData(model), np.zeros((count, model.nsensordata))
        for j, angle in enumerate(pose):
            data.joint(f"joint{j + 1}").qpos[0] = angle
        data.ctrl[:] = pose
        mujoco.mj_step(model, data, 2000)
        for row, command in zip(shown, controls, strict=True):
            data.ctrl[:] = command
            mujoco.mj_forward(model, data)
            row[:] = data.sensordata
            mujoco.mj_step(model, data, EVERY)
        shown += rng.normal(0, [2e-5, 2e-5, 2e-5, 2e-3, 0.03, 0.03, 0.03], shown.shape)
        names = ("encoder1", "encoder2", "encoder3", "rate3")
        runs.append(
            Run(
                name=f"run-{k + 1:02d}.parquet",
                time=np.arange(count) * FINE * EVERY,
                controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
                sensors={n: shown[:, c] for c, n in enumerate(names)} | {"shake": shown[:, 4:]},
                excited=("joint1",),
            )
        )
    return write_recording(folder, model_xml=LEVEL, runs=runs)


@pytest.fixture(scope="module")
def struck(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Of a link with hard stops that ring."""
    spec = with_effect("structural_looseness", "link2", [1.0, 2e-4, 1.0, 1e6, 0.03])
    return shaken(tmp_path_factory.mktemp("struck") / "recording", spec)


def test_runs_that_impacts_make_chaotic_are_told_of(struck: Recording, tmp_path: Path) -> None:
    healthy = shaken(tmp_path / "healthy", with_effect("viscous_friction", "joint1", [0.0]))
    for recording, chaotic in ((struck, True), (healthy, False)):
        warnings = prepare(recording, GapSettings(threads=1)).warnings
        assert any("chaotic (impacts against stops)" in words for words in warnings) is chaotic


@pytest.mark.slow
def test_the_loose_link_is_named(struck: Recording) -> None:
    kinds = ("structural_looseness", "joint_compliance", "viscous_friction")
    found = find_gap(struck, GapSettings(threads=1, kinds=kinds, most_effects=1))
    assert found.verdict == "named"
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("structural_looseness", "link2")
    assert found.best.held_out_rms < 0.5 * found.base.held_out_rms
    result = result_of(found, diagnose_residuals(found))
    assert result.gap.after < 0.5 * result.gap.before
    assert result.effects[0].where == "link2"
    names = {channel.name for channel in found.problem.held_out_whole.channels}
    assert set(result.gap.by_channel) == names
    before, after = result.gap.by_channel["sensor.shake.y"]
    assert before > 3 and after < 0.6 * before
    assert {left.channel for left in result.residual_tests} == names
