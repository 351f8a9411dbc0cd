"""Motion, loads and residual torques of a run's joints: measured less inverse dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.signal import periodogram

from loose_env.errors import InvalidData
from loose_env.gap.data.actuator_states import activations
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.motion_band import Band
from loose_env.gap.data.smoothing import SmoothedMotion, filled, smooth_motion
from loose_env.gap.diagnostics.regressors import direction_of
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.statistics import noise_floor
from loose_env.typing import Array

_EDGE = 1.0
"""Periods of the filter's end that are left out at the ends of a run."""
_COURSE = 5
"""Samples of the median that tells a position's course."""
_GLITCH = 8.0
"""Deviation from the course over the usual one, from which a sample is left out [1]: white noise
deviates so far in none of a million samples."""
_MOST_GLITCHES = 0.03
"""Share of such samples above which they are the motion [1]; each spoils three second
differences."""
_LOWEST_HZ = 2.0
"""Lowest end of a band [Hz]."""
_MOTION_SHARE = 0.99
"""Share of a position's variance that is its motion [1]."""
_MOTION_ROOM = 3.0
"""First band's end over the end of the motion [1]: friction has the third harmonic of a swing."""
_RUNG = 1.5
"""Ratio of the ends of bands that are tried [1]."""
_NOISE_GROWTH = 2.0
"""Growth of the residual torque's power with the band, as an exponent, from which it is noise [1]:
that of errors of the readings is 3 to 5, that of a torque levels off."""
_WHITE_GROWTH = 5.0
"""The same of white noise of the positions [1]."""
_TRIED_POINTS = 400
"""Points of a run at which a band is tried."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """Motion of all joints in one run, on a uniform time grid."""

    joints: tuple[str, ...]
    """Names of the joints."""
    units: tuple[str, ...]
    """Unit of each joint's driving force, "N·m" or "N"."""
    time: Array
    """Time [s] (T,)."""
    position: Array
    """Position [rad, m] (T, J); NaN where the joint was not measured."""
    speed: Array
    """Velocity [rad/s, m/s] (T, J)."""
    acceleration: Array
    """Acceleration [rad/s², m/s²] (T, J)."""
    load: Array
    """Inverse dynamics torque [N·m] or force [N] of the nominal model (T, J); NaN where not
    every joint was measured."""
    residual_torque: Array
    """Residual torque (T, J): applied torque less that of the nominal model. NaN where it is not
    known."""
    residual_noise: Array
    """Standard deviation of `residual_torque` due to the noise of the readings (J,)."""

    def regressor(self, name: str, joint: int) -> Array:
        """Values (T,) of one regressor of `diagnostics.regressors` at a joint."""
        if name == "direction":
            return direction_of(self.speed[:, joint])
        table = {"position": self.position, "velocity": self.speed, "load": self.load}
        return np.asarray(table.get(name, self.acceleration)[:, joint])

    def at(self, name: str, joint: int, time: Array) -> Array:
        """Interpolate to other times (N,); directions are not interpolated."""
        values = self.regressor(name, joint)
        if name == "direction":
            near = np.clip(np.searchsorted(self.time, time), 0, len(self.time) - 1)
            return np.asarray(values[near])
        return np.interp(time, self.time, values)


def joint_motion(
    machine: NominalModel, trial: Trial, channels: Sequence[Channel], floors: Array
) -> JointMotion:
    """Compare the measured motion of a run with the nominal model.

    In a forward run the applied torque is that of the nominal actuators at this motion; in an
    inverse run it is the measured torque; in a free run there is none. All of them pass the filter
    that smooths the motion. Where an actuator's activation is not known
    (`loose_env.gap.data.actuator_states`), neither is the applied torque.
    """
    joints = machine.joints
    units = tuple("N·m" if machine.turns(joint) else "N" for joint in joints)
    measured = [np.isfinite(trial.motion.get(joint, np.nan)).any() for joint in joints]
    readings = _without_glitches(machine, trial, channels)
    try:
        smooth = smooth_motion(trial, machine, channels, readings)
    except InvalidData:  # too short
        return _unknown(joints, units, trial)
    known, most = np.array(measured, dtype=bool), np.full(len(joints), np.inf)
    if trial.form != "inverse" and known.all() and machine.model.nv == len(joints):
        smooth, most = _quiet(machine, trial, channels, readings, smooth)
    shape = smooth.position.shape
    load, missing = np.full(shape, np.nan), np.full(shape, np.nan)
    floor = np.full(len(joints), np.nan)
    if known.all() and machine.model.nv == len(joints):
        needed, applied = _torques(machine, trial, smooth)
        load = smooth.band.smooth(needed)
        floor = np.minimum(_needed_noise(machine, trial, smooth), np.sqrt(most))
        if trial.form != "inverse":
            missing = smooth.band.smooth(applied) - load
        passed = np.sqrt(2 * smooth.band.end / smooth.band.rate)
        for c, channel in enumerate(channels):
            prefix, _, name = channel.column.partition(".")
            values = trial.measured[:, c]
            if prefix == "torque" and trial.form == "inverse" and np.isfinite(values).any():
                j = machine.joint_number(name)
                torque = smooth.band.smooth(filled(trial.time, values, smooth.time))
                missing[:, j] = torque - load[:, j]
                floor[j] = np.hypot(floor[j], floors[c] * passed)
        edge = min(int(_EDGE * smooth.band.rate / smooth.band.end), (len(missing) - 1) // 4)
        missing[:edge], missing[len(missing) - edge :] = np.nan, np.nan
    return JointMotion(
        joints=joints,
        units=units,
        time=smooth.time,
        position=np.where(known, smooth.position, np.nan),
        speed=np.where(known, smooth.speed, np.nan),
        acceleration=np.where(known, smooth.acceleration, np.nan),
        load=load,
        residual_torque=missing,
        residual_noise=floor,
    )


def _without_glitches(
    machine: NominalModel, trial: Trial, channels: Sequence[Channel]
) -> dict[str, Array]:
    """Joint positions (T,) by column, with samples that leave their course and come back replaced.

    By a cubic spline through the others. A sample is one if it differs from the median of
    `_COURSE` samples about it by more than `_GLITCH` times the usual deviation or the usual second
    difference, whichever is larger: at a turning point a smooth course differs from the median by
    half a second difference.
    """
    found = {}
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        values = trial.measured[:, k]
        if prefix != "sensor" or np.isfinite(values).sum() < 4 * _COURSE:
            continue
        if int(machine.model.sensor(name).type[0]) != mujoco.mjtSensor.mjSENS_JOINTPOS:
            continue
        good = np.flatnonzero(np.isfinite(values))
        away = np.abs(values[good] - median_filter(values[good], _COURSE, mode="mirror"))
        bend = float(np.quantile(np.abs(np.diff(values[good], 2)), 1 - 3 * _MOST_GLITCHES))
        usual = max(1.4826 * float(np.median(away)), bend, noise_floor(values))
        wrong = good[away > _GLITCH * usual]
        if len(wrong) and len(wrong) < _MOST_GLITCHES * len(good):
            kept = np.setdiff1d(good, wrong)
            found[channel.column] = values.copy()
            found[channel.column][wrong] = CubicSpline(trial.time[kept], values[kept])(
                trial.time[wrong]
            )
    return found


def _quiet(
    machine: NominalModel,
    trial: Trial,
    channels: Sequence[Channel],
    readings: dict[str, Array],
    widest: SmoothedMotion,
) -> tuple[SmoothedMotion, Array]:
    """Motion in the widest band in which the residual torque does not grow as noise does.

    With it the largest power of noise in the residual torque (J,), which the growth to the next
    band allows; infinite where the widest band is kept.

    Without a measured torque nothing limits the band, and readings that err by more than white
    noise (lost, late, held or glitched samples) pass as motion up to its end. The power of the
    second derivative of such errors grows with the 3rd to 5th power of the band's end, that of a
    torque levels off once the band holds the motion.
    """
    grid = widest.time
    end = max(_LOWEST_HZ, _MOTION_ROOM * max(_power_end(v, trial.rate) for v in widest.position.T))
    at = np.unique(np.linspace(0, len(grid) - 1, _TRIED_POINTS).astype(int))
    at = at[len(at) // 20 : -max(1, len(at) // 20)]
    before: tuple[SmoothedMotion, Array] | None = None
    while True:
        band = Band(rate=widest.band.rate, end=end)
        last = end >= widest.band.end
        end *= _RUNG
        try:
            tried = widest if last else smooth_motion(trial, machine, channels, readings, band)
        except InvalidData:  # too short for so low a band
            continue
        needed, applied = _torques(machine, trial, tried, at)
        power = np.mean((applied - needed) ** 2, axis=0)
        if before is not None:
            motion, own = before
            ratio = tried.band.end / motion.band.end
            if np.any(power > own * ratio**_NOISE_GROWTH):
                return motion, np.maximum(power - own, 0.0) / (ratio**_WHITE_GROWTH - 1)
        if last:
            return widest, np.full(len(power), np.inf)
        before = tried, power


def _power_end(values: Array, rate: float) -> float:
    """Frequency below which 99 % of a position's variance lies [Hz]."""
    frequency, power = periodogram(values, rate, window="hann", detrend="linear")
    total = np.cumsum(power)
    if not total[-1] > 0:
        return 0.0
    return float(frequency[int(np.searchsorted(total, _MOTION_SHARE * total[-1]))])


def _unknown(joints: tuple[str, ...], units: tuple[str, ...], trial: Trial) -> JointMotion:
    """Motion with known times only."""
    empty = np.full((len(trial.time), len(joints)), np.nan)
    return JointMotion(
        joints=joints,
        units=units,
        time=trial.time,
        position=empty,
        speed=empty,
        acceleration=empty,
        load=empty,
        residual_torque=empty,
        residual_noise=np.full(len(joints), np.nan),
    )


def _torques(
    machine: NominalModel, trial: Trial, motion: SmoothedMotion, at: NDArray[np.intp] | None = None
) -> tuple[Array, Array]:
    """Inverse dynamics torque of the nominal model, and its actuator torque (T, J).

    At some points of the grid, or at all. The latter is NaN in a forward run where an activation
    is not known.
    """
    at = np.arange(len(motion.time)) if at is None else at
    model = machine.model.__copy__()
    if machine.integrator is not None:
        model.opt.integrator = machine.integrator
    # Contacts and stops of an approximate motion would be noise.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    friction = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0.0  # a constraint, whose force at rest is not known
    data = mujoco.MjData(model)
    needed, applied = np.zeros((2, len(at), motion.position.shape[1]))
    commanded = _held(trial.controls, trial.step, motion.time)
    forward, acting = trial.form == "forward", None
    if forward:
        own = activations(model, trial.controls, trial.step)
        acting = None if own is None else _held(own, trial.step, motion.time)
        if acting is None:
            applied[:] = np.nan
    for row, k in enumerate(at):
        data.qpos[:], data.qvel[:] = motion.position[k], motion.speed[k]
        data.qacc[:] = motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        needed[row] = data.qfrc_inverse
        if acting is not None:
            data.act[:] = acting[k]
            data.ctrl[: trial.controls.shape[1]] = commanded[k]
            mujoco.mj_fwdActuation(model, data)
            applied[row] = data.qfrc_actuator
    return needed + friction * np.sign(motion.speed[at]), applied


def _held(values: Array, step: float, time: Array) -> Array:
    """Average zero-order-hold values (steps, N) about each time (T, N)."""
    half = 0.5 * float(np.median(np.diff(time)))
    edges = np.arange(len(values) + 1) * step
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    first = np.clip(time - half, 0.0, edges[-1] - step)
    last = np.clip(time + half, first + 1e-9, edges[-1])
    found = np.empty((len(time), values.shape[1]))
    for k in range(found.shape[1]):
        passed = np.interp(last, edges, sums[:, k]) - np.interp(first, edges, sums[:, k])
        found[:, k] = passed * step / (last - first)
    return found


def _needed_noise(machine: NominalModel, trial: Trial, motion: SmoothedMotion) -> Array:
    """Noise of the inverse dynamics torque less the applied torque (J,)."""
    model = machine.model
    data = mujoco.MjData(model)
    data.qpos[:] = motion.position[len(motion.time) // 2]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    spring, damper = np.zeros(model.nv), model.dof_damping.copy()
    if trial.form == "forward":
        for k, name in enumerate(machine.actuators):
            joint = machine.actuated_joint.get(name)
            if joint is not None:
                j, gear = machine.joint_number(joint), float(model.actuator_gear[k, 0])
                spring[j] += abs(gear**2 * model.actuator_biasprm[k, 1])
                damper[j] += abs(gear**2 * model.actuator_biasprm[k, 2])
    position, speed, acceleration = motion.noise**2
    variance = mass**2 @ acceleration + damper**2 * speed + spring**2 * position
    return np.asarray(np.sqrt(variance))
