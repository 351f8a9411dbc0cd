"""All kinds of effects of the blind recordings, by name."""

from __future__ import annotations

from scripts.suites.gap.arms import Figures
from scripts.suites.gap.drive_effects import DRIVE_KINDS, OUTSIDE_KINDS, SENSOR_KINDS
from scripts.suites.gap.effects import JOINT_KINDS, LINK_KINDS, Effect, Kind, Readings
from scripts.suites.gap.simulate import System


def kinds() -> dict[str, Kind]:
    """All kinds by name: the catalogue in the order of its table, then those outside it."""
    parts = (JOINT_KINDS, LINK_KINDS, DRIVE_KINDS, SENSOR_KINDS, OUTSIDE_KINDS)
    found = {kind.name: kind for part in parts for kind in part}
    return {name: found[name] for name in (*CATALOGUE, *OUTSIDE)}


CATALOGUE = (
    "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag",
    "joint_compliance", "backlash", "structural_looseness", "link_flexibility", "link_mass",
    "link_com", "payload", "rotor_inertia", "actuator_gain", "actuator_lag", "command_delay",
    "encoder_offset", "sensor_misalignment", "sensor_gain", "sensor_bias", "sensor_delay",
    "base_tilt", "torque_ripple", "joint_spring", "load_friction", "asymmetric_friction",
    "torque_limit", "voltage_limit", "dead_zone", "gravity_compensation", "torque_constant",
    "base_compliance", "gear_eccentricity", "sensor_quantisation",
)  # fmt: skip
"""Identifiers of the catalogue."""


OUTSIDE = (
    "warming_friction", "cable_coupling", "shaking_force", "voltage_sag", "tight_spots",
    "drive_hysteresis",
)  # fmt: skip
"""Effects that the catalogue does not have."""


def apply_effect(effect: Effect, system: System, readings: Readings, figures: Figures) -> None:
    """Change an arm and its sensors by an effect, in place."""
    kind = kinds()[effect.kind]
    kind.apply(system, readings, figures, effect.place, dict(effect.parameters))
