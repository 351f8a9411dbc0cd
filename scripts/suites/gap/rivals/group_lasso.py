"""Group lasso on the inverse-dynamics regressor, its penalty chosen by cross-validation over runs.

Each candidate effect is one group of `skglm.GroupLasso`; nominal parameters are taken out of target
and columns beforehand, with their prior (Frisch, Waugh and Lovell). Each training run is left out
once; the largest penalty within one standard error of the least error is taken (Hastie, Tibshirani
and Friedman). The chosen groups are fitted again without penalty (relaxed lasso), and those go that
a Wald test with Bonferroni's level does not keep, the least significant first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg

from loose_env.typing import Array
from scripts.suites.gap.rivals.regression import Fit, Regression, regression_of
from scripts.suites.gap.rivals.results import write_finding

__all__ = ["LassoSettings", "kept", "run_group_lasso", "selected_groups"]


@dataclass(frozen=True, kw_only=True)
class LassoSettings:
    """Settings of the path and of the tests after it."""

    penalties: int = 15
    """Penalties on the path, spaced evenly in their logarithm."""
    least_penalty: float = 1e-3
    """Least penalty over the one that empties the model."""
    tol: float = 1e-3
    """Stopping tolerance of the solver, over the largest gradient at zero."""
    level: float = 0.05
    """Level of the tests after the refit, shared by all candidate groups."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """Least squares of candidates alone, in as few rows as columns, each column of length one."""

    columns: Array
    target: Array
    scale: Array
    rows: float


def run_group_lasso(recording: Path, folder: Path, tolerance: float) -> None:
    """Select effects of a recording by the group lasso and write the result.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
    settings = LassoSettings()
    regression = regression_of(recording, tolerance, np.random.default_rng(settings.seed))
    fit = kept(regression, selected_groups(regression, settings), settings)
    told = {"tolerance": tolerance, "seed": settings.seed}
    write_finding(folder, regression.finding("group_lasso", fit, told))


def selected_groups(regression: Regression, settings: LassoSettings) -> list[int]:
    """Numbers of the groups that are not zero at the penalty of cross-validation."""
    candidates = [i for i, group in enumerate(regression.groups) if not group.tensor]
    whole = _problem(regression, candidates, regression.training)
    largest = _emptying(regression, candidates, whole)
    path = largest * np.geomspace(1.0, settings.least_penalty, settings.penalties)
    errors = []
    for left_out in regression.training:
        others = [i for i in regression.training if i != left_out]
        if not others:
            continue
        problem = _problem(regression, candidates, others)
        found = _path(regression, candidates, problem, path, settings)
        errors.append(
            [_error(regression, candidates, values, others, left_out) for values in found]
        )
    best = _one_standard_error(np.array(errors)) if len(errors) > 1 else len(path) // 2
    values = _path(regression, candidates, whole, path[: best + 1], settings)[-1]
    spans = _spans(regression, candidates)
    return [g for g, span in zip(candidates, spans, strict=True) if np.any(values[span])]


def kept(regression: Regression, groups: Sequence[int], settings: LassoSettings) -> Fit:
    """Fit of those groups that stay significant in each other's presence."""
    level = settings.level / sum(not group.tensor for group in regression.groups)
    gram = regression.gram()
    fit = regression.fit(groups, gram)
    while fit.chosen:
        values = [regression.p_value(fit, k) for k in range(len(fit.chosen))]
        wrong = [not regression.counts(fit, k) for k in range(len(fit.chosen))]
        order = sorted(range(len(values)), key=lambda k: (wrong[k], values[k]))
        worst = order[-1]
        if values[worst] < level and not wrong[worst]:
            break
        fit = regression.fit([g for k, g in enumerate(fit.chosen) if k != worst], gram)
    return fit


def _spans(regression: Regression, candidates: Sequence[int]) -> list[slice]:
    ends = np.cumsum([regression.groups[g].width for g in candidates])
    widths = [regression.groups[g].width for g in candidates]
    return [slice(int(e) - w, int(e)) for e, w in zip(ends, widths, strict=True)]


def _problem(regression: Regression, candidates: Sequence[int], runs: Sequence[int]) -> _Problem:
    """Candidates and target with the nominal parameters taken out, from the normal equations."""
    gram = regression.gram(runs)
    own = regression.columns(candidates)[regression.nuisances :]
    at = np.append(own, gram.shape[0] - 1)
    inner = slice(0, regression.nuisances)
    solved = linalg.solve(gram[inner, inner], gram[inner][:, at], assume_a="pos")
    left = gram[np.ix_(at, at)] - gram[at][:, inner] @ solved
    scale = np.sqrt(np.maximum(np.diag(left), 1e-300))
    unit = left / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (unit + unit.T))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return _Problem(
        columns=np.asfortranarray(root[:, :-1]),
        target=root[:, -1] * scale[-1],
        scale=scale[:-1],
        rows=float(len(root)),
    )


def _emptying(regression: Regression, candidates: Sequence[int], problem: _Problem) -> float:
    """Least penalty at which no group is left."""
    slope = problem.columns.T @ problem.target / problem.rows
    return max(
        float(np.linalg.norm(slope[span]) / np.sqrt(span.stop - span.start))
        for span in _spans(regression, candidates)
    )


def _path(
    regression: Regression,
    candidates: Sequence[int],
    problem: _Problem,
    path: Array,
    settings: LassoSettings,
) -> list[Array]:
    """Coefficients at each penalty, in the units of the regressor."""
    package: Any = import_module("skglm")
    widths = [regression.groups[g].width for g in candidates]
    model = package.GroupLasso(
        groups=widths,
        weights=np.sqrt(np.array(widths, dtype=float)),
        fit_intercept=False,
        warm_start=True,
        tol=settings.tol * float(path[0]),
    )
    found = []
    for penalty in path:
        model.alpha = float(penalty)
        model.fit(problem.columns, problem.target)
        found.append(np.ravel(model.coef_).copy() / problem.scale)
    return found


def _error(
    regression: Regression,
    candidates: Sequence[int],
    values: Array,
    others: Sequence[int],
    left_out: int,
) -> float:
    """Mean square error on the run left out, nominal parameters fitted to the others."""
    gram = regression.gram(others)
    own = regression.columns(candidates)[regression.nuisances :]
    inner = slice(0, regression.nuisances)
    right = gram[inner, -1] - gram[inner][:, own] @ values
    nominal = linalg.solve(gram[inner, inner], right, assume_a="pos")
    rows = regression.rows[left_out]
    residual = rows[..., -1] - rows[..., inner] @ nominal - rows[..., own] @ values
    return float(np.mean((residual / regression.weights) ** 2))


def _one_standard_error(errors: Array) -> int:
    """Position of the largest penalty within one standard error of the best."""
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    # runs differ in how hard they are; what counts is the difference to the best penalty
    excess = errors - errors[:, [best]]
    error = excess.std(axis=0, ddof=1) / np.sqrt(len(errors))
    return int(np.flatnonzero(excess.mean(axis=0) <= error)[0])
