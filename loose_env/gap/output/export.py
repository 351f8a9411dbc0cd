"""Export of a result to mujoco.sysid, mjlab, Isaac Lab, URDF, BAM or ranges, as files.

An effect such as viscous friction adds to one attribute of the model. The nominal value of that
attribute is its value in the corrected model less the effect; its bounds are the 95 % interval of
the effect, added to the nominal value.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.output.export_actuators import isaaclab_export, mjlab_export
from loose_env.gap.output.export_source import (
    ALL,
    Export,
    ExportSettings,
    ExportSource,
    JointValues,
    effect_words,
    not_carried,
    number,
    read_source,
)
from loose_env.gap.output.result import NamedEffect
from loose_env.io import json_text, plain, write_text

Element = Literal["joint", "actuator", "sensor", ""]


@dataclass(frozen=True, kw_only=True)
class ModelParameter:
    """One parameter of one effect, as the value of an attribute in MJCF where there is one."""

    name: str
    """Unique name: kind, location and parameter, separated by dots."""
    effect: NamedEffect
    """The effect."""
    where: str
    """Its location; the element itself where the effect is on all actuators."""
    parameter: str
    """Name of the parameter in the effect."""
    unit: str
    """Unit, "" for a ratio."""
    nominal: float
    """Value in the nominal model; of a parameter without attribute, that without the effect, NaN
    where the effect vanishes only in a limit."""
    value: float
    """Identified value."""
    low: float
    """Lower end of the 95 % interval; the value itself where none is known."""
    high: float
    """Upper end."""
    element: Element = ""
    """Element of MJCF whose attribute it sets: "joint", "actuator" or "sensor"; "" if none."""
    attribute: str = ""
    """The attribute; "" if the effect is no single attribute of one element."""
    index: int | None = None
    """Index into an attribute with several values."""
    scales: bool = False
    """Whether the attribute is the nominal one times the parameter."""

    @property
    def words(self) -> str:
        """Name and value."""
        return f"{self.name} {self.value:.4g} {self.unit}".rstrip()


_ADDED: dict[tuple[str, str], tuple[Element, str, int | None, str]] = {
    ("viscous_friction", "damping"): ("joint", "damping", 0, "dof_damping"),
    ("quadratic_drag", "drag"): ("joint", "damping", 1, "dof_dampingpoly"),
    ("coulomb_friction", "torque"): ("joint", "frictionloss", None, "dof_frictionloss"),
    ("rotor_inertia", "inertia"): ("joint", "armature", None, "dof_armature"),
    ("command_delay", "delay"): ("actuator", "delay", None, "actuator_delay"),
    ("sensor_delay", "delay"): ("sensor", "delay", None, "sensor_delay"),
}
"""Kind and parameter -> element, attribute and index in MJCF, and field of MjModel."""


def model_parameters(source: ExportSource) -> tuple[ModelParameter, ...]:
    """List all parameters of the named effects."""
    found: list[ModelParameter] = []
    for effect in source.effects:
        for name in effect.parameters:
            found += _of_attribute(source, effect, name) or [_plain(effect, name)]
    return tuple(found)


def _plain(effect: NamedEffect, name: str, where: str = "") -> ModelParameter:
    """Return the parameter as the effect has it."""
    value = float(effect.parameters[name])
    low, high = effect.interval_95.get(name, (value, value))
    scales = effect.kind == "actuator_gain"
    return ModelParameter(
        name=f"{effect.kind}.{where or effect.where}.{name}",
        effect=effect,
        where=where or effect.where,
        parameter=name,
        unit=effect.units.get(name, ""),
        nominal=_without(effect, name),
        value=value,
        low=min(float(low), value),
        high=max(float(high), value),
        element="actuator" if scales else "",
        attribute="gain" if scales else "",
        scales=scales,
    )


def _without(effect: NamedEffect, name: str) -> float:
    """Value of a parameter without the effect; NaN where it vanishes only in a limit."""
    known = CATALOGUE.get(effect.kind)
    return float("nan") if known is None else known.null_value(list(effect.parameters), name)


def _of_attribute(source: ExportSource, effect: NamedEffect, name: str) -> list[ModelParameter]:
    """Return the parameter as values of attributes; empty where it is not one."""
    if (effect.kind, name) not in _ADDED or not effect.in_model:
        return []
    element, attribute, index, field = _ADDED[effect.kind, name]
    model, found = source.model, []
    for where in _elements(source, effect, element):
        k = int(getattr(model, element)(where).id)
        if element == "joint":
            k = int(model.jnt_dofadr[k])
        whole = float(np.ravel(np.asarray(getattr(model, field))[k])[0])
        own = _plain(effect, name, where)
        found.append(
            replace(
                own, nominal=max(whole - own.value, 0.0), value=whole,
                low=min(max(whole + own.low - own.value, 0.0), whole),
                high=whole + own.high - own.value, element=element, attribute=attribute,
                index=index,
            )
        )  # fmt: skip
    return found


def _elements(source: ExportSource, effect: NamedEffect, element: str) -> list[str]:
    """Names of the elements that an effect acts on; empty if the model lacks them."""
    model = source.model
    count = {"joint": model.njnt, "actuator": model.nu, "sensor": model.nsensor}[element]
    names = [str(getattr(model, element)(k).name) for k in range(count)]
    if effect.where == "all":
        return [name for name in names if name]
    return [effect.where] if effect.where in names else []


_HEAD = '''"""Effects identified by 'loose gap' as parameters of mujoco.sysid.

    import mujoco
    from parameters import parameters

    spec = mujoco.MjSpec.from_file("model.xml")  # the corrected model beside result.json
    found = parameters()

Bounds are 95 % intervals, nominal is the value of the nominal model. A frozen parameter has no
modifier: model.xml contains its effect, which is no single attribute of MJCF.
{listed}"""

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import sysid

Modifier = Callable[[mujoco.MjSpec, sysid.Parameter], None]


def _sets(element: str, name: str, attribute: str, index: int | None = None) -> Modifier:
    """Modifier that sets an attribute of an element."""

    def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        found = getattr(spec, element)(name)
        value = float(parameter.value[0])
        if index is not None:
            whole = np.array(getattr(found, attribute))
            whole[index] = value
            setattr(found, attribute, whole)
        else:
            setattr(found, attribute, value)
            if attribute == "delay":  # its history covers twice the delay
                needed = 2 * int(np.ceil(value / spec.option.timestep)) + 2
                found.nsample = max(int(found.nsample), needed)

    return modify


def _scales(name: str, nominal: dict[str, list[float]]) -> Modifier:
    """Modifier that multiplies attributes of an actuator."""

    def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        for attribute, value in nominal.items():
            setattr(spec.actuator(name), attribute, float(parameter.value[0]) * np.array(value))

    return modify


def parameters() -> sysid.ParameterDict:
    """Return the parameters, at their identified values."""
    found = sysid.ParameterDict()
'''
_TAIL = """    return found
"""


def _sysid(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write the parameters of the named effects as a ``ParameterDict`` of ``mujoco.sysid``.

    ``parameters.py`` builds it with a modifier for each parameter that is one attribute of MJCF;
    ``parameters.yaml`` has the same values in the form that ``ParameterDict.load_from_disk`` reads.
    Classes and their arguments are those of MuJoCo 4.0: ``Parameter(name, nominal, min_value,
    max_value, frozen, modifier)``, whose modifier is called with the spec and the parameter.
    """
    found = model_parameters(source)
    states = {p.name: _state(p) for p in found}
    left = tuple(
        f"{p.words} has no modifier and is frozen; "
        + ("model.xml contains it" if p.effect.in_model else "the code in result.json applies it")
        for p in found
        if not p.attribute
    )
    # JSON is YAML, which needs a package to be written
    return Export(
        files={
            "parameters.py": _HEAD.format(listed=_listed(left))
            + "".join(_added(source, p, states[p.name]) for p in found)
            + _TAIL,
            "parameters.yaml": json_text(states),
        },
        not_expressed=left,
        notes=("the parameters apply to model.xml beside result.json",),
    )


def _listed(left: Sequence[str]) -> str:
    return "".join(f"\n- {words}" for words in left) + ("\n" if left else "")


def _state(p: ModelParameter) -> dict[str, object]:
    """Return a parameter in the form of ``ParameterDict.save_to_disk``."""
    nominal = p.nominal if isfinite(p.nominal) else p.value
    state: dict[str, object] = plain(
        {
            "name": p.name,
            "nominal": [nominal],
            "min_value": [p.low],
            "max_value": [p.high],
            "value": [p.value],
            "frozen": not p.attribute or not p.low < p.high,
        }
    )
    return state


def _added(source: ExportSource, p: ModelParameter, state: dict[str, object]) -> str:
    """Lines that add one parameter."""
    lines = [
        "    found.add(",
        "        sysid.Parameter(",
        f"            {p.name!r},{f'  # {p.unit}' if p.unit else ''}",
        f"            nominal={state['nominal']},",
        f"            min_value={state['min_value']},",
        f"            max_value={state['max_value']},",
        f"            frozen={state['frozen']},",
    ]
    if p.scales:
        lines.append(f"            modifier=_scales({p.where!r}, {_scaled(source, p)}),")
    elif p.attribute:
        index = "" if p.index is None else f", {p.index}"
        lines.append(
            f"            modifier=_sets({p.element!r}, {p.where!r}, {p.attribute!r}{index}),"
        )
    lines += [
        "        )",
        "    )",
        f"    found[{p.name!r}].update_from_vector(np.array({state['value']}))",
    ]
    return "\n".join(lines) + "\n"


def _scaled(source: ExportSource, p: ModelParameter) -> dict[str, list[float]]:
    """Attributes of an actuator that its gain scales, with their nominal values."""
    actuator = source.model.actuator(p.where)
    attributes = {"gainprm": actuator.gainprm}
    if p.effect.variant != "command":
        attributes["biasprm"] = actuator.biasprm
    if not p.effect.variant and actuator.forcelimited[0]:
        attributes["forcerange"] = actuator.forcerange
    whole = {a: (np.asarray(v, dtype=float) / p.value).tolist() for a, v in attributes.items()}
    nominal: dict[str, list[float]] = plain(whole)
    return nominal


RANGES_FORMAT = "loose-ranges/1"


def _ranges(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write a range for every parameter of the named effects, in the form ``loose-ranges/1``.

    Each has the parameter's effect, location, unit and interval; where the parameter is one
    attribute of MJCF, also that attribute with its absolute range.
    """
    parameters = model_parameters(source)
    left = tuple(
        f"{p.words}: the result has no interval for it" for p in parameters if not p.low < p.high
    )
    whole = {
        "format": RANGES_FORMAT,
        "interval": "95 % confidence interval, to be drawn from uniformly",
        "ranges": [_range(p) for p in parameters if p.low < p.high],
        "not_expressed": list(left),
    }
    return Export(files={"ranges.json": json_text(whole)}, not_expressed=left)


def _range(p: ModelParameter) -> dict[str, Any]:
    low, high = p.effect.interval_95[p.parameter]
    found: dict[str, Any] = {
        "effect": p.effect.kind,
        "where": p.where,
        "parameter": p.parameter,
        "unit": p.unit,
        "value": p.effect.parameters[p.parameter],
        "low": low,
        "high": high,
    }
    if p.attribute and not p.scales:
        index = "" if p.index is None else f"[{p.index}]"
        found["mjcf"] = {
            "attribute": f"{p.element}/{p.attribute}{index}",
            "nominal": p.nominal,
            "value": p.value,
            "low": p.low,
            "high": p.high,
        }
    elif isfinite(p.nominal):
        found["without_effect"] = p.nominal
    return found


_BY_URDF = {"viscous_friction": ALL, "coulomb_friction": ALL}


def _urdf(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write the joint friction of the corrected model as ``<dynamics>`` tags of URDF.

    ``damping`` [N·m·s/rad, N·s/m] and ``friction``, the static friction [N·m, N], are its
    attributes (wiki.ros.org/urdf/XML/joint).
    """
    left = not_carried(source.effects, _BY_URDF)
    joints = source.joints
    if urdf is None:
        return Export(files={"dynamics.urdf.xml": _snippets(joints, left)}, not_expressed=left)
    root = _robot(urdf)
    there = {each.get("name"): each for each in root.findall("joint")}
    named = {e.where for e in source.effects if e.kind in _BY_URDF}
    lacking = sorted(named - set(there))
    if lacking:
        raise InvalidData(
            f"{urdf} has no joint {lacking[0]!r}, where the result names friction; it has "
            f"{sorted(str(name) for name in there)}"
        )
    for joint in joints:
        if joint.name in there:
            _set_tag(there[joint.name], joint)
    if left:
        root.insert(0, ET.Comment(_comment(left)))
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode", xml_declaration=False)
    return Export(
        files={urdf.name: f'<?xml version="1.0"?>\n{text}\n'},
        not_expressed=left,
        notes=(f"paths of meshes in {urdf.name} are relative to the folder of the original",),
    )


def _robot(urdf: Path) -> ET.Element:
    try:
        parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        root = ET.fromstring(urdf.read_text(encoding="utf-8"), parser=parser)
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InvalidData(f"{urdf} is not XML: {error}") from error
    if root.tag != "robot":
        raise InvalidData(
            f"{urdf} is no URDF: its first element is <{root.tag}>, not <robot>; leave --urdf out "
            "for tags to paste"
        )
    return root


def _set_tag(element: ET.Element, joint: JointValues) -> None:
    tag = element.find("dynamics")
    if tag is None:
        tag = ET.SubElement(element, "dynamics")
    tag.set("damping", number(joint.damping))
    tag.set("friction", number(joint.frictionloss))


def _snippets(joints: tuple[JointValues, ...], left: tuple[str, ...]) -> str:
    """Element ``<joint>`` with its tag, for each joint."""
    root = ET.Element("robot", name="dynamics")
    root.append(ET.Comment(" paste each <dynamics> into the <joint> of the same name "))
    if left:
        root.append(ET.Comment(_comment(left)))
    for joint in joints:
        kind = "revolute" if joint.turns else "prismatic"
        _set_tag(ET.SubElement(root, "joint", name=joint.name, type=kind), joint)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _comment(left: tuple[str, ...]) -> str:
    listed = "".join(f"\n  - {words}" for words in left).replace("--", "−−")
    return f" not expressed:{listed}\n"


SERVOS = (
    "mx64", "mx106", "xl320", "xl330", "xl330i", "erob80_100", "erob80_50", "sts3215",
    "unitree_go1",
)  # fmt: skip
"""Actuators of better-actuator-models 1.0 (``bam.actuators``)."""
_BY_BAM = {
    "viscous_friction": ALL,
    "coulomb_friction": ALL,
    "stribeck_friction": ALL,
    "rotor_inertia": ALL,
    "load_friction": ALL,
}
_ALPHA = 2.0
"""Exponent of the Stribeck curve in this package."""
_SPEED = 0.2
"""Stribeck speed of BAM where none is identified [rad/s]; without effect there."""


def _bam(source: ExportSource, settings: ExportSettings, urdf: Path | None) -> Export:
    """Write a parameter file of BAM for each hinge with a named effect.

    Its keys are ``model`` ("m1" to "m6"), ``actuator``, and parameters by name, as
    ``bam.model.load_model`` of better-actuator-models 1.0 reads them. Its friction is
    ``friction_base`` + ``friction_stribeck`` exp(-(v/``dtheta_stribeck``)^``alpha``) +
    ``friction_viscous`` v, in model m5 also ``load_friction_motor`` times the motor's torque, with
    a Stribeck part of its own.
    """
    servo = settings.servo
    if servo not in SERVOS:
        raise InvalidSetting(
            f"BAM needs the servo of the joints: give --servo with one of {', '.join(SERVOS)}"
            + (f"; got {servo!r}" if servo else "")
        )
    effects = source.effects
    files, left = {}, list(not_carried(effects, _BY_BAM))
    for joint in source.joints:
        own = [e for e in effects if e.where in _locations(joint) and e.kind in _BY_BAM]
        if not own:
            continue
        if not joint.turns:
            left += [f"{effect_words(e)}; BAM has no slides" for e in own]
            continue
        files[f"bam_{_safe(joint.name)}.json"] = json_text(_parameters(joint, own, servo))
    if not files:
        raise InvalidSetting(
            "the result names no effect that BAM has: viscous, Coulomb, Stribeck or load-dependent "
            "friction or rotor inertia of a hinge; choose another target"
        )
    return Export(
        files=files,
        not_expressed=tuple(left),
        notes=(
            f"torque constant and resistance (kt, R) are those of {servo} in BAM; they are not "
            "identified",
            "BAM computes back-EMF itself (kt² v / R): where the nominal model has none, "
            "friction_viscous contains it and is too large by kt² / R",
        ),
    )


def _locations(joint: JointValues) -> tuple[str, ...]:
    return (joint.name,) if joint.drive is None else (joint.name, joint.drive.name)


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)


def _parameters(
    joint: JointValues, effects: Sequence[NamedEffect], servo: str
) -> dict[str, float | str]:
    """Parameters of one joint in the order of BAM's own files.

    Friction that grows with the load is that of model m5.
    """
    stribeck = next((e for e in effects if e.kind == "stribeck_friction"), None)
    load = next((e for e in effects if e.kind == "load_friction"), None)
    fall, speed = 0.0, _SPEED
    if load is not None:
        speed = load.parameters.get("speed", _SPEED)
    if stribeck is not None:
        fall = (stribeck.parameters["static_ratio"] - 1.0) * stribeck.parameters["torque"]
        speed = stribeck.parameters["speed"]
    found: dict[str, float | str] = {"armature": joint.armature, "q_offset": 0.0}
    found["friction_base"] = max(joint.frictionloss - fall, 0.0)
    if stribeck is not None or load is not None:
        found |= {"friction_stribeck": fall, "dtheta_stribeck": speed, "alpha": _ALPHA}
    if load is not None:
        share = load.parameters["share"]
        found |= {
            "load_friction_motor": share,
            "load_friction_external": load.parameters.get("load_share", 0.0),
            "load_friction_motor_stribeck": share * (load.parameters.get("static_ratio", 1.0) - 1),
            "load_friction_external_stribeck": 0.0,
        }
    found["friction_viscous"] = joint.damping
    found["model"] = "m5" if load is not None else "m2" if stribeck is not None else "m1"
    found["actuator"] = servo
    return found


_Exporter = Callable[[ExportSource, ExportSettings, Path | None], Export]
TARGETS: Mapping[str, _Exporter] = {
    "sysid": _sysid,
    "mjlab": mjlab_export,
    "isaaclab": isaaclab_export,
    "urdf": _urdf,
    "bam": _bam,
    "ranges": _ranges,
}
"""Target -> its export."""


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
        One of `TARGETS`: "sysid", "mjlab", "isaaclab", "urdf", "bam" or "ranges".
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
    return TARGETS[target](read_source(path), settings or ExportSettings(), urdf)


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
