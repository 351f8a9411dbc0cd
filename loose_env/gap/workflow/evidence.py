"""Diagnostics of a finished search: location, horizons, whiteness and identifiability."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from loose_env.gap.diagnostics.experiment_advice import identifiability_words
from loose_env.gap.diagnostics.feature_localisation import (
    StruckChannel,
    struck_channels,
    struck_left,
)
from loose_env.gap.diagnostics.identifiability import identifiability
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import locate
from loose_env.gap.diagnostics.prediction_horizon import HorizonError, horizon_errors
from loose_env.gap.diagnostics.remaining_error import left_motions
from loose_env.gap.diagnostics.residual_tests import left_over
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.output.evidence_schema import Identifiability, LeftOver, Location
from loose_env.gap.output.export_check import Exported, exported
from loose_env.gap.preparation.integrator_choice import corrected_step_words
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.typing import Array

__all__ = ["Evidence", "gather"]

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Evidence shown beside the verdict of a comparison."""

    motions_held: tuple[JointMotion, ...] = ()
    """Residual size on the held-out runs."""
    location: Location = field(default_factory=Location)
    """Localised residual of the nominal model, on all runs."""
    before: tuple[HorizonError, ...] = ()
    """Open-loop errors of the nominal model on the held-out runs."""
    after: tuple[HorizonError, ...] = ()
    """Open-loop errors of the corrected model."""
    left_over: tuple[LeftOver, ...] = ()
    """Residual tests on the held-out runs."""
    left_location: Location = field(default_factory=Location)
    """Localised residual of the corrected model."""
    struck_before: tuple[StruckChannel, ...] = ()
    """Of the nominal model: channels of held-out runs that are compared by features."""
    struck_after: tuple[StruckChannel, ...] = ()
    """The same for the corrected model."""
    identifiability: Identifiability = field(default_factory=Identifiability)
    """Effects that the motions could not show, or distinguish."""
    exported: Exported = field(default_factory=Exported)
    """Export form of the corrected model."""
    warnings: tuple[str, ...] = ()
    """Notes found along the way."""


def gather(solution: GapSolution, *, say: Say = lambda _: None) -> Evidence:
    """Localise the residual, compute open-loop errors, and test for whiteness."""
    say("where the gap is")
    problem, base, best = solution.problem, solution.base, solution.best
    machine, motions, struck = _fitted_nominal(solution), {}, {}
    before, corrected, held = solution.nominal, solution.corrected, problem.whole_held
    for name, comparison in (("fit", problem.fit), ("held", held)):
        motions[name] = tuple(
            joint_motion(machine, trial, comparison.channels, comparison.floors)
            for trial in comparison.trials
        )
        struck[name] = struck_channels(comparison, before, motions[name])
    struck_after = struck_channels(held, corrected, motions["held"])
    parts = [
        _located(problem.fit, base.fitted.residual, motions["fit"]),
        _located(held, base.held_residual, motions["held"]),
    ]
    left = [
        _left(solution, comparison, residual, motions[name])
        for name, comparison, residual in (
            ("fit", problem.fit, best.fitted.residual),
            ("held", held, best.held_residual),
        )
    ]
    struck_fit = struck_channels(problem.fit, corrected, motions["fit"])
    say("open-loop errors by horizon")
    errors = [
        horizon_errors(
            problem.machine,
            held.trials,
            held.channels,
            held.floors,
            hypothesis,
            threads=problem.settings.threads,
        )
        for hypothesis in (before, corrected)
    ]
    say("what these motions can show")
    kinds = problem.settings.kinds or None
    shown = identifiability(problem.fit, best.fitted, candidates(problem.machine, kinds))
    own = exported(held, corrected, best.held_residual)
    say("tests of what is left")
    return Evidence(
        motions_held=motions["held"],
        location=Location(
            channels=(
                *(gap for part in parts for gap in part.channels),
                *(each.gap for many in struck.values() for each in many),
            ),
            joints=tuple(gap for part in parts for gap in part.joints),
        ),
        before=errors[0],
        after=errors[1],
        left_over=(
            *left_over(best.held_residual, held.rows, held.trials, held.channels, motions["held"]),
            *struck_left(struck_after),
        ),
        left_location=Location(
            channels=(
                *(gap for part in left for gap in part.channels),
                *(each.gap for each in (*struck_fit, *struck_after)),
            ),
            joints=tuple(gap for part in left for gap in part.joints),
        ),
        struck_before=tuple(struck["held"]),
        struck_after=tuple(struck_after),
        identifiability=shown,
        exported=own,
        warnings=(
            *corrected_step_words(held, corrected),
            *own.words(),
            *identifiability_words(shown),
        ),
    )


def _fitted_nominal(solution: GapSolution) -> Machine:
    """Return the nominal model with its parameters fitted within the tolerance."""
    machine = solution.problem.machine
    spec = machine.spec.copy()
    solution.nominal.edit(spec)
    return replace(machine, spec=spec)


def _located(comparison: Comparison, residual: Array, motions: Sequence[JointMotion]) -> Location:
    return locate(residual, comparison.rows, comparison.trials, comparison.channels, motions)


def _left(
    solution: GapSolution, comparison: Comparison, residual: Array, motions: Sequence[JointMotion]
) -> Location:
    """Localised residual of the corrected model; torques only where these are known."""
    own = left_motions(solution.problem.machine, comparison, solution.corrected)
    found = _located(comparison, residual, own or motions)
    return found if own else Location(channels=found.channels)
