"""Motions before they are made: limits of the joints, and what a model does in a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.typing import Array, IndexArray

SLIDE = 0.2
"""Limits of slides over those of hinges: metres for radians."""
_OVERSHOOT = 1.25
"""Speed of the machine over the limit of its commands: a servo overshoots after a step."""
_ROOM = 1e-6
"""Rounding that a limit does not count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion as it is given to a machine and as its model answers."""

    desired: Array
    """Desired joint positions [rad, m] (T, joints)."""
    interval: float
    """Interval of the samples [s]."""
    controls: Array
    """Commands of the actuators, in their own units (T, actuators)."""
    position: Array
    """Joint positions of the model [rad, m] (T, joints)."""
    speed: Array
    """Joint speeds of the model [rad/s, m/s] (T, joints)."""
    torque: Array
    """Torque of the drives on the joints [N·m, N] (T, joints)."""
    readings: Array
    """Readings of all sensors of the model (T, sensordata)."""
    contacts: tuple[tuple[str, str], ...]
    """Pairs of bodies that touch and do not at the beginning."""
    saturated: tuple[str, ...]
    """Actuators that reach the range of their force."""

    @property
    def time(self) -> Array:
        """Sample times [s], from 0 (T,)."""
        return np.arange(len(self.desired), dtype=float) * self.interval


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of the joints, with where they come from."""

    joints: tuple[str, ...]
    """Names of the joints."""
    turning: NDArray[np.bool_]
    """Whether each of them is a hinge (joints,)."""
    rate: float
    """Sample rate [1/s]."""
    home: Array
    """Pose in which motions begin and end [rad, m] (joints,)."""
    low: Array
    """Lowest positions [rad, m] (joints,)."""
    high: Array
    """Highest positions [rad, m] (joints,)."""
    speed: Array
    """Largest speeds [rad/s, m/s] (joints,)."""
    torque: Array
    """Largest torques of the drives [N·m, N] (joints,), infinite where none is known."""
    sources: tuple[str, str, str]
    """Where those of position, speed and torque come from."""

    @property
    def unit(self) -> Array:
        """Size of a motion of each joint over that of a hinge (joints,)."""
        return np.where(self.turning, 1.0, SLIDE)

    def refusal(self, motion: PlannedMotion) -> str:
        """Reason why a motion does not fit, "" if it does."""
        if not (np.isfinite(motion.position).all() and np.isfinite(motion.torque).all()):
            return "the model does not follow it"
        if motion.contacts:
            return f"{motion.contacts[0][0]} and {motion.contacts[0][1]} would touch"
        low = np.minimum(motion.position, motion.desired).min(axis=0)
        high = np.maximum(motion.position, motion.desired).max(axis=0)
        beyond = (low < self.low - _ROOM) | (high > self.high + _ROOM)
        for k in np.flatnonzero(beyond):
            return (
                f"{self.joints[k]} would move from {low[k]:.3g} to {high[k]:.3g}; it may from "
                f"{self.low[k]:.3g} to {self.high[k]:.3g} ({self.sources[0]})"
            )
        if motion.saturated:
            return f"{motion.saturated[0]} would reach the range of its force"
        wanted = np.abs(np.gradient(motion.desired, motion.time, axis=0)).max(axis=0)
        fastest = np.maximum(wanted, np.abs(motion.speed).max(axis=0) / _OVERSHOOT)
        largest = np.abs(motion.torque).max(axis=0)
        for name, found, limits, source in (
            ("speed", fastest, self.speed, self.sources[1]),
            ("torque", largest, self.torque, self.sources[2]),
        ):
            for k in np.flatnonzero(found > limits * (1 + _ROOM)):
                return (
                    f"{self.joints[k]} would need a {name} of {found[k]:.3g}; it may have "
                    f"{limits[k]:.3g} ({source})"
                )
        return ""

    def notes(self, motion: PlannedMotion) -> tuple[str, ...]:
        """What was checked, with the margins left."""
        room = np.minimum(motion.position - self.low, self.high - motion.position).min()
        fastest = float(np.max(np.abs(motion.speed) / self.speed))
        torques = "torques: the model and the recording state no limit; not checked"
        if np.isfinite(self.torque).any():
            share = float(np.max(np.abs(motion.torque).max(axis=0) / self.torque))
            torques = f"torques reach {share:.0%} of their limit ({self.sources[2]})"
        return (
            f"joint positions stay {room:.3g} rad or m within their range ({self.sources[0]})",
            f"joint speeds reach {fastest:.0%} of their limit ({self.sources[1]})",
            torques,
            "collisions: no two bodies of the model touch that do not at the beginning",
        )


def followed(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    desired: Array,
    interval: float,
    where: tuple[IndexArray, IndexArray],
    command: Callable[[int], None],
) -> PlannedMotion:
    """Simulate a motion from a state, with a command at each sample, contacts included."""
    at, dofs = where
    mujoco.mj_forward(model, data)
    before = _touching(model, data)  # what touches at home may
    met, saturated = dict[tuple[str, str], None](), dict[str, None]()
    position, speed, torque = np.zeros((3, *desired.shape))
    controls = np.zeros((len(desired), model.nu))
    limited = np.flatnonzero(model.actuator_forcelimited)
    readings = np.zeros((len(desired), model.nsensordata))
    for row in range(len(desired)):
        for _ in range(round(interval / model.opt.timestep) if row else 0):
            mujoco.mj_step(model, data)
            met |= dict.fromkeys(sorted(_touching(model, data) - before))
        mujoco.mj_forward(model, data)
        position[row], speed[row] = data.qpos[at], data.qvel[dofs]
        torque[row] = data.qfrc_actuator[dofs]
        readings[row] = data.sensordata
        for k in limited:
            low, high = model.actuator_forcerange[k]
            if not low < data.actuator_force[k] < high:
                saturated[model.actuator(int(k)).name] = None
        command(row)
        controls[row] = data.ctrl
        torque[row] += data.qfrc_applied[dofs]
    return PlannedMotion(
        desired=desired, interval=interval, controls=controls, position=position, speed=speed,
        torque=torque, readings=readings, contacts=tuple(met), saturated=tuple(saturated),
    )  # fmt: skip


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies in contact."""
    found = set()
    for contact in map(data.contact.__getitem__, range(data.ncon)):
        if contact.dist <= 0:
            one, two = (model.body(int(model.geom_bodyid[g])).name for g in contact.geom)
            found.add((min(one, two), max(one, two)))
    return found
