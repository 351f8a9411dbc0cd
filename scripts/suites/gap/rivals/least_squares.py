"""Dense least squares on the inverse-dynamics regressor, named by tests of each parameter.

The textbook's identification of a robot: mass, centre of mass and inertia tensor of every link,
rotor inertia, Coulomb and viscous friction and a spring with an offset at every joint are all
fitted at once. A group of coefficients is named where its Wald test rejects zero at a level divided
by the number of tests (Bonferroni) and where it is larger than the tolerance told allows. The
named groups are fitted again without the others, whose scatter would spoil the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scripts.suites.gap.rivals.regression import Regression, regression_of
from scripts.suites.gap.rivals.results import Finding, write_finding

__all__ = ["DenseSettings", "named_groups", "run_least_squares"]


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
    write_finding(
        folder,
        Finding(
            method="least_squares",
            before=regression.held_out(regression.fit([])),
            after=regression.held_out(fit),
            held_out=regression.runs[-1],
            effects=[regression.effect(fit, i) for i in range(len(named))],
            settings={"tolerance": tolerance, "seed": settings.seed, "level": settings.level},
        ),
    )


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
