"""What a model says about measuring its arm: joints, modes, and which faults could be found.

Every fault is looked at in a few dozen poses, each joint shaken alone at the level that is
proposed there. A seat can be found along a direction if in some pose gravity lets it move and
what that changes stands out of the sensors' noise and the model's errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.linear import LinearArm
from loose_env.diagnosis.records.excitation_design import Proposal, holding_modes
from loose_env.instrument.candidates import candidate_poses
from loose_env.instrument.findable import Findable, best_seen, findable_faults
from loose_env.instrument.ground import Ground
from loose_env.instrument.model_arm import ModelArm
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.plan import load
from loose_env.instrument.plan_settings import ModelSettings
from loose_env.instrument.proposed import limited, proposed, torque_of
from loose_env.io.json_codec import json_text

__all__ = ["FORMAT", "Inspection", "JointSeen", "inspect_model"]

Array = NDArray[np.float64]

FORMAT = "loose-inspection/1"
"""Format of the file."""
_DIGITS = 5


@dataclass(frozen=True, kw_only=True)
class JointSeen:
    """A joint as it will be shaken."""

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
    """What drives it, in words."""
    level_tool: float
    """Proposed rms acceleration of the tool [m/s²]; 0 where it does not move the tool."""
    level_joint: float
    """The same at the joint [rad/s², m/s²]."""
    torque_rms: float
    """Rms noise torque that takes [N·m, N]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Inspection:
    """What was found."""

    machine: ModelArm
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
    """Length of a record that was reckoned with [s]."""
    seconds_needed: float
    """Length at which noise and the seat's own rattling leave a direction with a standard
    deviation of 3 degrees, for half of what can be found [s]."""
    faults: tuple[Findable, ...]
    """Every fault that a diagnosis asks for."""
    poses: int
    """Poses in which they were looked at."""
    warnings: tuple[str, ...]
    """What to know."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything that it depends on besides the model."""

    def to_json(self) -> str:
        """Text of a file of the format ``loose-inspection/1``."""
        found = self.machine.report
        whole = {
            "format": FORMAT,
            "model": self.machine.path.name,
            "tool": {
                "name": found.tool,
                "found": found.tool_origin,
                "site": self.machine.recordable.site,
                "accelerometer": self.machine.recordable.accelerometer,
            },
            "held_by": self.machine.held_by,
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
    """Say what a model promises for a diagnosis of its arm.

    Parameters
    ----------
    path : str or Path
        MJCF or URDF.
    settings : NextSettings, optional
        Noise, rate, length, gap of interest and number of poses.
    arm : ModelSettings, optional
        What the file does not say: tool, what holds the joints, payload.

    Returns
    -------
    Inspection

    Raises
    ------
    InvalidSetting, InvalidData, UnknownName
        If the model cannot be used.

    Examples
    --------
    >>> from loose_env.arms.from_file import DESK_ARM
    >>> seen = inspect_model(DESK_ARM, NextSettings(poses=2))
    >>> [fault.hypothesis for fault in seen.faults][-1]
    'backlash@turn'
    """
    rules = NextSettings() if settings is None else settings
    machine = load(path, arm)
    own, linear = limited(machine.arm, LinearArm(machine.arm), rules)
    ground = Ground.of(own, rules.ground_m)

    def allowed(pose: Array) -> bool:
        return ground.clear(pose) and not machine.collisions.touch(pose)

    where = candidate_poses(
        own,
        linear,
        count=rules.poses,
        margin=rules.margin,
        rng=np.random.default_rng(rules.seed),
        here=machine.home,
        allowed=allowed,
    )
    shakable = [j for j, drive in enumerate(machine.drives) if drive is not None]
    found = best_seen(linear, where, rules, shakable)
    shown = proposed(own, where[0], rules)
    none = np.zeros(own.n, dtype=bool)
    return Inspection(
        machine=machine,
        joints=_joints(machine, linear, where[0], shown, rules),
        pose=machine.pose(where[0]),
        modes_hz=tuple(float(f) for f in holding_modes(linear.at(where[0]), none)),
        band_hz=(float(shown.band[0]), float(shown.band[1])),
        noise_rms=found.noise,
        seconds=rules.seconds,
        seconds_needed=found.seconds(rules),
        faults=findable_faults(machine, found),
        poses=len(where),
        warnings=tuple(dict.fromkeys((*_telling(machine.named(shown.warnings)), *machine.notes))),
        settings={**asdict(arm or ModelSettings()), **asdict(rules)},
    )


def _telling(notes: Sequence[str]) -> list[str]:
    """Notes without the one on modes below the band, above which an arm is merely free."""
    return [note for note in notes if not note.startswith("the lowest holding mode")]


def _joints(
    machine: ModelArm, linear: LinearArm, pose: Array, shown: Proposal, rules: NextSettings
) -> tuple[JointSeen, ...]:
    arm, at = machine.arm, linear.at(pose)
    made = []
    for j, found in enumerate(machine.report.joints):
        torque = float(torque_of(shown, j, rules)[j])
        answer = at.response(np.arange(arm.n) == j).joint[:, j, 0]
        made.append(
            JointSeen(
                name=found.name,
                link=machine.links[j],
                kind=found.kind,
                range=found.range,
                torque_limit=arm.torque_limits[j],
                drive=_drive_words(machine, j),
                level_tool=min(float(shown.levels[j]), rules.most_tool),
                level_joint=torque * float(np.sqrt(np.mean(np.abs(answer) ** 2))),
                torque_rms=torque,
            )
        )
    return tuple(made)


def _drive_words(machine: ModelArm, j: int) -> str:
    drive = machine.drives[j]
    if drive is None:
        return "none that can be told in figures"
    if drive.servo:
        unit = "N/m" if machine.arm.sliding[j] else "N·m/rad"
        return f"position servo {drive.actuator}, {drive.stiffness:.4g} {unit}"
    unit = "N" if machine.arm.sliding[j] else "N·m"
    return f"torque motor {drive.actuator}, {drive.gain:.3g} {unit} per unit"
