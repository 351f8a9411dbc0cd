"""Libraries of motions for an arm (full, brief, battery), scaled to its limits, simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.typing import Array

_TORQUE_SHARE = 0.8
"""Share of a torque limit that a motion may take in the nominal model."""
_SPEED_SHARE = 1.25
"""Speed of the nominal arm over the limit of its commands: a servo overshoots after a step."""
_SHRINK, _TRIES = 0.7, 8
"""Factor on amplitude and speed of a motion that does not fit, and how often it is tried."""
_POSES = 400
"""Random poses among which those of small and of large load are chosen."""


@dataclass(frozen=True, kw_only=True)
class MotionCheck:
    """Result of a motion's simulation with the nominal model."""

    seconds: float
    """Machine time [s]."""
    torque_share: float
    """Largest torque over its joint's limit [1]."""
    speed_share: float
    """Largest joint speed over its limit [1]."""
    wear: float
    """Integral of the squared torque shares, summed over joints [s]."""
    contact: str
    """Bodies that touch, "" if none do."""
    beyond: str
    """Joint that leaves its range, "" if none does."""

    @property
    def refusal(self) -> str:
        """Reason why the motion is refused, "" if it is not."""
        if self.contact:
            return f"{self.contact} would touch"
        if self.beyond:
            return f"{self.beyond} would leave its range"
        if self.torque_share > _TORQUE_SHARE:
            return f"it would take {self.torque_share:.2f} of a torque limit"
        if self.speed_share > _SPEED_SHARE:
            return f"it would take {self.speed_share:.2f} of a speed limit"
        return ""


def check_motion(motion: Motion, arm: ServoArm) -> MotionCheck:
    """Simulate a motion with the nominal model, contacts included.

    Raises
    ------
    InvalidSetting
        If its commands leave the range of a joint.

    Examples
    --------
    >>> from loose_env.arms import SERVO_ARM
    >>> from loose_env.gap.experiment_design.servo_arm import read_servo_arm
    >>> arm = read_servo_arm(SERVO_ARM)
    >>> slow = Motion(kind="slow_triangle", joints=(1,), amplitude=0.2, speed=0.2)
    >>> check_motion(slow, arm).refusal
    ''
    """
    commands = motion.commands(arm)
    model: mujoco.MjModel = arm.model
    data = mujoco.MjData(model)
    data.qpos[:] = arm.rest_position
    data.qpos[arm.driven] = arm.home
    parts = round(1.0 / (arm.sensing.rate * model.opt.timestep))
    controls = arm.controls(commands)
    data.ctrl[:] = controls[0]
    mujoco.mj_forward(model, data)
    apart = {_pair(data.contact[k]) for k in range(data.ncon)}  # what touches at home may
    low, high = arm.ranges
    gears = np.abs(model.actuator_gear[arm.actuators, 0])
    torque, speed, wear, contact, beyond = 0.0, 0.0, 0.0, "", ""
    for _ in range(round(0.4 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    for row in controls:
        data.ctrl[:] = row
        for _ in range(parts):
            mujoco.mj_step(model, data)
        shares = np.abs(gears * data.actuator_force[arm.actuators]) / arm.torque_limits
        torque = max(torque, float(shares.max()))
        wear += float(np.sum(shares**2)) / arm.sensing.rate
        # joints are hinges and slides: one position and one speed each
        speed = max(speed, float(np.max(np.abs(data.qvel[arm.driven]) / arm.speed_limits)))
        outside = (data.qpos[arm.driven] < low) | (data.qpos[arm.driven] > high)
        if outside.any() and not beyond:
            beyond = arm.joints[int(np.argmax(outside))]
        for k in range(data.ncon):
            if not contact and _pair(data.contact[k]) not in apart:
                bodies = [
                    model.body(int(model.geom_bodyid[g])).name for g in _pair(data.contact[k])
                ]
                contact = " and ".join(bodies)
    return MotionCheck(
        seconds=len(commands) / arm.sensing.rate,
        torque_share=torque,
        speed_share=speed,
        wear=wear,
        contact=contact,
        beyond=beyond,
    )


def _pair(contact: mujoco.MjContact) -> tuple[int, int]:
    return int(min(contact.geom)), int(max(contact.geom))


def scaled_to_fit(motion: Motion, arm: ServoArm) -> tuple[Motion, MotionCheck]:
    """Reduce amplitude and speed of a motion until it fits the arm's limits.

    Raises
    ------
    InvalidSetting
        If it does not fit at a twentieth of its size either: in its centre pose, say.
    """
    reason = ""
    for _ in range(_TRIES):
        try:
            found = check_motion(motion, arm)
            reason = found.refusal
            if not reason:
                return motion, found
        except InvalidSetting as error:
            reason = str(error)
        slower = motion.speed if "touch" in reason or "range" in reason else _SHRINK * motion.speed
        motion = replace(motion, amplitude=_SHRINK * motion.amplitude, speed=slower)
    raise InvalidSetting(
        f"{motion.description} does not fit the arm: {reason}; give another centre pose"
    )


def loaded_poses(arm: ServoArm) -> tuple[Array, Array]:
    """Poses of small and of large load by gravity on the joints, free of contact (J,) each.

    Of random poses in the middle 70 % of the ranges.
    """
    model: mujoco.MjModel = arm.model
    rng = np.random.default_rng(0)
    low, high = arm.ranges
    middle, half = (low + high) / 2, 0.35 * (high - low)
    half = np.minimum(half, 1.2 * np.where(arm.turning, 1.0, 0.2))
    data = mujoco.MjData(model)
    found, loads = [], []
    for _ in range(_POSES):
        pose = np.clip(arm.home + rng.uniform(-1, 1, len(half)) * half, low + 0.2, high - 0.2)
        pose = np.where(high - low > 0.8, pose, middle)
        data.qpos[:] = arm.rest_position
        data.qpos[arm.driven] = pose
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        if data.ncon == 0:
            found.append(pose)
            loads.append(float(np.sum((data.qfrc_bias[arm.driven] / arm.torque_limits) ** 2)))
    if not found:
        return arm.home, arm.home
    return found[int(np.argmin(loads))], found[int(np.argmax(loads))]


def motion_library(arm: ServoArm, *, brief: bool = True) -> tuple[Motion, ...]:
    """Motions of an arm that fit its limits.

    For each joint: slow triangles under small and large load, several constant speeds, a chirp
    and steps. For all joints together: multisines, chirps, random excitations,
    steps, triangles and poses held, under small and large load; and brief ones of each kind.

    Parameters
    ----------
    arm : ServoArm
        The arm.
    brief : bool
        False without the brief motions: excitations of 0.5 to 3 s.

    Returns
    -------
    tuple of Motion
        Those that fit, reduced where need be; what does not fit is left out.
    """
    every = tuple(range(len(arm.joints)))
    small, large = (tuple(map(float, pose)) for pose in loaded_poses(arm))
    wanted = []
    for j in every:
        wanted += [
            Motion(kind="slow_triangle", joints=(j,), amplitude=0.25, speed=0.25, centre=small),
            Motion(kind="slow_triangle", joints=(j,), amplitude=0.25, speed=0.25, centre=large),
            Motion(kind="constant_speed", joints=(j,), amplitude=0.8, speed=1.6, seconds=5.0),
            Motion(kind="chirp", joints=(j,), amplitude=0.2, speed=0.8, highest=20.0),
            Motion(kind="steps", joints=(j,), amplitude=0.06, speed=1.5, seconds=2.5),
        ]
    for centre in (small, large):
        wanted += [
            Motion(kind="holds", joints=every, amplitude=0.5, speed=1.2, centre=centre),
            Motion(kind="multisine", joints=every, amplitude=0.4, speed=1.2, centre=centre),
            Motion(kind="steps", joints=every, amplitude=0.06, speed=1.5, seconds=2.5,
                   centre=centre),
        ]  # fmt: skip
    wanted += [
        *battery(arm),
        Motion(kind="holds", joints=every, amplitude=0.7, speed=1.2, seconds=8.0, seed=1),
        Motion(kind="chirp", joints=every, amplitude=0.2, speed=0.8, highest=20.0),
        Motion(kind="random", joints=every, amplitude=0.5, speed=1.8, seed=9),
        Motion(kind="random", joints=every, amplitude=0.5, speed=1.8, seed=3, seconds=1.5),
        *(_brief_motions(every) if brief else ()),
    ]  # fmt: skip
    return _fitting(wanted, arm)


def brief_library(arm: ServoArm) -> tuple[Motion, ...]:
    """Brief motions of an arm and its battery: a library of few motions, soon computed."""
    every = tuple(range(len(arm.joints)))
    return _fitting([*battery(arm), *_brief_motions(every)], arm)


def _fitting(wanted: Sequence[Motion], arm: ServoArm) -> tuple[Motion, ...]:
    """Motions that fit the limits of an arm, reduced where need be, each once."""
    fitting = []
    for motion in wanted:
        try:
            fitting.append(scaled_to_fit(motion, arm)[0])
        except InvalidSetting:
            continue
    if not fitting:
        raise InvalidSetting(
            "no motion fits the arm: its home pose touches something or takes its torque limits"
        )
    return tuple(dict.fromkeys(fitting))


def _brief_motions(every: tuple[int, ...]) -> tuple[Motion, ...]:
    """Excitations of 0.5 to 3 s about home: a second motion need not cost the way to a pose.

    A servo settles in a tenth of a second.
    """
    brief = partial(Motion, joints=every, pause=0.1)
    noise = partial(brief, kind="random", speed=1.8)
    return (
        noise(amplitude=0.5, seconds=0.5, seed=3),
        noise(amplitude=0.5, seconds=1.0, seed=3),
        noise(amplitude=0.5, seconds=1.0, seed=9),
        noise(amplitude=0.6, seconds=1.5, seed=9, highest=2.5),
        noise(amplitude=0.6, seconds=2.5, seed=5, highest=2.0),
        brief(kind="multisine", amplitude=0.4, speed=1.8, seconds=1.5),
        brief(kind="chirp", amplitude=0.3, speed=1.2, seconds=1.5, highest=20.0),
        brief(kind="steps", amplitude=0.06, speed=1.5, seconds=1.0),
        brief(kind="holds", amplitude=0.5, speed=1.8, seconds=2.0, seed=1),
        brief(kind="holds", amplitude=0.7, speed=1.8, seconds=3.0, seed=2),
        brief(kind="slow_triangle", amplitude=0.1, speed=0.3, seconds=1.5),
        brief(kind="constant_speed", amplitude=0.5, speed=1.2, seconds=2.0),
    )


def battery(arm: ServoArm) -> tuple[Motion, ...]:
    """Battery that an experienced engineer runs: slow triangle, multisine and steps, all joints."""
    every = tuple(range(len(arm.joints)))
    wanted = (
        Motion(kind="slow_triangle", joints=every, amplitude=0.3, speed=0.3, seconds=8.0),
        Motion(kind="multisine", joints=every, amplitude=0.4, speed=1.2, seconds=8.0),
        Motion(kind="steps", joints=every, amplitude=0.06, speed=1.5, seconds=5.0),
    )
    return tuple(scaled_to_fit(motion, arm)[0] for motion in wanted)
