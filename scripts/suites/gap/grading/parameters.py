"""Parameters by which named effects are judged: errors, and which intervals hold the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

__all__ = [
    "OTHERS",
    "PARAMETERS",
    "SAID",
    "JudgedInterval",
    "judged_intervals",
    "parameter_error",
]

PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "viscous_friction": ("damping",),
    "coulomb_friction": ("torque",),
    "stribeck_friction": ("torque",),
    "quadratic_drag": ("drag",),
    "joint_compliance": ("stiffness",),
    "backlash": ("gap",),
    "structural_looseness": ("gap",),
    "link_flexibility": ("stiffness",),
    "link_mass": ("mass",),
    "link_com": ("x", "y", "z"),
    "payload": ("mass",),
    "rotor_inertia": ("inertia",),
    "actuator_gain": ("gain",),
    "actuator_lag": ("time",),
    "command_delay": ("delay",),
    "encoder_offset": ("offset",),
    "sensor_misalignment": ("x", "y", "z"),
    "sensor_gain": ("gain",),
    "sensor_bias": ("bias", "x", "y", "z"),
    "sensor_delay": ("delay",),
    "base_tilt": ("x", "y"),
    "torque_ripple": ("amplitude",),
    "joint_spring": ("stiffness",),
    "load_friction": ("share",),
    "asymmetric_friction": ("forward", "backward"),
    "torque_limit": ("limit",),
    "voltage_limit": ("stall_torque",),
    "dead_zone": ("width",),
    "gravity_compensation": ("share",),
    "torque_constant": ("factor",),
    "base_compliance": ("stiffness",),
    "gear_eccentricity": ("sine", "cosine"),
    "sensor_quantisation": ("step",),
}
"""Parameters by which an effect is judged; those of a kind make one vector."""
SAID: Mapping[str, Mapping[str, str]] = {
    "actuator_lag": {"time": "time_constant"},
    "sensor_misalignment": {axis: f"turn_{axis}" for axis in "xyz"},
    "base_tilt": {axis: f"tilt_{axis}" for axis in "xyz"},
    "sensor_bias": {axis: f"bias_{axis}" for axis in "xyz"},
}
"""Name of a parameter in a result, where it is not that of the truth."""
NEUTRAL = {"gain": 1.0, "factor": 1.0}
"""Values that change nothing; an error is judged against the distance from them."""
OTHERS: Mapping[str, Mapping[str, Callable[[Mapping[str, Any]], float]]] = {
    "stribeck_friction": {
        "static_ratio": lambda p: p["static_torque"] / p["torque"],
        "speed": lambda p: p["speed"],
    },
    "link_flexibility": {"position": lambda p: p["position"]},
    "structural_looseness": {"friction": lambda p: p["friction"]},
    "joint_spring": {"reference": lambda p: p["reference"]},
    "payload": {axis: (lambda p, axis=axis: p[axis]) for axis in "xyz"},  # type: ignore[misc]
    "voltage_limit": {"no_load_speed": lambda p: p["no_load_speed"]},
    "torque_ripple": {"periods": lambda p: p["order"], "phase": lambda p: p["phase"]},
}
"""Further parameters of a result that mean the same in the truth: what they are there. Damping and
stiffness of stops are laws of another form there, and have no counterpart."""


def _in_words_of_truth(effect: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters and intervals of a named effect under the names that the truth has."""
    words = {said: true for true, said in SAID.get(str(effect["kind"]), {}).items()}
    found = dict(effect)
    for part in ("parameters", "interval_95"):
        found[part] = {words.get(k, k): v for k, v in (effect.get(part) or {}).items()}
    return found


def _values(effect: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    given = effect.get("parameters", {})
    return np.array([float(given.get(name, 0.0)) - NEUTRAL.get(name, 0.0) for name in names])


def _names(kind: str, truth: Mapping[str, Any], effect: Mapping[str, Any]) -> list[str]:
    given = effect.get("parameters", {})
    names = [name for name in PARAMETERS.get(kind, ()) if name in truth["parameters"]]
    return names if any(name in given for name in names) else []


def parameter_error(truth: Mapping[str, Any], effect: Mapping[str, Any]) -> float:
    """Relative error of the parameters of a named effect, as one vector; NaN without any."""
    said = _in_words_of_truth(effect)
    names = _names(str(truth["kind"]), truth, said)
    if not names:
        return float("nan")
    want, have = _values(truth, names), _values(said, names)
    return float(np.linalg.norm(have - want) / np.linalg.norm(want))


@dataclasses.dataclass(frozen=True, kw_only=True)
class JudgedInterval:
    """The 95 % interval of a parameter, beside its true value."""

    name: str
    main: bool
    """Whether it is one of `PARAMETERS`; else a further one of `OTHERS`."""
    value: float
    interval: tuple[float, float]
    truth: float

    @property
    def held(self) -> bool:
        """Whether the interval holds the truth."""
        low, high = self.interval
        return low <= self.truth <= high


def judged_intervals(truth: Mapping[str, Any], effect: Mapping[str, Any]) -> list[JudgedInterval]:
    """Intervals of a named effect whose parameters mean the same in the truth.

    Parameters
    ----------
    truth : mapping
        An effect of a truth.
    effect : mapping
        The effect of the same kind and place of a result.
    """
    kind, said = str(truth["kind"]), _in_words_of_truth(effect)
    wanted = [(name, True, truth["parameters"][name]) for name in _names(kind, truth, said)]
    for name, of in OTHERS.get(kind, {}).items():
        try:
            wanted.append((name, False, float(of(truth["parameters"]))))
        except KeyError:
            continue
    found = []
    for name, main, true in wanted:
        if name not in said["interval_95"]:
            continue
        low, high = (float(end) for end in said["interval_95"][name])
        value = float(said["parameters"].get(name, 0.5 * (low + high)))
        if name == "phase":  # the same after every turn
            true += 2 * np.pi * round((value - true) / (2 * np.pi))
        found.append(
            JudgedInterval(
                name=name, main=main, value=value, interval=(low, high), truth=float(true)
            )
        )
    return found
