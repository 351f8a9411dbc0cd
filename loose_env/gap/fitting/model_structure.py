"""Parameter vector of a hypothesis: nuisance parameters with their priors, then its effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from loose_env.gap.fitting.initial_state import InitialStates
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_parameters import NominalParameters
from loose_env.gap.model.parameter import Parameter, free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Nuisance:
    """Nuisance parameters: fitted with every hypothesis, and never identified as an effect."""

    initial: InitialStates | None = None
    """Initial states of the runs that begin in motion; None where all begin at rest."""
    nominal: NominalParameters | None = None
    """Uncertain parameters of the nominal model."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Initial states first, then the nominal parameters."""
        return (
            *(() if self.initial is None else self.initial.parameters),
            *(() if self.nominal is None else self.nominal.parameters),
        )

    @property
    def initial_slice(self) -> slice:
        """Slice of the initial states in the parameter vector."""
        return slice(0, 0 if self.initial is None else len(self.initial.parameters))

    @property
    def nominal_slice(self) -> slice:
        """Slice of the nominal parameters in the parameter vector."""
        return slice(self.initial_slice.stop, len(self.parameters))


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelStructure:
    """Unknown parameters of a hypothesis: nuisance parameters, then those of its effects.

    The parameter vector holds free numbers (P,), each parameter on its own scale
    (`loose_env.gap.model.parameter.Parameter.free`).
    """

    nuisance: Nuisance = Nuisance()
    """Fitted with every hypothesis."""
    effects: tuple[Effect, ...] = ()
    """In the order in which they act."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of the vector."""
        return (*self.nuisance.parameters, *(p for e in self.effects for p in e.parameters))

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slice of each effect's parameters in the vector."""
        first = len(self.nuisance.parameters)
        ends = np.cumsum([first, *(len(effect.parameters) for effect in self.effects)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    @property
    def nominal_start(self) -> Array:
        """Free numbers of the nuisance parameters at their nominal values."""
        centres = np.array([p.centre for p in self.nuisance.parameters], dtype=float)
        return free_of(self.nuisance.parameters, centres)

    def slice_of(self, effect: Effect) -> slice:
        """Slice of one effect's parameters in the vector; that very object is looked up."""
        return next(
            own for each, own in zip(self.effects, self.slices, strict=True) if each is effect
        )

    def with_effects(self, effects: Sequence[Effect]) -> ModelStructure:
        """Copy with other effects, and the same nuisance parameters."""
        return replace(self, effects=tuple(effects))

    def plus(self, *effects: Effect) -> ModelStructure:
        """Copy with further effects."""
        return self.with_effects((*self.effects, *effects))

    def hypothesis(self, free: Array) -> Hypothesis:
        """Return the hypothesis with the values of free numbers (P,)."""
        nuisance, position, speed = self.nuisance, None, None
        if nuisance.initial is not None:
            own = nuisance.initial_slice
            offsets = values_of(nuisance.initial.parameters, free[own])
            position, speed = nuisance.initial.offsets(offsets)
        factors = np.empty(0)
        if nuisance.nominal is not None:
            factors = values_of(nuisance.nominal.parameters, free[nuisance.nominal_slice])
        return Hypothesis(
            effects=self.effects,
            values=tuple(
                values_of(effect.parameters, free[own])
                for effect, own in zip(self.effects, self.slices, strict=True)
            ),
            nominal=nuisance.nominal,
            factors=factors,
            position=position,
            speed=speed,
        )


def nuisance_of(comparison: ResidualModel, *, tolerance: float) -> Nuisance:
    """Nuisance parameters of some runs."""
    driven = any(trial.form == "forward" for trial in comparison.trials)
    return Nuisance(
        initial=initial_states_of(comparison),
        nominal=NominalParameters(comparison.machine, tolerance=tolerance, drives=driven),
    )


def initial_states_of(comparison: ResidualModel) -> InitialStates | None:
    """Initial states of the runs that begin in motion; None where all begin at rest."""
    initial = InitialStates(comparison.machine, comparison.trials, comparison.channels)
    return initial if initial.moving else None


def prior_of(parameters: Sequence[Parameter]) -> tuple[Array, Array]:
    """Prior means and weights of the free numbers (P,), weight 0 without a prior."""
    centres = [0.0 if p.centre is None else p.free(p.centre) for p in parameters]
    weights = [0.0 if p.spread is None else 1.0 / p.spread for p in parameters]
    return np.array(centres), np.array(weights)
