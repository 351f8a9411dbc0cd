"""Torques of a motion whose drives give way: how they begin, and what noise they carry."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.data.motion_band import motion_band
from loose_env.gap.data.smoothing import smooth_motion
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.selection.screening.data_driven_starts import proposals
from loose_env.gap.selection.screening.stiffness_starts import joint_stiffness
from loose_env.recording import Run
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.recorded_runs import compared, measurable, torque_run

NOTHING = Hypothesis()
MACHINE = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
SPRING = CATALOGUE["joint_compliance"](MACHINE, "joint2")


def spring(stiffness: float, ratio: float) -> Hypothesis:
    return Hypothesis(effects=(SPRING,), values=(np.array([stiffness, ratio]),))


def test_a_spring_hangs_in_its_sag_when_a_run_begins() -> None:
    run = torque_run(MACHINE, MACHINE.model, np.random.default_rng(1))
    comparison = compared(MACHINE, [run])
    assert comparison.inverse is not None
    motion = comparison.inverse.motions[0]
    still = replace(
        motion, position=np.tile(motion.position[:1], (len(motion.time), 1)),
        speed=np.zeros_like(motion.speed), acceleration=np.zeros_like(motion.acceleration),
    )  # fmt: skip
    torque = comparison.inverse._drive.torque(spring(150.0, 0.005), still)
    assert np.all(np.abs(torque[0]) > 1.0)  # it carries the arm
    assert np.all(np.ptp(torque, axis=0) < 0.01 * np.abs(torque[0]))


def test_a_soft_spring_shuts_out_noise_and_a_resonance_lets_it_in() -> None:
    rngs = [np.random.default_rng(k) for k in range(2)]
    runs = [torque_run(MACHINE, MACHINE.model, rng, noise=1e-4) for rng in rngs]
    comparison = compared(MACHINE, runs)
    channel = [c.name for c in comparison.channels].index("torque.joint2")
    own = comparison.rows.channel == channel
    end = comparison.inverse.motions[0].band.end  # type: ignore[union-attr]

    def level(mode: float, ratio: float) -> float:
        stiffness = SPRING.carried * (2 * np.pi * mode) ** 2  # type: ignore[attr-defined]
        found = comparison.levels(spring(stiffness, ratio))
        assert found.shape == comparison.measured.shape
        return float(np.mean(found[own]))

    assert np.all(comparison.levels(NOTHING) == 1.0)
    soft, rings, stiff = level(0.2 * end, 0.5), level(0.7 * end, 0.01), level(10.0 * end, 0.1)
    assert soft < 0.9 * stiff and rings > 1.5 * stiff


@pytest.mark.parametrize("noise", [1e-4, 0.05])
def test_the_band_ends_with_the_motion_or_where_the_torques_noise_is_the_less(noise: float) -> None:
    run = torque_run(MACHINE, MACHINE.model, np.random.default_rng(1), noise=noise)
    channels = channels_of([run])
    trial = align_run(run, MACHINE, channels, step=0.001)
    motion = smooth_motion(trial, MACHINE, channels)
    columns = [run.sensors[name] for name in run.sensors]
    highest = motion_band(columns, trial.rate)
    if noise == 0.05:
        assert motion.band.end == pytest.approx(2 * highest)
    else:
        assert motion.band.end < 2 * highest


def compliant_run(stiffness: float) -> Run:
    """A motion of rotors, and the torques by which a compliant second joint follows it."""
    run = torque_run(MACHINE, MACHINE.model, np.random.default_rng(4), noise=1e-4)
    comparison = compared(MACHINE, [run])
    assert comparison.inverse is not None
    motion = comparison.inverse.motions[0]
    torque = comparison.inverse._drive.torque(spring(stiffness, 0.05), motion)
    return replace(
        run, torques={name: torque[:, MACHINE.joint_number(name)] for name in run.torques}
    )


@pytest.mark.parametrize("mode", [3.0, 8.0])
def test_the_stiffness_of_a_joint_is_read_from_its_torque(mode: float) -> None:
    stiffness = SPRING.carried * (2 * np.pi * mode) ** 2  # type: ignore[attr-defined]
    comparison = compared(MACHINE, [compliant_run(stiffness)])
    found = joint_stiffness(comparison, NOTHING)
    assert found["joint2"] == pytest.approx(stiffness, rel=0.1)
    starts = proposals(comparison, NOTHING, [SPRING])[SPRING.key]
    assert starts[0][0] == found["joint2"] and set(SPRING.inverse_starts) <= set(starts)


def test_longer_steps_change_little_of_what_a_spring_does() -> None:
    run = torque_run(MACHINE, MACHINE.model, np.random.default_rng(1))
    comparison = compared(MACHINE, [run])
    cheaper = comparison.with_cheaper_integrator()
    stiffness = SPRING.carried * (2 * np.pi * 8.0) ** 2  # type: ignore[attr-defined]
    tried = [NOTHING, spring(stiffness, 0.4)]
    exact, cheap = (
        found[1] - found[0] for found in (comparison.residuals(tried), cheaper.residuals(tried))
    )
    assert np.linalg.norm(exact) > 10
    assert np.linalg.norm(cheap - exact) < 0.06 * np.linalg.norm(exact)


def test_a_run_without_the_torque_of_a_joint_says_nothing_of_its_stiffness() -> None:
    stiffness = SPRING.carried * (2 * np.pi * 8.0) ** 2  # type: ignore[attr-defined]
    whole = compliant_run(stiffness)
    others = {name: torque for name, torque in whole.torques.items() if name != "joint2"}
    comparison = compared(MACHINE, [whole, replace(whole, torques=others)])
    assert joint_stiffness(comparison, NOTHING)["joint2"] == pytest.approx(stiffness, rel=0.1)
