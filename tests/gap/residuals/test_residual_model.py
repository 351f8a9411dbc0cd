"""Runs of every form in one comparison."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.autocorrelation import LaggedProducts, largest
from loose_env.gap.residuals.residual_model import Rows
from loose_env.gap.selection.screening.grouping import joint_of
from loose_env.recording import Run
from tests.gap.cases.effect_arms import PLANAR, commands, simulate
from tests.gap.cases.recorded_runs import compared, measurable, torque_run

NOTHING = Hypothesis()
_OF_DRIVES = ("actuator_gain", "actuator_lag", "command_delay")


def mixed() -> tuple[NominalModel, list[Run]]:
    """A commanded run and one of motion and torque."""
    machine = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
    rng = np.random.default_rng(1)
    time = np.arange(4000) * 0.001
    controls = commands(machine, time)
    still = np.zeros((1500, controls.shape[1]))  # held until it rests
    read = simulate(machine.model, np.concatenate([still, controls]))
    sensors = {
        name: read[f"sensor.{name}"][1500:] + rng.normal(0, 1e-3, 4000)
        for name in ("joint1_pos", "joint2_pos", "joint3_pos")
    }
    ahead = Run(
        name="ahead",
        time=time,
        controls={name: controls[:, k] for k, name in enumerate(machine.actuators)},
        sensors=sensors,
    )
    back = torque_run(machine, machine.model, rng, step=1.7e-3, speeds=None, name="back")
    return machine, [back, ahead]


def test_each_run_is_compared_by_its_form() -> None:
    machine, runs = mixed()
    comparison = compared(machine, runs, step=0.001)
    rows = comparison.rows
    names = np.array([c.column for c in comparison.channels])
    assert set(names[rows.channel[rows.trial == 0]]) == {f"torque.joint{k}" for k in (1, 2, 3)}
    assert set(names[rows.channel[rows.trial == 1]]) == {f"sensor.joint{k}_pos" for k in (1, 2, 3)}
    payload = CATALOGUE["payload"](machine, "tool")
    loaded = Hypothesis(effects=(payload,), values=(np.array(payload.starts[0]),))
    residuals = comparison.residuals([NOTHING, loaded])
    sizes = np.array([[np.std(r[rows.trial == t]) for t in (0, 1)] for r in residuals])
    assert np.all(sizes[0] < 1.5)
    assert sizes[1, 0] > 5.0 and sizes[1, 1] > 1.3


def test_starts_reach_the_run_they_belong_to() -> None:
    machine, runs = mixed()
    comparison = compared(machine, runs, step=0.001)
    shift = np.zeros((2, 3))
    shift[0] = 0.3  # of the inverse run, which has no start
    moved = Hypothesis(effects=(), values=(), position=shift, speed=np.zeros((2, 3)))
    first, second = comparison.residuals([NOTHING, moved])
    assert np.array_equal(first, second)


def test_neighbours_of_an_inverse_run_count_as_neighbours() -> None:
    machine, runs = mixed()
    comparison = compared(machine, runs, step=0.001)
    structure = LaggedProducts(comparison.rows)
    residual = comparison.residuals([NOTHING])[0]
    *sums, counts = structure.by_channel(residual)
    torques = np.bincount(comparison.rows.channel[comparison.rows.trial == 0])
    assert np.all(counts[: len(torques)] > 0.5 * torques)
    assert structure.products(residual).sum(axis=1) == pytest.approx(np.sum(sums, axis=1))
    assert np.all(np.abs(np.sum(sums, axis=1)) < 0.25 * counts.sum())


@pytest.mark.parametrize("shaken", [False, True])
@pytest.mark.parametrize("frequency", [0.01, 0.125, 0.16, 0.25, 0.3])
def test_what_rings_is_structure_and_noise_is_not(frequency: float, *, shaken: bool) -> None:
    count, rng = 20000, np.random.default_rng(5)
    place, alone = np.arange(count), np.zeros(count, dtype=np.intp)
    rows = Rows(
        trial=alone, channel=alone, sample=place, index=place, block=place // 500,
        random_excitation=np.full(count, shaken), is_feature=np.zeros(count, dtype=bool),
        inverse=np.zeros(count, dtype=bool),
    )  # fmt: skip
    structure = LaggedProducts(rows)
    noise, ring = rng.normal(size=count), np.sin(2 * np.pi * frequency * place)
    assert largest(structure.products(noise).sum(axis=1)) < 4 * np.sqrt(count)
    found = largest(structure.products(noise + ring).sum(axis=1)) / np.sum(ring**2)
    assert 0.65 < found < 1.1


def let_go(run: Run) -> Run:
    """The motion of a run as a free one."""
    return Run(name="free", time=run.time, sensors=run.sensors)


def test_a_free_run_shows_what_is_at_joints_named_like_their_motors() -> None:
    xml = PLANAR.replace('name="servo', 'name="joint')
    machine = NominalModel(measurable(mujoco.MjSpec.from_string(xml)))
    assert machine.actuators == machine.joints
    comparison = compared(machine, [let_go(mixed()[1][1])], step=0.001)
    shown = {repr(e) for e in candidates(machine) if comparison.shows(e)}
    assert shown >= {"viscous_friction@joint1", "backlash@joint2", "payload@tool"}
    assert not any(name.split("@")[0] in _OF_DRIVES for name in shown)


class MotorStiffness(Effect):
    """As of one's own, which does not say what it acts on."""

    kind = "motor_stiffness"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        return machine.actuators

    def edit(self, spec: mujoco.MjSpec, values: np.ndarray) -> None:
        spec.actuator(self.where).gainprm[0] *= values[0]


class MotorHold(MotorStiffness):
    kind = "motor_hold"
    acts_on = "actuator"


class Late(MotorStiffness):
    kind = "late"

    def command(self, time: np.ndarray, controls: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.roll(controls, 1, axis=0)


class Creep(Effect):
    kind = "creep"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        return machine.sensors


def test_what_an_effect_acts_on_is_told_by_its_class_and_else_by_names() -> None:
    machine = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
    assert MotorStiffness(machine, "servo1").part == "actuator"
    assert CATALOGUE["payload"](machine, "tool").part == "arm"
    shared = PLANAR.replace('name="servo', 'name="joint').replace('name="encoder', 'name="joint')
    machine = NominalModel(mujoco.MjSpec.from_string(shared))
    kinds = (MotorStiffness, MotorHold, Late, Creep, CATALOGUE["viscous_friction"])
    found = [kind(machine, "joint2") for kind in kinds]
    assert [e.part for e in found] == ["joint", "actuator", "actuator", "sensor", "joint"]
    assert [joint_of(e) for e in found] == [1] * 5
    assert [e.drives for e in found] == [False, True, True, False, False]


def test_a_forward_run_shows_every_effect() -> None:
    machine, runs = mixed()
    both, ahead = compared(machine, runs, step=0.001), compared(machine, runs[1:], step=0.001)
    assert ahead.inverse is None
    for effect in candidates(machine):
        assert both.shows(effect)
        assert ahead.shows(effect)
