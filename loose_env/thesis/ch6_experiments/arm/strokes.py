"""The boom of the cylindrical arm stroked again and again, under point-to-point control."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.signal import lfilter

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.thesis.ch6_experiments.arm.guideway import (
    AXES,
    SEAT_HINGE,
    Guideway,
    StrokePose,
    guideway_model,
)
from loose_env.thesis.rigs.cylindrical import cylindrical
from loose_env.typing import Array

__all__ = ["Strokes", "stroke_many"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Strokes:
    """Records of repeated strokes in one pose."""

    time: Array
    """Time since the nominal trigger [s] (N,)."""
    acceleration: Array
    """At the base of the wrist, along the boom, as measured [m/s²] (strokes, N)."""
    potentiometer: Array
    """Reach by the potentiometer, as measured [V] (strokes, N)."""
    reach: Array = field(repr=False)
    """True reach [m] (strokes, N)."""
    pitch: Array = field(repr=False)
    """True pitch of the boom on its blocks [rad] (strokes, N)."""


def stroke_many(
    pose: StrokePose, count: int, settings: Guideway, rng: np.random.Generator
) -> Strokes:
    """Stroke the horizontal axis again and again, under point-to-point control.

    Every stroke is simulated. From stroke to stroke the potentiometer's noise, which also
    goes through the servo, the accelerometer's noise and the trigger's jitter differ.

    Examples
    --------
    >>> from loose_env.thesis.ch6_experiments.arm.guideway import POSES
    >>> found = stroke_many(POSES["B"], 2, Guideway(record=0.2), np.random.default_rng(0))
    >>> found.acceleration.shape
    (2, 200)
    """
    if count < 1:
        raise InvalidSetting(f"at least one stroke is needed, got count={count!r}")
    ranges = cylindrical().joint_ranges[:3]
    ends = ((pose.swing,) * 2, (pose.lift,) * 2, (pose.start, pose.end))
    for joint, allowed, values in zip(AXES, ranges, ends, strict=True):
        if allowed is not None and not all(allowed[0] <= v <= allowed[1] for v in values):
            raise InvalidSetting(f"{joint} must stay within {allowed}, got {values}")
    model = guideway_model(pose, settings)
    start = _at_rest(model, pose, settings)

    margin = 6 * settings.trigger_jitter  # so that a jittered record has samples at its ends
    begin = settings.lead + settings.trigger - margin
    steps = round((begin + settings.record + 2 * margin) / settings.timestep)
    t = settings.timestep * np.arange(steps, dtype=float)
    control = np.tile(start[1], (count, steps, 1))
    noise = settings.potentiometer_noise / 6 / settings.potentiometer_scale
    control[:, :, 2] += _travel(t - settings.lead, pose, settings) - _seen_by_servo(
        noise, (count, steps), model, settings, rng
    )
    batch = Batch(model, count, 1)
    batch.state[:] = start[0]
    recorded = batch.rollout(steps, control, record=("sensordata",))["sensordata"]
    if not np.isfinite(recorded).all() or batch.warning[:, :, 1].any():
        raise InvalidData("a stroke diverged; use a shorter timestep or softer blocks")

    wanted = np.arange(round(settings.record * settings.rate)) / settings.rate
    first = round(begin / settings.timestep)
    jitter = np.clip(settings.trigger_jitter * rng.standard_normal(count), -margin, margin)
    sampled = np.empty((3, count, len(wanted)))
    for k in range(count):
        # Sensors of a step are those of its start; a sample is the mean over one period.
        at = begin + margin + jitter[k] + wanted
        # The accelerometer has three axes, the first along the boom.
        for channel, column in enumerate((0, 3, 4)):
            smooth = recorded[k, :, column]
            if channel == 0 and settings.every > 1:
                smooth = np.convolve(smooth, np.ones(settings.every) / settings.every, "same")
            sampled[channel, k] = np.interp(at, t[first:], smooth[first:])
    acceleration, reach, pitch = sampled
    shape = reach.shape
    return Strokes(
        time=wanted,
        acceleration=acceleration + settings.accelerometer_noise * rng.standard_normal(shape),
        potentiometer=settings.potentiometer_scale * reach
        + settings.potentiometer_noise / 6 * rng.standard_normal(shape),
        reach=reach,
        pitch=pitch,
    )


def _travel(t: Array, pose: StrokePose, settings: Guideway) -> Array:
    """Commanded reach [m] over time since the start of the stroke: smooth start and stop."""
    distance = pose.end - pose.start
    # A raised-cosine run up, steady speed, and the same down.
    ramp, speed = settings.ramp, settings.speed * np.sign(distance)
    steady = abs(distance) / settings.speed - ramp
    if steady < 0:
        raise InvalidSetting(
            f"a stroke of {distance:g} m is too short for ramps of {ramp:g} s to "
            f"{settings.speed:g} m/s"
        )

    def run_up(x: Array) -> Array:
        x = np.clip(x, 0.0, ramp)
        return np.asarray(speed / 2 * (x - ramp / np.pi * np.sin(np.pi * x / ramp)))

    up = run_up(t) + speed * np.clip(t - ramp, 0.0, None)
    stopped = t - ramp - steady
    down = run_up(stopped) + speed * np.clip(stopped - ramp, 0.0, None)
    return np.asarray(up - down)


def _seen_by_servo(
    noise: float,
    shape: tuple[int, int],
    model: mujoco.MjModel,
    settings: Guideway,
    rng: np.random.Generator,
) -> Array:
    """Noise of the reach potentiometer as an error of the set point [m].

    The drive acts on the position and on its rate, both through the feedback's low-pass.
    """
    dt = settings.timestep
    # White over the recording band; a step's sample carries more, so that the density is kept.
    white = noise * np.sqrt(1 / (settings.rate * dt)) * rng.standard_normal(shape)
    keep = np.exp(-2 * np.pi * settings.feedback_bandwidth * dt)
    # Two poles, so that the rate is low-passed too.
    poles = [1.0, -2 * keep, keep**2]
    low = np.asarray(lfilter([(1 - keep) ** 2], poles, white, axis=1))
    drive = model.actuator("servo_joint3").id
    gain, rate_gain = model.actuator_gainprm[drive, 0], -model.actuator_biasprm[drive, 2]
    rate = np.diff(low, axis=1, prepend=low[:, :1]) / dt
    return np.asarray(low + rate_gain / gain * rate)


def _at_rest(model: mujoco.MjModel, pose: StrokePose, settings: Guideway) -> tuple[Array, Array]:
    """State at rest at the start of the stroke, and the set points that hold it there."""
    data = mujoco.MjData(model)
    target = np.array([pose.swing, pose.lift, pose.start])
    data.qpos[[model.joint(j).qposadr[0] for j in AXES]] = target
    mujoco.mj_forward(model, data)
    weight = data.qfrc_bias[[model.joint(j).dofadr[0] for j in AXES]]
    data.ctrl[:] = target + weight / model.actuator_gainprm[:, 0]
    # Start on the pair of blocks that carries the boom, and let what sags come to rest.
    load = data.qfrc_bias[model.joint(SEAT_HINGE).dofadr[0]]
    data.joint(SEAT_HINGE).qpos[0] = -np.sign(load) * settings.gap / 2
    for _ in range(round(4.0 / settings.timestep)):
        mujoco.mj_step(model, data)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state, data.ctrl.copy()
