"""Weighted least squares on the inverse-dynamics regressor, with nominal parameters as a prior.

Rows are weighted by the noise of their joint: what the sensors' noise makes of the torque residual
after filtering, or, where a fit of all classical columns leaves more, that (feasible generalised
least squares). Nominal parameters are known within the tolerance: they have columns of their own
with a Gaussian prior inside bounds, and so widen the interval of every effect that resembles them.
The last run is held out. Autocorrelation of the residual divides the number of independent rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg, optimize, stats

from loose_env.gap import NamedEffect
from loose_env.recording import Recording, read_recording
from loose_env.typing import Array
from scripts.suites.gap.rivals.candidates import GridSettings, columns_of
from scripts.suites.gap.rivals.inverse_dynamics import Columns, Group, InverseDynamics
from scripts.suites.gap.rivals.joint_data import (
    FilterSettings,
    JointRun,
    joint_runs,
    noise_replicas,
)
from scripts.suites.gap.rivals.results import Finding

__all__ = ["Fit", "Regression", "RegressionSettings", "regression_of"]

_RIDGE = 1e-10
"""Ridge relative to the diagonal of the normal equations: it only keeps them solvable."""
_RANK = 1e-7
"""Share of a column that has to be left by the others, squared, for it to be a direction."""


@dataclass(frozen=True, kw_only=True)
class RegressionSettings:
    """Settings of the regression."""

    tolerance: float = 0.03
    """Largest relative error of nominal parameters."""
    confidence: float = 0.95
    """Of intervals."""
    longest_lag_s: float = 0.3
    """Longest lag at which autocorrelation of the residual counts [s]."""
    filter: FilterSettings = field(default_factory=FilterSettings)
    grid: GridSettings = field(default_factory=GridSettings)

    @property
    def prior_sd(self) -> float:
        """Prior standard deviation of a relative error within ± tolerance, all equally likely."""
        return float(self.tolerance / np.sqrt(3.0))


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fit of some groups."""

    chosen: tuple[int, ...]
    """Numbers of the groups."""
    coefficients: Array
    """Of nuisances, then of the chosen groups in their order."""
    covariance: Array
    """Of the coefficients, with the autocorrelation of the residual in it."""
    bound: tuple[int, ...]
    """Numbers of the nominal parameters that are on the bound of their tolerance."""
    objective: float
    """Weighted sum of squares, with that of the prior."""


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Rows of all runs; training rows as normal equations in units of weighted residuals."""

    settings: RegressionSettings
    runs: tuple[str, ...]
    groups: tuple[Group, ...]
    nuisances: int
    """Number of nuisance columns, which come first."""
    weights: Array
    """Standard deviation of a row of each joint for the fit, of shape (n,) [N m or N]."""
    noise: Array
    """What of that is the sensors' noise, of shape (n,)."""
    rows: tuple[Array, ...]
    """For each run, of shape (t, n, columns + 1): nuisances, groups, target [N m or N]."""
    rate_hz: float
    """Rate of the rows."""
    driven: bool
    """Whether there are torques."""
    inflation: float = 1.0
    """Rows for each independent one."""

    def span(self, group: int) -> slice:
        """Columns of a group."""
        start = self.nuisances + sum(g.width for g in self.groups[:group])
        return slice(start, start + self.groups[group].width)

    def columns(self, chosen: Sequence[int]) -> Array:
        """Numbers of the nuisance columns and those of the chosen groups."""
        spans = [np.arange(self.nuisances)]
        spans += [np.arange(self.span(g).start, self.span(g).stop) for g in chosen]
        return np.concatenate(spans)

    @property
    def scale(self) -> tuple[Group, ...]:
        """Groups that give the scale of a response without torques, and have to stay nominal.

        Without a torque, an arm without any inertia and friction would fit as well.
        """
        if self.driven:
            return ()
        kinds = ("link_mass", "rotor_inertia")
        return tuple(next(g for g in self.groups if g.kind == kind) for kind in kinds)

    @property
    def training(self) -> tuple[int, ...]:
        """Numbers of the runs that are fitted."""
        return tuple(range(max(1, len(self.rows) - 1)))

    def gram(self, runs: Sequence[int] | None = None) -> Array:
        """Normal equations of some runs with the prior: training runs by default."""
        which = self.training if runs is None else runs
        total = np.zeros((self.rows[0].shape[-1],) * 2)
        for i in which:
            flat = (self.rows[i] / self.weights[:, None]).reshape(-1, total.shape[0])
            total += flat.T @ flat
        own = np.arange(self.nuisances)
        total[own, own] += 1.0 / self.settings.prior_sd**2
        return total

    @property
    def independent_rows(self) -> float:
        """Number of independent training rows."""
        count = sum(self.rows[i].shape[0] * self.rows[i].shape[1] for i in self.training)
        return float(count / self.inflation)

    def fit(self, chosen: Sequence[int], gram: Array | None = None) -> Fit:
        """Fit some groups beside the nominal parameters, which stay within the tolerance."""
        gram = self.gram() if gram is None else gram
        at = self.columns(chosen)
        inner, right = gram[np.ix_(at, at)], gram[at, -1]
        scale = np.sqrt(np.diag(inner))
        scale[scale == 0] = 1.0
        factor = linalg.cholesky(
            inner / np.outer(scale, scale) + _RIDGE * np.eye(len(at)), check_finite=False
        )
        limits = np.full(len(at), np.inf)
        limits[: self.nuisances] = self.settings.tolerance * scale[: self.nuisances]
        wanted = linalg.solve_triangular(factor, right / scale, trans="T")
        values = linalg.solve_triangular(factor, wanted)
        bound = np.zeros(len(at), dtype=bool)
        if (np.abs(values) > limits).any():
            solved = optimize.lsq_linear(factor, wanted, (-limits, limits), method="bvls")
            values, bound = solved.x, solved.active_mask != 0
        inverse = np.zeros_like(inner)
        free = np.flatnonzero(~bound)
        inverse[np.ix_(free, free)] = linalg.inv((factor.T @ factor)[np.ix_(free, free)])
        values, inverse = values / scale, inverse / np.outer(scale, scale)
        return Fit(
            chosen=tuple(chosen),
            coefficients=values,
            covariance=inverse * self.inflation,
            bound=tuple(map(int, np.flatnonzero(bound))),
            objective=float(gram[-1, -1] - 2 * right @ values + values @ inner @ values),
        )

    def gains(self, fit: Fit, gram: Array | None = None) -> Array:
        """What each group takes off the objective when it joins a fit, of shape (groups,).

        Nominal parameters that are on their bound stay there. An effect that would have the wrong
        sign, or be too large for its columns, takes nothing off.
        """
        gram = self.gram() if gram is None else gram
        at = self.columns(fit.chosen)
        bound = list(fit.bound)
        fixed, own = at[bound], np.delete(at, bound)
        target = gram[:, -1] - gram[:, fixed] @ fit.coefficients[bound]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inner = gram[np.ix_(own, own)] / np.outer(scale[own], scale[own])
        factor = linalg.cho_factor(inner + _RIDGE * np.eye(len(own)))
        cross = gram[own] / scale[own][:, None]
        solved = linalg.cho_solve(factor, np.column_stack((cross, target[own] / scale[own])))
        left = target - cross.T @ solved[:, -1]
        gains = np.zeros(len(self.groups))
        for g in range(len(self.groups)):
            if g in fit.chosen:
                continue
            span = self.span(g)
            size = scale[span]
            schur = gram[span, span] - cross[:, span].T @ solved[:, span]
            inverse = linalg.pinvh(schur / np.outer(size, size), rtol=_RANK, atol=_RANK)
            values = inverse @ (left[span] / size)
            if self._possible(self.groups[g], values / size):
                gains[g] = (left[span] / size) @ values
        return gains

    @staticmethod
    def _possible(group: Group, values: Array) -> bool:
        right_sign = not group.positive or values[0] > 0.0
        return bool(right_sign and np.all(np.abs(values) <= group.largest))

    def counts(self, fit: Fit, position: int) -> bool:
        """Whether an effect is possible and beyond what the tolerance of the model allows."""
        group, values = self.groups[fit.chosen[position]], fit.coefficients
        own = values[self.within(fit, position)]
        allowed = self.settings.tolerance * group.nominal + group.least
        return self._possible(group, own) and bool(np.abs(own[0]) > allowed)

    def residual(self, fit: Fit, run: int) -> Array:
        """Residual torque of a run, of shape (t, n) [N m or N]."""
        rows = self.rows[run]
        return np.asarray(rows[..., -1] - rows[..., self.columns(fit.chosen)] @ fit.coefficients)

    def held_out(self, fit: Fit) -> float:
        """Root mean square of the held-out run's residual [noise sd]."""
        return float(np.sqrt(np.mean((self.residual(fit, -1) / self.noise) ** 2)))

    def wald(self, fit: Fit, position: int) -> tuple[float, int]:
        """Wald statistic of the group at a position among the chosen ones, and its rank."""
        at = self.within(fit, position)
        values, covariance = fit.coefficients[at], fit.covariance[at, at]
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        inverse = linalg.pinvh(covariance / np.outer(scale, scale), rtol=1e-8)
        return float(values / scale @ inverse @ (values / scale)), len(values)

    def p_value(self, fit: Fit, position: int) -> float:
        """Probability of so large a Wald statistic without the effect."""
        return float(stats.chi2.sf(*self.wald(fit, position)))

    def effect(self, fit: Fit, position: int) -> NamedEffect:
        """Effect at a position among the chosen ones; intervals by the delta method."""
        group, at = self.groups[fit.chosen[position]], self.within(fit, position)
        values, covariance = fit.coefficients[at], fit.covariance[at, at]
        parameters = group.read(values)
        z = float(stats.norm.ppf(0.5 + 0.5 * self.settings.confidence))
        slopes = {name: np.zeros(len(values)) for name in parameters}
        for i, sd in enumerate(np.sqrt(np.diag(covariance))):
            step = 1e-3 * sd + 1e-12
            up, down = (group.read(values + sign * step * _unit(i, values)) for sign in (1, -1))
            for name in parameters:
                slopes[name][i] = (up[name] - down[name]) / (2 * step)
        intervals = {}
        for name, slope in slopes.items():
            half = z * float(np.sqrt(slope @ covariance @ slope))
            if half > 0:
                intervals[name] = (parameters[name] - half, parameters[name] + half)
        return NamedEffect(
            kind=group.kind,
            where=group.where,
            parameters=parameters,
            interval_95=intervals,
            in_model=False,
        )

    def within(self, fit: Fit, position: int) -> slice:
        """Coefficients of the group at a position among the chosen ones."""
        widths = [self.groups[g].width for g in fit.chosen]
        start = self.nuisances + sum(widths[:position])
        return slice(start, start + widths[position])

    def finding(self, method: str, fit: Fit, settings: Mapping[str, Any]) -> Finding:
        """What a method found: the groups of a fit, beside the fit of none."""
        return Finding(
            method=method,
            before=self.held_out(self.fit([])),
            after=self.held_out(fit),
            held_out=self.runs[-1],
            effects=[self.effect(fit, i) for i in range(len(fit.chosen))],
            settings=settings,
        )


def _unit(i: int, like: Array) -> Array:
    out = np.zeros_like(like)
    out[i] = 1.0
    return out


def regression_of(
    folder: Path, tolerance: float, rng: np.random.Generator, **options: object
) -> Regression:
    """Read a recording and set up its regression.

    Parameters
    ----------
    folder : Path
        Folder of the recording.
    tolerance : float
        Largest relative error of the nominal parameters.
    rng : numpy.random.Generator
        Source of the noise replica by which the residual's noise is measured.
    options
        Further fields of `RegressionSettings`.
    """
    settings = RegressionSettings(tolerance=tolerance, **options)  # type: ignore[arg-type]
    recording = read_recording(folder)
    runs = joint_runs(recording, settings.filter)
    columns = [columns_of(recording, run, settings.grid) for run in runs]
    noise = _noise(recording, runs, columns, settings, rng)
    rows = tuple(
        np.concatenate((c.nuisance, c.candidates, c.target[..., None]), axis=-1) for c in columns
    )
    low_pass = runs[0].low_pass
    first = Regression(
        settings=settings,
        runs=tuple(run.name for run in runs),
        groups=columns[0].groups,
        nuisances=len(columns[0].nuisances),
        weights=noise,
        noise=noise,
        rows=rows,
        rate_hz=low_pass.rate_hz / low_pass.stride,
        driven=any(bool(run.torque.any()) for run in runs),
    )
    return _reweighted(first)


def _noise(
    recording: Recording,
    runs: tuple[JointRun, ...],
    columns: Sequence[Columns],
    settings: RegressionSettings,
    rng: np.random.Generator,
) -> Array:
    """Noise of the residual torque of each joint, of shape (n,)."""
    dynamics, total, count = InverseDynamics(recording=recording), 0.0, 0
    for own, replica in zip(columns, noise_replicas(recording, runs, rng), strict=True):
        target = replica.low_pass.reduced(replica.torque) - dynamics.torque(replica.motion())
        total = total + np.sum((target - own.target) ** 2, axis=0)
        count += len(target)
    return np.asarray(np.sqrt(total / count))


def _reweighted(first: Regression) -> Regression:
    """Weights and autocorrelation from what a fit of all groups outside grids leaves."""
    # without torques the whole regressor would fit any motion by an arm of no inertia
    fit = first.fit(
        [i for i, g in enumerate(first.groups) if not g.grid and not g.tensor] * first.driven
    )
    residuals = [first.residual(fit, i) for i in first.training]
    left = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    weights = np.maximum(first.noise, left) if first.driven else first.noise
    lags = round(first.settings.longest_lag_s * first.rate_hz)
    inflation = _inflation([r / weights for r in residuals], lags)
    return dataclasses.replace(first, weights=weights, inflation=inflation)


def _inflation(residuals: Sequence[Array], lags: int) -> float:
    """Rows for each independent one: 1 + 2 sum of autocorrelations up to the first below zero."""
    total = sum(float(np.sum(r * r)) for r in residuals)
    inflation = 1.0
    for lag in range(1, lags + 1):
        share = sum(float(np.sum(r[lag:] * r[:-lag])) for r in residuals) / total
        if share <= 0.0:
            break
        inflation += 2.0 * share
    return inflation
