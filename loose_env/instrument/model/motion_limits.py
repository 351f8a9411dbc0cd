"""Joint limits of speed, acceleration, jerk and torque rate, collected with their sources.

A URDF states them at ``<limit velocity="..." acceleration="..." jerk="...">`` and in the
``ros2_control`` tag, as the range of a joint's velocity command. An MJCF states them as the range
of a velocity actuator, or as ``<custom><numeric name="max_speed_rad_s" data="..."/></custom>``
with the names of the settings. Of several statements the tightest counts.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.thresholds import ASSUMED_SLIDE_SPEED, ASSUMED_SPEED
from loose_env.typing import Array

Quantity = Literal["speed", "acceleration", "jerk", "torque rate"]
QUANTITIES: Mapping[Quantity, str] = {
    "speed": "max_speed_rad_s",
    "acceleration": "max_acceleration_rad_s2",
    "jerk": "max_jerk_rad_s3",
    "torque rate": "max_torque_rate_nm_s",
}
"""Limited quantity -> its setting."""
_UNITS = {
    "speed": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "jerk": ("rad/s³", "m/s³"),
    "torque rate": ("N·m/s", "N/s"),
}
_ATTRIBUTES: Mapping[str, Quantity] = {
    "velocity": "speed",
    "acceleration": "acceleration",
    "jerk": "jerk",
}


def unit_of(quantity: Quantity, slides: bool) -> str:
    """Unit of a quantity of a joint that slides, or turns."""
    return _UNITS[quantity][int(slides)]


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of n joints, base first; infinite where there is none."""

    values: Mapping[Quantity, Array]
    """Limit of each quantity, by joint (n,) [rad/s, rad/s², rad/s³, N·m/s; m, N for slides]."""
    sources: Mapping[Quantity, tuple[str, ...]]
    """Source of each; "" for none."""
    bandwidth_hz: float
    """Frequency up to which commands are followed [Hz]; infinite where it is not stated."""
    command_rate_hz: float | None
    """Rate of the commands [Hz]; None for that of the recorder."""

    def limit(self, quantity: Quantity, joint: int) -> float:
        """Limit of a joint, from 0; infinite where there is none."""
        return float(self.values[quantity][joint])


def motion_limits(arm: InstrumentedArm, settings: MotionSettings | None = None) -> MotionLimits:
    """Collect the limits of an arm: of the settings, else of its model, else assumed.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> from loose_env.instrument import read_arm
    >>> limits = motion_limits(read_arm(DESK_ARM), MotionSettings(max_jerk_rad_s3=(500.0,)))
    >>> limits.limit("jerk", 0), limits.sources["jerk"][0]
    (500.0, '--max-jerk-rad-s3')
    """
    own = MotionSettings() if settings is None else settings
    joints, slides = arm.joints, arm.nominal.sliding
    stated = _stated(arm)
    values: dict[Quantity, Array] = {}
    sources: dict[Quantity, tuple[str, ...]] = {}
    for quantity, name in QUANTITIES.items():
        given: Sequence[float] = getattr(own, name)
        if given:
            if len(given) not in (1, len(joints)):
                raise InvalidSetting(
                    f"{name} has one value for all joints, or one for each of "
                    f"{', '.join(joints)}; got {len(given)}"
                )
            values[quantity] = np.broadcast_to(np.array(given, dtype=float), len(joints)).copy()
            sources[quantity] = (f"--{name.replace('_', '-')}",) * len(joints)
            continue
        limits, said = np.full(len(joints), np.inf), [""] * len(joints)
        for j, joint in enumerate(joints):
            for value, source in stated.get((joint, quantity), []):
                if not (np.isfinite(value) and value > 0):
                    raise InvalidData(
                        f"{arm.path.name}: joint {joint!r} has a {quantity} limit of {value!r} in "
                        f"its {source}; it is a positive number, or give --{name.replace('_', '-')}"
                    )
                if value < limits[j]:
                    limits[j], said[j] = value, f"{source} of {arm.path.name}"
            if quantity == "speed" and not np.isfinite(limits[j]):
                limits[j] = ASSUMED_SLIDE_SPEED if slides[j] else ASSUMED_SPEED
                said[j] = "assumed"
        values[quantity], sources[quantity] = limits, tuple(said)
    return MotionLimits(
        values=values,
        sources=sources,
        bandwidth_hz=np.inf if own.command_bandwidth_hz is None else own.command_bandwidth_hz,
        command_rate_hz=own.command_rate_hz,
    )


_Stated = dict[tuple[str, Quantity], list[tuple[float, str]]]


def _stated(arm: InstrumentedArm) -> _Stated:
    """Limits that the file states, by joint and quantity, each with its place."""
    if arm.report.format == "URDF":
        return _of_urdf(arm)
    return _of_mjcf(arm)


def _of_urdf(arm: InstrumentedArm) -> _Stated:
    found: _Stated = {}
    root = ET.parse(arm.path).getroot()  # scanned when the model was read
    for joint in root.iterfind("joint"):
        limit = joint.find("limit")
        for attribute, quantity in _ATTRIBUTES.items():
            text = None if limit is None else limit.get(attribute)
            if text is None:
                continue
            value = _number(text)
            if value == 0:  # tools write 0 where nobody has filled it in
                continue
            place = f'<limit {attribute}="{text}">'
            found.setdefault((joint.get("name", ""), quantity), []).append((value, place))
    for joint in root.iterfind("ros2_control/joint"):
        for interface in joint.iterfind("command_interface"):
            kind = interface.get("name", "")
            ends = {p.get("name"): _number(p.text or "") for p in interface.iterfind("param")}
            if kind in _ATTRIBUTES and {"min", "max"} <= ends.keys():
                value = min(abs(ends["min"]), abs(ends["max"]))
                place = f"ros2_control {kind} command_interface"
                found.setdefault((joint.get("name", ""), _ATTRIBUTES[kind]), []).append(
                    (value, place)
                )
    return found


def _of_mjcf(arm: InstrumentedArm) -> _Stated:
    found: _Stated = {}
    model, joints = arm.recording_model.model, arm.joints
    for quantity, name in QUANTITIES.items():
        for k in range(model.nnumeric):
            if model.numeric(k).name != name:
                continue
            data = np.asarray(model.numeric(k).data, dtype=float)
            if len(data) not in (1, len(joints)):
                raise InvalidData(
                    f"{arm.path.name}: <numeric name={name!r}> has {len(data)} values; give one "
                    f"for all joints, or one for each of {', '.join(joints)}"
                )
            for joint, value in zip(joints, np.broadcast_to(data, len(joints)), strict=True):
                found.setdefault((joint, quantity), []).append(
                    (float(value), f"<numeric name={name!r}>")
                )
    for a in range(model.nu):
        bias, gain = model.actuator_biasprm[a], float(model.actuator_gainprm[a, 0])
        of_joint = int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        velocity = bias[1] == 0 and bias[2] != 0 and gain == -bias[2]
        if not (of_joint and velocity and model.actuator_ctrllimited[a]):
            continue
        joint = model.joint(int(model.actuator_trnid[a, 0])).name
        low, high = np.abs(model.actuator_ctrlrange[a] / model.actuator_gear[a, 0])
        place = f"<velocity ctrlrange> of actuator {model.actuator(a).name!r}"
        found.setdefault((joint, "speed"), []).append((float(min(low, high)), place))
    return found


def _number(text: str) -> float:
    """A number; NaN where it is none."""
    try:
        return float(text)
    except ValueError:
        return np.nan
