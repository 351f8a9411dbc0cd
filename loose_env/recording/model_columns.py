"""Columns of a run that a model allows, checks of them, and the sensors of its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.io import nearest
from loose_env.typing import Array

Group = Literal["controls", "sensors", "torques"]

_PREFIX: dict[str, Group] = {"ctrl": "controls", "sensor": "sensors", "torque": "torques"}
_AXES = ("x", "y", "z")
_ONE_DOF = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True, kw_only=True)
class ModelColumns:
    """Names of a model that a column, or an entry of a run, may carry."""

    known: Mapping[str, tuple[Group, str, int | None]]
    """What each allowed column holds: its group, the element, and the axis of a 3-vector."""
    refused: Mapping[str, str]
    """Columns that name something of the model and still hold nothing, with the reason."""
    joints: tuple[str, ...]
    """Joints with one position: hinges and slides."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> ModelColumns:
        """Columns that a model allows, in its own order.

        Examples
        --------
        >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/>
        ... <site name="tip"/></body></worldbody>
        ... <sensor><jointpos name="encoder" joint="turn"/>
        ... <accelerometer name="tool" site="tip"/></sensor></mujoco>'''
        >>> list(ModelColumns.of(mujoco.MjModel.from_xml_string(xml)).known)
        ['sensor.encoder', 'sensor.tool.x', 'sensor.tool.y', 'sensor.tool.z', 'torque.turn']
        """
        known: dict[str, tuple[Group, str, int | None]] = {}
        refused: dict[str, str] = {}
        for i in range(model.nu):
            name = model.actuator(i).name
            inputs = int(model.actuator_ctrlnum[i])
            if inputs == 1:
                known[f"ctrl.{name}"] = ("controls", name, None)
            elif name:
                refused[f"ctrl.{name}"] = f"actuator {name!r} has {inputs} inputs, a column holds 1"
        sizes = {model.sensor(i).name: int(model.sensor_dim[i]) for i in range(model.nsensor)}
        for name, size in sizes.items():
            axes = [f"sensor.{name}.{axis}" for axis in _AXES]
            if size == 1:
                known[f"sensor.{name}"] = ("sensors", name, None)
                reason = f"sensor {name!r} reads one value: its column is 'sensor.{name}'"
                refused.update({column: reason for column in axes})
            elif size == 3:
                known.update({c: ("sensors", name, axis) for axis, c in enumerate(axes)})
                refused[f"sensor.{name}"] = (
                    f"sensor {name!r} reads a 3-vector: its columns are {', '.join(axes)}"
                )
            else:
                reason = f"sensor {name!r} reads {size} values; a recording holds one or three"
                refused.update({column: reason for column in (f"sensor.{name}", *axes)})
        doubtful = {
            f"sensor.{name}.{axis}": f"both the 3-vector {name!r} and the sensor '{name}.{axis}' "
            "of the model have this column; rename one"
            for name, size in sizes.items()
            for axis in _AXES
            if size == 3 and f"{name}.{axis}" in sizes
        }
        joints = []
        for i in range(model.njnt):
            name = model.joint(i).name
            if int(model.jnt_type[i]) in _ONE_DOF:
                known[f"torque.{name}"] = ("torques", name, None)
                joints.append(name)
            elif name:
                refused[f"torque.{name}"] = f"joint {name!r} is neither a hinge nor a slide"
        nameless = {f"{prefix}." for prefix in _PREFIX} | {f"sensor..{axis}" for axis in _AXES}
        known = {
            c: meaning for c, meaning in known.items() if c not in nameless and c not in doubtful
        }
        refused = {c: why for c, why in refused.items() if c not in known} | doubtful
        return cls(known=known, refused=refused, joints=tuple(j for j in joints if j))

    def check_header(self, file: str, header: Sequence[str]) -> None:
        """Refuse the names of a run's columns."""
        own = set(header) - {"time"}
        if "time" in header and len(own) > 1 and own.isdisjoint({*self.known, *self.refused}):
            raise InvalidData(
                f"{file}: none of its {len(own)} columns is in the model, which has "
                f"{_few([*self.known])}: is it the model of this machine?"
            )
        seen: set[str] = set()
        for column in header:
            if column in seen:
                raise InvalidData(f"{_header(file, column)}: the column is there twice")
            seen.add(column)
            if column != "time" and column not in self.known:
                raise InvalidData(f"{_header(file, column)}: {self._why(column)}")
        if "time" not in seen:
            raise InvalidData(f"{_header(file, 'time')}: the column is missing; a run needs it")
        for column in header:
            _, name, axis = self.known.get(column, ("", "", None))
            lacking = [f"sensor.{name}.{a}" for a in _AXES if f"sensor.{name}.{a}" not in seen]
            if axis is not None and lacking:
                raise InvalidData(
                    f"{_header(file, column)}: sensor {name!r} is a 3-vector, and "
                    f"{' and '.join(map(repr, lacking))} are missing; give all three or none"
                )
        if not any(self.known[c][0] in ("sensors", "torques") for c in seen - {"time"}):
            allowed = [c for c in self.known if not c.startswith("ctrl.")]
            raise InvalidData(
                f"{file}: the header names no column of data; a run needs at least one of "
                f"{_few(allowed)}"
            )

    def _why(self, column: str) -> str:
        if column in self.refused:
            return self.refused[column]
        near = nearest(column, ["time", *self.known])
        prefix = column.split(".", 1)[0]
        allowed = [c for c in self.known if c.startswith(f"{prefix}.")] or ["time", *self.known]
        head = ""
        try:
            float(column)
            head = "; a CSV file starts with a line that names its columns"
        except ValueError:
            pass
        return f"it names nothing in the model; allowed are {_few(allowed)}{head}{near}"

    def grouped(self, columns: Mapping[str, Array]) -> dict[Group, dict[str, Array]]:
        """Columns as arrays of each element, shapes (T,) and (T, 3), in the model's order."""
        groups: dict[Group, dict[str, Array]] = {"controls": {}, "sensors": {}, "torques": {}}
        for column, (group, name, axis) in self.known.items():
            if column not in columns:
                continue
            if axis is None:
                groups[group][name] = columns[column]
            elif axis == 0:
                parts = [columns[f"sensor.{name}.{a}"] for a in _AXES]
                groups[group][name] = np.stack(parts, axis=1)
        return groups

    def check_joint(self, place: str, joint: str) -> None:
        """Refuse what is no hinge or slide of the model; ``place`` says where it was given."""
        if joint not in self.joints:
            raise InvalidData(
                f"{place}: {_short(joint)} is no hinge or slide of the model; it has "
                f"{_few(self.joints)}{nearest(joint, self.joints)}"
            )

    def check_command(self, place: str, actuator: str) -> None:
        """Refuse what is no actuator with a command; ``place`` says where it was given."""
        if f"ctrl.{actuator}" not in self.known:
            drives = [name for group, name, _ in self.known.values() if group == "controls"]
            raise InvalidData(
                f"{place}: {_short(actuator)} is no actuator of the model; it has {_few(drives)}"
                f"{nearest(actuator, drives)}"
            )


def _header(file: str, column: str) -> str:
    return f"{file}: column {_short(column)}, row 0 (the header)"


def _short(name: str, most: int = 80) -> str:
    return repr(name if len(name) <= most else f"{name[:most]}...")


def _few(names: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(map(_short, names[:most])) or "none"
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


@dataclass(frozen=True, kw_only=True)
class JointSensors:
    """Sensors of one joint, in the model's order."""

    position: tuple[str, ...] = ()
    """Sensors that read its position [rad or m]."""
    velocity: tuple[str, ...] = ()
    """Sensors that read its velocity [rad/s or m/s]."""


def joint_sensors(model: mujoco.MjModel) -> dict[str, JointSensors]:
    """Find the ``jointpos`` and ``jointvel`` sensors of each hinge and slide with a name.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.

    Returns
    -------
    dict
        Sensors of each joint, in the model's order; empty tuples where it has none.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> joint_sensors(mujoco.MjModel.from_xml_string(xml))
    {'turn': JointSensors(position=('encoder',), velocity=())}
    """
    return {
        model.joint(j).name: JointSensors(
            position=_reading(model, mujoco.mjtSensor.mjSENS_JOINTPOS, j),
            velocity=_reading(model, mujoco.mjtSensor.mjSENS_JOINTVEL, j),
        )
        for j in range(model.njnt)
        if model.jnt_type[j] in _ONE_DOF and model.joint(j).name
    }


def add_joint_columns(spec: mujoco.MjSpec) -> None:
    """Give a model without sensors and actuators, such as a URDF, those of its joints."""
    kinds = {"pos": mujoco.mjtSensor.mjSENS_JOINTPOS, "vel": mujoco.mjtSensor.mjSENS_JOINTVEL}
    for joint in spec.joints:
        if joint.type not in _ONE_DOF or not joint.name:
            continue
        for ending, kind in kinds.items():
            spec.add_sensor(
                name=f"{joint.name}_{ending}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
        motor = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_motor()


def _reading(model: mujoco.MjModel, kind: mujoco.mjtSensor, joint: int) -> tuple[str, ...]:
    found = (model.sensor_type == kind) & (model.sensor_objid == joint)
    names = (model.sensor(int(i)).name for i in np.flatnonzero(found))
    return tuple(name for name in names if name)
