"""Bounded Gauss-Newton fit of a hypothesis (Fit), with settings, cost and Jacobian by simulation.

Each iteration is two batches: one for the sensitivities, one for several step lengths at once. The
bounded linear least-squares problem is solved by scipy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.model_structure import ModelStructure, prior_of
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.parameter import Parameter, free_of
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.simulation.applied_torque_terms import has_terms
from loose_env.inference import bounded_step
from loose_env.typing import Array

_AT_ONCE = 8
"""Degrees of freedom of a hypothesis, over all runs, up to which stepping them from Python takes
longer than simulating them."""
_NONE, _NEW, _ALL = 0, 1, 2
"""Which sensitivities are worked out (anew): none, those not known beforehand, all."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of the Gauss-Newton fit."""

    iterations: int = 16
    """Most Gauss-Newton steps."""
    cost_tolerance: float = 1e-3
    """Share of the cost below which a further step is not worth its simulations."""
    finite_difference_step: float = 0.002
    """Step of the sensitivities, in free units. Figures that nearly cancel one another leave a
    valley, which differences over longer steps bar: what bends in each of them does not cancel."""
    min_gain_ratio: float = 0.7
    """Share of the promised gain below which sensitivities are worked out anew."""
    relinearise_below: float = 0.5
    """Share of the cost at which sensitivities were worked out below which a fit does not end by
    them: from far off they see no valley."""
    levenberg_dampings: tuple[float, ...] = (0.0, 0.1, 3.0)
    """Levenberg's dampings, as shares of the curvature; those after the first are tried where its
    step does not bring what it promises."""
    comparison_tolerance: float = 0.05
    """Share of the cost beyond that of a better fit, below which a further step is not worth its
    simulations where the two are only compared."""
    backtracking: tuple[float, ...] = (0.3, 0.1, 0.03)
    """Shares of the damped steps that are tried where none of the whole steps is any good."""


STOP_FIT_SETTINGS = FitSettings(
    iterations=8, cost_tolerance=3e-3, finite_difference_step=0.02, relinearise_below=0.0
)
"""How parts with stops, and what stands beside them, are fitted: a simulation takes three times as
long, and the law of stops is never that of the machine to the last per mille. Sensitivities are
taken over longer steps, for an impact that is just missed makes short ones jump; for the same
reason fresh ones are no better at the end than those from afar."""


def fit_settings_for(structure: ModelStructure) -> FitSettings:
    """Return the fit settings for a model structure."""
    return STOP_FIT_SETTINGS if have_stops(structure.effects) else FitSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A hypothesis with its best-fit parameters."""

    structure: ModelStructure
    """The unknown parameters."""
    free: Array
    """Free numbers (P,)."""
    residual: Array
    """Measured less predicted, in noise standard deviations (N,)."""
    jacobian: Array
    """Change of the residual with the free numbers (N, P)."""
    cost: float
    """Cost: sum of squares of the residual, and of the deviations from priors."""

    @property
    def hypothesis(self) -> Hypothesis:
        """The hypothesis at the fitted values."""
        return self.structure.hypothesis(self.free)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of the hypothesis, without the nuisance parameters."""
        return self.structure.effects

    @property
    def bare(self) -> Fit:
        """The same without its sensitivities, which take most of the memory."""
        return replace(self, jacobian=np.zeros((0, len(self.free))))

    @property
    def rms(self) -> float:
        """Root mean square residual, in noise standard deviations."""
        return float(np.sqrt(np.mean(self.residual**2)))


def sensitivities(
    comparison: ResidualModel,
    structure: ModelStructure,
    free: Array,
    residual: Array,
    which: Sequence[int],
    *,
    difference: float = FitSettings.finite_difference_step,
) -> Array:
    """Jacobian of the residual in some free numbers (N, len(which)); inward at bounds."""
    known = _of_initial_states(comparison, structure, free, residual, which)
    rest = [k for k in which if k not in known]
    known |= _differences(comparison, structure, free, residual, rest, difference)
    return np.stack([known[k] for k in which], axis=1)


def _differences(
    comparison: ResidualModel,
    structure: ModelStructure,
    free: Array,
    residual: Array,
    which: Sequence[int],
    difference: float,
) -> dict[int, Array]:
    """Derivatives of the residual (N,) by free number; finite differences in bounds."""
    parameters = structure.parameters
    tried, steps = [], []
    for k in which:
        moved = free.copy()
        low, high = parameters[k].bounds
        step = difference if moved[k] + difference <= high else -difference
        moved[k] = np.clip(moved[k] + step, low, high)
        steps.append(moved[k] - free[k])
        tried.append(structure.hypothesis(moved))
    if not tried:
        return {}
    found = comparison.residuals(tried)
    found -= residual
    found /= np.array(steps)[:, None]
    return dict(zip(which, found, strict=True))


def _of_initial_states(
    comparison: ResidualModel,
    structure: ModelStructure,
    free: Array,
    residual: Array,
    which: Sequence[int],
) -> dict[int, Array]:
    """Derivatives of the residual in the parameters of initial states (N,), by index."""
    initial = structure.nuisance.initial
    own = [k for k in which if k < structure.nuisance.initial_slice.stop]
    if initial is None or not own:
        return {}
    columns = initial.sensitivities(comparison, structure.hypothesis(free), residual)
    return {k: columns[:, k] for k in own}


def cost_of(residual: Array, free: Array, parameters: Sequence[Parameter]) -> float:
    """Sum of squares, priors included."""
    centres, weights = prior_of(parameters)
    return float(residual @ residual + np.sum((weights * (free - centres)) ** 2))


def fit(
    comparison: ResidualModel,
    structure: ModelStructure,
    start: Array,
    *,
    settings: FitSettings | None = None,
    known: Array | None = None,
    residual: Array | None = None,
    reference: float = np.inf,
) -> Fit:
    """Fit a hypothesis."""
    settings = settings or fit_settings_for(structure)
    parameters = structure.parameters
    low, high = np.array([p.bounds for p in parameters]).T.reshape(2, -1)
    free = np.clip(start, low, high)
    if residual is None:
        residual = comparison.residuals([structure.hypothesis(free)])[0]
    cost = cost_of(residual, free, parameters)
    held = 0 if known is None else known.shape[1]
    # Nominal parameters move within their tolerance only: known sensitivities of these are not
    # recomputed.
    kept = structure.nuisance.nominal_slice if held else slice(0, 0)
    again = [k for k in range(len(parameters)) if not kept.start <= k < kept.stop]
    jacobian = np.zeros((len(residual), len(parameters)))
    if known is not None:
        jacobian[:, :held] = known
    count = len(parameters)
    first = _NEW if held < count else _NONE
    renew, seen_at = first, cost
    title = f"fit of {count} parameters, steps"
    for _ in counted(title, range(settings.iterations), most=True):
        which = {_NONE: [], _NEW: list(range(held, count)), _ALL: again}[renew]
        if len(which) == len(again):
            seen_at = cost
        if which:
            jacobian[:, which] = sensitivities(
                comparison,
                structure,
                free,
                residual,
                which,
                difference=settings.finite_difference_step,
            )
        dampings = settings.levenberg_dampings
        steps = _damped_steps(jacobian, residual, free, parameters, dampings)
        # far from the optimum the gradient gives the direction and not the distance
        short = [share * long for long in steps[1:] for share in settings.backtracking if which]
        best_of = _tries(comparison, structure, free, (steps[:1], steps[1:], short))
        step, left, after = best_of(0)
        hoped = cost - cost_of(residual + jacobian @ step, free + step, parameters)
        if (
            cost - after < settings.min_gain_ratio * hoped
            and hoped >= settings.cost_tolerance * cost
        ):
            damped = best_of(1)
            step, left, after = min((step, left, after), damped, key=lambda found: found[2])
            hoped = cost - cost_of(residual + jacobian @ step, free + step, parameters)
        if which and cost - after < settings.cost_tolerance * cost <= hoped:
            shortened = best_of(2)
            step, left, after = min((step, left, after), shortened, key=lambda found: found[2])
        gained = cost - after
        if gained > 0:
            free, residual, cost = free + step, left, after
        if max(gained, hoped) < settings.comparison_tolerance * (cost - reference):
            break
        if gained < settings.cost_tolerance * cost:
            if cost < settings.relinearise_below * seen_at:
                renew = _ALL
            elif which or hoped < settings.cost_tolerance * cost:
                break
            else:
                renew = first or _ALL
        elif gained < settings.min_gain_ratio * hoped:
            renew = _ALL if which else first or _ALL  # the old sensitivities are inaccurate
        else:
            renew = _NONE
    return Fit(structure=structure, free=free, residual=residual, jacobian=jacobian, cost=cost)


def _tries(
    comparison: ResidualModel,
    structure: ModelStructure,
    free: Array,
    groups: Sequence[Sequence[Array]],
) -> Callable[[int], tuple[Array, Array, float]]:
    """Return a function that gives the best step of a group, with its residual and cost.

    A small simulation that is stepped from Python costs by its steps and hardly by how many run
    side by side: there the groups are simulated at once, else each when it is asked for.
    """
    steps = [step for group in groups for step in group]
    hypotheses = [structure.hypothesis(free + step) for step in steps]
    ends = np.cumsum([0, *map(len, groups)])
    side_by_side = len(comparison.trials) * comparison.machine.model.nv
    at_once = side_by_side <= _AT_ONCE and has_terms(structure.hypothesis(free))
    whole = comparison.residuals(hypotheses) if at_once else None

    def best_of(group: int) -> tuple[Array, Array, float]:
        own = slice(ends[group], ends[group + 1])
        found = comparison.residuals(hypotheses[own]) if whole is None else whole[own]
        costs = [
            cost_of(residual, free + step, structure.parameters)
            for residual, step in zip(found, steps[own], strict=True)
        ]
        best = int(np.argmin(costs))
        return steps[own][best], found[best], costs[best]

    return best_of


def step_of(
    jacobian: Array, residual: Array, free: Array, parameters: Sequence[Parameter]
) -> Array:
    """Bounded step that minimises the linearised cost (P,)."""
    return _damped_steps(jacobian, residual, free, parameters, (0.0,))[0]


def _damped_steps(
    jacobian: Array,
    residual: Array,
    free: Array,
    parameters: Sequence[Parameter],
    dampings: Sequence[float],
) -> list[Array]:
    """Bounded steps that minimise the linearised cost with Levenberg's dampings, (P,) each."""
    centres, weights = prior_of(parameters)
    curvature = jacobian.T @ jacobian + np.diag(weights**2)
    slope = jacobian.T @ residual + weights**2 * (free - centres)
    low, high = np.array([p.bounds for p in parameters]).T.reshape(2, -1)
    room = np.minimum(low - free, 0.0), np.maximum(high - free, 0.0)
    return [
        np.clip(free + bounded_step(curvature, slope, *room, damping=damping), low, high) - free
        for damping in dampings
    ]


def started(fitted: Fit, effect: Effect, values: Sequence[float]) -> Array:
    """Free numbers of a fit with one more effect (P + p,)."""
    return np.concatenate([fitted.free, free_of(effect.parameters, np.array(values))])
