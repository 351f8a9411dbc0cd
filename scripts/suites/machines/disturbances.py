"""What true machines have and the nominal model lacks: ranges and random draws."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

PRESENT = 0.4
"""Probability that a disturbance is present in a case."""
STRONG = 0.75
"""Place within its range of a disturbance that is played alone."""

WEAK_IS_HIGH = frozenset({"rate", "cutoff", "mode", "bandwidth", "bits", "speed", "ratio"})
"""Parameters of which low values disturb most."""


@dataclasses.dataclass(frozen=True)
class Range:
    """Range of a parameter, log-uniform."""

    low: float
    high: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Kind:
    """A disturbance and the ranges of its parameters."""

    title: str
    parameters: Mapping[str, Range]
    present: float = PRESENT


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "parameter_errors": Kind(
            "masses, centres, inertias, rotors off (lengths a fifteenth, damping five times that)",
            {"relative": Range(0.02, 0.04, "relative standard deviation")},
            1.0,
        ),
        "coulomb_friction": Kind(
            "Coulomb friction of the joints",
            {"share": Range(0.005, 0.03, "of peak torque")},
        ),
        "stribeck_friction": Kind(
            "larger friction at low speed",
            {
                "excess": Range(0.2, 0.8, "of Coulomb friction"),
                "speed": Range(0.005, 0.05, "rad/s"),
            },
        ),
        "load_friction": Kind(
            "friction that grows with load",
            {"share": Range(0.02, 0.1, "of drive torque")},
        ),
        "sampled_servo": Kind(
            "servo that samples, with a delay of whole samples",
            {"rate": Range(500.0, 8000.0, "Hz"), "delay": Range(0.5, 3.49, "samples")},
        ),
        "velocity_filter": Kind(
            "low-pass on the servo's velocity", {"cutoff": Range(60.0, 300.0, "Hz")}
        ),
        "servo_gains": Kind(
            "gains of the servos, or torque constants, off",
            {"relative": Range(0.05, 0.25, "relative, at most")},
        ),
        "torque_saturation": Kind(
            "drives that saturate early", {"share": Range(0.35, 0.8, "of peak torque")}
        ),
        "flexible_joints": Kind(
            "springs between motors and links",
            {"mode": Range(40.0, 300.0, "Hz"), "ratio": Range(0.01, 0.05, "damping ratio")},
        ),
        "flexible_links": Kind(
            "one or two links that bend",
            {"mode": Range(40.0, 300.0, "Hz"), "ratio": Range(0.005, 0.03, "damping ratio")},
        ),
        "compliant_base": Kind(
            "base that slides and rocks",
            {"mode": Range(30.0, 200.0, "Hz"), "ratio": Range(0.01, 0.05, "damping ratio")},
        ),
        "cables": Kind(
            "springs and dampers of cables at the joints",
            {
                "stiffness": Range(0.005, 0.05, "of peak torque per rad"),
                "damping": Range(0.001, 0.01, "of peak torque per rad/s"),
            },
        ),
        "tool_offset": Kind("accelerometer off its place", {"offset": Range(0.001, 0.005, "m")}),
        "accelerometer_rotation": Kind(
            "accelerometer turned", {"angle": Range(0.5, 2.0, "degrees")}
        ),
        "cross_axis": Kind(
            "axes of the accelerometer that leak into each other",
            {"share": Range(0.01, 0.03, "at most")},
        ),
        "accelerometer_filter": Kind(
            "analogue low-pass of second order in the accelerometer",
            {"bandwidth": Range(120.0, 1000.0, "Hz")},
        ),
        "accelerometer_delay": Kind("late accelerometer", {"delay": Range(1e-4, 1e-3, "s")}),
        "clock_offset": Kind(
            "accelerometer's clock off the controller's", {"offset": Range(5e-4, 5e-3, "s")}, 0.33
        ),
        "clock_drift": Kind(
            "clocks of recorders that drift apart", {"drift": Range(20.0, 300.0, "ppm")}
        ),
        "encoder_quantisation": Kind(
            "encoders with few bits a turn; the servo's own, behind the gear, have four more",
            {"bits": Range(12.0, 20.0, "bits")},
        ),
        "accelerometer_noise": Kind(
            "noise of the accelerometer, 20 where absent", {"density": Range(20.0, 300.0, "µg/√Hz")}
        ),
        "pose_repeat": Kind("poses not quite repeated", {"error": Range(5e-4, 0.01, "rad")}),
        "friction_drift": Kind(
            "friction and damping that change between sessions",
            {"relative": Range(0.1, 0.4, "relative, at most")},
        ),
    }
)
"""Name -> disturbance."""


@dataclasses.dataclass(frozen=True)
class Disturbances:
    """Disturbances of a machine and their sizes.

    Examples
    --------
    >>> only = Disturbances.only("pose_repeat")
    >>> only.has("pose_repeat"), only.has("cables")
    (True, False)
    """

    sizes: Mapping[str, Mapping[str, float]]
    """Name -> parameter -> value; those that are absent are not there."""

    @classmethod
    def none(cls) -> Disturbances:
        """Return a machine that is its model."""
        return cls({})

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Disturbances:
        """Draw each disturbance by its probability, its sizes log-uniform."""
        sizes = {}
        for name, kind in KINDS.items():
            there = rng.random() < kind.present
            values = {
                key: float(np.exp(rng.uniform(np.log(r.low), np.log(r.high))))
                for key, r in kind.parameters.items()
            }
            if there:
                sizes[name] = values
        return cls(sizes)

    @classmethod
    def only(cls, name: str, share: float = STRONG) -> Disturbances:
        """One disturbance alone, strong by default.

        Raises
        ------
        KeyError
            If there is no such disturbance.
        """
        sizes = {}
        for key, r in KINDS[name].parameters.items():
            weak_is_high = key in WEAK_IS_HIGH or name == "torque_saturation"
            place = 1 - share if weak_is_high else share
            sizes[key] = float(r.low * (r.high / r.low) ** place)
        return cls({name: sizes})

    def has(self, name: str) -> bool:
        """Return True if a disturbance is present."""
        return name in self.sizes

    def size(self, name: str, parameter: str, absent: float = 0.0) -> float:
        """Value of a parameter, or ``absent`` where the disturbance is not there."""
        if parameter not in KINDS[name].parameters:
            raise KeyError(f"{name} has no parameter {parameter!r}")
        return self.sizes[name][parameter] if name in self.sizes else absent


def ranges_table() -> str:
    """Table of the disturbances in Markdown."""
    lines = ["| disturbance | meaning | range | present |", "|---|---|---|---:|"]
    for name, kind in KINDS.items():
        ranges = "; ".join(
            f"{key} {r.low:g} to {r.high:g} {r.unit}" for key, r in kind.parameters.items()
        )
        lines.append(f"| `{name}` | {kind.title} | {ranges} | {kind.present:.0%} |")
    return "\n".join(lines)
