"""Inspection of a model alone: joints, modes and detectable faults of an arm, also as text.

Every fault is evaluated in a few dozen poses, each joint shaken alone at the level that is
proposed there. A seat can be found along a direction if in some pose gravity lets it move and
what that changes stands out of the sensors' noise and the model's errors.

An inspection as one screen of text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis import Proposal, holding_modes
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_arm
from loose_env.instrument.planning.candidate_poses import candidate_poses
from loose_env.instrument.planning.detectability import Findable, best_seen, findable_faults
from loose_env.instrument.planning.excitation import limited, proposed, torque_of
from loose_env.instrument.settings.arm_and_plan import ModelSettings
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.io import json_text
from loose_env.typing import Array

FORMAT = "loose-inspection/1"
"""Format of the file."""
_DIGITS = 5


@dataclass(frozen=True, kw_only=True)
class JointSeen:
    """Properties of a joint under excitation."""

    name: str
    """The model's."""
    link: str
    """Body that it moves."""
    kind: str
    """"hinge" or "slide"."""
    range: tuple[float, float] | None
    """Allowed positions [rad or m]; None where it has no limits."""
    torque_limit: float
    """Peak torque of its drive [N·m, N]."""
    drive: str
    """Description of its drive."""
    level_tool: float
    """Proposed rms acceleration of the tool [m/s²]; 0 where it does not move the tool."""
    level_joint: float
    """The same at the joint [rad/s², m/s²]."""
    torque_rms: float
    """Rms noise torque that takes [N·m, N]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Inspection:
    """Result of an inspection."""

    arm: InstrumentedArm
    """The arm."""
    joints: tuple[JointSeen, ...]
    """Base first."""
    pose: Mapping[str, float]
    """Pose at which modes, band and levels are given [rad or m]."""
    modes_hz: tuple[float, ...]
    """Of the arm with all joints held, rising [Hz]."""
    band_hz: tuple[float, float]
    """Proposed band [Hz]."""
    noise_rms: float
    """Noise of an axis of the tool accelerometer in that band, rms [m/s²]."""
    seconds: float
    """Assumed length of a record [s]."""
    seconds_needed: float
    """Length at which noise and the seat's own rattling leave a direction with a standard
    deviation of 3 degrees, for half of what can be found [s]."""
    faults: tuple[Findable, ...]
    """Every fault that a diagnosis asks for."""
    poses: int
    """Number of poses in which they were evaluated."""
    warnings: tuple[str, ...]
    """Warnings, in sentences."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings, all of them."""

    def to_json(self) -> str:
        """Serialise to the format ``loose-inspection/1``."""
        found = self.arm.report
        whole = {
            "format": FORMAT,
            "model": self.arm.path.name,
            "tool": {
                "name": found.tool,
                "found": found.tool_origin,
                "site": self.arm.recording_model.site,
                "accelerometer": self.arm.recording_model.accelerometer,
            },
            "held_by": self.arm.held_by,
            "links": [
                {"name": name, "mass_kg": mass}
                for name, mass in zip(found.links, found.link_masses, strict=True)
            ],
            "joints": [asdict(joint) for joint in self.joints],
            "pose": dict(self.pose),
            "modes_hz": list(self.modes_hz),
            "band_hz": list(self.band_hz),
            "noise_rms": self.noise_rms,
            "seconds": self.seconds,
            "seconds_needed": self.seconds_needed,
            "poses": self.poses,
            "faults": [asdict(fault) for fault in self.faults],
            "warnings": list(self.warnings),
            "settings": dict(self.settings),
        }
        return json_text(whole, digits=_DIGITS)


def inspect_model(
    path: str | Path,
    settings: NextSettings | None = None,
    arm: ModelSettings | None = None,
) -> Inspection:
    """Predict from a model alone how well an arm can be diagnosed.

    Parameters
    ----------
    path : str or Path
        MJCF or URDF.
    settings : NextSettings, optional
        Noise, rate, length, gap of interest and number of poses.
    arm : ModelSettings, optional
        Properties that the file lacks: tool, holding, payload.

    Returns
    -------
    Inspection

    Raises
    ------
    InvalidSetting, InvalidData, UnknownName
        If the model cannot be used.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> seen = inspect_model(DESK_ARM, NextSettings(poses=2))
    >>> [fault.hypothesis for fault in seen.faults][-1]
    'backlash@turn'
    """
    rules = NextSettings() if settings is None else settings
    instrumented = read_arm(path, arm)
    own, linear = limited(instrumented.nominal, instrumented.linear, rules)
    ground = Ground.of(own, rules.ground_m)

    def allowed(pose: Array) -> bool:
        return ground.clear(pose) and not instrumented.collisions.touch(pose)

    where = candidate_poses(
        own,
        linear,
        count=rules.poses,
        margin=rules.margin,
        rng=np.random.default_rng(rules.seed),
        here=instrumented.home,
        allowed=allowed,
    )
    shakable = [j for j, drive in enumerate(instrumented.drives) if drive is not None]
    found = best_seen(linear, where, rules, shakable)
    shown = proposed(own, where[0], rules)
    none = np.zeros(own.n, dtype=bool)
    return Inspection(
        arm=instrumented,
        joints=_joints(instrumented, linear, where[0], shown, rules),
        pose=instrumented.by_joint(where[0]),
        modes_hz=tuple(float(f) for f in holding_modes(linear.at(where[0]), none)),
        band_hz=(float(shown.band[0]), float(shown.band[1])),
        noise_rms=found.noise,
        seconds=rules.seconds,
        seconds_needed=found.seconds(rules),
        faults=findable_faults(instrumented, found),
        poses=len(where),
        warnings=tuple(
            dict.fromkeys(
                (*_telling(instrumented.with_joint_names(shown.warnings)), *instrumented.notes)
            )
        ),
        settings={**asdict(arm or ModelSettings()), **asdict(rules)},
    )


def _telling(notes: Sequence[str]) -> list[str]:
    """Notes except that on modes below the band, above which an arm is free."""
    return [note for note in notes if not note.startswith("the lowest holding mode")]


def _joints(
    arm: InstrumentedArm, linear: LinearArm, pose: Array, shown: Proposal, rules: NextSettings
) -> tuple[JointSeen, ...]:
    nominal, at = arm.nominal, linear.at(pose)
    made = []
    for j, found in enumerate(arm.report.joints):
        torque = float(torque_of(shown, j, rules)[j])
        answer = at.response(np.arange(arm.n) == j).joint[:, j, 0]
        made.append(
            JointSeen(
                name=found.name,
                link=arm.links[j],
                kind=found.kind,
                range=found.range,
                torque_limit=nominal.torque_limits[j],
                drive=_drive_words(arm, j),
                level_tool=min(float(shown.levels[j]), rules.most_tool),
                level_joint=torque * float(np.sqrt(np.mean(np.abs(answer) ** 2))),
                torque_rms=torque,
            )
        )
    return tuple(made)


def _drive_words(arm: InstrumentedArm, j: int) -> str:
    drive = arm.drives[j]
    if drive is None:
        return "none with a linear law"
    if drive.servo:
        unit = "N/m" if arm.nominal.sliding[j] else "N·m/rad"
        return f"position servo {drive.actuator}, {drive.stiffness:.4g} {unit}"
    unit = "N" if arm.nominal.sliding[j] else "N·m"
    return f"torque motor {drive.actuator}, {drive.gain:.3g} {unit} per unit"


_WIDTH = 100


def screen(found: Inspection) -> str:
    """Format an inspection for a terminal."""
    arm = found.arm
    report = arm.report
    lines = [f"{report.file} ({report.format}): {len(found.joints)} joints", ""]
    rows: list[tuple[str, ...]] = [("joint", "moves", "mass", "range", "torque", "driven by")]
    rows += [
        (
            joint.name,
            joint.link,
            f"{mass:.3g} kg",
            _range(joint),
            f"{joint.torque_limit:.3g} {_torque(joint)}",
            joint.drive,
        )
        for joint, mass in zip(found.joints, report.link_masses, strict=True)
    ]
    lines += _table(rows)
    lines += ["", f"accelerometer: at {report.tool}, {report.tool_origin}"]
    lines += [
        f"payload: {branch.body} on {branch.link}, {branch.mass:.3g} kg"
        for branch in report.payload
    ]
    lines.append(f"held by: {arm.held_by}")
    pose = ", ".join(
        f"{value * 1e3:.0f} mm" if joint.kind == "slide" else f"{np.degrees(value):.0f}°"
        for joint, value in zip(found.joints, found.pose.values(), strict=True)
    )
    lines.append(f"in the pose {pose}:")
    lines.append(f"  modes of the held arm: {_hertz(found.modes_hz)}")
    lines.append(f"  band to shake in: {found.band_hz[0]:g} to {found.band_hz[1]:g} Hz")
    lines.append("")
    rows = [("shake", "tool, rms", "joint, rms", "torque, rms")]
    for joint in found.joints:
        if joint.torque_rms <= 0:
            rows.append((joint.name, "does not move the tool here", "", ""))
            continue
        turn = "m/s²" if joint.kind == "slide" else "rad/s²"
        rows.append(
            (
                joint.name,
                f"{joint.level_tool:.3g} m/s²",
                f"{joint.level_joint:.3g} {turn}",
                f"{joint.torque_rms:.3g} {_torque(joint)}",
            )
        )
    lines += _table(rows)
    gap = found.settings.get("gap_mm", 0.1)
    lines += [
        "",
        f"faults, in {found.poses} poses, records of {found.seconds:g} s, a gap of {gap:g} mm:",
    ]
    rows = [("fault", "found?", "smallest gap", "with a healthy record", "best shaken by")]
    rows += [
        (
            fault.hypothesis,
            fault.verdict if fault.verdict != "mostly" else f"mostly ({fault.directions:.0%})",
            _gap(found, fault, fault.smallest_gap_model),
            _gap(found, fault, fault.smallest_gap),
            fault.best_joint if fault.verdict != "no" else "",
        )
        for fault in found.faults
    ]
    lines += _table(rows)
    lines += [f"  {fault.hypothesis}: {fault.why}" for fault in found.faults if fault.why]
    lines += [
        f"  {fault.hypothesis} shows the same direction in every pose as {', '.join(fault.alike)}"
        for fault in found.faults
        if fault.alike
    ]
    needed = found.seconds_needed
    if np.isfinite(needed):
        length = "under 0.2" if needed < 0.2 else f"{needed:.2g}"
        lines.append(
            f"record length: after {length} s noise leaves 3° of a direction (accelerometer "
            f"{found.noise_rms * 1e3:.2g} mm/s² rms in the band); longer records do not help "
            "against errors of the model"
        )
    else:
        lines.append("record length: no fault shows at this noise, gap and level, however long")
    for warning in found.warnings:
        lines += wrap(f"note: {warning}", _WIDTH, subsequent_indent="      ")
    return "\n".join(lines)


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _range(joint: JointSeen) -> str:
    if joint.range is None:
        return "no limits"
    low, high = joint.range
    if joint.kind == "slide":
        return f"{low * 1e3:.0f} to {high * 1e3:.0f} mm"
    return f"{np.degrees(low):.0f} to {np.degrees(high):.0f}°"


def _torque(joint: JointSeen) -> str:
    return "N" if joint.kind == "slide" else "N·m"


def _hertz(modes: Sequence[float]) -> str:
    shown = [f"{f:.0f}" if f >= 10 else f"{f:.1f}" for f in modes[:8]]
    more = f" and {len(modes) - 8} more" if len(modes) > 8 else ""
    return ", ".join(shown) + f" Hz{more}" if shown else "none"


def _gap(found: Inspection, fault: Findable, gap: float | None) -> str:
    if gap is None:
        return "none shows"
    kind, _, where = fault.hypothesis.partition("@")
    joint = next((j for j in found.joints if j.name == where), None)
    if kind == "backlash" and joint is not None and joint.kind == "hinge":
        return f"{np.degrees(gap) * 60:.2g} arcmin"
    return f"{gap * 1e3:.2g} mm"
