"""Catalogue of effects: register one, read a file of custom ones, list candidates of a machine."""

from __future__ import annotations

import importlib.util
import sys
from collections import ChainMap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects import drives, elasticity, inertia, joints, sensors
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.io import nearest

Kind = TypeVar("Kind", bound=type[Effect])

CATALOGUE: dict[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        joints.ViscousFriction, joints.CoulombFriction, joints.StribeckFriction,
        joints.QuadraticDrag, elasticity.JointCompliance, elasticity.Backlash,
        elasticity.StructuralLooseness, elasticity.LinkFlexibility, inertia.LinkMass,
        inertia.LinkCom, inertia.Payload, joints.RotorInertia, drives.ActuatorGain,
        drives.ActuatorLag, drives.CommandDelay, sensors.EncoderOffset,
        sensors.SensorMisalignment, sensors.SensorGain, sensors.SensorBias, sensors.SensorDelay,
        inertia.BaseTilt, joints.TorqueRipple, joints.JointSpring, joints.LoadFriction,
        joints.AsymmetricFriction, drives.TorqueLimit, drives.VoltageLimit, drives.SpeedLimit,
        drives.DeadZone, inertia.GravityCompensation, sensors.TorqueConstant,
        elasticity.BaseCompliance, sensors.GearEccentricity, sensors.SensorQuantisation,
    )
}  # fmt: skip
"""Identifier, as in the result file -> class."""
EFFECTS: Mapping[str, type[Effect]] = ChainMap(
    {
        effect.kind: effect
        for effect in (joints.TorqueOffset, joints.FrictionBehindSlack, drives.CommandInterpolation)
    },
    CATALOGUE,
)
"""The same with what logs of machines ask for, and simulations do without; those that users
register included."""


def register(effect: Kind) -> Kind:
    """Add an effect to the catalogue; usable as a decorator.

    Raises
    ------
    InvalidSetting
        If it has no identifier, or one that another effect has, or a term on the torque, at once or
        along a path, without anything that applies it to the written model.

    Examples
    --------
    >>> from loose_env.gap import Effect
    >>> class NoEffect(Effect):
    ...     kind = ""
    >>> register(NoEffect)
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidSetting: NoEffect needs a kind, its identifier in the result file
    """
    if not effect.kind:
        raise InvalidSetting(f"{effect.__name__} needs a kind, its identifier in the result file")
    term = effect.torque is not Effect.torque and effect.export is Effect.export
    if term and (effect.in_model or effect.torque_code is Effect.torque_code):
        raise InvalidSetting(
            f"{effect.__name__} is a term on the torque: give it in_model = False and a "
            "torque_code that applies it, or an export where MJCF has means for it"
        )
    if effect.torque_along is not Effect.torque_along and effect.edit is Effect.edit:
        raise InvalidSetting(
            f"{effect.__name__} has a torque_along, which only a force balance uses: give it an "
            "edit, by which simulations and the written model have the same torque"
        )
    known = CATALOGUE.get(effect.kind, effect)
    # a notebook reruns a cell: the new version of a class replaces the old one
    again = (known.__module__, known.__qualname__) == (effect.__module__, effect.__qualname__)
    if not again:
        raise InvalidSetting(
            f"{effect.__name__} has the kind {effect.kind!r} of "
            f"{CATALOGUE[effect.kind].__name__}; give it another"
        )
    CATALOGUE[effect.kind] = effect
    return effect


def effect_class(kind: str) -> type[Effect]:
    """Class of a kind of effect; refuses one that there is not."""
    if kind not in EFFECTS:
        known = nearest(kind, [*EFFECTS]) or f"; there are {', '.join(EFFECTS)}"
        raise UnknownName(f"unknown effect {kind!r}{known}")
    return EFFECTS[kind]


def candidates(machine: NominalModel, kinds: Iterable[str] | None = None) -> list[Effect]:
    """List effects at all possible locations, in every variant; all that simulations have."""
    classes = [effect_class(kind) for kind in (CATALOGUE if kinds is None else kinds)]
    return [
        own(machine, where, variant)
        for own in classes
        for where in own.locations(machine)
        for variant in own.variants_at(machine, where)
    ]


def read_effects(path: str | Path) -> tuple[str, ...]:
    """Run a file that registers effects, and return their identifiers.

    Parameters
    ----------
    path : str or Path
        A Python file with classes under ``@register`` of `loose_env.gap.model.effects.catalogue`.

    Raises
    ------
    InvalidSetting
        If it cannot be read or run, or registers no effect.
    """
    file = Path(path)
    name = f"effects_of_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if not file.is_file():
        raise InvalidSetting(f"there is no file {str(file)!r}; give a Python file with effects")
    if spec is None or spec.loader is None:
        raise InvalidSetting(f"{file} is no Python file; its name ends with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # as in an import: dataclasses look there for their module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the file does
        raise InvalidSetting(f"{file} cannot be run: {type(error).__name__}: {error}") from error
    found = tuple(kind for kind, effect in CATALOGUE.items() if effect.__module__ == name)
    if not found:
        raise InvalidSetting(f"{file} registers no effect; put @register before its class")
    return found
