"""Whether the data of a case could tell its effect from another one.

The other effect is fitted, in the blind simulator and together with the nuisance parameters, to
the noiseless readings of one run; then both are compared on another run. If the chi-square excess
there is under three of its own standard deviations, no likelihood on held-out runs separates the
two (the excess is that of `sizing`).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from loose_env.typing import Array
from scripts.suites.gap.cases.cases import HELD_OUT, SEED, Case
from scripts.suites.gap.cases.draw import draw_case
from scripts.suites.gap.cases.effect_sizing import VISIBLE, Visibility
from scripts.suites.gap.cases.motions import Motion
from scripts.suites.gap.effects.catalogue import kinds
from scripts.suites.gap.effects.types import RANDOM, Effect, Kind, Parameters, Place
from scripts.suites.gap.grading.grade import Named, Separable

SCAN = 7
"""Sizes that are tried before the best one is refined."""
STEPS = 60
"""Evaluations of the refinement for every free number."""


class Comparison:
    """One case's effect against others.

    Parameters
    ----------
    case : Case
        The case.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        runs = self._two_runs()
        self._views = [
            Visibility(case.arm, motion, case.noise, case.form, seed=i)
            for i, motion in enumerate(runs)
        ]
        self._truth = [view.difference(case.arm.effects) for view in self._views]

    def _two_runs(self) -> tuple[Motion, Motion]:
        # a shaken arm's held-out run shakes the same joint in another pose
        motions = self.case.motions
        if self.case.form == RANDOM:
            return motions[-1 - min(2, len(motions) - 1)], motions[HELD_OUT]
        return motions[0], motions[HELD_OUT]

    def separable(self, effect: int, named: Named) -> bool:
        """Whether held-out data tell an effect of the case from another kind and place.

        Parameters
        ----------
        effect : int
            Position of the effect in the case; the others stay as they are.
        named : (str, str)
            Kind and place.
        """
        return self.score(effect, named) >= VISIBLE

    def score(self, effect: int, named: Named) -> float:
        """Held-out excess of the best other effect in its own standard deviations."""
        kind = kinds().get(named[0])
        places = [] if kind is None else kind.places(self.case.arm.figures)
        place = next((p for p in places if p.name == named[1]), None)
        if kind is None or place is None:
            return float("inf")
        others = tuple(e for i, e in enumerate(self.case.arm.effects) if i != effect)
        best = min(
            (self._fit(kind, place, drawn, others) for drawn in self._shapes(kind, place)),
            key=lambda found: found[0],
        )
        return self._held_out((*others, best[1]))

    def _shapes(self, kind: Kind, place: Place) -> list[Parameters]:
        """Starting shapes: both signs, and all directions of a vector."""
        rng = np.random.default_rng(2)
        drawn = kind.draw(rng, self.case.arm.figures, place)
        if "sign" in drawn:
            return [{**drawn, "sign": sign} for sign in (-1.0, 1.0)]
        if "direction" in drawn:
            return [
                {**drawn, "direction": (sign * axis).tolist()}
                for axis in np.eye(3)
                for sign in (-1.0, 1.0)
            ]
        return [drawn]

    def _fit(
        self, kind: Kind, place: Place, drawn: Parameters, others: tuple[Effect, ...]
    ) -> tuple[float, Effect]:
        figures = self.case.arm.figures
        low, high = np.log(kind.bounds(figures, place))
        free = [name for name in ("reference", "damping_ratio") if name in drawn]
        turns = "direction" in drawn

        def effect_at(x: Array) -> Effect:
            shape = dict(drawn)
            size = float(np.exp(np.clip(x[0], low, high)))
            for name, value in zip(free, x[1:], strict=False):
                shape[name] = float(value) if name == "reference" else float(np.exp(value))
            if turns:
                direction = x[-3:] / max(float(np.linalg.norm(x[-3:])), 1e-9)
                shape["direction"] = direction.tolist()
            return Effect(
                kind=kind.name, place=place, parameters=kind.size(size, shape, figures, place)
            )

        def loss(x: Array) -> float:
            effects = (*others, effect_at(x))
            difference = self._views[0].difference(effects) - self._truth[0]
            value = self._views[0].excess(difference)
            return float(np.log(max(value, 1e-6))) if np.isfinite(value) else 1e3

        rest = [drawn[name] if name == "reference" else np.log(drawn[name]) for name in free]
        rest += list(drawn["direction"]) if turns else []
        starts = [np.array([size, *rest]) for size in np.linspace(low, high, SCAN + 2)[1:-1]]
        start = min(starts, key=loss)
        found = minimize(
            loss, start, method="Nelder-Mead",
            options={"maxfev": STEPS * len(start), "xatol": 1e-3, "fatol": 1e-3},
        )  # fmt: skip
        return float(found.fun), effect_at(found.x)

    def _held_out(self, effects: tuple[Effect, ...]) -> float:
        """Excess on the second run with the nuisance parameters of the first."""
        fit, judge = self._views
        difference = fit.difference(effects) - self._truth[0]
        nuisance = fit.explained(difference)
        rest = judge.difference(effects) - self._truth[1] + judge.columns @ nuisance
        return judge.score(float(rest @ rest))


def separable_by_data(number: int, *, seed: int = SEED) -> Separable:
    """An answer for `grade.grade`, worked out only if it is asked.

    Parameters
    ----------
    number : int
        Number of the case; it is drawn again when the first question comes.
    seed : int
        Seed of its suite.
    """
    known: list[Comparison] = []

    def separable(effect: int, named: Named) -> bool:
        if not known:
            known.append(Comparison(draw_case(number, seed=seed)))
        return known[0].separable(effect, named)

    return separable
