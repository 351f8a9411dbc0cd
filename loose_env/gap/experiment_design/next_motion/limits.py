"""Joint limits from settings, model or recording, and the check of a motion against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.experiment_design.next_motion.motion_trials import Played
from loose_env.gap.experiment_design.next_motion.settings import NextMotionSettings
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_SLIDE = 0.2
"""Limits of slides over those of hinges: metres for radians."""
_OVERSHOOT = 1.25
"""Speed of the machine over the limit of its commands: a servo overshoots after a step."""
_ROOM = 1e-6
"""Rounding that a limit does not count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of the joints, with where they come from."""

    joints: tuple[str, ...]
    """Names of the joints."""
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

    def refusal(self, motion: Played) -> str:
        """Reason why a motion does not fit, "" if it does."""
        if not (np.isfinite(motion.position).all() and np.isfinite(motion.torque).all()):
            return "the corrected model does not follow it"
        if motion.contacts:
            return f"{motion.contacts[0][0]} and {motion.contacts[0][1]} would touch"
        low = np.minimum(motion.position, motion.desired).min(axis=0)
        high = np.maximum(motion.position, motion.desired).max(axis=0)
        for k, joint in enumerate(self.joints):
            if low[k] < self.low[k] - _ROOM or high[k] > self.high[k] + _ROOM:
                return (
                    f"{joint} would move from {low[k]:.3g} to {high[k]:.3g}; it may from "
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
            over = found > limits * (1 + _ROOM)
            if over.any():
                k = int(np.argmax(over))
                return f"{self.joints[k]} would need a {name} of {found[k]:.3g}; it may have " + (
                    f"{limits[k]:.3g} ({source})"
                )
        return ""

    def notes(self, motion: Played) -> tuple[str, ...]:
        """What was checked, with the margins left."""
        room = np.minimum(motion.position - self.low, self.high - motion.position).min()
        fastest = float(np.max(np.abs(motion.speed) / self.speed))
        found = [
            f"joint positions stay {room:.3g} rad or m within their range ({self.sources[0]})",
            f"joint speeds reach {fastest:.0%} of their limit ({self.sources[1]})",
        ]
        if np.isfinite(self.torque).any():
            share = float(np.max(np.abs(motion.torque).max(axis=0) / self.torque))
            found.append(f"torques reach {share:.0%} of their limit ({self.sources[2]})")
        else:
            found.append("torques: the model and the recording state no limit; not checked")
        found.append("collisions: no two bodies of the model touch that do not at the beginning")
        return tuple(found)


def limits_of(
    machine: NominalModel, trials: Sequence[Trial], settings: NextMotionSettings
) -> MotionLimits:
    """Collect the limits: of the settings, else of the model, else what the recording showed."""
    model: mujoco.MjModel = machine.model
    unit = np.where(model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE), _SLIDE, 1.0)
    home = np.asarray(trials[0].position, dtype=float)
    limited = model.jnt_limited.astype(bool)
    low = np.where(limited, model.jnt_range[:, 0], home - settings.next_reach_rad * unit)
    high = np.where(limited, model.jnt_range[:, 1], home + settings.next_reach_rad * unit)
    from_model = "joint limits of the model" if limited.all() else (
        "joint limits of the model, else --next-reach-rad" if limited.any() else "--next-reach-rad"
    )  # fmt: skip
    if settings.next_max_speed_rad_s > 0:
        speed, of_speed = settings.next_max_speed_rad_s * unit, "--next-max-speed-rad-s"
    else:
        speed, of_speed = _fastest(machine, trials), "the fastest of the recorded runs"
        for k in range(model.nnumeric):
            if model.numeric(k).name == "max_speed_rad_s":
                told = np.asarray(model.numeric(k).data, dtype=float)
                if told.size not in (1, len(unit)):
                    raise InvalidData(
                        f"max_speed_rad_s of the model has {told.size} values; it must have one, "
                        f"or one for each of the {len(unit)} joints (of a slide in m/s)"
                    )
                speed = told * unit if told.size == 1 else told
                of_speed = "max_speed_rad_s of the model"
    torque = np.full(len(unit), np.inf)
    for k, joint in enumerate(machine.joints):
        gears = np.abs(machine.gears(joint))
        for a in np.flatnonzero(gears > 0):
            if model.actuator_forcelimited[a]:
                own = gears[a] * float(np.min(np.abs(model.actuator_forcerange[a])))
                torque[k] = own if np.isinf(torque[k]) else torque[k] + own
        if model.jnt_actfrclimited[k]:
            torque[k] = min(torque[k], float(np.min(np.abs(model.jnt_actfrcrange[k]))))
    return MotionLimits(
        joints=machine.joints,
        home=home,
        low=np.minimum(low, home),
        high=np.maximum(high, home),
        speed=speed,
        torque=settings.next_torque_share * torque,
        sources=(from_model, of_speed, f"{settings.next_torque_share:g} of the drives' limits"),
    )


def _fastest(machine: NominalModel, trials: Sequence[Trial]) -> Array:
    """Largest speed of each joint in any run (joints,); of one that never moved that of others."""
    found = np.zeros(len(machine.joints))
    for trial in trials:
        for joint, values in trial.motion.items():
            wide = max(round(0.05 * trial.rate), 1)
            if len(values) > wide:
                moved = np.abs(values[wide:] - values[:-wide]) / (
                    trial.time[wide:] - trial.time[:-wide]
                )
                k = machine.joint_number(joint)
                found[k] = max(found[k], float(np.nanmax(moved)))
    return np.where(found > 0.05 * found.max(initial=0.0), found, max(found.max(initial=0.0), 0.1))
