"""Starting values of effects from data: residual torques and residual accelerations of runs.

The motion of runs with commands is smoothed and put into the inverse dynamics of the model, and the
result is subtracted from the actuator torque at the measured commands and state; runs with measured
torques give that residual themselves. An effect with too many possible starts, such as a ripple of
any period, fits its start to this residual torque. A loose link takes its direction from the
accelerometer residuals, a compliant joint its stiffness from measured torques
(`loose_env.gap.selection.screening.stiffness_starts`).
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.actuator_states import activations
from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.data.smoothing import SmoothedMotion, smooth_motion
from loose_env.gap.model.data_starts import ResidualAccelerations
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.sensor_columns import column_of
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.stiffness_starts import joint_stiffness
from loose_env.gap.simulation.applied_torque_terms import torque_terms
from loose_env.gap.simulation.driven_effects import Driven
from loose_env.statistics import resolution_of
from loose_env.typing import Array

_DYNAMICS_SAMPLES = 6000
"""Samples of all runs that are evaluated, at most."""
_TURNING = 0.01
"""Speed below which the direction of friction is in doubt, as a share of the largest."""
_OFF = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


def proposals(
    comparison: ResidualModel, hypothesis: Hypothesis, candidates: Sequence[Effect]
) -> dict[tuple[str, str, str], tuple[tuple[float, ...], ...]]:
    """Return data-driven starts by candidate key; {} where no run has commands."""
    starts: dict[tuple[str, str, str], tuple[tuple[float, ...], ...]] = {}
    along = [e for e in candidates if type(e).propose_along is not Effect.propose_along]
    residual = residual_accelerations(comparison, hypothesis) if along else None
    if residual is not None:
        starts |= {e.key: own for e in along if (own := e.propose_along(residual))}
    for effect in candidates:
        if type(effect).propose_from is not Effect.propose_from:
            starts[effect.key] = _from_readings(comparison, effect)
    springs = [e for e in candidates if type(e).propose_stiffness is not Effect.propose_stiffness]
    if springs:
        stiffness = joint_stiffness(comparison, hypothesis)
        starts |= {
            e.key: e.propose_stiffness(stiffness[e.where]) for e in springs if e.where in stiffness
        }
    searching = [effect for effect in candidates if effect.needs_data_starts]
    limits = [e for e in candidates if type(e).propose_limit is not Effect.propose_limit]
    found = residual_torque(comparison, hypothesis) if searching or limits else None
    if found is None:
        return starts
    angle, speed, acceleration, torque, needed = found
    machine = comparison.machine
    for effect in searching:
        k = machine.joint_number(effect.where)
        read = np.isfinite(torque[:, k])
        if read.any() and np.ptp(angle[read, k]) > 0:
            starts[effect.key] = effect.propose(
                angle[read, k], speed[read, k], acceleration[read, k], torque[read, k]
            )
    for effect in limits:
        k = machine.joint_number(machine.actuated_joint[effect.where])
        read = np.isfinite(needed[:, k])
        if read.any():
            own = needed[read, k]
            starts[effect.key] = effect.propose_limit(speed[read, k], own + torque[read, k], own)
    return starts


def _from_readings(comparison: ResidualModel, effect: Effect) -> tuple[tuple[float, ...], ...]:
    """Starts from the coarsest resolution of a sensor's readings; none if some run has none.

    Runs in which the channel stays on one step do not tell.
    """
    column = column_of(effect.where)
    numbers = [k for k, channel in enumerate(comparison.channels) if channel.column == column]
    columns = [run.measured[:, k] for run in comparison.trials for k in numbers]
    steps = [resolution_of(each) for each in columns if len(np.unique(each[np.isfinite(each)])) > 1]
    return effect.propose_from(max(steps)) if steps and all(steps) else ()


def residual_torque(
    comparison: ResidualModel, hypothesis: Hypothesis
) -> tuple[Array, Array, Array, Array, Array] | None:
    """Motion, residual torque and needed torque of all runs with commands or measured torques."""
    machine = comparison.machine
    rigid = [(effect, values) for effect, values in hypothesis.pairs if not effect.adds_motion]
    known = hypothesis.of_model.with_effects(rigid)
    step = machine.time_step
    model = known.model(machine, step)
    model.opt.disableflags |= _OFF
    runs = [trial for trial in comparison.trials if trial.form == "forward"]
    parts = _compared(comparison, known)
    for trial in runs:
        try:
            motion = smooth_motion(trial, machine, comparison.channels)
        except InvalidData:
            continue
        found = _missing(model, known, trial, motion, max(1, _DYNAMICS_SAMPLES // len(runs)))
        if found is None:
            break  # an activation that nothing tells: of inverse runs the torques are known
        parts.append(found)
    if not parts:
        return None
    position, speed, acceleration, torque, needed = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    return position, speed, acceleration, torque, needed


def _compared(
    comparison: ResidualModel, known: Hypothesis
) -> list[tuple[Array, Array, Array, Array, Array]]:
    """Motion, residual and needed torque of the runs whose torques are compared with motion."""
    inverse = comparison.inverse
    if inverse is None:
        return []
    parts = []
    predicted = inverse.predict([known])[0]
    for t, motion in enumerate(inverse.motions):
        own = motion.chosen
        torque, needed = np.full((2, *motion.position[own].shape), np.nan)
        for channel, joint in inverse.torque_joints.items():
            needed[:, joint] = predicted[t][own, channel]
            torque[:, joint] = inverse.measured(t)[own, channel] - needed[:, joint]
        parts.append(
            (motion.position[own], motion.speed[own], motion.acceleration[own], torque, needed)
        )
    return parts


def _missing(
    model: mujoco.MjModel, known: Hypothesis, trial: Trial, motion: SmoothedMotion, most: int
) -> tuple[Array, Array, Array, Array, Array] | None:
    """Motion, residual and needed torque of one run; None where an activation is not known."""
    times = trial.step * np.arange(trial.steps, dtype=np.float64)
    controls = trial.controls
    for effect, values in known.pairs:
        controls = effect.command(times, controls, values)
    states = activations(model, controls, trial.step)
    if states is None:
        return None
    given = _about(controls, trial.step, motion.time)
    acting = _about(states, trial.step, motion.time)
    # At the ends of a run the filter is one-sided.
    ends = min(int(motion.band.rate / motion.band.end), len(motion.time) // 4)
    chosen = np.arange(ends, len(motion.time) - ends, max(1, len(motion.time) // most))
    joints = len(trial.joints)
    friction = model.dof_frictionloss[:joints]
    slow = _TURNING * np.maximum(np.abs(motion.speed).max(axis=0), 1e-9)
    data = mujoco.MjData(model)
    torque, needed = np.zeros((2, len(chosen), joints))
    driven = Driven.of(known)
    for row, own, k in zip(torque, needed, chosen, strict=True):
        data.qpos[:joints], data.qvel[:joints] = motion.position[k], motion.speed[k]
        data.qacc[:joints] = motion.acceleration[k]
        data.ctrl[: controls.shape[1]] = given[k]
        data.act[:] = acting[k]
        mujoco.mj_inverse(model, data)
        rigid = data.qfrc_inverse[:joints].copy()
        mujoco.mj_fwdActuation(model, data)
        drive = data.qfrc_actuator[:joints]
        load = -data.qfrc_bias[:joints]
        rubbing = friction + driven.frictions(drive, load, motion.speed[k])
        own[:] = rigid + rubbing * np.tanh(motion.speed[k] / slow)
        row[:] = drive - own
    further = torque_terms(known, motion.position[chosen], motion.speed[chosen])
    return (
        motion.position[chosen], motion.speed[chosen], motion.acceleration[chosen],
        torque + further, needed - further,
    )  # fmt: skip


def _about(controls: Array, step: float, times: Array) -> Array:
    """Average commands or activations (T, N) as the smoothing filter does the motion.

    Values are sampled on an even grid. A command is held from one sample to the next. On the mean
    over an interval about a sample it comes half an interval late, which behind a stiff servo is a
    torque like that of friction.
    """
    summed = np.concatenate([np.zeros((1, controls.shape[1])), np.cumsum(controls, axis=0)])
    edges = step * np.arange(len(summed), dtype=np.float64)
    half = 0.5 * float(times[1] - times[0])
    begin = np.clip(times - half, 0.0, edges[-1] - 2 * half)
    found = np.empty((len(times), controls.shape[1]))
    for k in range(controls.shape[1]):
        ends = np.interp(begin + 2 * half, edges, summed[:, k])
        found[:, k] = (ends - np.interp(begin, edges, summed[:, k])) * step / (2 * half)
    return found


_ACCELEROMETER_SAMPLES = 2000
"""Samples of all runs that are taken, about."""


def residual_accelerations(
    comparison: ResidualModel, hypothesis: Hypothesis
) -> ResidualAccelerations | None:
    """Return residuals of three-axis accelerometers in simulated runs."""
    model, channels = comparison.machine.model, comparison.channels
    triads = []
    for column in dict.fromkeys(channel.column for channel in channels):
        own = [k for k, channel in enumerate(channels) if channel.column == column]
        kind, _, name = column.partition(".")
        if kind == "sensor" and len(own) == 3:
            sensor = model.sensor(name)
            if int(sensor.type[0]) == int(mujoco.mjtSensor.mjSENS_ACCELEROMETER):
                triads.append((model.site(int(sensor.objid[0])).name, own))
    runs = [t for t, trial in enumerate(comparison.trials) if trial.form == "forward"]
    if not triads or not runs:
        return None
    predicted = comparison.predict([hypothesis])[0]
    poses, sites, found = [], [], []
    for t in runs:
        trial = comparison.trials[t]
        apart = trial.measured - predicted[t]
        at = np.tile(trial.position, (len(trial.time), 1))
        for j, joint in enumerate(trial.joints):
            at[:, j] = trial.motion.get(joint, at[:, j])
        for site, own in triads:
            read = np.isfinite(apart[:, own]).all(axis=1) & np.isfinite(at).all(axis=1)
            good = np.flatnonzero(read)
            taken = good[:: max(1, len(good) * len(runs) * len(triads) // _ACCELEROMETER_SAMPLES)]
            poses.append(at[taken])
            found.append(apart[taken][:, own])
            sites += [site] * len(taken)
    if not sites:
        return None
    return ResidualAccelerations(
        joints=comparison.trials[runs[0]].joints,
        poses=np.concatenate(poses),
        sites=tuple(sites),
        accelerations=np.concatenate(found),
    )
