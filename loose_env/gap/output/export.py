"""Export of a result to mujoco.sysid, mjlab, Isaac Lab, URDF, USD, BAM or ranges, as files.

An export carries some kinds of effects, and lists all others by name, so that none is lost
unnoticed. Values are those of the corrected model beside ``result.json``. An effect such as viscous
friction adds to one attribute there: nominal is that less the effect, and its bounds are the 95 %
interval of the effect, added to the nominal value.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import AT_JOINT, MOVING, affine_actuators
from loose_env.gap.output.result import NamedEffect, read_result
from loose_env.io import Checked, Positive, json_text, plain, write_text
from loose_env.recording import CommandTiming


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


def export_result(
    path: str | Path,
    target: str,
    settings: ExportSettings | None = None,
    *,
    urdf: Path | None = None,
) -> Export:
    """Export the named effects of a result.

    Parameters
    ----------
    path : str or Path
        ``result.json`` of ``loose gap``, or the folder with it.
    target : str
        One of `TARGETS`: "sysid", "mjlab", "isaaclab", "urdf", "usd", "bam", "drivebam", "ranges".
    settings : ExportSettings, optional
        Settings of the export.
    urdf : Path, optional
        URDF of the arm, for the target "urdf".

    Raises
    ------
    InvalidData
        If there is no result of this version, or it names no effect.
    InvalidSetting
        If a setting that the target needs is missing.
    UnknownName
        If there is no such target.

    Examples
    --------
    >>> export_result("arm-gap", "gazebo")
    Traceback (most recent call last):
        ...
    loose_env.errors.UnknownName: no export to 'gazebo'; there are sysid, mjlab, isaaclab, ...
    """
    if target not in TARGETS:
        raise UnknownName(f"no export to {target!r}; there are {', '.join(TARGETS)}")
    result, place = read_result(path), Path(path)
    if not result.effects:
        raise InvalidData(
            f"{place} names no effect (verdict {result.verdict!r}): there is nothing to export. "
            "Only effects that 'loose gap' identified are exported"
        )
    folder = place if place.is_dir() else place.parent
    model = folder / (result.model or "model.xml")
    given = settings or ExportSettings()
    source = _Source(
        effects=result.effects, commands=result.commands, path=model, settings=given, urdf=urdf
    )
    return TARGETS[target](source)


def write_export(folder: str | Path, export: Export) -> list[Path]:
    """Write the files of an export into a folder, each complete or not at all.

    Returns
    -------
    list of Path
        The files.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    return [write_text(place / name, text) for name, text in export.files.items()]


# Source: effects, and the corrected model with its joints and drives


@dataclass(frozen=True, kw_only=True, eq=False)
class _Source:
    """The named effects of a result, and the corrected model beside it."""

    effects: tuple[NamedEffect, ...]
    commands: Mapping[str, CommandTiming]
    path: Path
    settings: ExportSettings
    urdf: Path | None

    @cached_property
    def spec(self) -> mujoco.MjSpec:
        """The corrected model, to be read element by element."""
        if not self.path.is_file():
            raise InvalidData(
                f"there is no corrected model {str(self.path)!r}, whose values this export needs; "
                "give the whole folder that 'loose gap' wrote"
            )
        try:
            spec = mujoco.MjSpec.from_file(str(self.path))
            spec.compile()
        except ValueError as error:
            raise InvalidData(f"{self.path} does not compile: {error}") from error
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The same compiled."""
        return self.spec.compile()

    @cached_property
    def joints(self) -> tuple[_Joint, ...]:
        """Hinges and slides."""
        single = np.flatnonzero(np.isin(self.model.jnt_type, MOVING)).tolist()
        return tuple(_joint(self.model, k) for k in single)

    @property
    def step(self) -> float:
        """Physics step in which delays are counted [s]."""
        return self.settings.timestep or float(self.model.opt.timestep)

    def not_carried(
        self, carried: Mapping[str, Sequence[str]], *, remedy: str = ""
    ) -> tuple[str, ...]:
        """What an export leaves out that carries these parameters of kinds of effects."""
        found = []
        for effect in self.effects:
            known = carried.get(effect.kind, ())
            if lost := [] if known is _ALL else [n for n in effect.parameters if n not in known]:
                where = "model.xml" if effect.in_model else "the code in result.json"
                part = _PARTLY.get(effect.kind, "") if len(lost) == len(effect.parameters) else ""
                found.append(f"{_words(effect, lost)}{part}; {remedy or f'{where} carries it'}")
        return (*found, *self.timings())

    def timings(self) -> Iterator[str]:
        """How commands act that are not held: no target has it, and delays are beyond it."""
        for timing in dict.fromkeys(self.commands.values()):
            names = " and ".join(n for n, each in self.commands.items() if each == timing)
            way = "held" if timing.mode == "held" else "along straight lines"
            late = f", {1e3 * timing.shift_s:.3g} ms after their stamps" if timing.shift_s else ""
            yield (
                f"commands of {names} act {way} from sample to sample of the log{late}, and delays "
                "count from there; give the simulation references that are timed so"
            )


_ALL: tuple[str, ...] = ("*",)  # stands for all parameters of an effect
_PARTLY = {
    "asymmetric_friction": ": only their mean is written, as dry friction",
    "stribeck_friction": ": only that at rest is written, as dry friction",
}
"""Part of an effect that the friction of a joint has where a target has none for the whole."""
_NO_DRIVE = "no actuator drives it"
_SAME = 1e-6  # relative difference of two gains that are the same


def _words(effect: NamedEffect, names: Iterable[str] | None = None) -> str:
    """An effect with some of its parameters; by default with all."""
    return f"{effect.kind} at {effect.where} ({effect.values_in_words(names)})"


@dataclass(frozen=True, kw_only=True)
class _Joint:
    """One hinge or slide, and its drive as a PD controller at the joint.

    A drive with an affine force law, force = k u + b0 + b1 x + b2 v with gear g and damping d, has
    the stiffness -g² b1 and the damping g² (d - b2), as MuJoCo documents for its servos.
    """

    name: str
    turns: bool
    armature: float  # [kg·m², kg]
    frictionloss: float  # at rest [N·m, N]
    viscous: float  # [N·m·s/rad, N·s/m]
    drive: str = ""  # its actuator; "" if it has none that is a PD law
    undriven: str = _NO_DRIVE  # reason why
    mode: str = ""  # "position", "velocity" or "effort", which its command sets
    stiffness: float = 0.0  # [N·m/rad, N/m]
    damping: float = 0.0  # [N·m·s/rad, N·s/m]
    effort_limit: float | None = None  # largest torque or force at the joint [N·m, N]
    gear: float = 1.0  # torque at the joint over the force of the actuator
    effort_gain: float = 1.0  # torque at the joint per unit of an effort command
    delay: float = 0.0  # of the command [s]
    remarks: tuple[str, ...] = ()  # properties that a PD law does not have
    scale: tuple[str, ...] = ()  # remark on the torque per effort command, where that is not 1


def _joint(model: mujoco.MjModel, joint: int) -> _Joint:
    """Read a joint from a compiled model, with the actuator of affine force that drives it."""
    dof, at_joint = int(model.jnt_dofadr[joint]), np.isin(model.actuator_trntype, AT_JOINT)
    alone = _Joint(
        name=str(model.joint(joint).name), turns=bool(model.jnt_type[joint] == MOVING[0]),
        armature=float(model.dof_armature[dof]), frictionloss=float(model.dof_frictionloss[dof]),
        viscous=float(model.dof_damping[dof]),
    )  # fmt: skip
    there = np.flatnonzero(at_joint & (model.actuator_trnid[:, 0] == joint))
    # an actuator without a command, as effects add them, is no drive
    own = [int(k) for k in there if model.actuator_ctrlnum[k] > 0]
    name = ", ".join(str(model.actuator(k).name) for k in own)
    if not own:
        return alone
    if len(own) > 1:
        return replace(alone, undriven=f"several actuators drive it ({name})")
    k = own[0]
    if not affine_actuators(model)[k] or model.actuator_gainprm[k, 1:3].any():
        words = f"the force of {name} is not linear in command, position and speed"
        return replace(alone, undriven=words)
    gain, gear = float(model.actuator_gainprm[k, 0]), float(model.actuator_gear[k, 0])
    bias, stiff, damped = (float(v) for v in model.actuator_biasprm[k][:3])
    remarks = [f"the constant force of {name}"] if bias else []
    # a motor with a voltage limit loses torque with speed, the reverse of a velocity servo's sign
    mode = "position" if stiff else "velocity" if damped < 0 else "effort"
    expected = {"position": -stiff, "velocity": -damped, "effort": gain}[mode]
    if abs(gain - expected) > _SAME * abs(expected):
        remarks.append(f"the factor {gain / expected:.4g} on the command of {name}")
    ends = [(inf, inf)]  # against and along the joint
    if model.actuator_forcelimited[k]:
        ends.append(abs(gear) * np.abs(model.actuator_forcerange[k]))
    if mode == "effort" and model.actuator_ctrllimited[k]:
        ends.append(abs(gear * gain) * np.abs(model.actuator_ctrlrange[k]))
    if model.jnt_actfrclimited[joint]:
        ends.append(np.abs(model.jnt_actfrcrange[joint]))
    low, high = np.min(ends, axis=0).tolist()
    if low != high:
        limits = f"the effort limits of {name} by direction ({low:.4g} and {high:.4g})"
        remarks.append(f"{limits}: the smaller one is exported")
    scale = f"the torque of {name} per command, {gear * gain:.4g}"
    scaled = mode == "effort" and abs(gear * gain - 1.0) > 1e-9
    return replace(
        alone, drive=name, mode=mode, stiffness=-(gear**2) * stiff + 0.0,
        damping=(gear**2) * (float(model.actuator_damping[k]) - damped) + 0.0,
        effort_limit=min(low, high) if len(ends) > 1 else None, gear=gear,
        effort_gain=gear * gain, delay=float(model.actuator_delay[k]), remarks=tuple(remarks),
        scale=(f"{scale}; multiply the effort targets by it",) * scaled,
    )  # fmt: skip


# Parameters with their intervals: mujoco.sysid, ranges


@dataclass(frozen=True, kw_only=True)
class _Parameter:
    """One parameter of one effect, as the value of an attribute in MJCF where there is one."""

    effect: NamedEffect
    where: str  # location; the element itself where the effect is on all actuators
    parameter: str
    nominal: float  # value in the nominal model, NaN where the effect vanishes only in a limit
    value: float
    low: float  # ends of the 95 % interval; the value itself where none is known
    high: float
    element: str = ""  # "joint", "actuator" or "sensor" of MJCF whose attribute it sets
    attribute: str = ""  # "gain" if it scales several; "" if the effect is no single one
    index: int | None = None  # into an attribute with several values

    @property
    def name(self) -> str:
        """Unique name."""
        return f"{self.effect.kind}.{self.where}.{self.parameter}"

    @property
    def unit(self) -> str:
        """Unit, "" for a ratio."""
        return self.effect.units.get(self.parameter, "")

    @property
    def words(self) -> str:
        """Name and value."""
        return f"{self.name} {self.value:.4g} {self.unit}".rstrip()


_ADDED: dict[tuple[str, str], tuple[str, str, int | None]] = {
    ("viscous_friction", "damping"): ("joint", "damping", 0),
    ("quadratic_drag", "drag"): ("joint", "damping", 1),
    ("coulomb_friction", "torque"): ("joint", "frictionloss", None),
    ("rotor_inertia", "inertia"): ("joint", "armature", None),
    ("command_delay", "delay"): ("actuator", "delay", None),
    ("sensor_delay", "delay"): ("sensor", "delay", None),
}
"""Kind and parameter -> element, attribute and index in MJCF."""


def _parameters(source: _Source) -> Iterator[_Parameter]:
    """All parameters of the named effects."""
    for effect, name in ((e, name) for e in source.effects for name in e.parameters):
        value = effect.parameters[name]
        low, high = effect.interval_95.get(name, (value, value))
        low, high = min(low, value), max(high, value)
        element, attribute, index = _ADDED.get((effect.kind, name), ("", "", None))
        places = _places(source, effect, element) if attribute and effect.in_model else {}
        for where, found in places.items():
            whole = float(np.ravel(getattr(found, attribute))[index or 0])
            yield _Parameter(
                effect=effect, where=where, parameter=name, nominal=max(whole - value, 0.0),
                value=whole, low=min(max(whole - value + low, 0.0), whole),
                high=whole - value + high, element=element, attribute=attribute, index=index,
            )  # fmt: skip
        if not places:
            known, gain = CATALOGUE.get(effect.kind), effect.kind == "actuator_gain"
            yield _Parameter(
                effect=effect, where=effect.where, parameter=name, value=value, low=low, high=high,
                nominal=nan if known is None else known.null_value([*effect.parameters], name),
                element="actuator" * gain, attribute="gain" * gain,
            )  # fmt: skip


def _places(source: _Source, effect: NamedEffect, element: str) -> dict[str, Any]:
    """Elements of the model that an effect acts on; those with a command where it is on all."""
    wanted, model = {effect.where}, source.model
    if effect.where == "all":
        wanted = {model.actuator(k).name for k in range(model.nu) if model.actuator_ctrlnum[k]}
    return {e.name: e for e in getattr(source.spec, f"{element}s") if e.name in wanted - {""}}


_SYSID = resources.files("loose_env.gap.output").joinpath("parameters.py.txt").read_text("utf-8")
"""Program with a ``ParameterDict``, without its parameters."""


def _sysid(source: _Source) -> Export:
    """Write the parameters of the named effects as a ``ParameterDict`` of ``mujoco.sysid``.

    ``parameters.py`` builds it with a modifier for each parameter that is one attribute of MJCF;
    ``parameters.yaml`` has the same values in the form that ``ParameterDict.load_from_disk`` reads.
    Classes and their arguments are those of MuJoCo 4.0: ``Parameter(name, nominal, min_value,
    max_value, frozen, modifier)``, whose modifier is called with the spec and the parameter.
    """
    left, states, added = [*source.timings()], dict[str, dict[str, Any]](), ""
    for p in _parameters(source):
        nominal = p.nominal if isfinite(p.nominal) else p.value
        state = {
            "name": p.name, "nominal": [nominal], "min_value": [p.low], "max_value": [p.high],
            "value": [p.value], "frozen": not p.attribute or not p.low < p.high,
        }  # fmt: skip
        states[p.name] = plain(state)
        given = [repr(value) for value in states[p.name].values()]
        if p.attribute == "gain":
            given.append(f"_scales({p.where!r}, {_scaled(source, p)})")
        elif p.attribute:
            index = "" if p.index is None else f", {p.index}"
            given.append(f"_sets({p.element!r}, {p.where!r}, {p.attribute!r}{index})")
        else:
            where = "model.xml contains" if p.effect.in_model else "the code in result.json applies"
            left.append(f"{p.words} has no modifier and is frozen; {where} it")
        added += f"    add({', '.join(given)}){f'  # {p.unit}' * bool(p.unit)}\n"
    listed = "".join(f"\n- {words}" for words in left) + "\n" * bool(left)
    # JSON is YAML, which needs a package to be written
    text = _SYSID.replace("{left}", listed).replace("{added}", added)
    files = {"parameters.py": text, "parameters.yaml": json_text(states)}
    notes = ("the parameters apply to model.xml beside result.json",)
    return Export(files=files, not_expressed=tuple(left), notes=notes)


def _scaled(source: _Source, p: _Parameter) -> dict[str, list[float]]:
    """Attributes of an actuator that its gain scales, with their nominal values."""
    actuator, variant = source.model.actuator(p.where), p.effect.variant
    names = ["gainprm", *["biasprm"] * (variant != "command")]
    names += ["forcerange"] * bool(not variant and actuator.forcelimited[0])
    return {n: plain((np.array(getattr(actuator, n)) / p.value).tolist()) for n in names}


def _ranges(source: _Source) -> Export:
    """Write a range for every parameter of the named effects, in the form ``loose-ranges/1``.

    Each has the parameter's effect, location, unit and interval; where the parameter is one
    attribute of MJCF, also that attribute with its absolute range.
    """
    ranges, left = [], [*source.timings()]
    for p in _parameters(source):
        if not p.low < p.high:
            left.append(f"{p.words}: the result has no interval for it")
            continue
        low, high = p.effect.interval_95[p.parameter]
        found: dict[str, Any] = {
            "effect": p.effect.kind, "where": p.where, "parameter": p.parameter, "unit": p.unit,
            "value": p.effect.parameters[p.parameter], "low": low, "high": high,
        }  # fmt: skip
        if p.attribute not in ("", "gain"):
            index = "" if p.index is None else f"[{p.index}]"
            found["mjcf"] = {
                "attribute": f"{p.element}/{p.attribute}{index}", "nominal": p.nominal,
                "value": p.value, "low": p.low, "high": p.high,
            }  # fmt: skip
        elif isfinite(p.nominal):
            found["without_effect"] = p.nominal
        ranges.append(found)
    interval = "95 % confidence interval, to be drawn from uniformly"
    whole = {"format": "loose-ranges/1", "interval": interval, "ranges": ranges}
    text = json_text(whole | {"not_expressed": left})
    return Export(files={"ranges.json": text}, not_expressed=tuple(left))


# Actuator configurations: mjlab, Isaac Lab

_CARRIED = dict.fromkeys(
    ("viscous_friction", "coulomb_friction", "rotor_inertia", "actuator_gain", "command_delay",
     "torque_limit", "voltage_limit"), _ALL,
)  # fmt: skip
_AT_DRIVE = frozenset({"actuator_gain", "command_delay", "torque_limit", "voltage_limit"})
"""Kinds that only the configuration of a drive carries."""
_Fields = dict[str, float | str | None]
"""Arguments of a class: numbers, and texts of Python; None where one is left out."""


def _mjlab(source: _Source) -> Export:
    """Write actuator configurations for mjlab.

    Fields are those of ``mjlab.actuator`` 1.6 (``ActuatorCfg``, ``DcMotorActuatorCfg`` and the
    classes ``Builtin...Cfg``), as their docstrings define them; delays are whole physics steps.
    """

    def configured(joint: _Joint, left: list[str]) -> tuple[str, _Fields] | None:
        if not joint.drive:
            left += _undriven(source, joint)
            return None
        low, high = _lags(source, joint, left)
        kind, motor = f"Builtin{joint.mode.capitalize()}ActuatorCfg", _motor(source, joint)
        effort, limit = joint.mode == "effort", joint.effort_limit
        own: _Fields = {"target_names_expr": f"({re.escape(joint.name)!r},)"}
        own |= {"stiffness": joint.stiffness, "damping": joint.damping, "effort_limit": limit}
        if motor:
            kind, own = "DcMotorActuatorCfg", own | motor | ({"damping": 0.0} if effort else {})
        elif effort:  # its gear is the torque per command
            kind, gear = "BuiltinMotorActuatorCfg", joint.effort_gain
            own |= {"stiffness": None, "damping": None, "gear": gear}
            own["effort_limit"] = 'float("inf")' if limit is None else limit / abs(gear)
        elif joint.mode == "velocity":
            own["stiffness"] = None
        left += joint.remarks + (joint.scale if motor else ())
        return kind, own | {
            "armature": joint.armature, "frictionloss": joint.frictionloss,
            "viscous_damping": joint.viscous, "delay_min_lag": low, "delay_max_lag": high,
        }  # fmt: skip

    note = (
        "armature, frictionloss and viscous_damping replace those of the joints; the other effects "
        "are those of the MJCF file that the entity loads: load model.xml without its actuators"
    )
    return _module(source, "mjlab", "mjlab.actuator", configured, _CARRIED, note)


def _isaaclab(source: _Source) -> Export:
    """Write actuator configurations for Isaac Lab.

    Fields are those of ``isaaclab.actuators`` 2.3 (``ActuatorBaseCfg``, ``IdealPDActuatorCfg``,
    ``DCMotorCfg``, ``DelayedPDActuatorCfg``, ``ImplicitActuatorCfg``), as their docstrings define
    them; delays are whole physics steps.
    """

    def configured(joint: _Joint, left: list[str]) -> tuple[str, _Fields]:
        low, high = _lags(source, joint, left)
        left += joint.remarks + joint.scale
        left += [] if joint.drive or joint.undriven == _NO_DRIVE else _undriven(source, joint)
        there = (e for e in source.effects if e.where == joint.name)
        falls = sum(_fall(e.parameters) for e in there if e.kind == "stribeck_friction")
        own: _Fields = {
            "joint_names_expr": f"[{re.escape(joint.name)!r}]", "stiffness": joint.stiffness,
            "damping": joint.damping, "effort_limit": joint.effort_limit,
            "armature": joint.armature, "friction": joint.frictionloss,
            "dynamic_friction": max(joint.frictionloss - falls, 0.0),
            "viscous_friction": joint.viscous,
        }  # fmt: skip
        if motor := _motor(source, joint):
            left += [f"the delay of {joint.name}: DCMotorCfg has none"] if high else []
            return "DCMotorCfg", own | motor
        if high:
            return "DelayedPDActuatorCfg", own | {"min_delay": low, "max_delay": high}
        # a joint that nothing drives has friction and inertia too
        return "IdealPDActuatorCfg" if joint.drive else "ImplicitActuatorCfg", own

    return _module(
        source, "Isaac Lab", "isaaclab.actuators", configured,
        _CARRIED | {"stribeck_friction": ("torque", "static_ratio")},
        "friction and dynamic_friction are torques or forces, as from Isaac Sim 5.0 on; in Isaac "
        "Sim 4.5 they are coefficients",
        "velocity_limit is that of the USD asset where none is written",
        remedy="change the USD asset or the environment accordingly", keyed=True,
    )  # fmt: skip


def _lags(source: _Source, joint: _Joint, left: list[str]) -> tuple[int, int] | tuple[None, None]:
    """Smallest and largest delay of a joint's commands in steps; a lost one is listed."""
    if joint.delay <= 0:
        return None, None
    step, low, high = source.step, joint.delay, joint.delay
    for effect in source.effects:
        if effect.kind == "command_delay" and effect.where in (joint.drive, "all"):
            value = effect.parameters["delay"]
            ends = effect.interval_95.get("delay", (value, value))
            low, high = (joint.delay + end - value for end in ends)
    if most := max(round(high / step), 0):
        return max(round(low / step), 0), most
    late = f"the delay of {joint.drive}, {joint.delay:.3g} s"
    left.append(f"{late}: less than half a physics step of {step:.3g} s")
    return None, None


def _undriven(source: _Source, joint: _Joint) -> list[str]:
    """What is lost at a joint without a drive that can be configured."""
    kinds = [e.kind for e in source.effects if e.where == joint.name and e.kind not in _AT_DRIVE]
    words = f": {', '.join(kinds)}" * bool(kinds)
    return [f"the configuration of joint {joint.name}{words}, because {joint.undriven}"]


def _motor(source: _Source, joint: _Joint) -> _Fields:
    """Torque-speed line of a joint's drive whose voltage limit was identified; empty if none."""
    for effect in source.effects:
        if effect.kind == "voltage_limit" and effect.where == joint.drive:
            gear, own = abs(joint.gear), effect.parameters
            stall, speed = gear * own["stall_torque"], own["no_load_speed"] / gear
            return {"effort_limit": stall, "saturation_effort": stall, "velocity_limit": speed}
    return {}


def _number(value: float | str) -> str:
    """A number with six significant digits; a text as it is."""
    return value if isinstance(value, str) else f"{value:.6g}"


def _module(
    source: _Source, target: str, package: str,
    configured: Callable[[_Joint, list[str]], tuple[str, _Fields] | None],
    carried: Mapping[str, Sequence[str]], *notes: str, remedy: str = "", keyed: bool = False,
) -> Export:  # fmt: skip
    """Python text of a tuple or mapping of configurations, and what it does not contain."""
    lost = list[str]()
    made = {joint.name: configured(joint, lost) for joint in source.joints}
    configs = {name: own for name, own in made.items() if own is not None}
    left = [*source.not_carried(carried, remedy=remedy), *lost]
    kinds = sorted({kind for kind, _ in configs.values()})
    lines = [f"from {package} import (", *(f"    {kind}," for kind in kinds), ")"] if kinds else []
    lines += ["", f"ACTUATORS = {'{' if keyed else '('}"]
    for name, (kind, own) in configs.items():
        lines += _configured(kind, own, 4, f"{name!r}: " * keyed)
    text = _python(target, source, left, [*lines, "}" if keyed else ")", ""])
    name = f"{package.partition('.')[0]}_actuators.py"
    return Export(files={name: text}, not_expressed=tuple(left), notes=notes)


def _python(target: str, source: _Source, left: Sequence[str], lines: Sequence[str]) -> str:
    """Python text that says at its head for what it is and what it does not contain."""
    head = [f'"""Actuators for {target}, identified by \'loose gap\'.', ""]
    head += [f"Delays are counted in physics steps of {_number(source.step)} s."]
    head += ["", "Not expressed:", *(f"- {words}" for words in left)] if left else []
    return "\n".join([*head, '"""', "", *lines])


def _configured(kind: str, own: _Fields, indent: int, key: str) -> list[str]:
    """Python lines of one configuration."""
    given = {field: value for field, value in own.items() if value is not None}
    fields = [f"    {field}={_number(value)}," for field, value in given.items()]
    return [" " * indent + line for line in (f"{key}{kind}(", *fields, "),")]


# URDF


def _urdf(source: _Source) -> Export:
    """Write the joint friction of the corrected model as ``<dynamics>`` tags of URDF.

    ``damping`` [N·m·s/rad, N·s/m] and ``friction``, the static friction [N·m, N], are its
    attributes (wiki.ros.org/urdf/XML/joint). Without a URDF they are tags to be pasted.
    """
    carried = {"viscous_friction": _ALL, "coulomb_friction": _ALL}
    left = source.not_carried(carried)
    listed = "".join(f"\n  - {words}" for words in left).replace("--", "−−")
    lost = [ET.Comment(f" not expressed:{listed}\n")] if left else []
    urdf, name, head, notes = source.urdf, "dynamics.urdf.xml", "", tuple[str, ...]()
    if urdf is None:
        root = ET.Element("robot", name="dynamics")
        root.append(ET.Comment(" paste each <dynamics> into the <joint> of the same name "))
        root.extend(lost)
        for joint in source.joints:
            kind = "revolute" if joint.turns else "prismatic"
            ET.SubElement(root, "joint", name=joint.name, type=kind)
    else:
        root, name, head = _robot(urdf), urdf.name, '<?xml version="1.0"?>\n'
        notes = (f"paths of meshes in {urdf.name} are relative to the folder of the original",)
    there = {each.get("name"): each for each in root.findall("joint")}
    lacking = sorted({e.where for e in source.effects if e.kind in carried} - set(there))
    if urdf is not None and lacking:
        raise InvalidData(
            f"{urdf} has no joint {lacking[0]!r}, where the result names friction; it has "
            f"{sorted(str(name) for name in there)}"
        )
    for joint in source.joints:
        if (element := there.get(joint.name)) is not None:
            tag = element.find("dynamics")
            tag = ET.SubElement(element, "dynamics") if tag is None else tag
            tag.set("damping", _number(joint.viscous))
            tag.set("friction", _number(joint.frictionloss))
    if urdf is not None and lost:
        root.insert(0, lost[0])
    ET.indent(root)
    text = f"{head}{ET.tostring(root, encoding='unicode')}\n"
    return Export(files={name: text}, not_expressed=left, notes=notes)


def _robot(urdf: Path) -> ET.Element:
    """The root of a URDF, its comments kept."""
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    try:
        root = ET.fromstring(urdf.read_text(encoding="utf-8"), parser=parser)
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InvalidData(f"{urdf} is not XML: {error}") from error
    if root.tag != "robot":
        raise InvalidData(
            f"{urdf} is no URDF: its first element is <{root.tag}>, not <robot>; leave --urdf out "
            "for tags to paste"
        )
    return root


# USD

_DEGREE = float(np.pi / 180)


def _usd(source: _Source) -> Export:
    """Write drives and joint dynamics of the corrected model as a layer of USD.

    Drives have the attributes of ``UsdPhysics.DriveAPI``, whose force is stiffness (target - q) +
    damping (target speed - speed), at most ``maxForce``; joints those of ``NewtonJointAPI``, which
    Newton, MuJoCo and PhysX read. Stiffness and damping of a hinge are per degree there.
    """
    name, left = _identifier(source.spec.modelname), list[str]()
    lines = ["#usda 1.0", f'(\n    defaultPrim = "{name}"\n    metersPerUnit = 1\n)', ""]
    lines += [f'over "{name}"', "{", '    over "joints"', "    {"]
    for joint in source.joints:
        axis, per = ("angular", _DEGREE) if joint.turns else ("linear", 1.0)
        values: dict[str, float | str] = {
            "float newton:armature": joint.armature, "float newton:friction": joint.frictionloss,
            "float newton:damping": joint.viscous * per,
        }  # fmt: skip
        if joint.drive:
            drive = f"drive:{axis}:physics:"
            values[f"uniform token {drive}type"] = '"force"'
            values[f"float {drive}stiffness"] = joint.stiffness * per
            values[f"float {drive}damping"] = joint.damping * per
            if joint.effort_limit is not None:
                values[f"float {drive}maxForce"] = joint.effort_limit
            left += joint.remarks + joint.scale
            left += [f"the delay of {joint.drive}, {joint.delay:.3g} s"] if joint.delay else []
        elif joint.undriven != _NO_DRIVE:
            left += _undriven(source, joint)
        schemas = f'"PhysicsDriveAPI:{axis}", ' * bool(joint.drive) + '"NewtonJointAPI"'
        lines += [f'        over "{_identifier(joint.name)}" (']
        lines += [f"            prepend apiSchemas = [{schemas}]", "        )", "        {"]
        lines += [f"            {key} = {_number(value)}" for key, value in values.items()]
        lines += ["        }"]
    carried = {k: _ALL for k in _CARRIED if k not in ("command_delay", "voltage_limit")}
    left = [*source.not_carried(carried), *left]
    notes = (f"joints are sought at /{name}/joints, where Isaac Sim's importers put them",)
    told = [f"# not expressed: {words}" for words in left]
    text = "\n".join([lines[0], *told, *lines[1:], "    }", "}", ""])
    return Export(files={"joints.usda": text}, not_expressed=tuple(left), notes=notes)


def _identifier(name: str) -> str:
    """Name of a prim: letters, digits and _, none of the digits first."""
    return re.sub(r"^(?=\d)|\W", "_", name, flags=re.ASCII)


# BAM

SERVOS = (
    "mx64", "mx106", "xl320", "xl330", "xl330i", "erob80_100", "erob80_50", "sts3215",
    "unitree_go1",
)  # fmt: skip
"""Actuators of better-actuator-models 1.0 (``bam.actuators``)."""
_BY_BAM = dict.fromkeys(
    ("viscous_friction", "coulomb_friction", "stribeck_friction", "rotor_inertia", "load_friction"),
    _ALL,
)
_ALPHA = 2.0  # exponent of the Stribeck curve in this package
_SPEED = 0.2  # stribeck speed of BAM where none is identified [rad/s]; without effect there


def _bam(source: _Source) -> Export:
    """Write a parameter file of BAM for each hinge with a named effect.

    Its keys are ``model`` ("m1" to "m6"), ``actuator``, and parameters by name, as
    ``bam.model.load_model`` of better-actuator-models 1.0 reads them. Its friction is
    ``friction_base`` + ``friction_stribeck`` exp(-(v/``dtheta_stribeck``)^``alpha``) +
    ``friction_viscous`` v, in model m5 also ``load_friction_motor`` times the motor's torque, with
    a Stribeck part of its own.
    """
    servo = source.settings.servo
    if servo not in SERVOS:
        raise InvalidSetting(
            f"BAM needs the servo of the joints: give --servo with one of {', '.join(SERVOS)}"
            + f"; got {servo!r}" * bool(servo)
        )
    left = list(source.not_carried(_BY_BAM))
    files = {}
    for joint, own in _bam_hinges(source, left):
        name = "bam_" + re.sub(r"[^\w.-]", "_", joint.name) + ".json"
        files[name] = json_text(own | {"q_offset": 0.0, "actuator": servo})
    notes = (
        f"torque constant and resistance (kt, R) are those of {servo} in BAM; they are not "
        "identified",
        "BAM computes back-EMF itself (kt² v / R): where the nominal model has none, "
        "friction_viscous contains it and is too large by kt² / R",
    )
    return Export(files=files, not_expressed=tuple(left), notes=notes)


def _drivebam(source: _Source) -> Export:
    """Write actuator configurations for Isaac Lab's ``DriveBam``, BAM as a drive of Newton.

    Fields are those of ``isaaclab.actuators`` with Newton 1.6 (``BamActuatorCfg``,
    ``BamMotorCfg``); the motor's own come from the servo's fit in BAM, of which ``fit`` has kt,
    resistance, error_gain and max_current.
    """
    left = list(source.not_carried(_BY_BAM | {"command_delay": _ALL}))
    lines = ["from isaaclab.actuators import BamActuatorCfg, BamMotorCfg", "", ""]
    lines += ["def actuators(fit: dict, kp_fw: float, vin: float) -> dict[str, BamActuatorCfg]:"]
    lines += ['    """Configurations by joint, of a servo\'s fit, firmware gain and supply [V]."""']
    lines += ["    return {"]
    for joint, own in _bam_hinges(source, left):
        low, high = _lags(source, joint, left)
        motor = ", ".join(f"{k!r}: {v!r}" for k, v in own.items() if k != "armature")
        fields: _Fields = {
            "joint_names_expr": f"[{re.escape(joint.name)!r}]", "kp_fw": "kp_fw", "vin": "vin",
            "armature": repr(own["armature"]), "motor": f"BamMotorCfg(**fit | {{{motor}}})",
        }  # fmt: skip
        fields |= {"min_delay": low, "max_delay": high} if high else {}
        lines += _configured("BamActuatorCfg", fields, 8, f"{joint.name!r}: ")
    notes = ("kt, resistance, error_gain and max_current are those of the fit given to it",)
    text = _python("DriveBam", source, left, [*lines, "    }", ""])
    return Export(files={"drivebam_actuators.py": text}, not_expressed=tuple(left), notes=notes)


def _bam_hinges(source: _Source, left: list[str]) -> list[tuple[_Joint, dict[str, float | str]]]:
    """Hinges with an effect that BAM has, and their parameters in BAM; the others are listed."""
    made = []
    for joint in source.joints:
        places = (joint.name, joint.drive)
        own = {e.kind: e for e in source.effects if e.where in places and e.kind in _BY_BAM}
        if own and joint.turns:
            made.append((joint, _bam_parameters(joint, own)))
        else:
            left += [f"{_words(e)}; BAM has no slides" for e in own.values()]
    if not made:
        raise InvalidSetting(
            "the result names no effect that BAM has: viscous, Coulomb, Stribeck or load-dependent "
            "friction or rotor inertia of a hinge; choose another target"
        )
    return made


def _bam_parameters(joint: _Joint, effects: Mapping[str, NamedEffect]) -> dict[str, float | str]:
    """Parameters of one joint; friction that grows with the load is that of model m5."""
    stribeck, load = (
        effects[kind].parameters if kind in effects else {}
        for kind in ("stribeck_friction", "load_friction")
    )
    fall, found = _fall(stribeck), dict[str, float | str](armature=joint.armature)
    found["friction_base"] = max(joint.frictionloss - fall, 0.0)
    if stribeck or load:
        speed = {**load, **stribeck}.get("speed", _SPEED)
        found |= {"friction_stribeck": fall, "dtheta_stribeck": speed, "alpha": _ALPHA}
    if load:
        found |= {
            "load_friction_motor": load["share"],
            "load_friction_external": load.get("load_share", 0.0),
            "load_friction_motor_stribeck": load["share"] * (load.get("static_ratio", 1.0) - 1),
            "load_friction_external_stribeck": 0.0,
        }
    found["friction_viscous"] = joint.viscous
    found["model"] = "m5" if load else "m2" if stribeck else "m1"
    return found


def _fall(stribeck: Mapping[str, float]) -> float:
    """Friction at rest beyond that in motion, by the parameters of a Stribeck friction [N·m, N]."""
    return (stribeck["static_ratio"] - 1.0) * stribeck["torque"] if stribeck else 0.0


TARGETS: Mapping[str, Callable[[_Source], Export]] = {
    "sysid": _sysid,
    "mjlab": _mjlab,
    "isaaclab": _isaaclab,
    "urdf": _urdf,
    "usd": _usd,
    "bam": _bam,
    "drivebam": _drivebam,
    "ranges": _ranges,
}
"""Target -> its export."""
