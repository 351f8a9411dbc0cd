"""What exports share: the result with the corrected model, its joints and drives, their output.

An export carries some kinds of effects; `not_carried` lists all others by name, so that none is
lost unnoticed. A drive with an affine force law, force = k u + b0 + b1 x + b2 v with gear g and
damping d, is a PD controller at the joint with stiffness -g² b1 and damping g² (d - b2), as MuJoCo
documents for position and velocity servos.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.model.nominal_model import affine_actuators
from loose_env.gap.output.result import GapResult, NamedEffect, read_result
from loose_env.io import Checked, Positive

ALL: tuple[str, ...] = ("*",)
"""Stands for all parameters of an effect."""
Carried = Mapping[str, tuple[str, ...]]
"""Kind of effect -> its parameters that an export carries, or `ALL`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportSource:
    """The named effects of a result, and the corrected model beside it."""

    result: GapResult
    """The result; it names one effect at least."""
    path: Path
    """File of the corrected model."""

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """The named effects."""
        return self.result.effects

    @cached_property
    def joints(self) -> tuple[JointValues, ...]:
        """Joints of the corrected model."""
        return joint_values(self.model)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The corrected model."""
        if not self.path.is_file():
            raise InvalidData(
                f"there is no corrected model {str(self.path)!r}, whose values this export needs; "
                "give the whole folder that 'loose gap' wrote"
            )
        try:
            return mujoco.MjModel.from_xml_path(str(self.path))
        except ValueError as error:
            raise InvalidData(f"{self.path} does not compile: {error}") from error


@dataclass(frozen=True, kw_only=True)
class ExportSettings(Checked):
    """Settings of an export."""

    timestep: Positive | None = None
    """Physics step of the trainer, in which mjlab and Isaac Lab count delays [s]; by default that
    of model.xml."""
    servo: str = ""
    """Name of the servo in BAM, such as xl330; needed for that target."""


@dataclass(frozen=True, kw_only=True)
class Export:
    """Files of one export, with what they do not contain."""

    files: Mapping[str, str]
    """Name of a file -> its text."""
    not_expressed: tuple[str, ...] = ()
    """Effects, or parameters of effects, that the target cannot express, in sentences."""
    notes: tuple[str, ...] = ()
    """Conditions under which the files hold, in sentences."""


def read_source(path: str | Path) -> ExportSource:
    """Read a result, and locate the corrected model beside it.

    Parameters
    ----------
    path : str or Path
        ``result.json`` of ``loose gap``, or the folder with it.

    Raises
    ------
    InvalidData
        If there is no result of this version, or it names no effect.

    Examples
    --------
    >>> read_source("no/such/folder")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: ...
    """
    result, place = read_result(path), Path(path)
    if not result.effects:
        raise InvalidData(
            f"{place} names no effect (verdict {result.verdict!r}): there is nothing to export. "
            "Only effects that 'loose gap' identified are exported"
        )
    folder = place if place.is_dir() else place.parent
    return ExportSource(result=result, path=folder / (result.model or "model.xml"))


def number(value: float) -> str:
    """Format a number with six significant digits."""
    return f"{value:.6g}"


def effect_words(effect: NamedEffect, names: Iterable[str] | None = None) -> str:
    """Format an effect with some of its parameters; by default with all."""
    return f"{effect.kind} at {effect.where} ({effect.values_in_words(names)})"


def not_carried(
    effects: Iterable[NamedEffect], carried: Carried, *, remedy: str = ""
) -> tuple[str, ...]:
    """List what an export with these kinds of effects leaves out, in sentences."""
    found = []
    for effect in effects:
        known = carried.get(effect.kind, ())
        lost = () if known == ALL else tuple(n for n in effect.parameters if n not in known)
        if lost:
            where = "model.xml" if effect.in_model else "the code in result.json"
            found.append(f"{effect_words(effect, lost)}; {remedy or f'{where} carries it'}")
    return tuple(found)


Mode = Literal["position", "velocity", "effort"]
_AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_SAME = 1e-6
"""Relative difference of two gains that are the same."""


@dataclass(frozen=True, kw_only=True)
class JointDrive:
    """One actuator at a joint."""

    name: str
    """Name of the actuator."""
    mode: Mode
    """Quantity that its command sets."""
    stiffness: float = 0.0
    """Proportional gain at the joint [N·m/rad, N/m]."""
    damping: float = 0.0
    """Derivative gain at the joint [N·m·s/rad, N·s/m]."""
    effort_limit: float | None = None
    """Largest torque or force at the joint [N·m, N]; None without a limit."""
    gear: float = 1.0
    """Torque at the joint over the force of the actuator."""
    effort_gain: float = 1.0
    """Torque at the joint per unit of an effort command."""
    delay: float = 0.0
    """Delay of the command [s]."""
    remarks: tuple[str, ...] = ()
    """Properties that a PD law does not have."""


@dataclass(frozen=True, kw_only=True)
class JointValues:
    """One joint with its passive properties."""

    name: str
    """Name of the joint."""
    turns: bool
    """Whether it is a hinge; otherwise a slide."""
    armature: float
    """Rotor inertia at the joint [kg·m², kg]."""
    frictionloss: float
    """Dry friction at rest [N·m, N]."""
    damping: float
    """Viscous friction [N·m·s/rad, N·s/m]."""
    drive: JointDrive | None = None
    """Its drive; None without one, or where it is no PD law."""
    reason: str = ""
    """Reason why a driven joint has no `drive`; "" otherwise."""


def joint_values(model: mujoco.MjModel) -> tuple[JointValues, ...]:
    """Read hinges and slides with their drives from a compiled model."""
    found = []
    for k in np.flatnonzero(np.isin(model.jnt_type, (_HINGE, _SLIDE))).tolist():
        dof = int(model.jnt_dofadr[k])
        drive, reason = _drive(model, k)
        found.append(
            JointValues(
                name=str(model.joint(k).name), turns=bool(model.jnt_type[k] == _HINGE),
                armature=float(model.dof_armature[dof]),
                frictionloss=float(model.dof_frictionloss[dof]),
                damping=float(model.dof_damping[dof]), drive=drive, reason=reason,
            )
        )  # fmt: skip
    return tuple(found)


def _drive(model: mujoco.MjModel, joint: int) -> tuple[JointDrive | None, str]:
    """Return the drive of a joint, or the reason why it has none that is a PD law."""
    at_joint = np.isin(model.actuator_trntype, _AT_JOINT)
    there = np.flatnonzero(at_joint & (model.actuator_trnid[:, 0] == joint))
    # an actuator without a command, as effects add them, is no drive
    own = [int(k) for k in there if model.actuator_ctrlnum[k] > 0]
    if not own:
        return None, ""
    names = ", ".join(str(model.actuator(k).name) for k in own)
    if len(own) > 1:
        return None, f"several actuators drive it ({names})"
    k = own[0]
    if not affine_actuators(model)[k] or model.actuator_gainprm[k][1:3].any():
        return None, f"the force of {names} is not linear in command, position and speed"
    gain, gear = float(model.actuator_gainprm[k, 0]), float(model.actuator_gear[k, 0])
    bias, stiff, damped = (float(v) for v in model.actuator_biasprm[k][:3])
    remarks = []
    if bias:
        remarks.append(f"the constant force of {names}")
    # a motor with a voltage limit loses torque with speed, the reverse of a velocity servo's sign
    mode: Mode = "position" if stiff else "velocity" if damped < 0 else "effort"
    expected = {"position": -stiff, "velocity": -damped, "effort": gain}[mode]
    if abs(gain - expected) > _SAME * abs(expected):
        remarks.append(f"the factor {gain / expected:.4g} on the command of {names}")
    limit = _effort_limit(model, joint, k, gain if mode == "effort" else None)
    if limit is not None and limit[0] != limit[1]:
        remarks.append(
            f"the effort limits of {names} by direction ({limit[0]:.4g} and {limit[1]:.4g}): the "
            "smaller one is exported"
        )
    return JointDrive(
        name=names, mode=mode, stiffness=-(gear**2) * stiff + 0.0,
        damping=(gear**2) * (float(model.actuator_damping[k]) - damped) + 0.0,
        effort_limit=None if limit is None else min(limit), gear=gear, effort_gain=gear * gain,
        delay=float(model.actuator_delay[k]), remarks=tuple(remarks),
    ), ""  # fmt: skip


def _effort_limit(
    model: mujoco.MjModel, joint: int, actuator: int, gain: float | None
) -> tuple[float, float] | None:
    """Largest torque at the joint against and along it, or None without a limit.

    The gain is that of a drive whose command is an effort, which the command's range limits too.
    """
    gear = abs(float(model.actuator_gear[actuator, 0]))
    ends = []
    if model.actuator_forcelimited[actuator]:
        ends.append(gear * np.abs(model.actuator_forcerange[actuator]))
    if gain is not None and model.actuator_ctrllimited[actuator]:
        ends.append(gear * abs(gain) * np.abs(model.actuator_ctrlrange[actuator]))
    if model.jnt_actfrclimited[joint]:
        ends.append(np.abs(model.jnt_actfrcrange[joint]))
    if not ends:
        return None
    low, high = np.min(ends, axis=0)
    return float(low), float(high)
