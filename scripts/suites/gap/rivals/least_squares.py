"""Least squares on the inverse-dynamics regressor: dense with tests, and stepwise by a criterion.

Dense is the textbook's identification of a robot: mass, centre of mass and inertia tensor of every
link, rotor inertia, Coulomb and viscous friction and a spring with an offset at every joint are all
fitted at once. A group of coefficients is named where its Wald test rejects zero at a level divided
by the number of tests (Bonferroni) and where it is larger than the tolerance told allows. The
named groups are fitted again without the others, whose scatter would spoil the prediction.

Stepwise, in each step the candidate group joins that lowers the extended Bayesian information
criterion most (Chen and Chen, Biometrika 2008): weighted squares per independent row, plus ln(rows)
for each coefficient, plus 2 ln(candidates) for each group, which pays for the search among many.
After each step groups that no longer earn this are dropped again. Selection ends where no group
lowers the criterion by `least_drop`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scripts.suites.gap.rivals.regression import Fit, Regression, regression_of
from scripts.suites.gap.rivals.results import write_finding

__all__ = [
    "DenseSettings",
    "StepwiseSettings",
    "named_groups",
    "run_least_squares",
    "run_stepwise_bic",
    "selected",
]


@dataclass(frozen=True, kw_only=True)
class DenseSettings:
    """Settings of the tests."""

    level: float = 0.05
    """Probability of any false name where nothing is missing, shared by all tests."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


def run_least_squares(recording: Path, folder: Path, tolerance: float) -> None:
    """Fit all classical parameters of a recording, test each and write the result.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
    settings = DenseSettings()
    regression = regression_of(recording, tolerance, np.random.default_rng(settings.seed))
    named = named_groups(regression, settings)
    fit = regression.fit(named)
    told = {"tolerance": tolerance, "seed": settings.seed, "level": settings.level}
    write_finding(folder, regression.finding("least_squares", fit, told))


def named_groups(regression: Regression, settings: DenseSettings) -> list[int]:
    """Numbers of the groups that pass both tests in the dense fit."""
    dense = [
        i
        for i, group in enumerate(regression.groups)
        if group.basic and group not in regression.scale
    ]
    fit = regression.fit(dense)
    tested = [k for k, g in enumerate(dense) if not regression.groups[g].tensor]
    level = settings.level / len(tested)
    return [
        dense[k] for k in tested if regression.p_value(fit, k) < level and regression.counts(fit, k)
    ]


@dataclass(frozen=True, kw_only=True)
class StepwiseSettings:
    """Settings of the selection."""

    least_drop: float = 10.0
    """Least drop of the criterion by a group: above 10 the evidence is very strong (Kass and
    Raftery, JASA 1995)."""
    most_groups: int = 15
    """Groups after which selection ends: as many as a whole machine may have."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


def run_stepwise_bic(recording: Path, folder: Path, tolerance: float) -> None:
    """Select effects of a recording stepwise and write the result.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
    settings = StepwiseSettings()
    regression = regression_of(recording, tolerance, np.random.default_rng(settings.seed))
    fit = selected(regression, settings)
    told = {"tolerance": tolerance, "seed": settings.seed}
    write_finding(folder, regression.finding("stepwise_bic", fit, told))


def selected(regression: Regression, settings: StepwiseSettings) -> Fit:
    """Fit of the groups that forward steps with deletions choose."""
    gram = regression.gram()
    search = 2.0 * np.log(sum(not group.tensor for group in regression.groups))
    prices = np.array(
        [
            np.inf if group.tensor else group.width * np.log(regression.independent_rows) + search
            for group in regression.groups
        ]
    )
    fit = regression.fit([], gram)
    while len(fit.chosen) < settings.most_groups:
        drops = regression.gains(fit, gram) / regression.inflation - prices
        best = int(np.argmax(drops))
        if drops[best] < settings.least_drop:
            break
        larger = regression.fit([*fit.chosen, best], gram)
        drop = (fit.objective - larger.objective) / regression.inflation - prices[best]
        if drop < settings.least_drop or not regression.counts(larger, len(fit.chosen)):
            prices[best] = np.inf  # nominal parameters inside the tolerance explain it
            continue
        fit = _without_idle(regression, larger, prices, gram, settings.least_drop)
    return fit


def _without_idle(
    regression: Regression, fit: Fit, prices: np.ndarray, gram: np.ndarray, least_drop: float
) -> Fit:
    """Drop groups, the least useful first, that the others have made superfluous."""
    newest = fit.chosen[-1]
    while len(fit.chosen) > 1:
        smaller = {g: regression.fit(_others(fit.chosen, g), gram) for g in fit.chosen[:-1]}
        worth = {
            g: (own.objective - fit.objective) / regression.inflation - prices[g]
            for g, own in smaller.items()
        }
        if not worth:
            break
        idle = min(worth, key=lambda g: worth[g])
        if worth[idle] >= least_drop:
            break
        fit = smaller[idle]
    assert newest in fit.chosen
    return fit


def _others(chosen: Sequence[int], group: int) -> list[int]:
    return [g for g in chosen if g != group]
