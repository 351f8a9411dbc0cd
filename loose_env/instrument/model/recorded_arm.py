"""Model of a recorded arm: nominal arm with all seats, drives and sensors."""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import (
    Arm,
    LinearArm,
    arm_from_file,
    compile_spec,
    find_chain,
    load_spec,
    read_model_file,
)
from loose_env.errors import InvalidData
from loose_env.instrument.model.actuators import actuators_on
from loose_env.instrument.model.tool_site import tool_site
from loose_env.instrument.result import HEALTHY, hypothesis_of
from loose_env.typing import Array

__all__ = ["Drives", "Machine", "Reading"]

SensorKind = Literal["acceleration", "turning", "position", "velocity"]

_KINDS: Mapping[int, SensorKind] = {
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "acceleration",
    int(mujoco.mjtSensor.mjSENS_GYRO): "turning",
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): "position",
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): "velocity",
}


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Sensor channel that is used."""

    sensor: str
    """Its name in the model."""
    kind: SensorKind
    """What it reads: acceleration or turning of a site, position or velocity of a joint."""
    at: int
    """Number of the site among `Machine.sites`, or of the joint among the arm's, from 0."""

    @property
    def axes(self) -> int:
        """Number of components."""
        return 3 if self.kind in ("acceleration", "turning") else 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Drives:
    """Actuator forces on the joints, linear in command, position and velocity."""

    names: tuple[str, ...]
    """Actuators of the chain's joints (A,)."""
    joint: NDArray[np.intp]
    """Number of the joint that each drives, from 0 (A,)."""
    force: Array
    """Force on each joint per command of each actuator (n, A)."""
    stiffness: Array
    """Force against each joint's displacement (n,) [N·m/rad or N/m]."""
    damping: Array
    """Force against each joint's velocity (n,)."""
    lag: Array
    """Time constant of each actuator's filter (A,) [s]; 0 for none."""
    unknown: tuple[str, ...]
    """Actuators whose law is not of this kind: their joints' forces are taken as unknown."""


class Machine:
    """A nominal arm read from a model, with the model's own drives and sensors.

    Parameters
    ----------
    path : Path
        MJCF file.

    Raises
    ------
    InvalidData
        If the model is no serial arm on a fixed base or has no accelerometer on it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        file, _, spec = load_spec(path)
        self.model = model = compile_spec(spec, file)
        if not (model.sensor_type == mujoco.mjtSensor.mjSENS_ACCELEROMETER).any():
            raise InvalidData(
                f"{path.name}: the model has no accelerometer; a diagnosis needs one at the tool: "
                '<sensor><accelerometer name="tool_acc" site="tool"/></sensor>'
            )
        name = tool_site(spec)
        if name is None:
            raise InvalidData(f"{path.name}: the site of the tool's accelerometer needs a name")
        with python_warnings.catch_warnings():
            python_warnings.simplefilter("ignore", UserWarning)  # limits and ranges are not used
            arm = arm_from_file(path, tool=name)
        self.arm, self.sites = _with_probes(arm, path, name, model)
        """The nominal arm, and the model's name of every site with a sensor, the tool first."""
        self.linear = LinearArm(self.arm, points=8)
        chain = find_chain(read_model_file(path), name, None)
        self.joints = tuple(model.joint(j).name for j in chain.joints)
        """Joints of the chain, as the model names them, base first (n,)."""
        self.links = tuple(model.body(b).name for b in chain.links)
        """The body that each moves (n,)."""

    @property
    def n(self) -> int:
        """Number of joints, and of links."""
        return self.arm.n

    @cached_property
    def shown(self) -> Arm:
        """Arm for display: joints bear the model's names, reserved ones included."""
        if self.arm.joints == self.joints:
            return self.arm
        spec = self.arm.spec.copy()
        for own, name in zip(self.arm.joints, self.joints, strict=True):
            spec.joint(own).name = name
        return replace(self.arm, spec=spec, joints=self.joints)

    @cached_property
    def hypotheses(self) -> tuple[str, ...]:
        """Keys of a posterior: healthy, every link's slide, every joint's play."""
        return (
            HEALTHY,
            *(hypothesis_of("structural_looseness", link) for link in self.links),
            *(hypothesis_of("backlash", joint) for joint in self.joints),
        )

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """Usable sensors of the model, accelerometers first."""
        model, found = self.model, []
        for s in range(model.nsensor):
            kind = _KINDS.get(int(model.sensor_type[s]))
            name, of = model.sensor(s).name, int(model.sensor_objid[s])
            if kind is None or not name:
                continue
            if kind in ("acceleration", "turning"):
                site = model.site(of).name
                if site in self.sites:
                    found.append(Reading(sensor=name, kind=kind, at=self.sites.index(site)))
            elif model.joint(of).name in self.joints:
                joint = self.joints.index(model.joint(of).name)
                found.append(Reading(sensor=name, kind=kind, at=joint))
        order = ("acceleration", "turning", "velocity", "position")
        return tuple(sorted(found, key=lambda r: order.index(r.kind)))

    @cached_property
    def drives(self) -> Drives:
        """The model's actuators on the chain's joints."""
        drives, passed = actuators_on(self.model, self.joints)
        n, joints = self.n, [self.joints.index(drive.joint) for drive in drives]
        force, stiffness, damping = np.zeros((n, len(drives))), np.zeros(n), np.zeros(n)
        for a, (drive, j) in enumerate(zip(drives, joints, strict=True)):
            force[j, a] = drive.gain
            stiffness[j] += drive.stiffness
            damping[j] += drive.damping
        return Drives(
            names=tuple(drive.actuator for drive in drives),
            joint=np.array(joints, dtype=np.intp),
            force=force,
            stiffness=stiffness,
            damping=damping,
            lag=np.array([drive.lag for drive in drives]),
            unknown=tuple(other.actuator for other in passed),
        )

    def driven_joint(self, actuator: str) -> int:
        """Index of the joint that an actuator drives, from 0."""
        return int(self.drives.joint[self.drives.names.index(actuator)])

    def pose_of(self, pose: Mapping[str, float]) -> Array:
        """Joint positions (n,) of a pose by names.

        Joints that it does not name are at their reference in the model.
        """
        reference = self.model.qpos0[[self.model.joint(j).qposadr[0] for j in self.joints]]
        return np.array(
            [pose.get(j, float(q)) for j, q in zip(self.joints, reference, strict=True)]
        )

    def named(self, pose: Array) -> dict[str, float]:
        """Positions by joint."""
        return {joint: float(q) for joint, q in zip(self.joints, pose, strict=True)}


def _with_probes(
    arm: Arm, path: Path, tool: str, model: mujoco.MjModel
) -> tuple[Arm, tuple[str, ...]]:
    """Add the sites of further accelerometers and gyroscopes on the arm's links."""
    file = read_model_file(path)
    m = file.model
    chain = find_chain(file, tool, None)
    wanted = {
        model.site(int(model.sensor_objid[s])).name
        for s in range(model.nsensor)
        if _KINDS.get(int(model.sensor_type[s])) in ("acceleration", "turning")
    } - {tool}
    names = {m.site(s).name for s in range(m.nsite)}
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    spec, probes = arm.spec.copy(), []
    for name in sorted(wanted & names):
        site = m.site(name)
        owner = chain.owner[int(site.bodyid[0])]
        if owner == 0:
            continue  # it stands on the ground
        link = chain.links[owner - 1]
        back = data.xmat[link].reshape(3, 3).T
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, (back @ data.site_xmat[site.id].reshape(3, 3)).ravel())
        place = back @ (data.site_xpos[site.id] - data.xpos[link])
        body = spec.body(arm.seat_bodies[owner - 1])
        body.add_site(name=f"probe_{name}", pos=list(place), quat=list(quat))
        probes.append(name)
    if not probes:
        return arm, (tool,)
    made = replace(arm, spec=spec, probes=tuple(f"probe_{name}" for name in probes))
    return made, (tool, *probes)
