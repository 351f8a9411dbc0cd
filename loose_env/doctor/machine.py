"""Columns of a run as channels, a model's drives, and the motion that joint positions imply."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.importing import (
    Drive,
    drives_of,
    filled,
    inverse_dynamics,
    joint_targets,
    median_step,
)
from loose_env.kinematics import carried_bodies
from loose_env.recording import Run, table_of
from loose_env.typing import Array

Kind = Literal["position", "velocity", "acceleration", "turning", "torque", "command", "other"]
"""Quantity of a channel."""

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): "position",
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): "velocity",
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "acceleration",
    int(mujoco.mjtSensor.mjSENS_GYRO): "turning",
}
_GROUPS: dict[str, Kind] = {"ctrl": "command", "torque": "torque"}

BLOCK_S = 0.1
"""Length of the block means of slow signals [s]: a period at 10 Hz, where servos end."""
MOST_BLOCKS = 150
"""Blocks of a run that are compared, evenly chosen: 15 s, after which means no longer change."""
MOST_SAMPLES = 8192
"""Samples of a run whose spectra are compared: eight segments of a second at 1 kHz."""
PAUSE_STEPS = 5.0
"""Step that counts as a pause [median steps]: a few missing rows are bridged by interpolation."""


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
        good = np.isfinite(self.values)
        return self.values if good.all() else np.asarray(self.values[good])

    @property
    def reach(self) -> float:
        """Largest size of a sample; 0 where none is there."""
        return float(np.abs(self.there).max(initial=0.0))


class Machine:
    """Names, limits and drives of a model, as the checks need them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.joints = {target.name: target for target in joint_targets(model)}
        """Hinges and slides with a name."""
        self.drives = {drive.name: drive for drive in drives_of(model) if not drive.tendon}
        """Actuators on joints, by name."""

    def hinge(self, joint: str) -> bool:
        """Return True for a hinge, False for a slide."""
        return not self.joints[joint].slide

    def unit(self, joint: str) -> str:
        """Unit of the joint's position."""
        return "rad" if self.hinge(joint) else "m"


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of a run in windows of equal length, and what the rigid model makes of it."""

    run: Run
    edges: Array
    """Times at which the windows begin and end [s], shape (N + 1,)."""
    chosen: NDArray[np.intp]
    """Windows that are compared, shape (T,)."""
    positions: Array
    """Positions, shape (T, nq) [rad or m]."""
    readings: Array
    """Sensor data that the model implies, shape (T, nsensordata)."""
    torques: Array
    """Generalised force that the motion needs, shape (T, nv) [N·m or N]."""
    known: frozenset[str]
    """Joints whose position is measured or noted."""

    def mean(self, values: Array) -> Array:
        """Means of a column of the run over the windows compared, shape (T,)."""
        return _means(self.run.time, values, self.edges)[self.chosen]


def motion_of(machine: Machine, run: Run, window_s: float = 0.0) -> Motion | None:
    """Motion by means over windows, of one sample at least; None for fewer than four of them."""
    step = median_step(run.time)
    window = max(step, window_s)
    count = int((run.time[-1] - run.time[0]) / window + 1e-6)
    if not window_s:
        count = min(count, MOST_SAMPLES)
    edges = run.time[0] + window * np.arange(count + 1)
    pauses = np.flatnonzero(np.diff(run.time) > PAUSE_STEPS * step)
    broken = np.zeros(max(count, 2), bool)
    for k in pauses:
        first, last = np.searchsorted(edges, run.time[k : k + 2])
        broken[max(first - 2, 0) : last + 1] = True  # no derivative across a pause
    chosen = np.flatnonzero(~broken)
    chosen = chosen[(chosen > 0) & (chosen < count - 1)]
    if len(chosen) < 2:
        return None
    if window_s:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, MOST_BLOCKS).astype(int))]
    model = machine.model
    qpos = np.tile(model.qpos0, (len(chosen), 1))
    qvel, qacc = np.zeros((2, len(chosen), model.nv))
    measured = positions_of(machine, run)
    for joint, q in (run.pose or {}).items():
        qpos[:, int(model.jnt_qposadr[model.joint(joint).id])] = q
    for joint, channel in measured.items():
        mean = _means(run.time, channel.values, edges)
        at, dof = (int(a[model.joint(joint).id]) for a in (model.jnt_qposadr, model.jnt_dofadr))
        qpos[:, at] = mean[chosen]
        qvel[:, dof] = (mean[chosen + 1] - mean[chosen - 1]) / (2 * window)
        qacc[:, dof] = (mean[chosen + 1] - 2 * mean[chosen] + mean[chosen - 1]) / window**2
    readings = np.zeros((len(chosen), model.nsensordata))
    torques = inverse_dynamics(model, qpos, qvel, qacc, readings)
    known = frozenset(measured) | frozenset(run.pose or {})
    return Motion(
        run=run,
        edges=edges,
        chosen=chosen,
        positions=qpos,
        readings=readings,
        torques=torques,
        known=known,
    )


def _means(time: Array, values: Array, edges: Array) -> Array:
    last = int(np.searchsorted(time, edges[-1])) + 1
    time, values = time[:last], values[:last]
    values = filled(time, values)
    areas = 0.5 * (values[1:] + values[:-1]) * np.diff(time)
    total = np.interp(edges, time, np.concatenate([[0.0], np.cumsum(areas)]))
    return np.asarray(np.diff(total) / np.diff(edges))


def carried(machine: Machine, sensor: str, known: frozenset[str]) -> bool:
    """Return whether all joints that carry a site sensor are known."""
    model = machine.model
    on = int(model.site_bodyid[int(model.sensor_objid[model.sensor(sensor).id])])
    joints = (j for j, b in enumerate(model.jnt_bodyid) if carried_bodies(model, int(b))[on])
    return all(model.joint(j).name in known for j in joints)


def channels_of(machine: Machine, run: Run) -> list[Channel]:
    """All columns of a run but the time, in the order controls, sensors, torques."""
    model, found = machine.model, []
    for column, values in table_of(run).items():
        group, _, name = column.partition(".")
        kind, of = _GROUPS.get(group, "other"), name
        if group == "sensor":
            of = name if name in run.sensors and run.sensors[name].ndim == 1 else name[:-2]
            sensor = model.sensor(of).id
            kind = _KINDS.get(int(model.sensor_type[sensor]), "other")
            if kind in ("position", "velocity"):
                of = model.joint(int(model.sensor_objid[sensor])).name
        if group in ("sensor", *_GROUPS):
            found.append(Channel(name=column, kind=kind, of=of, values=values))
    return found


def positions_of(machine: Machine, run: Run) -> dict[str, Channel]:
    """Position of each joint that has one, the first of several."""
    found: dict[str, Channel] = {}
    for channel in channels_of(machine, run):
        if channel.kind == "position":
            found.setdefault(channel.of, channel)
    return found


def servos_of(machine: Machine, run: Run) -> list[tuple[Drive, Array]]:
    """Position servos of a run with their commands as joint positions [rad or m], shape (T,)."""
    return [
        (drive, filled(run.time, run.controls[name]) / (drive.gear or 1.0))
        for name, drive in machine.drives.items()
        if name in run.controls and drive.follows
    ]


def told_to_move(machine: Machine, run: Run) -> set[str]:
    """Joints whose position servo has a command that moves."""
    return {own.joint for own, command in servos_of(machine, run) if np.ptp(command) > 0}


def forces_of(
    machine: Machine, run: Run, *, commands_only: bool = False
) -> dict[str, tuple[str, Array]]:
    """Column and torque of each joint whose torque is recorded, or follows from a motor command.

    Torques [N·m or N] have the rows of the run, shape (T,); the command of a position or
    velocity servo is none, and a joint with two drives has none.
    """
    driven = [drive.joint for drive in machine.drives.values()]
    found = {
        drive.joint: (
            f"ctrl.{name}",
            filled(run.time, run.controls[name]) * drive.gain * drive.gear,
        )
        for name, drive in machine.drives.items()
        if name in run.controls and drive.motor and driven.count(drive.joint) == 1
    }
    if not commands_only:
        for joint, values in run.torques.items():
            found[joint] = f"torque.{joint}", filled(run.time, values)
    return found
