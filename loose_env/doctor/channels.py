"""Columns of a run as channels (quantity, joint, axis), and the model's names and servos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np

from loose_env.recording import Run
from loose_env.typing import Array

Kind = Literal["position", "velocity", "acceleration", "turning", "torque", "command", "other"]
"""Quantity of a channel."""

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): "position",
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): "velocity",
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "acceleration",
    int(mujoco.mjtSensor.mjSENS_GYRO): "turning",
}
_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


@dataclass(frozen=True, kw_only=True, eq=False)
class Channel:
    """One column of a run."""

    name: str
    """Name of the column."""
    kind: Kind
    of: str
    """Joint, site sensor or actuator that it belongs to."""
    values: Array
    """Samples, NaN where one is missing, shape (T,)."""

    @cached_property
    def there(self) -> Array:
        """Samples that are not missing."""
        return np.asarray(self.values[np.isfinite(self.values)])

    @property
    def reach(self) -> float:
        """Largest size of a sample; 0 where none is there."""
        return float(np.abs(self.there).max(initial=0.0))


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Actuator of the model that drives one joint by a gain on its command."""

    name: str
    joint: str
    gear: float
    """Joint torque over actuator force [1]."""
    gain: float
    """Actuator force over command."""
    follows: bool
    """True for a position servo: its command is a position."""
    motor: bool
    """True if its force is the gain times the command, whatever the motion."""
    lag: float
    """Delay of slow motion behind the command of a position servo in the model [s]."""
    limits: tuple[float, float] | None
    """Limits of the command; None where it has none."""


class Machine:
    """Names, limits and drives of a model, as the checks need them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.joints = [
            model.joint(j).name
            for j in range(model.njnt)
            if int(model.jnt_type[j]) in _SINGLE and model.joint(j).name
        ]
        """Hinges and slides with a name."""
        self.drives = {
            model.actuator(a).name: self._drive(a)
            for a in range(model.nu)
            if int(model.actuator_trntype[a]) in _ON_JOINT and int(model.actuator_ctrlnum[a]) == 1
        }
        """Actuators on joints, by name."""

    def hinge(self, joint: str) -> bool:
        """Return True for a hinge, False for a slide."""
        return int(self.model.jnt_type[self.model.joint(joint).id]) == _SINGLE[0]

    def unit(self, joint: str) -> str:
        """Unit of the joint's position."""
        return "rad" if self.hinge(joint) else "m"

    def limits(self, joint: str) -> tuple[float, float] | None:
        """Limits of the joint [rad or m]; None where it has none."""
        j = self.model.joint(joint).id
        if not self.model.jnt_limited[j]:
            return None
        return float(self.model.jnt_range[j][0]), float(self.model.jnt_range[j][1])

    def _drive(self, a: int) -> Servo:
        m = self.model
        gain, bias = float(m.actuator_gainprm[a][0]), m.actuator_biasprm[a]
        fixed = int(m.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        affine = int(m.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        limited = bool(m.actuator_ctrllimited[a])
        follows = bool(affine and fixed and gain > 0 and np.isclose(bias[1], -gain))
        gear, joint = float(m.actuator_gear[a][0]), int(m.actuator_trnid[a][0])
        damping = float(m.dof_damping[int(m.jnt_dofadr[joint])]) - float(bias[2]) * gear**2
        return Servo(
            name=m.actuator(a).name,
            joint=m.joint(joint).name,
            gear=gear,
            gain=gain if fixed and int(m.actuator_dyntype[a]) == 0 else 0.0,
            follows=follows,
            motor=fixed and not bias[:3].any(),
            lag=damping / (gain * gear**2) if follows and gear else 0.0,
            limits=tuple(map(float, m.actuator_ctrlrange[a])) if limited else None,  # type: ignore[arg-type]
        )


Runs = Sequence[tuple[Run, Sequence[Channel]]]
"""Runs with their channels."""

Factors = Mapping[tuple[str, str], float]
"""Run and joint -> factor that brings its positions to rad or m and to the model's sign; 1 where
there is none."""


def channels_of(machine: Machine, run: Run) -> list[Channel]:
    """All columns of a run but the time, in the order controls, sensors, torques."""
    model = machine.model
    found = [
        Channel(name=f"ctrl.{name}", kind="command", of=name, values=values)
        for name, values in run.controls.items()
    ]
    for name, values in run.sensors.items():
        sensor = model.sensor(name).id
        kind = _KINDS.get(int(model.sensor_type[sensor]), "other")
        on_joint = kind in ("position", "velocity")
        of = model.joint(int(model.sensor_objid[sensor])).name if on_joint else name
        if values.ndim == 1:
            found.append(Channel(name=f"sensor.{name}", kind=kind, of=of, values=values))
            continue
        for axis, letter in enumerate("xyz"):
            column = values[:, axis]
            found.append(Channel(name=f"sensor.{name}.{letter}", kind=kind, of=of, values=column))
    found += [
        Channel(name=f"torque.{joint}", kind="torque", of=joint, values=values)
        for joint, values in run.torques.items()
    ]
    return found


def positions(channels: Sequence[Channel]) -> dict[str, Channel]:
    """Position of each joint that has one, the first of several."""
    found: dict[str, Channel] = {}
    for channel in channels:
        if channel.kind == "position":
            found.setdefault(channel.of, channel)
    return found


def filled(time: Array, values: Array) -> Array:
    """Column with missing samples interpolated; zeros where none is there."""
    there = np.isfinite(values)
    if there.all():
        return values
    if not there.any():
        return np.zeros_like(values)
    return np.interp(time, time[there], values[there])
