"""Usable sensors of a model on its arm: kind, site or joint of each; sites of added probes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np

from loose_env.arms import Arm, Chain, ModelFile
from loose_env.instrument.model.recording_model import RecordingModel

SensorKind = Literal["acceleration", "turning", "position", "velocity"]

_KINDS: Mapping[int, SensorKind] = {
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "acceleration",
    int(mujoco.mjtSensor.mjSENS_GYRO): "turning",
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): "velocity",
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): "position",
}
"""Sensors that are used, in the order in which their readings stand."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Sensor channel that is used."""

    sensor: str
    """Its name in the model."""
    kind: SensorKind
    """Acceleration or turning of a site, position or velocity of a joint."""
    at: int
    """Index of the site among `InstrumentedArm.sites`, or of the joint, from 0."""

    @property
    def on_site(self) -> bool:
        """True for a sensor of a site, which has three axes; else it reads a joint."""
        return self.kind in ("acceleration", "turning")

    @property
    def axes(self) -> int:
        """Number of components."""
        return 3 if self.on_site else 1


def readings_of(
    model: mujoco.MjModel, sites: Sequence[str], joints: Sequence[str]
) -> tuple[Reading, ...]:
    """Usable sensors on sites and joints, accelerometers first, else in the model's order."""
    found = []
    for s in range(model.nsensor):
        kind = _KINDS.get(int(model.sensor_type[s]))
        if kind is None:
            continue
        on_site = kind in ("acceleration", "turning")
        of = int(model.sensor_objid[s])
        name, known = (model.site(of).name, sites) if on_site else (model.joint(of).name, joints)
        if name in known:
            found.append(Reading(sensor=model.sensor(s).name, kind=kind, at=known.index(name)))
    order = tuple(_KINDS.values())
    return tuple(sorted(found, key=lambda r: order.index(r.kind)))


def with_probes(
    arm: Arm, file: ModelFile, chain: Chain, made: RecordingModel
) -> tuple[Arm, tuple[str, ...]]:
    """Add the sites of further accelerometers and gyroscopes on the arm's links."""
    m, model = file.model, made.model
    wanted = {
        model.site(int(model.sensor_objid[s])).name
        for s in range(model.nsensor)
        if _KINDS.get(int(model.sensor_type[s])) in ("acceleration", "turning")
    } - {made.site}
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    spec, names = arm.spec.copy(), []
    for name in sorted(wanted):
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
        names.append(name)
    if not names:
        return arm, ()
    return replace(arm, spec=spec, probes=tuple(f"probe_{name}" for name in names)), tuple(names)
