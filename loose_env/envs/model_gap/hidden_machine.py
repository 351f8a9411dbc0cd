"""Machines with hidden effects, drawn at random and simulated exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.gap import Hypothesis, Ray, SignatureBank
from loose_env.typing import Array

__all__ = ["HiddenEffect", "HiddenMachine", "MachineDraw"]

_SHAPE_LIMIT = 1.5
"""Largest deviation of a drawn shape parameter [standard deviations]."""
_LARGEST = 0.7
"""Largest size that is drawn, over the largest in the bank."""


@dataclass(frozen=True, eq=False)
class HiddenEffect:
    """An effect of the machine, with its values."""

    ray: Ray
    values: Array

    @property
    def name(self) -> str:
        """Kind and location."""
        return self.ray.name

    @property
    def value(self) -> float:
        """Parameter by which its size is stated."""
        return float(self.values[self.ray.main])


@dataclass(frozen=True, eq=False)
class HiddenMachine:
    """A machine: hidden effects, and nominal parameters that are off."""

    bank: SignatureBank
    effects: tuple[HiddenEffect, ...]
    factors: Array
    """Factors on the nominal parameters."""

    @property
    def names(self) -> tuple[str, ...]:
        """Hidden effects, sorted."""
        return tuple(sorted(effect.name for effect in self.effects))

    @property
    def hypothesis(self) -> Hypothesis:
        """The machine as a hypothesis."""
        return Hypothesis(
            effects=tuple(e.ray.effect for e in self.effects),
            values=tuple(e.values for e in self.effects),
            nominal=self.bank.arm.nominal,
            factors=self.factors,
        )

    def run(self, motion: int, rng: np.random.Generator) -> Array:
        """Measure a motion of the library: readings with noise (n, C); NaN if it diverged."""
        arm = self.bank.arm
        commands = self.bank.library[motion].commands(arm)
        return arm.measured(arm.simulate([self.hypothesis], commands)[0], rng)


@dataclass(frozen=True, kw_only=True)
class MachineDraw:
    """Distribution of hidden machines.

    Sizes are uniform in the logarithm from that seen at `least_visible` up to a share of the
    largest in the bank, so that the belief's prior, which is wider at both ends, does not tell
    where they end. Locations and kinds are uniform.
    """

    probabilities: tuple[float, float, float] = (0.2, 0.5, 0.3)
    """Probabilities of none, one and two effects."""
    least_visible: float = 15.0
    """Least visibility on the fixed battery [noise standard deviations]."""

    def __post_init__(self) -> None:
        """Check the values."""
        p = self.probabilities
        if len(p) != 3 or min(p) < 0 or abs(sum(p) - 1) > 1e-9:
            raise InvalidSetting(f"probabilities of none, one and two effects sum to 1, got {p!r}")
        if not self.least_visible > 0:
            raise InvalidSetting(f"least_visible is above 0, got {self.least_visible!r}")

    def draw(
        self, bank: SignatureBank, rng: np.random.Generator, *, count: int | None = None,
        names: tuple[str, ...] = (),
    ) -> HiddenMachine:  # fmt: skip
        """Draw a machine, with a number of effects or with given ones where asked.

        Raises
        ------
        InvalidSetting
            If a name is no candidate of the bank.
        """
        unknown = [name for name in names if name not in bank.names]
        if unknown:
            raise InvalidSetting(f"no candidate {unknown[0]!r}; candidates are {list(bank.names)}")
        if count is None:
            count = int(rng.choice(3, p=self.probabilities))
        count = min(count, len(bank.names))
        chosen = names or tuple(
            bank.names[k] for k in rng.choice(len(bank.names), count, replace=False)
        )
        tolerance = bank.arm.tolerance
        factors = 1 + rng.uniform(-tolerance, tolerance, len(bank.arm.nominal.entries))
        return HiddenMachine(bank, tuple(self._effect(bank, n, rng) for n in chosen), factors)

    def _effect(self, bank: SignatureBank, name: str, rng: np.random.Generator) -> HiddenEffect:
        rays = [k for k, ray in enumerate(bank.rays) if ray.name == name]
        k = int(rng.choice(rays))
        ray, sizes, seen = bank.rays[k], np.log(bank.sizes[k]), np.log(bank.visibilities[k])
        order = np.maximum.accumulate(seen)
        least = np.interp(np.log(self.least_visible), order, sizes)
        most = sizes[-1] + np.log(_LARGEST)
        size = float(np.exp(rng.uniform(min(least, most - 0.1), most)))
        shape = np.clip(rng.normal(size=len(ray.shape_parameters)), -_SHAPE_LIMIT, _SHAPE_LIMIT)
        return HiddenEffect(ray, ray.values(size, shape))
