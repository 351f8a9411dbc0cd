"""Diagnostics of a finished search: location, horizons, whiteness and identifiability."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from loose_env.arms import quiet
from loose_env.gap.diagnostics.feature_localisation import (
    FeatureChannel,
    feature_channels,
    feature_tests,
)
from loose_env.gap.diagnostics.identifiability import identifiability
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import locate
from loose_env.gap.diagnostics.prediction_horizon import HorizonError, horizon_errors
from loose_env.gap.diagnostics.remaining_error import remaining_motions
from loose_env.gap.diagnostics.residual_tests import residual_tests
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.evidence_schema import Identifiability, Location, ResidualTest
from loose_env.gap.output.export_check import Exported, exported
from loose_env.gap.residuals.preparation.integrator_choice import corrected_step_notes
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.typing import Array

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualDiagnostics:
    """Evidence shown beside the verdict of a comparison."""

    held_out_motions: tuple[JointMotion, ...] = ()
    """Motion of each held-out run."""
    location: Location = field(default_factory=Location)
    """Localised residual of the nominal model, on all runs."""
    before: tuple[HorizonError, ...] = ()
    """Open-loop errors of the nominal model on the held-out runs."""
    after: tuple[HorizonError, ...] = ()
    """Open-loop errors of the corrected model."""
    residual_tests: tuple[ResidualTest, ...] = ()
    """Residual tests on the held-out runs."""
    remaining_location: Location = field(default_factory=Location)
    """Localised residual of the corrected model."""
    features_before: tuple[FeatureChannel, ...] = ()
    """Of the nominal model: channels of held-out runs that are compared by features."""
    features_after: tuple[FeatureChannel, ...] = ()
    """The same for the corrected model."""
    identifiability: Identifiability = field(default_factory=Identifiability)
    """Effects that the motions could not show, or distinguish."""
    exported: Exported = field(default_factory=Exported)
    """Export form of the corrected model."""
    warnings: tuple[str, ...] = ()
    """Notes found along the way."""


def diagnose_residuals(solution: GapSolution, *, say: Say = lambda _: None) -> ResidualDiagnostics:
    """Localise the residual, compute open-loop errors, and test for whiteness."""
    say("localising the residual")
    problem, base, best = solution.problem, solution.base, solution.best
    machine, motions, features = _fitted_nominal(solution), {}, {}
    before, corrected, held = solution.nominal, solution.corrected, problem.held_out_whole
    for name, comparison in (("fit", problem.fit), ("held", held)):
        motions[name] = tuple(
            joint_motion(machine, trial, comparison.channels, comparison.floors)
            for trial in comparison.trials
        )
        features[name] = feature_channels(comparison, before, motions[name])
    features_after = feature_channels(held, corrected, motions["held"])
    parts = [
        _located(problem.fit, base.fitted.residual, motions["fit"]),
        _located(held, base.held_out_residual, motions["held"]),
    ]
    left = [
        _left(solution, comparison, residual, motions[name])
        for name, comparison, residual in (
            ("fit", problem.fit, best.fitted.residual),
            ("held", held, best.held_out_residual),
        )
    ]
    features_fit = feature_channels(problem.fit, corrected, motions["fit"])
    say("prediction errors by horizon")
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
    say("identifiability from these motions")
    kinds = problem.settings.kinds or None
    with quiet():  # an effect of any size may make a simulation diverge
        shown = identifiability(problem.fit, best.fitted, candidates(problem.machine, kinds))
    own = exported(held, corrected, best.held_out_residual)
    say("residual tests")
    return ResidualDiagnostics(
        held_out_motions=motions["held"],
        location=Location(
            channels=(
                *(gap for part in parts for gap in part.channels),
                *(each.gap for many in features.values() for each in many),
            ),
            joints=tuple(gap for part in parts for gap in part.joints),
        ),
        before=errors[0],
        after=errors[1],
        residual_tests=(
            *residual_tests(
                best.held_out_residual, held.rows, held.trials, held.channels, motions["held"]
            ),
            *feature_tests(features_after),
        ),
        remaining_location=Location(
            channels=(
                *(gap for part in left for gap in part.channels),
                *(each.gap for each in (*features_fit, *features_after)),
            ),
            joints=tuple(gap for part in left for gap in part.joints),
        ),
        features_before=tuple(features["held"]),
        features_after=tuple(features_after),
        identifiability=shown,
        exported=own,
        warnings=(
            *corrected_step_notes(held, corrected),
            *own.notes(),
        ),
    )


def _fitted_nominal(solution: GapSolution) -> NominalModel:
    """Return the nominal model with its parameters fitted within the tolerance."""
    machine = solution.problem.machine
    spec = machine.spec.copy()
    solution.nominal.edit(spec)
    return replace(machine, spec=spec)


def _located(
    comparison: ResidualModel, residual: Array, motions: Sequence[JointMotion]
) -> Location:
    return locate(residual, comparison.rows, comparison.trials, comparison.channels, motions)


def _left(
    solution: GapSolution,
    comparison: ResidualModel,
    residual: Array,
    motions: Sequence[JointMotion],
) -> Location:
    """Localised residual of the corrected model; torques only where these are known."""
    own = remaining_motions(solution.problem.machine, comparison, solution.corrected)
    found = _located(comparison, residual, own or motions)
    return found if own else Location(channels=found.channels)
