"""What an effect is here, and the list of all of them."""

from __future__ import annotations

from scripts.suites.gap.effects.types import Effect, Kind, Readings
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.simulate import System


def kinds() -> dict[str, Kind]:
    """All kinds by name: the catalogue in the order of its table, then those outside it."""
    from scripts.suites.gap.effects import drive as effects_drive
    from scripts.suites.gap.effects import joint as effects_joint
    from scripts.suites.gap.effects import link as effects_link
    from scripts.suites.gap.effects import outside_catalogue as outside
    from scripts.suites.gap.effects import sensor as effects_sensor

    parts = (effects_joint, effects_link, effects_drive, effects_sensor, outside)
    found = {kind.name: kind for part in parts for kind in part.KINDS}
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
