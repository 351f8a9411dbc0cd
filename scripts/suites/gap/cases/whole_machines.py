"""Whole machines: 5 to 15 effects at once on arms whose nominal figures are 3 to 10 % off.

Friction at nearly every joint, and some of what else a machine has after years: a load at the tool,
late commands, a compliant gear, an encoder that was set up badly, a base that is not level, a drive
with another gain. Runs are commanded, or have torques, or are of both forms.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from scripts.suites.gap.cases.cases import LONG, RUNS, SHORT, Case
from scripts.suites.gap.cases.effect_sizing import Visibility, drawn_effect
from scripts.suites.gap.cases.motions import motions
from scripts.suites.gap.cases.sensing import Noise
from scripts.suites.gap.cases.true_arm import TrueArm
from scripts.suites.gap.effects.catalogue import kinds
from scripts.suites.gap.effects.types import FORWARD, INVERSE, MIXED, Effect
from scripts.suites.gap.simulator.arms import MACHINES
from scripts.suites.gap.simulator.build import Factors

__all__ = ["TOLERANCE", "draw_machine"]

LEAST_ERROR, TOLERANCE = 0.03, 0.10
"""Smallest and largest relative error of nominal masses, inertias, dampings, gains and rotors."""
FEWEST, MOST = 5, 15
"""Effects at once."""
SMALLEST, LARGEST = 3.0, 30.0
"""Sizes over the size that is just visible without the other effects."""
FRICTION = 0.8
"""Probability of each joint to have a friction that the model lacks."""
FRICTIONS = ("viscous_friction", "coulomb_friction")
PARTS = (
    ("payload", 0.7), ("command_delay", 0.5), ("joint_compliance", 0.5), ("encoder_offset", 0.5),
    ("base_tilt", 0.3), ("actuator_gain", 0.4), ("joint_spring", 0.2), ("torque_ripple", 0.2),
)  # fmt: skip
"""Other effects, and their probabilities."""


def draw_machine(number: int, rng: np.random.Generator) -> Case:
    """Draw a whole machine.

    Parameters
    ----------
    number : int
        Its number in the suite.
    rng : numpy.random.Generator
        Source of all that is random.
    """
    form = str(rng.choice([FORWARD, INVERSE, MIXED], p=[0.5, 0.3, 0.2]))
    makers = list(MACHINES.values())
    figures = makers[int(rng.integers(len(makers)))]()
    factors = Factors.draw(figures.joints, rng, least=LEAST_ERROR, most=TOLERANCE)
    arm = TrueArm(figures=figures, factors=factors)
    many = form == MIXED
    runs = motions(
        rng, figures, form=form, runs=2 * RUNS if many else RUNS, seconds=SHORT if many else LONG
    )
    noise = Noise.draw(figures, rng)
    shown = INVERSE if form == INVERSE else FORWARD
    seen = next(run for run in reversed(runs) if run.straight == (shown == INVERSE))
    visibility = Visibility(
        arm, seen, noise, shown, seed=int(rng.integers(2**31)), tolerance=TOLERANCE
    )
    effects: list[Effect] = []
    sizes: list[dict[str, Any]] = []
    while len(effects) < FEWEST:
        effects, sizes = [], []
        for name, index in _wanted(rng, figures.joints, shown)[:MOST]:
            kind = kinds()[name]
            places = [p for p in kind.places(figures) if index in (None, p.index)]
            if not places:
                continue
            place = places[int(rng.integers(len(places)))]
            found = drawn_effect(rng, visibility, kind, place, ratios=(SMALLEST, LARGEST))
            if found is None or found[1]["ratio"] < SMALLEST:
                continue  # no real size of it is clearly visible
            effects.append(found[0])
            sizes.append(found[1])
    return Case(
        number=number,
        form=form,
        arm=dataclasses.replace(arm, effects=tuple(effects)),
        motions=tuple(runs),
        noise=noise,
        sizes=tuple(sizes),
    )


def _wanted(rng: np.random.Generator, joints: int, form: str) -> list[tuple[str, int | None]]:
    """Kinds, with the joint where it is drawn beforehand, in an order that tells nothing."""
    found: list[tuple[str, int | None]] = [
        (str(rng.choice(FRICTIONS)), joint) for joint in range(joints) if rng.random() < FRICTION
    ]
    for name, likely in PARTS:
        if rng.random() < likely and form in kinds()[name].forms:
            found.append((name, None))
    return [found[k] for k in rng.permutation(len(found))]
