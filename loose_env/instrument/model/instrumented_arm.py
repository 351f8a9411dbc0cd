"""InstrumentedArm: nominal arm, actuators, sensors and collisions, read for plan or recording."""

from __future__ import annotations

import re
import warnings as python_warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from loose_env.arms import (
    Arm,
    Chain,
    FileReport,
    HoldKind,
    LinearArm,
    ModelFile,
    arm_of_model_file,
    find_chain,
    model_file,
    read_model_file,
    report,
)
from loose_env.errors import InvalidData
from loose_env.instrument.model.actuators import (
    ActuatorForces,
    JointDrive,
    actuator_forces,
    drives_of,
    held_by_drives,
)
from loose_env.instrument.model.clearance import Collisions
from loose_env.instrument.model.readings import Reading, readings_of, with_probes
from loose_env.instrument.model.recording_model import (
    RecordingModel,
    recording_model,
    tool_force_of,
)
from loose_env.instrument.model.tool_site import body_beyond, sensed_sites, tool_site
from loose_env.instrument.result import HEALTHY, hypothesis_of
from loose_env.instrument.settings.arm_and_plan import Hold, ModelSettings
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class InstrumentedArm:
    """Arm of a model file with its actuators and sensors; n joints, base first.

    Planning and inference use the same one: the arm of the model as a recording holds it.
    """

    path: Path
    """The file."""
    report: FileReport
    """Summary of the file's contents."""
    recording_model: RecordingModel
    """Self-contained model that recordings of the arm are validated against."""
    nominal: Arm
    """Nominal arm with holding, payload, and a probe at every further sensor."""
    sites: tuple[str, ...]
    """The model's name of every site with a sensor, the tool first."""
    hold: Hold
    """Selected holding mode of the joints."""
    collisions: Collisions
    """Collision checks with the shapes of the file."""
    notes: tuple[str, ...]
    """Omissions and assumptions, in sentences."""

    @property
    def n(self) -> int:
        """Number of joints, and of links."""
        return self.nominal.n

    @property
    def joints(self) -> tuple[str, ...]:
        """The model's own names of the joints (n,)."""
        return tuple(joint.name for joint in self.report.joints)

    @property
    def links(self) -> tuple[str, ...]:
        """Body that each joint moves (n,)."""
        return self.report.links

    @cached_property
    def hypotheses(self) -> tuple[str, ...]:
        """Keys of a posterior: healthy, every link's slide, every joint's play."""
        return (
            HEALTHY,
            *(hypothesis_of("structural_looseness", link) for link in self.links),
            *(hypothesis_of("backlash", joint) for joint in self.joints),
        )

    @cached_property
    def linear(self) -> LinearArm:
        """The nominal arm, linearised wherever it is asked to be."""
        return LinearArm(self.nominal)

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """Usable sensors of the model, accelerometers first."""
        return readings_of(self.recording_model.model, self.sites, self.joints)

    @cached_property
    def tool_force(self) -> str | None:
        """Sensor of the measured force on the tool, in its axes; None where there is none."""
        return tool_force_of(self.recording_model.model, self.recording_model.site)

    @cached_property
    def actuators(self) -> ActuatorForces:
        """Forces of the model's actuators on the joints."""
        return actuator_forces(self.recording_model.model, self.joints)

    @cached_property
    def drives(self) -> tuple[JointDrive | None, ...]:
        """Actuator that servoes and excites each joint; None where none is linear (n,)."""
        return drives_of(self.recording_model.model, self.joints)[0]

    @property
    def held_by(self) -> str:
        """Description of the holding mode."""
        if self.hold != "model":
            return _HELD_BY[self.hold]
        servos = [d.joint for d in self.drives if d is not None and d.servo]
        if len(servos) == self.n:
            return "the model's position servos"
        if servos:
            return (
                f"the model's position servos ({', '.join(servos)}); the other joints by a soft "
                "controller of yours, taken to have 4 Hz"
            )
        return (
            "a soft controller of yours, taken to have 4 Hz: the model's actuators give torque "
            "alone"
        )

    @property
    def shown(self) -> Arm:
        """Arm for display: joints bear the model's names, reserved ones included."""
        if self.nominal.joints == self.joints:
            return self.nominal
        spec = self.nominal.spec.copy()
        for own, name in zip(self.nominal.joints, self.joints, strict=True):
            spec.joint(own).name = name
        return replace(self.nominal, spec=spec, joints=self.joints)

    @property
    def home(self) -> Array:
        """The model's first keyframe, or its reference pose [rad or m] (n,)."""
        model = self.recording_model.model
        return self._positions(model.key_qpos[0] if model.nkey else model.qpos0)

    def pose_of(self, pose: Mapping[str, float]) -> Array:
        """Joint positions (n,) of a pose by names.

        Joints that it does not name are at their reference in the model.
        """
        reference = self._positions(self.recording_model.model.qpos0)
        return np.array(
            [pose.get(j, float(q)) for j, q in zip(self.joints, reference, strict=True)]
        )

    def by_joint(self, pose: Array) -> dict[str, float]:
        """Joint positions (n,) by the joints' names."""
        return {joint: float(q) for joint, q in zip(self.joints, pose, strict=True)}

    def with_joint_names(self, notes: Sequence[str]) -> tuple[str, ...]:
        """Notes with joint numbers replaced by joint names."""

        def name(found: re.Match[str]) -> str:
            number = int(found[1])
            return f"joint {self.joints[number - 1]}" if 0 < number <= self.n else found[0]

        return tuple(re.sub(r"\bjoint (\d+)\b", name, note) for note in notes)

    def _positions(self, qpos: Array) -> Array:
        model = self.recording_model.model
        return np.array([qpos[int(model.joint(name).qposadr[0])] for name in self.joints])


_HELD_BY: Mapping[Hold, str] = {
    "brake": "stiff brakes",
    "servo": "assumed position servos of 25 Hz",
    "compliant": "brakes behind assumed elastic gears",
}


def read_arm(path: str | Path, settings: ModelSettings | None = None) -> InstrumentedArm:
    """Read a model and derive the drives, excitation and sensors of its arm.

    The accelerometer is where the settings say, by default where the model's own sits, of several
    as `loose_env.instrument.model.tool_site.tool_site` chooses; else as
    `loose_env.arms.arm_from_file` finds the tool. Actuators and sensors that a recording needs and
    the model lacks are added, see `loose_env.instrument.model.recording_model`.

    Parameters
    ----------
    path : str or Path
        MJCF or URDF of a serial arm on a fixed base.
    settings : ModelSettings, optional
        Properties that the file lacks.

    Raises
    ------
    InvalidSetting, InvalidData, UnknownName
        As `loose_env.arms.arm_from_file`.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> desk = read_arm(DESK_ARM)
    >>> desk.joints[:2], desk.drives[0].actuator
    (('base', 'shoulder'), 'actuator1')
    """
    settings = settings or ModelSettings()
    return _instrumented(read_model_file(path, package=settings.package_path), settings)


def read_recorded_arm(path: Path) -> InstrumentedArm:
    """Read the model of a recording, which has to hold the tool accelerometer.

    Raises
    ------
    InvalidData
        If the model is no serial arm on a fixed base or has no accelerometer on it.
    """
    file = read_model_file(path)
    kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
    if not any(sensor.type == kind for sensor in file.spec.sensors):
        raise InvalidData(
            f"{file.path.name}: the model has no accelerometer; a diagnosis needs one at the tool: "
            '<sensor><accelerometer name="tool_acc" site="tool"/></sensor>'
        )
    if tool_site(file.spec) is None:
        raise InvalidData(f"{file.path.name}: the site of the tool's accelerometer needs a name")
    return _instrumented(file, ModelSettings())


def _instrumented(file: ModelFile, settings: ModelSettings) -> InstrumentedArm:
    chain, notes = _chain_to_tool(file, settings.tool)
    made = recording_model(
        file,
        chain,
        payload_kg=settings.payload_kg,
        payload_at_m=settings.payload_at_m,
        tool_force=settings.excitation != "joint",
    )
    found = report(file, chain)
    if settings.tool is None and tool_site(file.spec) is not None:
        found = replace(found, tool_origin=f"where the model's {made.accelerometer!r} sits")
    copy = model_file(mujoco.MjSpec.from_string(made.xml), file.path, "MJCF")
    hold: HoldKind = "brake" if settings.hold == "model" else settings.hold
    with python_warnings.catch_warnings(record=True) as said:
        python_warnings.simplefilter("always")
        arm = arm_of_model_file(copy, tool=made.site, hold=hold)
    notes += [str(w.message).removeprefix(f"{file.path.name}: ") for w in said]
    joints = tuple(joint.name for joint in found.joints)
    if len(arm.joints) != len(joints):
        raise InvalidData(
            f"{file.path.name}: its copy with actuators has the joints {list(arm.joints)}, the "
            f"file {list(joints)}; name the tool with --tool"
        )
    notes += drives_of(made.model, joints)[1]
    if settings.hold == "model":
        arm = held_by_drives(arm, made.model, joints)
    nominal, probes = with_probes(arm, copy, find_chain(copy, made.site, None), made)
    return InstrumentedArm(
        path=file.path,
        report=found,
        recording_model=made,
        nominal=nominal,
        sites=(made.site, *probes),
        hold=settings.hold,
        collisions=Collisions.of(file.spec, joints),
        notes=(*found.warnings, *made.notes, *notes),
    )


def _chain_to_tool(file: ModelFile, tool: str | None) -> tuple[Chain, list[str]]:
    """Chain from the base to the accelerometer, and notes on what was assumed."""
    sites, own = sensed_sites(file.spec), tool_site(file.spec)
    if tool is not None or own is not None:
        several = tool is None and len(sites) > 1
        note = (
            f"the model has accelerometers at {', '.join(sites)}; the one at {own} is taken for "
            "the tool's: name another with --tool"
        )
        return find_chain(file, own if tool is None else tool, None), [note] if several else []
    chain = find_chain(file, None, None)
    outermost = body_beyond(file, chain)
    if outermost is None:
        return chain, []
    note = (
        f"the accelerometer is thought to sit at {outermost!r}, which is fixed to the last link; "
        "name another site or body with --tool"
    )
    return find_chain(file, outermost, None), [note]
