"""The list of cases: what is drawn for each by its number alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from scripts.suites.gap.cases.effect_sizing import VISIBLE, Visibility, drawn_effect
from scripts.suites.gap.cases.motions import Motion, motions
from scripts.suites.gap.cases.sensing import Noise
from scripts.suites.gap.cases.true_arm import TrueArm
from scripts.suites.gap.effects.catalogue import CATALOGUE, OUTSIDE, kinds
from scripts.suites.gap.effects.types import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Effect,
    Kind,
    Place,
)
from scripts.suites.gap.simulator.arms import ARMS, Figures
from scripts.suites.gap.simulator.build import Factors

SEED = 20_281
"""Seed of the published suite; a private one has another."""
GROSS = 30.0
"""Largest size over the size that is just visible."""
_SEVERAL = {"pair": 2, "triple": 3}
"""Number of effects by group."""
TRIES = 12
"""Places and shapes that are tried until an effect can be seen."""
NONE, SINGLE, PAIR, OUT, TRIPLE, MACHINE = 0, 1000, 2000, 3000, 4000, 5000
"""First numbers of the cases with nothing missing, one effect, two, one outside the catalogue,
three, and of whole machines."""
ROLES = ("none", "single", "pair", "outside", "triple", "machine")
"""Groups of cases, by thousands of their numbers."""
LAST = MACHINE + 999
"""Largest number of a case."""
SHORT, LONG = 3.0, 6.0
"""Lengths of runs [s]: with nothing missing, and else."""
RUNS = 4
"""Runs of a recording."""
HELD_OUT = -1
"""Run that the tool holds out of so many: the last one."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn: everything that its recording is made of."""

    number: int
    """Number in the suite."""
    form: str
    """Form of the recording."""
    arm: TrueArm
    """The true arm."""
    motions: tuple[Motion, ...]
    """The runs."""
    noise: Noise
    """Noise of the sensors."""
    sizes: tuple[dict[str, Any], ...] = ()
    """For each effect its size, the size that is just visible and their ratio."""
    seed: int = SEED
    """Seed of the suite that it belongs to."""

    @property
    def role(self) -> str:
        """One of `ROLES`."""
        return role_of(self.number)

    @property
    def name(self) -> str:
        """Name of the recording; it tells nothing."""
        return name_of(self.number, seed=self.seed)


def role_of(number: int) -> str:
    """Group of a case by its number."""
    return ROLES[number // 1000]


def name_of(number: int, *, seed: int = SEED) -> str:
    """Name of a case's recording: numbers in an order that tells nothing without the seed."""
    if seed != SEED:
        first, count, key = 0, LAST + 1, 1
    else:  # the published suite had names before it had cases of many effects
        first, count, key = (0, TRIPLE, 1) if number < TRIPLE else (TRIPLE, LAST + 1 - TRIPLE, 4)
    order = np.random.default_rng(np.random.SeedSequence([seed, key])).permutation(count)
    return f"case-{first + int(order[number - first]):04d}"


def quick_list() -> list[int]:
    """Numbers of a small suite of 20 cases."""
    return [
        *range(NONE, NONE + 6),
        *(SINGLE + i for i in (0, 1, 4, 6, 7, 8, 11, 15, 16, 20)),
        *range(PAIR, PAIR + 2),
        *range(OUT, OUT + 2),
    ]


def full_list(
    *, none: int = 100, singles: int = 3, pairs: int = 24, outside: int = 18
) -> list[int]:
    """Numbers of the whole suite.

    Parameters
    ----------
    none : int
        Cases with nothing missing.
    singles : int
        Cases of every kind of the catalogue.
    pairs : int
        Cases with two effects.
    outside : int
        Cases with an effect that the catalogue does not have.
    """
    return [
        *range(NONE, NONE + none),
        *range(SINGLE, SINGLE + singles * len(CATALOGUE)),
        *range(PAIR, PAIR + pairs),
        *range(OUT, OUT + outside),
    ]


def draw_few(number: int, rng: np.random.Generator, *, even_lengths: bool = False) -> Case:
    """Draw a case with at most three effects.

    Parameters
    ----------
    number : int
        Its number in the suite.
    rng : numpy.random.Generator
        Source of all that is random.
    even_lengths : bool
        Runs are as long where nothing is missing, so that their length tells nothing.
    """
    role, within = role_of(number), number % 1000
    if role == "none":
        wanted: list[str] = []
    elif role == "single":
        wanted = [CATALOGUE[within % len(CATALOGUE)]]
    elif role in _SEVERAL:
        wanted = _several(rng, _SEVERAL[role])
    else:
        wanted = [OUTSIDE[within % len(OUTSIDE)]]
    seconds = SHORT if role == "none" and not even_lengths else LONG
    while True:
        form = _draw_form(rng, wanted)
        if form is None:
            wanted = _several(rng, _SEVERAL[role])
            continue
        figures = _draw_arm(rng, form)
        arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
        runs = motions(rng, figures, form=form, runs=RUNS, seconds=seconds)
        noise = Noise.draw(figures, rng)
        placed = _draw_effects(rng, [kinds()[name] for name in wanted], arm, runs, noise, form)
        if placed is not None:
            break
        if role in _SEVERAL:
            wanted = _several(rng, _SEVERAL[role])
    effects, sizes = placed
    return Case(
        number=number,
        form=form,
        arm=dataclasses.replace(arm, effects=effects),
        motions=tuple(runs),
        noise=noise,
        sizes=sizes,
    )


def _several(rng: np.random.Generator, count: int) -> list[str]:
    """Kinds of the catalogue."""
    return [str(name) for name in rng.choice(CATALOGUE, count, replace=False)]


def _draw_form(rng: np.random.Generator, wanted: list[str]) -> str | None:
    allowed = [FORWARD, INVERSE, FREE, RANDOM]
    for name in wanted:
        allowed = [form for form in allowed if form in kinds()[name].forms]
    if not allowed:
        return None
    likely = {FORWARD: 0.7, INVERSE: 0.12, FREE: 0.08, RANDOM: 0.1}
    if "structural_looseness" in wanted or "backlash" in wanted:
        likely[RANDOM] = 0.5
    shares = np.array([likely[form] for form in allowed])
    return str(rng.choice(allowed, p=shares / shares.sum()))


def _draw_arm(rng: np.random.Generator, form: str) -> Figures:
    arms = [make() for make in ARMS.values()]
    if form == FREE:
        arms = [arm for arm in arms if arm.hanging is not None]
    return arms[int(rng.integers(len(arms)))]


def _draw_effects(
    rng: np.random.Generator,
    wanted: list[Kind],
    arm: TrueArm,
    runs: list[Motion],
    noise: Noise,
    form: str,
) -> tuple[tuple[Effect, ...], tuple[dict[str, Any], ...]] | None:
    """Effects at places where they can be seen, or None if none was found."""
    if not wanted:
        return (), ()
    visibility = Visibility(arm, runs[HELD_OUT], noise, form, seed=int(rng.integers(2**31)))
    effects: list[Effect] = []
    sizes = []
    taken: set[int] = set()
    for kind in wanted:
        found = None
        for _ in range(TRIES):
            place = _draw_place(rng, kind, arm.figures, taken)
            if place is None:
                return None
            found = drawn_effect(rng, visibility, kind, place, ratios=(1.0, GROSS))
            if found is not None:
                break
        if found is None or place is None:
            return None
        effects.append(found[0])
        sizes.append(found[1])
        taken.add(place.index)
    for effect in effects:
        for other in effects:
            # two that act alike cannot be told from one: they are no pair
            if effect is not other and visibility.beside(effect, other) < VISIBLE:
                return None
    return tuple(effects), tuple(sizes)


def _draw_place(
    rng: np.random.Generator, kind: Kind, figures: Figures, taken: set[int]
) -> Place | None:
    # two effects at one joint could be one spring behind another, which no data tell apart
    places = [place for place in kind.places(figures) if place.index not in taken]
    return places[int(rng.integers(len(places)))] if places else None
