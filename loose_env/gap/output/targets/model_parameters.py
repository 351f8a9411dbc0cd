"""MJCF attributes that identified effects set: value, nominal value and bounds of each.

An effect such as viscous friction adds to one attribute of the model. The nominal value of that
attribute is its value in the corrected model less the effect; its bounds are the 95 % interval of
the effect, added to the nominal value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.output.result import NamedEffect
from loose_env.gap.output.targets.source import ExportSource

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
    for effect in source.result.effects:
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
        nominal = max(whole - own.value, 0.0)
        found.append(
            ModelParameter(
                name=own.name,
                effect=effect,
                where=where,
                parameter=name,
                unit=own.unit,
                nominal=nominal,
                value=whole,
                low=min(max(whole + own.low - own.value, 0.0), whole),
                high=whole + own.high - own.value,
                element=element,
                attribute=attribute,
                index=index,
            )
        )
    return found


def _elements(source: ExportSource, effect: NamedEffect, element: str) -> list[str]:
    """Names of the elements that an effect acts on; empty if the model lacks them."""
    model = source.model
    count = {"joint": model.njnt, "actuator": model.nu, "sensor": model.nsensor}[element]
    names = [str(getattr(model, element)(k).name) for k in range(count)]
    if effect.where == "all":
        return [name for name in names if name]
    return [effect.where] if effect.where in names else []
