"""Export of actuator configurations for mjlab and for Isaac Lab, as Python text.

Fields are those of ``mjlab.actuator`` 1.6 (``ActuatorCfg``, ``DcMotorActuatorCfg`` and the classes
``Builtin...Cfg``) and of ``isaaclab.actuators`` 2.3 (``ActuatorBaseCfg``, ``IdealPDActuatorCfg``,
``DCMotorCfg``, ``DelayedPDActuatorCfg``, ``ImplicitActuatorCfg``), as their docstrings define them.
Delays are whole physics steps there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from loose_env.gap.output.export_source import (
    ALL,
    Export,
    ExportSettings,
    ExportSource,
    JointDrive,
    JointValues,
    not_carried,
    number,
)
from loose_env.gap.output.result import NamedEffect

_CARRIED = {
    "viscous_friction": ALL,
    "coulomb_friction": ALL,
    "rotor_inertia": ALL,
    "actuator_gain": ALL,
    "command_delay": ALL,
    "torque_limit": ALL,
    "voltage_limit": ALL,
}
_CARRIED_BY_ISAACLAB = {**_CARRIED, "stribeck_friction": ("torque", "static_ratio")}
_AT_DRIVE = frozenset({"actuator_gain", "command_delay", "torque_limit", "voltage_limit"})
"""Kinds that only the configuration of a drive carries."""


_Config = tuple[str, dict[str, str]]
"""Name of a class, and its arguments with their Python text."""


def mjlab_export(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write actuator configurations for mjlab."""
    step = settings.timestep or float(source.model.opt.timestep)
    configs: list[_Config] = []
    left: list[str] = []
    for joint in source.joints:
        lags, lost = _lags(source.effects, joint, step)
        left += lost
        if joint.drive is None:
            left += _undriven(source.effects, joint)
            continue
        left += joint.drive.remarks
        drive = joint.drive
        own = {"target_names_expr": f"({re.escape(joint.name)!r},)"}
        motor = _motor(source.effects, joint)
        if drive.mode == "effort" and motor:
            left += _effort_scale(drive)
            kind, own = "DcMotorActuatorCfg", own | {"stiffness": "0.0", "damping": "0.0"} | motor
        elif drive.mode == "effort":
            limit = drive.effort_limit
            kind, gear = "BuiltinMotorActuatorCfg", drive.effort_gain
            own["effort_limit"] = 'float("inf")' if limit is None else number(limit / abs(gear))
            own["gear"] = number(gear)
        else:
            position = drive.mode == "position"
            kind = "BuiltinPositionActuatorCfg" if position else "BuiltinVelocityActuatorCfg"
            if position:
                own["stiffness"] = number(drive.stiffness)
            own["damping"] = number(drive.damping)
            if drive.effort_limit is not None:
                own["effort_limit"] = number(drive.effort_limit)
            if motor:
                kind = "DcMotorActuatorCfg"
                own = {"stiffness": number(drive.stiffness)} | own | motor
        own |= {
            "armature": number(joint.armature),
            "frictionloss": number(joint.frictionloss),
            "viscous_damping": number(joint.damping),
        }
        if lags[1]:
            own |= {"delay_min_lag": str(lags[0]), "delay_max_lag": str(lags[1])}
        configs.append((kind, own))
    left = [*not_carried(source.effects, _CARRIED), *left]
    lines = [f"    {_call(config)}," for config in configs]
    text = _module("mjlab", "mjlab.actuator", configs, left, step, ["ACTUATORS = (", *lines, ")"])
    return Export(
        files={"mjlab_actuators.py": text},
        not_expressed=tuple(left),
        notes=(
            "armature, frictionloss and viscous_damping replace those of the joints; the other "
            "effects are those of the MJCF file that the entity loads: load model.xml without its "
            "actuators",
        ),
    )


def isaaclab_export(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write actuator configurations for Isaac Lab."""
    step = settings.timestep or float(source.model.opt.timestep)
    configs: dict[str, _Config] = {}
    left: list[str] = []
    for joint in source.joints:
        lags, lost = _lags(source.effects, joint, step)
        left += lost
        own = {"joint_names_expr": f"[{re.escape(joint.name)!r}]"}
        drive = joint.drive
        if drive is None:  # a joint that nothing drives has friction and inertia too
            left += [w for w in _undriven(source.effects, joint) if joint.reason]
            own |= {"stiffness": "0.0", "damping": "0.0"}
        else:
            left += drive.remarks
            left += _effort_scale(drive)
            own |= {"stiffness": number(drive.stiffness), "damping": number(drive.damping)}
            if drive.effort_limit is not None:
                own["effort_limit"] = number(drive.effort_limit)
        falls = _fall_of_friction(source.effects, joint.name)
        own |= {
            "armature": number(joint.armature),
            "friction": number(joint.frictionloss),
            "dynamic_friction": number(max(joint.frictionloss - falls, 0.0)),
            "viscous_friction": number(joint.damping),
        }
        kind = "ImplicitActuatorCfg" if drive is None else "IdealPDActuatorCfg"
        if motor := _motor(source.effects, joint):
            kind, own = "DCMotorCfg", own | motor
            if lags[1]:
                left.append(f"the delay of {joint.name}: DCMotorCfg has none")
        elif lags[1]:
            kind = "DelayedPDActuatorCfg"
            own |= {"min_delay": str(lags[0]), "max_delay": str(lags[1])}
        configs[joint.name] = (kind, own)
    left = [
        *not_carried(
            source.effects,
            _CARRIED_BY_ISAACLAB,
            remedy="change the USD asset or the environment accordingly",
        ),
        *left,
    ]
    lines = [f"    {name!r}: {_call(config)}," for name, config in configs.items()]
    text = _module(
        "Isaac Lab", "isaaclab.actuators", list(configs.values()), left, step,
        ["ACTUATORS = {", *lines, "}"],
    )  # fmt: skip
    return Export(
        files={"isaaclab_actuators.py": text},
        not_expressed=tuple(left),
        notes=(
            "friction and dynamic_friction are torques or forces, as from Isaac Sim 5.0 on; in "
            "Isaac Sim 4.5 they are coefficients",
            "velocity_limit is that of the USD asset where none is written",
        ),
    )


def _lags(
    effects: Sequence[NamedEffect], joint: JointValues, step: float
) -> tuple[tuple[int, int], list[str]]:
    """Smallest and largest delay of a joint's commands in steps, and what is lost of it."""
    drive = joint.drive
    if drive is None or drive.delay <= 0:
        return (0, 0), []
    low = high = drive.delay
    for effect in effects:
        if effect.kind == "command_delay" and effect.where in (drive.name, "all"):
            value = effect.parameters["delay"]
            ends = effect.interval_95.get("delay", (value, value))
            low, high = drive.delay + ends[0] - value, drive.delay + ends[1] - value
    steps = (max(round(low / step), 0), max(round(high / step), 0))
    if steps[1]:
        return steps, []
    return steps, [
        f"the delay of {drive.name}, {drive.delay:.3g} s: less than half a physics step of "
        f"{step:.3g} s"
    ]


def _undriven(effects: Sequence[NamedEffect], joint: JointValues) -> list[str]:
    """Say what is lost at a joint without a drive that can be configured."""
    reason = joint.reason or "no actuator drives it"
    own = [e.kind for e in effects if e.where == joint.name and e.kind not in _AT_DRIVE]
    words = f": {', '.join(own)}" if own else ""
    return [f"the configuration of joint {joint.name}{words}, because {reason}"]


def _effort_scale(drive: JointDrive) -> list[str]:
    """Remark on the torque per command of a motor, where that is not one."""
    if drive.mode != "effort" or abs(drive.effort_gain - 1.0) <= 1e-9:
        return []
    return [
        f"the torque of {drive.name} per command, {drive.effort_gain:.4g}; multiply the effort "
        "targets by it"
    ]


def _motor(effects: Sequence[NamedEffect], joint: JointValues) -> dict[str, str]:
    """Torque-speed line of a joint's drive whose voltage limit was identified; empty if none."""
    drive = joint.drive
    for effect in effects:
        if drive is not None and effect.kind == "voltage_limit" and effect.where == drive.name:
            gear = abs(drive.gear)
            stall = number(gear * effect.parameters["stall_torque"])
            speed = number(effect.parameters["no_load_speed"] / gear)
            return {"effort_limit": stall, "saturation_effort": stall, "velocity_limit": speed}
    return {}


def _fall_of_friction(effects: Sequence[NamedEffect], joint: str) -> float:
    """Static less dynamic friction of a joint [N·m, N]."""
    return sum(
        (e.parameters["static_ratio"] - 1.0) * e.parameters["torque"]
        for e in effects
        if e.kind == "stribeck_friction" and e.where == joint
    )


def _call(config: _Config) -> str:
    given = "".join(f"\n        {name}={text}," for name, text in config[1].items())
    return f"{config[0]}({given}\n    )"


def _module(
    target: str,
    package: str,
    configs: Sequence[_Config],
    left: Sequence[str],
    step: float,
    lines: Sequence[str],
) -> str:
    """Python text with its imports, and the list of what it does not contain."""
    kinds = sorted({kind for kind, _ in configs})
    head = [
        f'"""Actuators for {target}, identified by \'loose gap\'.',
        "",
        f"Delays are counted in physics steps of {number(step)} s.",
    ]
    if left:
        head += ["", "Not expressed:", *(f"- {words}" for words in left)]
    names = [f"    {kind}," for kind in kinds]
    imports = [f"from {package} import (", *names, ")"] if kinds else []
    return "\n".join([*head, '"""', "", *imports, "", *lines, ""])
