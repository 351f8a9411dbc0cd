"""What motions cannot show, or tell apart, is said before anything is made of it."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.data.aligned_run import Channel, align_run
from loose_env.gap.diagnostics.experiment_advice import how_to_see, identifiability_notes
from loose_env.gap.diagnostics.identifiability import identifiability
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.evidence_schema import Identifiability
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.recording import Run
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import stated

STEP = 0.002
MACHINE = NominalModel(
    mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=int(mujoco.mjtIntegrator.mjINT_RK4)
)
CHANNELS = tuple(Channel(f"sensor.encoder{j}") for j in (1, 2, 3))
FLOORS = np.full(3, 2e-5)


def compared(
    wave: Array, effects: list[Effect], values: list[Array], machine: NominalModel = MACHINE
) -> ResidualModel:
    """A run under these commands of an arm with some effects, and noise."""
    count = len(wave)
    run = Run(
        name="a.csv", time=STEP * np.arange(count),
        controls={f"servo{j + 1}": wave[:, j] for j in range(3)},
        sensors={f"encoder{j + 1}": 1e-9 * np.arange(count) for j in range(3)},
    )  # fmt: skip
    trial = align_run(run, machine, CHANNELS, step=STEP)
    plain = ResidualModel(machine, [trial], CHANNELS, FLOORS, threads=1)
    shown = plain.predict([Hypothesis(effects=tuple(effects), values=tuple(values))])[0][0]
    trial.measured[:] = shown + np.random.default_rng(2).normal(0, FLOORS, shown.shape)
    return ResidualModel(machine, [trial], CHANNELS, FLOORS, threads=1)


def swings(seconds: float, size: float = 0.6, rate: float = 5.0) -> Array:
    time = STEP * np.arange(round(seconds / STEP))
    shape = np.minimum(time, 1.0)[:, None] * np.sin(
        np.outer(time, rate * np.array([1.0, 1.4, 1.9]))
    )
    return size * shape


def found_on(
    comparison: ResidualModel, effects: list[Effect], values: list[Array], kinds: list[str]
) -> Identifiability:
    fitted = stated(comparison, effects, values)
    return identifiability(comparison, fitted, candidates(comparison.machine, kinds))


def test_a_joint_that_turns_round_shows_its_friction_and_one_that_stands_does_not() -> None:
    wave = swings(3.0)
    wave[:, 2] = 0.0
    found = found_on(compared(wave, [], []), [], [], ["quadratic_drag", "joint_compliance"])
    unseen = {(each.kind, each.where) for each in found.unidentifiable}
    assert ("quadratic_drag", "joint1") not in unseen
    slow = found_on(
        compared(swings(3.0, 0.002, 0.7), [], []), [], [], ["quadratic_drag", "viscous_friction"]
    )
    drag = [each for each in slow.unidentifiable if each.kind == "quadratic_drag"]
    assert {each.where for each in drag} >= {"joint2", "joint3"}
    assert all(each.z < 5 and (each.additional_s is None or each.additional_s > 0) for each in drag)
    words = [w for w in identifiability_notes(slow) if "quadratic_drag" in w]
    assert len(words) == 1 and how_to_see("quadratic_drag") in words[0]


def test_effects_that_do_the_same_are_alike_and_more_of_the_same_is_no_help() -> None:
    """In a vertical plane a tilted base and a first encoder off its zero are the same."""
    spec = mujoco.MjSpec.from_string(PLANAR)
    spec.joint("joint1").stiffness = np.zeros(3)  # a spring feels the joint itself turn
    machine = NominalModel(spec, step=STEP, integrator=MACHINE.integrator)
    tilt = CATALOGUE["base_tilt"](machine, "base")
    values = [np.array([0.05])]
    comparison = compared(swings(3.0), [tilt], values, machine)
    found = found_on(
        comparison, [tilt], values, ["base_tilt", "encoder_offset", "coulomb_friction"]
    )
    (pair,) = [p for p in found.confusable if p.kind == "base_tilt"]
    assert (pair.other_kind, pair.other_where) == ("encoder_offset", "joint1")
    assert pair.z < 5 and pair.additional_s is None
    (words,) = [w for w in identifiability_notes(found) if "do not tell" in w]
    assert "spirit level" in words


def test_a_longer_recording_shows_more() -> None:
    kinds = ["quadratic_drag", "viscous_friction", "rotor_inertia", "actuator_lag"]
    wave = swings(2.0, 0.05, 2.0)
    once, often = (
        found_on(compared(np.tile(wave, (times, 1)), [], []), [], [], kinds) for times in (1, 8)
    )
    assert len(often.unidentifiable) <= len(once.unidentifiable)
    left = {(e.kind, e.where) for e in often.unidentifiable}
    assert once.unidentifiable
    for each in once.unidentifiable:
        if each.additional_s is not None and each.additional_s < 5:
            assert (each.kind, each.where) not in left
        if each.additional_s is None:
            assert (each.kind, each.where) in left


def test_what_nothing_reads_is_not_spoken_of() -> None:
    found = found_on(compared(swings(2.0), [], []), [], [], ["sensor_gain", "sensor_bias"])
    assert not {e.where for e in found.unidentifiable} & {"shake", "rate3"}
