"""Kinds of effects that an answer may name, with their locations, parameters and units."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from scripts.suites.gap.grading.parameters import OTHERS, PARAMETERS, SAID
from scripts.suites.gap.simulator.arms import Figures

__all__ = ["Kind", "catalogue", "places_of"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect, as an answer may name it."""

    at: tuple[str, ...]
    """Groups of locations where it can be: keys of `places_of`."""
    about: str
    """The effect, in one line."""
    parameters: Mapping[str, str]
    """Unit of each parameter, "" for a ratio; the second unit is that of a sliding joint."""
    scored: tuple[str, ...] = ()
    """Parameters whose error counts, as one vector."""
    covered: tuple[str, ...] = ()
    """Further parameters whose intervals count."""


def places_of(figures: Figures, *, drives: bool) -> dict[str, list[str]]:
    """Locations of an arm by group.

    Parameters
    ----------
    figures : Figures
        The nominal arm.
    drives : bool
        Whether its model has actuators; that of a free response has none.

    Examples
    --------
    >>> from scripts.suites.gap.simulator.arms import ARMS
    >>> places_of(ARMS["planar3"](), drives=True)["actuator"]
    ['motor1', 'motor2', 'motor3']
    """
    numbers = range(1, figures.joints + 1)
    return {
        "joint": [f"joint{k}" for k in numbers],
        "link": [f"link{k}" for k in numbers],
        "actuator": [f"motor{k}" for k in numbers] if drives else [],
        "encoder": [f"joint{k}_{what}" for k in numbers for what in ("pos", "vel")],
        "accelerometer": ["tool_acc"],
        "tool": ["tool"],
        "base": ["base"],
        "all": ["all"],
    }


def catalogue() -> dict[str, Kind]:
    """All kinds by name.

    Examples
    --------
    >>> kind = catalogue()["coulomb_friction"]
    >>> kind.at, dict(kind.parameters), kind.scored
    (('joint',), {'torque': 'N·m or N'}, ('torque',))
    """
    return {
        name: Kind(
            at=tuple(at.split()),
            about=about,
            parameters=dict(parameters),
            scored=_scored(name, parameters),
            covered=tuple(each for each in OTHERS.get(name, {}) if each in parameters),
        )
        for name, (at, about, parameters) in _KINDS.items()
    }


def _scored(kind: str, parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Names in an answer of the parameters by which a kind is judged in the truth."""
    words = SAID.get(kind, {})
    names = [words.get(each, each) for each in PARAMETERS[kind]]
    return tuple(name for name in names if name in parameters)


_FORCE = "N·m or N"
_ANGLE = "rad or m"
_SPEED = "rad/s or m/s"
_SPRING = "N·m/rad or N/m"
_XYZ = {axis: "m" for axis in "xyz"}

_KINDS: dict[str, tuple[str, str, dict[str, str]]] = {
    "viscous_friction": ("joint", "friction torque proportional to speed",
        {"damping": "N·m·s/rad or N·s/m"}),
    "coulomb_friction": ("joint", "dry friction of constant size against the motion",
        {"torque": _FORCE}),
    "stribeck_friction": ("joint", "dry friction, static_ratio times larger near rest",
        {"torque": _FORCE, "static_ratio": "", "speed": _SPEED}),
    "quadratic_drag": ("joint", "friction torque proportional to speed squared",
        {"drag": "N·m·s²/rad² or N·s²/m²"}),
    "joint_compliance": ("joint", "elastic gear between motor and link",
        {"stiffness": _SPRING, "damping_ratio": ""}),
    "backlash": ("joint", "free travel between motor and link, stop to stop",
        {"gap": _ANGLE, "stiffness": _SPRING, "damping_ratio": "", "friction": _FORCE}),
    "structural_looseness": ("link", "link that slides in its seat between stops",
        {"gap": "m", "friction": "N", "stiffness": "N/m", "damping_ratio": "", "angle": "rad",
         "azimuth": "rad", "elevation": "rad"}),
    "link_flexibility": ("link", "link that bends; position as a share of its length",
        {"stiffness": "N·m/rad", "damping_ratio": "", "position": ""}),
    "link_mass": ("link", "mass beyond that of the model", {"mass": "kg"}),
    "link_com": ("link", "shift of the centre of mass, in the link's frame", _XYZ),
    "payload": ("tool", "point mass at the tool; x, y, z from the site `tool`",
        {"mass": "kg", **_XYZ}),
    "rotor_inertia": ("joint", "inertia about the joint beyond that of the model",
        {"inertia": "kg·m² or kg"}),
    "actuator_gain": ("actuator", "true over nominal servo gains", {"gain": ""}),
    "actuator_lag": ("actuator", "first-order lag of the drive", {"time_constant": "s"}),
    "command_delay": ("actuator all", "dead time of the command; `all` for all actuators alike",
        {"delay": "s"}),
    "encoder_offset": ("joint", "zero of the encoder", {"offset": _ANGLE}),
    "sensor_misalignment": ("accelerometer", "rotation vector of the sensor, in its own frame",
        {f"turn_{axis}": "rad" for axis in "xyz"}),
    "sensor_gain": ("encoder accelerometer", "reading over truth", {"gain": ""}),
    "sensor_bias": ("encoder accelerometer",
        "constant in the reading; bias of an encoder, bias_x to bias_z of an accelerometer",
        {"bias": "rad or m, rad/s or m/s", **{f"bias_{axis}": "m/s²" for axis in "xyz"}}),
    "sensor_delay": ("encoder accelerometer", "dead time of the reading", {"delay": "s"}),
    "base_tilt": ("base", "rotation vector by which the base is tilted",
        {"tilt_x": "rad", "tilt_y": "rad"}),
    "torque_ripple": ("joint", "amplitude · sin(periods · angle + phase)",
        {"amplitude": _FORCE, "periods": "1/turn or 1/m", "phase": "rad"}),
    "joint_spring": ("joint", "spring to the ground side with its rest position",
        {"stiffness": _SPRING, "reference": _ANGLE}),
    "load_friction": ("joint", "dry friction as a share of the transmitted torque",
        {"share": "", "static_ratio": "", "speed": _SPEED, "load_share": ""}),
    "asymmetric_friction": ("joint", "dry friction that differs by direction",
        {"forward": _FORCE, "backward": _FORCE}),
    "torque_limit": ("actuator", "largest torque of the drive", {"limit": _FORCE}),
    "voltage_limit": ("actuator", "torque limit that falls with speed",
        {"stall_torque": _FORCE, "no_load_speed": _SPEED}),
    "dead_zone": ("actuator", "servo error without a torque, half its width",
        {"width": _ANGLE}),
    "gravity_compensation": ("link all", "share of the weight that something else carries",
        {"share": ""}),
    "torque_constant": ("joint", "measured over true torque", {"factor": ""}),
    "base_compliance": ("base", "base on a rotational spring",
        {"stiffness": "N·m/rad", "damping_ratio": ""}),
    "gear_eccentricity": ("joint", "encoder error once a turn: sine · sin + cosine · cos of angle",
        {"sine": "rad", "cosine": "rad"}),
    "sensor_quantisation": ("encoder", "step to which the reading is rounded",
        {"step": "rad or m, rad/s or m/s"}),
}  # fmt: skip
"""Groups of locations, description, parameters with units."""
