"""Candidate effects of an arm as rays: one direction of the parameters, of any size.

A ray goes from no effect through one of the effect's starting values. Along it only the size
changes; what shapes the effect beside (a Stribeck speed, the other axes of a centre of mass) varies
about the ray with a standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.typing import Array

EXCLUDED = (
    "structural_looseness",
    "backlash",
    "sensor_quantisation",
    "torque_constant",
    "torque_limit",
    "voltage_limit",
)
"""Kinds that are no candidates of encoders and torque sensors on the drives' side: looseness needs
an accelerometer beyond the joint; play under a load that keeps its side shows the stiffness of its
stops alone (named as a kind, it is one); quantisation changes nothing but the noise; the torque
constant acts where torque is compared with motion; limits do nothing until they are reached, which
no linear model describes."""
_AXES = ("base_compliance", "link_flexibility")
"""Kinds whose variants are directions in the arm; those of others are richer laws of one effect,
of which the plain one is a candidate."""
_TIMES, _LEAST_S = ("actuator_lag", "command_delay", "sensor_delay"), 3e-4
"""Kinds that are a time, and the least of it [s]."""
_SPRINGS = ("joint_compliance", "backlash", "link_flexibility", "base_compliance")
"""Kinds with a spring of their own."""
_SOFTER = {"joint_compliance": 6.0}
"""Compliance over that of the stiffest start from which it is stable in every pose."""
_LOG_SD, _LINEAR_SD = 0.35, 0.5
"""Standard deviations of shape parameters: of logarithms, and of linear ones over their scale."""
_ACROSS_SD = 0.6
"""Standard deviation of the other components of a vector over its size along the ray."""
_MOST = 6
"""Rays of one candidate, evenly among those it has."""
_SAME = 1e-6
"""Difference of two directions that counts as none."""


@dataclass(frozen=True, eq=False)
class Ray:
    """One direction in the parameters of a candidate.

    Examples
    --------
    >>> from loose_env.arms import SERVO_ARM
    >>> from loose_env.gap.experiment_design.servo_arm import read_servo_arm
    >>> ray = rays_of(read_servo_arm(SERVO_ARM), ["command_delay"])[0]
    >>> ray.name, ray.values(3.0).round(4).tolist()
    ('command_delay@motor1', [0.003])
    """

    effect: Effect
    """Effect and location."""
    start: Array
    """Values at size 1 (P,)."""

    @property
    def name(self) -> str:
        """Kind and location, as a verdict names them."""
        return f"{self.effect.kind}@{self.effect.where}"

    @cached_property
    def sized(self) -> tuple[bool, ...]:
        """Whether each parameter goes with the size (P,)."""
        effect, count = self.effect, len(self.start)
        names = [p.name for p in effect.parameters]
        if effect.proportional is not None:
            return tuple(k == effect.proportional for k in range(count))
        if effect.null_values is not None:
            return (True,) * count
        ends = dict(effect.limit)
        if effect.has_stops and "gap" in ends:
            return tuple(name == "gap" for name in names)
        return tuple(name in ends for name in names)

    def values(self, size: float, shape: Array | None = None) -> Array:
        """Parameter values at a size, shape parameters off by some standard deviations.

        Parameters
        ----------
        size : float
            Size over that of the start; 0 is no effect.
        shape : ndarray (S,), optional
            Deviations of `shape_parameters`, in their standard deviations.
        """
        effect, ends = self.effect, dict(self.effect.limit)
        found = np.array(self.start, dtype=float)
        none = None if effect.null_values is None else np.array(effect.null_values)
        for k, parameter in enumerate(effect.parameters):
            if not self.sized[k]:
                continue
            if none is not None:
                found[k] = none[k] + size * (self.start[k] - none[k])
            elif ends.get(parameter.name) == "high":
                found[k] = self.start[k] / max(size, 1e-9)
            else:
                found[k] = self.start[k] * size
        if shape is not None:
            for k, sd, z in zip(*self._shape_sds(size), shape, strict=True):
                parameter = effect.parameters[k]
                found[k] = found[k] * np.exp(sd * z) if parameter.log else found[k] + sd * z
        return np.array([p.clipped(v) for p, v in zip(effect.parameters, found, strict=True)])

    def _shape_sds(self, size: float) -> tuple[list[int], list[float]]:
        """Indices and standard deviations of the shape parameters at a size."""
        effect, which, sds = self.effect, [], []
        for k, parameter in enumerate(effect.parameters):
            if not self.sized[k]:
                which.append(k)
                sds.append(_LOG_SD if parameter.log else _LINEAR_SD * parameter.scale)
            elif effect.null_values is not None and len(self.start) > 1 and effect.is_additive:
                along = np.abs(self.start - np.array(effect.null_values))
                if along[k] < _SAME * along.max():
                    which.append(k)
                    sds.append(_ACROSS_SD * size * float(along.max()))
        return which, sds

    @cached_property
    def shape_parameters(self) -> tuple[int, ...]:
        """Indices of the parameters that vary about the ray."""
        return tuple(self._shape_sds(1.0)[0])

    @cached_property
    def main(self) -> int:
        """Index of the parameter by which the effect's error is stated."""
        change = np.abs(self.values(1.0) - self.values(0.5))
        scale = np.array([p.scale for p in self.effect.parameters])
        return int(np.argmax(np.where(self.sized, change / scale, -1.0)))

    @cached_property
    def largest(self) -> float:
        """Size at which the first parameter reaches its bound."""
        effect, none = self.effect, self.effect.null_values
        ends, reached = dict(effect.limit), []
        for k, parameter in enumerate(effect.parameters):
            start = float(self.start[k])
            if not self.sized[k]:
                continue
            if none is not None:
                along = start - none[k]
                if along:
                    bound = parameter.high if along > 0 else parameter.low
                    reached.append((bound - none[k]) / along)
            elif ends.get(parameter.name) == "high":
                reached.append(start / parameter.low)
            else:
                reached.append(parameter.high / start)
        return min(reached)

    @cached_property
    def smallest(self) -> float:
        """Least size that a simulation at this arm's steps tells from none; 0 if any does.

        A spring or a play below the smallest of the effect's starts rings faster than the steps;
        lags and delays below 0.3 ms only say on which side of a step a sample was taken.
        """
        if self.effect.kind in _TIMES:
            return _LEAST_S / float(np.max(self.start))
        if (
            not self.effect.needs_fine_steps
            or self.effect.null_values is not None
            or self.effect.is_additive
        ):
            return 0.0
        if self.effect.kind not in _SPRINGS:
            return 0.0
        k = self.sized.index(True)
        sizes = [float(start[k]) / float(self.start[k]) for start in self.effect.starts]
        if self.effect.has_stops:
            return min(sizes)
        return _SOFTER.get(self.effect.kind, 1.0) / max(sizes)

    def hypothesis(self, values: Array) -> Hypothesis:
        """The effect alone with some values."""
        return Hypothesis((self.effect,), (values,))


def rays_of(arm: ServoArm, kinds: Iterable[str] | None = None) -> tuple[Ray, ...]:
    """Rays of all candidates of an arm: kinds of the catalogue at every location.

    Parameters
    ----------
    arm : ServoArm
        The arm.
    kinds : iterable of str, optional
        Identifiers; by default the catalogue without `EXCLUDED`.

    Raises
    ------
    UnknownName
        If the catalogue has no such identifier.
    """
    wanted = [k for k in CATALOGUE if k not in EXCLUDED] if kinds is None else list(kinds)
    found: list[Ray] = []
    for effect in candidates(arm.machine, wanted):
        first = type(effect).variants_at(arm.machine, effect.where)[0]
        if effect.variant != first and effect.kind not in _AXES:
            continue
        if effect.part == "actuator" and effect.where not in ("all", *_driven(arm)):
            continue
        mine: list[Ray] = []
        for start in _starts(effect):
            ray = Ray(effect, start)
            if not any(_same_direction(ray, other) for other in mine):
                mine.append(ray)
        count = len(mine)
        chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST)).round().astype(int))
        found += [mine[k] for k in chosen]
    return tuple(found)


def _driven(arm: ServoArm) -> set[str]:
    return {arm.model.actuator(int(k)).name for k in arm.actuators}


def _starts(effect: Effect) -> list[Array]:
    """Starting values, with those mirrored about no effect where the bounds let them be."""
    found = [np.array(start, dtype=float) for start in effect.starts]
    if effect.is_additive and effect.null_values is not None:  # small steps along axes
        none = np.array(effect.null_values)
        found = [none + row for row in np.diag(np.max(np.abs(np.array(found) - none), axis=0))]
    if effect.null_values is not None:
        none = np.array(effect.null_values)
        low = np.array([p.low for p in effect.parameters])
        index = effect.proportional
        for start in list(found):
            other = 2 * none - start
            if index is not None:
                other = np.where(np.arange(len(start)) == index, other, start)
            if np.all(other > low) and not any(np.allclose(other, s) for s in found):
                found.append(other)
    return found


def _same_direction(one: Ray, other: Ray) -> bool:
    """Whether two starts of one effect differ by their size alone."""
    fixed = [k for k, sized in enumerate(one.sized) if not sized]
    if not np.allclose(one.start[fixed], other.start[fixed], rtol=1e-6, atol=1e-12):
        return False
    effect = one.effect
    if effect.null_values is None:
        ends = [k for k, sized in enumerate(one.sized) if sized]
        ratios = np.log(one.start[ends] / other.start[ends])
        return bool(np.ptp(ratios) < _SAME)
    none = np.array(effect.null_values)
    a = np.where(one.sized, one.start - none, 0.0)
    b = np.where(one.sized, other.start - none, 0.0)
    return bool(a @ b > (1 - _SAME) * np.linalg.norm(a) * np.linalg.norm(b))
