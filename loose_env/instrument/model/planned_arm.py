"""Arm from a model file, with the drives and sensors of a planned measurement."""

from __future__ import annotations

import re
import tempfile
import warnings as python_warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from loose_env.arms import (
    Arm,
    Chain,
    FileReport,
    HoldKind,
    ModelFile,
    arm_from_file,
    find_chain,
    load_spec,
    read_model_file,
    report,
)
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.instrument.model.actuators import JointDrive, drives_of, held_by_drives
from loose_env.instrument.model.clearance import Collisions
from loose_env.instrument.model.recording_model import Recordable, recordable
from loose_env.instrument.model.tool_site import sensed_sites, tool_site
from loose_env.instrument.settings.arm_and_plan import Hold

__all__ = ["ModelArm", "load_model_arm"]

_APART = 1e-3
"""Distance from the last link's frame at which a fixed body counts as farther out [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelArm:
    """Arm from a model file, with drives and sensors."""

    path: Path
    """The file."""
    report: FileReport
    """What was found in it."""
    arm: Arm
    """The arm with what holds its joints; its payload rides on the tool."""
    links: tuple[str, ...]
    """Bodies of the model, the one that each joint moves, base first (n,)."""
    joints: tuple[str, ...]
    """The model's own names of the driven joints, base first (n,)."""
    recordable: Recordable
    """A model that recordings of the arm can name: with actuators and sensors."""
    drives: tuple[JointDrive | None, ...]
    """Actuator that holds each joint and is played; None where none can be told in figures (n,)."""
    hold: Hold
    """How that was chosen."""
    held_by: str
    """What holds the joints, in words."""
    collisions: Collisions
    """Says in which poses the model's bodies touch."""
    notes: tuple[str, ...]
    """What was left out or had to be assumed."""

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """Names of all hypotheses: healthy, a slide at every link, play in every joint."""
        return (
            "healthy",
            *(f"structural_looseness@{name}" for name in self.links),
            *(f"backlash@{name}" for name in self.joints),
        )

    @property
    def home(self) -> np.ndarray:
        """The model's first keyframe, or its reference pose [rad or m] (n,)."""
        model = self.recordable.model
        whole = model.key_qpos[0] if model.nkey else model.qpos0
        return np.array([whole[int(model.joint(name).qposadr[0])] for name in self.joints])

    def named(self, notes: Sequence[str]) -> tuple[str, ...]:
        """Notes with joint numbers replaced by joint names."""

        def name(found: re.Match[str]) -> str:
            number = int(found[1])
            return (
                f"joint {self.joints[number - 1]}" if 0 < number <= len(self.joints) else found[0]
            )

        return tuple(re.sub(r"\bjoint (\d+)\b", name, note) for note in notes)

    def pose(self, values: np.ndarray) -> dict[str, float]:
        """Pose by joint [rad or m]."""
        return {name: float(q) for name, q in zip(self.joints, values, strict=True)}


def load_model_arm(
    path: str | Path,
    *,
    tool: str | None = None,
    hold: Hold = "model",
    payload_kg: float = 0.0,
    payload_at_m: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> ModelArm:
    """Read a model and derive the drives, excitation and sensors of its arm.

    Parameters
    ----------
    path : str or Path
        MJCF or URDF of a serial arm on a fixed base.
    tool : str, optional
        Site or body that carries the accelerometer. By default where the model's own
        accelerometer sits, of several as `loose_env.instrument.model.tool_site` says; else as
        `loose_env.arms.files.load.arm_from_file` finds it.
    hold : {"model", "brake", "servo", "compliant"}
        "model": on the springs of the model's position servos; where it has none, by a controller
        that is slow beside the band, `loose_env.instrument.model.actuators.held_by_drives`.
    payload_kg : float
        Mass that the tool carries and the model lacks [kg].
    payload_at_m : tuple of 3 floats
        Its centre in the tool frame [m].

    Raises
    ------
    InvalidSetting, InvalidData, UnknownName
        As `loose_env.arms.files.load.arm_from_file`; and if a payload makes no sense.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> desk = load_model_arm(DESK_ARM)
    >>> desk.joints[:2], desk.drives[0].actuator
    (('base', 'shoulder'), 'actuator1')
    """
    _check_payload(payload_kg, payload_at_m)
    if hold not in ("model", "brake", "servo", "compliant"):
        raise UnknownName(f"unknown hold {hold!r}: 'model', 'brake', 'servo' or 'compliant'")
    file = read_model_file(path)
    given, notes = (tool, []) if tool is not None else _sensed(path)
    sensed = tool is None and given is not None
    chain = find_chain(file, given, None)
    outermost = _fixed_beyond(file, chain) if given is None else None
    if outermost is not None:
        notes.append(
            f"the accelerometer is thought to sit at {outermost!r}, which is fixed to the last "
            "link; name another site or body with --tool"
        )
        chain = find_chain(file, outermost, None)
    made = recordable(
        file, chain, payload_kg=payload_kg, payload_at_m=tuple(float(x) for x in payload_at_m)
    )
    found = report(file, chain)
    if sensed:
        found = replace(found, tool_origin=f"where the model's {made.accelerometer!r} sits")
    own: HoldKind = "brake" if hold == "model" else hold
    with (
        tempfile.TemporaryDirectory() as folder,
        python_warnings.catch_warnings(record=True) as said,
    ):
        python_warnings.simplefilter("always")
        copy = Path(folder, f"{file.name}.xml")
        copy.write_text(made.xml, encoding="utf-8")
        arm = arm_from_file(copy, tool=made.site, hold=own)
    notes += [str(w.message).removeprefix(f"{copy.name}: ") for w in said]
    joints = tuple(joint.name for joint in found.joints)
    if len(arm.joints) != len(joints):
        raise InvalidData(
            f"{file.path.name}: its copy with actuators has the joints {list(arm.joints)}, the "
            f"file {list(joints)}; name the tool with --tool"
        )
    drives, why = drives_of(made.model, joints)
    notes += why
    if hold == "model":
        arm = held_by_drives(arm, made.model, joints)
    return ModelArm(
        path=file.path,
        report=found,
        arm=arm,
        links=found.links,
        joints=joints,
        recordable=made,
        drives=drives,
        hold=hold,
        held_by=_words(hold, drives),
        collisions=Collisions.of(load_spec(path)[2], joints),
        notes=(*found.warnings, *made.notes, *notes),
    )


def _check_payload(mass: float, at: tuple[float, ...]) -> None:
    if not np.isfinite(mass) or mass < 0:
        raise InvalidSetting(f"a payload has a mass of zero or more kg, got {mass!r}")
    if len(at) != 3 or not np.isfinite(at).all():
        raise InvalidSetting(
            f"the payload's centre is three finite numbers in the tool frame [m], got {at!r}"
        )


def _sensed(path: str | Path) -> tuple[str | None, list[str]]:
    """Site of the model's accelerometer, and a note where there are several."""
    spec = load_spec(path)[2]
    sites, taken = sensed_sites(spec), tool_site(spec)
    if len(sites) < 2:
        return taken, []
    return taken, [
        f"the model has accelerometers at {', '.join(sites)}; the one at {taken} is taken for the "
        "tool's: name another with --tool"
    ]


def _fixed_beyond(file: ModelFile, chain: Chain) -> str | None:
    """Outermost body fixed to the last link (e.g. a URDF flange), if without a site."""
    m, last = file.model, chain.links[-1]
    if chain.tool_site is not None or chain.tool_body != last:
        return None
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    fixed = [b for b in range(last + 1, m.nbody) if m.body_weldid[b] == last]
    away = [float(np.linalg.norm(data.xpos[b] - data.xpos[last])) for b in fixed]
    if not fixed or max(away) < _APART:
        return None
    # Of equals the one that comes last: tool0 rather than the flange it lies on.
    far = max(range(len(fixed)), key=lambda k: (round(away[k], 6), k))
    return str(m.body(fixed[far]).name)


def _words(hold: Hold, drives: tuple[JointDrive | None, ...]) -> str:
    if hold != "model":
        return {
            "brake": "stiff brakes",
            "servo": "assumed position servos of 25 Hz",
            "compliant": "brakes behind assumed elastic gears",
        }[hold]
    servos = [d.joint for d in drives if d is not None and d.servo]
    if len(servos) == len(drives):
        return "the model's position servos"
    if servos:
        return (
            f"the model's position servos ({', '.join(servos)}); the other joints by a soft "
            "controller of yours, taken to have 4 Hz"
        )
    return "a soft controller of yours, taken to have 4 Hz: the model's actuators give torque alone"
