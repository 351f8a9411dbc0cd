"""Random draw of a case by its number: arm, fault and sensors."""

from __future__ import annotations

import dataclasses

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.cases.sensing import Noise
from scripts.suites.gap.cases.true_arm import TrueArm
from scripts.suites.gap.effects.catalogue import kinds
from scripts.suites.gap.effects.types import Effect
from scripts.suites.gap.simulator.arms import ARMS
from scripts.suites.gap.simulator.build import Factors

KINDS = ("healthy", "structural_looseness", "structural_looseness", "backlash")
"""Kinds in turn, by the case's number."""
GAPS = {"structural_looseness": (3e-5, 4e-4), "backlash": (3e-4, 3e-3)}
"""Free travel [m, rad], log-uniform."""
CROSS_AXIS = 0.03
"""Largest leakage of an accelerometer axis into another."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn."""

    number: int
    seed: int
    arm: TrueArm
    noise: Noise
    sensor: Array
    """Reading of the accelerometer per true acceleration (3, 3)."""
    reference: bool
    """True if the recording has runs of the healthy arm."""

    @property
    def name(self) -> str:
        """Name of the recording; it tells nothing."""
        return f"case-{self.number:04d}"

    @property
    def kind(self) -> str:
        """Kind of the fault."""
        return self.arm.effects[0].kind if self.arm.effects else "healthy"

    @property
    def hypothesis(self) -> str:
        """As the tool would name it."""
        effects = self.arm.effects
        return f"{effects[0].kind}@{effects[0].place.name}" if effects else "healthy"

    def rng(self, *purpose: int) -> np.random.Generator:
        """Generator for one purpose."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, self.number, *purpose]))


def draw(number: int, seed: int) -> Case:
    """Draw a case by its number."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 0]))
    kind = KINDS[number % len(KINDS)]
    names = sorted(ARMS)
    figures = ARMS[names[int(rng.integers(len(names)))]]()
    arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
    effects: tuple[Effect, ...] = ()
    if kind != "healthy":
        sort = kinds()[kind]
        places = sort.places(figures)
        place = places[int(rng.integers(len(places)))]
        gap = float(np.exp(rng.uniform(*np.log(GAPS[kind]))))
        drawn = sort.draw(rng, figures, place)
        parameters = sort.size(gap, drawn, figures, place)
        effects = (Effect(kind=kind, place=place, parameters=parameters),)
    leaks = CROSS_AXIS * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
    return Case(
        number=number,
        seed=seed,
        arm=dataclasses.replace(arm, effects=effects),
        noise=Noise.draw(figures, rng),
        sensor=np.eye(3) + leaks,
        reference=bool(rng.random() < 0.5),
    )
