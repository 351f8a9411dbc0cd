"""Self-contained MJCF model for recordings: explicit inertias, no meshes, sensors added."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms import Chain, ModelFile, compile_spec
from loose_env.instrument.tool_site import mark_tool

ACCELEROMETER = "tool_accelerometer"
"""Name of the accelerometer that is added where the model has none at its tool."""
_TOOL = "tool"


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordingModel:
    """Model as ``recording.json`` needs it: every sensor has a name."""

    xml: str
    """MJCF, complete in itself."""
    model: mujoco.MjModel
    """The same, compiled."""
    site: str
    """Site of the tool accelerometer."""
    accelerometer: str
    """Sensor at the tool: columns ``sensor.<name>.x``, ``.y``, ``.z``."""
    positions: tuple[str, ...]
    """Position sensor of each driven joint, base first."""
    notes: tuple[str, ...]
    """Elements added to the model, in sentences."""


def recording_model(
    file: ModelFile,
    chain: Chain,
    *,
    payload_kg: float = 0.0,
    payload_at_m: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> RecordingModel:
    """Make a self-contained model that recordings can be validated against.

    Shapes from files go, inertias found from them are written out. A site, an accelerometer and
    position sensors are added where they are missing. Which site is the tool's is written into it.
    """
    spec = file.spec.copy()
    spec.compiler.fusestatic = False
    _name(spec)
    _write_out(spec, file.model)
    notes: list[str] = []
    m = file.model
    site = _tool(spec, m, chain)
    if payload_kg > 0:
        _load(spec, m, chain, payload_kg, payload_at_m)
        notes.append(f"a payload of {payload_kg:g} kg is added at the tool")
    accelerometer = _accelerometer(spec, site, notes)
    mark_tool(spec, site)
    joints = [m.joint(j).name for j in chain.joints]
    positions = _positions(spec, joints, notes)
    model = compile_spec(spec, file.path)
    return RecordingModel(
        xml=spec.to_xml(),
        model=model,
        site=site,
        accelerometer=accelerometer,
        positions=positions,
        notes=tuple(notes),
    )


def _name(spec: mujoco.MjSpec) -> None:
    """Name bodies, joints and sites as `read_model_file` does, and all columns."""
    for kind, elements in (
        ("body", spec.bodies[1:]),
        ("joint", spec.joints),
        ("site", spec.sites),
        ("actuator", spec.actuators),
        ("sensor", spec.sensors),
    ):
        taken = {e.name for e in elements}
        for number, element in enumerate(elements, start=1):
            if not element.name:
                element.name = _free(f"{kind}{number}", taken)
                taken.add(element.name)


def _free(name: str, taken: Iterable[str]) -> str:
    used = set(taken)
    while name in used:
        name += "_"
    return name


def _write_out(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write explicit inertias, and drop all that refers to files."""
    for body in spec.bodies[1:]:
        k = model.body(body.name).id
        body.mass = float(model.body_mass[k])
        body.ipos, body.iquat = model.body_ipos[k].copy(), model.body_iquat[k].copy()
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.inertia, body.fullinertia = model.body_inertia[k].copy(), np.full(6, np.nan)
        body.explicitinertial = body.mass > 0
    compiler = spec.compiler
    compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    compiler.settotalmass = -1
    shapes = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.type in shapes or geom.meshname:
            spec.delete(geom)
    for group in (spec.skins, spec.flexes, spec.pairs, spec.excludes):
        for element in list(group):
            spec.delete(element)
    for group in (spec.meshes, spec.materials, spec.textures, spec.hfields):
        for element in list(group):
            spec.delete(element)


def _tool(spec: mujoco.MjSpec, m: mujoco.MjModel, chain: Chain) -> str:
    if chain.tool_site is not None:
        return str(m.site(chain.tool_site).name)
    name = _free(_TOOL, (s.name for s in spec.sites))
    spec.body(m.body(chain.tool_body).name).add_site(name=name)
    return name


def _load(
    spec: mujoco.MjSpec, m: mujoco.MjModel, chain: Chain, mass: float, at: tuple[float, ...]
) -> None:
    """Add a payload to the tool: a solid ball of the density of steel."""
    body, place, quat = chain.tool_body, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if chain.tool_site is not None:
        # As compiled: in the file a site may be turned by other angles, or stand in a frame.
        body = int(m.site_bodyid[chain.tool_site])
        place, quat = m.site_pos[chain.tool_site], m.site_quat[chain.tool_site]
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(at, dtype=float), quat)
    radius = (3 * mass / (4 * np.pi * 7850.0)) ** (1 / 3)
    spec.body(m.body(body).name).add_body(
        name=_free("payload", (b.name for b in spec.bodies)),
        pos=list(place + turned),
        mass=mass,
        ipos=[0, 0, 0],
        inertia=[0.4 * mass * radius**2] * 3,
        explicitinertial=True,
    )


def _accelerometer(spec: mujoco.MjSpec, site: str, notes: list[str]) -> str:
    kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
    for sensor in spec.sensors:
        if sensor.type == kind and sensor.objname == site:
            return str(sensor.name)
    name = _free(ACCELEROMETER, (s.name for s in spec.sensors))
    spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
    notes.append(f"the model has no accelerometer at its tool: {name!r} is added at site {site!r}")
    return name


def _positions(spec: mujoco.MjSpec, joints: list[str], notes: list[str]) -> tuple[str, ...]:
    kind = mujoco.mjtSensor.mjSENS_JOINTPOS
    there = {s.objname: str(s.name) for s in spec.sensors if s.type == kind}
    added = [joint for joint in joints if joint not in there]
    for joint in added:
        name = _free(f"{joint}_position", (s.name for s in spec.sensors))
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint)
        there[joint] = name
    if added:
        notes.append(f"position sensors are added for joints {', '.join(added)}")
    return tuple(there[joint] for joint in joints)
