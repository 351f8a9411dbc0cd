"""The catalogue of effects that a model can lack, and what of it a machine can have.

A new effect is a subclass of `loose_env.gap.effect.Effect` in a file of its own; `register` adds
it to the catalogue.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap.effect import Effect
from loose_env.gap.effects.actuator_gain import ActuatorGain
from loose_env.gap.effects.actuator_lag import ActuatorLag
from loose_env.gap.effects.backlash import Backlash
from loose_env.gap.effects.base_tilt import BaseTilt
from loose_env.gap.effects.command_delay import CommandDelay
from loose_env.gap.effects.coulomb_friction import CoulombFriction
from loose_env.gap.effects.encoder_offset import EncoderOffset
from loose_env.gap.effects.joint_compliance import JointCompliance
from loose_env.gap.effects.joint_spring import JointSpring
from loose_env.gap.effects.link_com import LinkCom
from loose_env.gap.effects.link_flexibility import LinkFlexibility
from loose_env.gap.effects.link_mass import LinkMass
from loose_env.gap.effects.payload import Payload
from loose_env.gap.effects.quadratic_drag import QuadraticDrag
from loose_env.gap.effects.rotor_inertia import RotorInertia
from loose_env.gap.effects.sensor_bias import SensorBias
from loose_env.gap.effects.sensor_delay import SensorDelay
from loose_env.gap.effects.sensor_gain import SensorGain
from loose_env.gap.effects.sensor_misalignment import SensorMisalignment
from loose_env.gap.effects.stribeck_friction import StribeckFriction
from loose_env.gap.effects.structural_looseness import StructuralLooseness
from loose_env.gap.effects.torque_ripple import TorqueRipple
from loose_env.gap.effects.viscous_friction import ViscousFriction
from loose_env.gap.machine import Machine

__all__ = ["CATALOGUE", "candidates", "register"]

Kind = TypeVar("Kind", bound=type[Effect])

CATALOGUE: dict[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        ViscousFriction,
        CoulombFriction,
        StribeckFriction,
        QuadraticDrag,
        JointCompliance,
        Backlash,
        StructuralLooseness,
        LinkFlexibility,
        LinkMass,
        LinkCom,
        Payload,
        RotorInertia,
        ActuatorGain,
        ActuatorLag,
        CommandDelay,
        EncoderOffset,
        SensorMisalignment,
        SensorGain,
        SensorBias,
        SensorDelay,
        BaseTilt,
        TorqueRipple,
        JointSpring,
    )
}
"""Identifier, as in the result file -> class."""


def register(effect: Kind) -> Kind:
    """Add an effect to the catalogue; usable as a decorator.

    Raises
    ------
    InvalidSetting
        If it has no identifier, or one that another effect has, or a term on the torque without
        anything that applies it to the written model.
    """
    if not effect.kind:
        raise InvalidSetting(f"{effect.__name__} needs a kind, its identifier in the result file")
    term = effect.torque is not Effect.torque and effect.export is Effect.export
    if term and (effect.in_model or effect.torque_code is Effect.torque_code):
        raise InvalidSetting(
            f"{effect.__name__} is a term on the torque: give it in_model = False and a "
            "torque_code that applies it, or an export where MJCF has means for it"
        )
    known = CATALOGUE.get(effect.kind, effect)
    # a notebook runs a cell again: the same class in a new version takes the place of the old one
    again = (known.__module__, known.__qualname__) == (effect.__module__, effect.__qualname__)
    if not again:
        raise InvalidSetting(
            f"{effect.__name__} has the kind {effect.kind!r} of "
            f"{CATALOGUE[effect.kind].__name__}; give it another"
        )
    CATALOGUE[effect.kind] = effect
    return effect


def candidates(machine: Machine, kinds: Iterable[str] | None = None) -> list[Effect]:
    """All effects at all places where they can be, in every variant.

    Parameters
    ----------
    machine : Machine
        The nominal model.
    kinds : iterable of str, optional
        Identifiers; all by default.

    Raises
    ------
    UnknownName
        If the catalogue has no such identifier.
    """
    wanted = tuple(CATALOGUE) if kinds is None else tuple(kinds)
    for kind in wanted:
        if kind not in CATALOGUE:
            raise UnknownName(f"unknown effect {kind!r}; the catalogue has {list(CATALOGUE)}")
    return [
        CATALOGUE[kind](machine, where, variant)
        for kind in wanted
        for where in CATALOGUE[kind].places(machine)
        for variant in CATALOGUE[kind].forms(machine, where)
    ]
