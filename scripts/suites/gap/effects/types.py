"""What an effect is here, and the list of all of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.simulate import System

Parameters = dict[str, Any]


FORWARD, INVERSE, FREE, RANDOM = "forward", "inverse", "free", "random"


FORMS = (FORWARD, INVERSE, FREE, RANDOM)
"""Commands to sensors, motion to torque, free response, random excitation of a held arm."""
MIXED = "mixed"
"""Runs of the first two forms in turn."""


@dataclasses.dataclass(kw_only=True)
class Readings:
    """What sensors may do to the signals; changed in place by effects of sensors."""

    rotation: Array = dataclasses.field(default_factory=lambda: np.eye(3))
    """Reading of the accelerometer = rotation @ truth, of shape (3, 3)."""
    gain: dict[str, float] = dataclasses.field(default_factory=dict)
    """Factor by sensor."""
    bias: dict[str, Array] = dataclasses.field(default_factory=dict)
    """Constant by sensor, of shape (1,) or (3,)."""
    delay: dict[str, float] = dataclasses.field(default_factory=dict)
    """Delay by sensor [s]."""
    step: dict[str, float] = dataclasses.field(default_factory=dict)
    """Step by sensor, to which its readings are rounded, noise and all."""
    torque: dict[int, float] = dataclasses.field(default_factory=dict)
    """Measured over true torque by number of the drive."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Place:
    """Where an effect sits."""

    name: str
    """Name in the model: of a joint, body, actuator or sensor; or `tool`, `base`, `all`."""
    index: int
    """Number of the joint or link from 0; -1 for `all`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect: where it can be, how large, and what it does to the true arm."""

    name: str
    """Identifier of the catalogue, or of an effect outside it."""
    places: Callable[[Figures], list[Place]]
    """Where it can sit on an arm."""
    draw: Callable[[np.random.Generator, Figures, Place], Parameters]
    """Everything about it but its size."""
    bounds: Callable[[Figures, Place], tuple[float, float]]
    """Least and largest size in the sense of physics."""
    size: Callable[[float, Parameters, Figures, Place], Parameters]
    """All its parameters, from a size and what was drawn; larger is easier to see."""
    apply: Callable[[System, Readings, Figures, Place, Parameters], None]
    """Change the arm or its sensors, in place."""
    forms: tuple[str, ...] = FORMS
    """Forms of recording that can show it."""
    rivals: tuple[str, ...] = ()
    """Kinds at the same joints that may explain most of it: it is sized by what they leave."""
    group: str = "catalogue"
    """`catalogue` or `outside`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """A kind at a place with its parameters."""

    kind: str
    place: Place
    parameters: Mapping[str, Any]


def joints(figures: Figures) -> list[Place]:
    """All joints."""
    return [Place(name=f"joint{i + 1}", index=i) for i in range(figures.joints)]


def hinges(figures: Figures) -> list[Place]:
    """All joints that turn."""
    return [p for p in joints(figures) if figures.links[p.index].kind == "hinge"]


def links(figures: Figures) -> list[Place]:
    """All links."""
    return [Place(name=f"link{i + 1}", index=i) for i in range(figures.joints)]


def bars(figures: Figures) -> list[Place]:
    """Links that are bars along their x axis."""
    return [p for p in links(figures) if figures.links[p.index].end[0] > 0.15]


def actuators(figures: Figures) -> list[Place]:
    """All actuators."""
    return [Place(name=f"motor{i + 1}", index=i) for i in range(figures.joints)]


def scalar(name: str) -> Callable[[float, Parameters, Figures, Place], Parameters]:
    """A size that is the parameter `name`, with the sign drawn as `sign` if there is one."""

    def parameters(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
        rest = {key: value for key, value in drawn.items() if key != "sign"}
        return {name: size * drawn.get("sign", 1.0), **rest}

    return parameters


def either_sign(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Nothing but a sign."""
    return {"sign": float(rng.choice([-1.0, 1.0]))}


def nothing(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """No further parameters."""
    return {}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two bounds, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
