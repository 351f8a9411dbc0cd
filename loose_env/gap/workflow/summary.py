"""Search result as a GapResult, and its files: model.xml, report and result.json."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.measured_runs import file_of
from loose_env.gap.diagnostics.experiment_advice import identifiability_notes
from loose_env.gap.diagnostics.localisation import location_notes
from loose_env.gap.diagnostics.remaining_error import remaining_notes
from loose_env.gap.experiment_design.next_motion import (
    NEXT_MOTION,
    NextMotionSettings,
    NextMotionSummary,
    write_next_motion,
)
from loose_env.gap.output.calibration import (
    more_likely_than_not,
    stored_calibration,
    with_probability,
)
from loose_env.gap.output.corrected_model import (
    correction_code,
    model_notes,
    unnamed_notes,
    write_model,
)
from loose_env.gap.output.evidence_schema import Identifiability
from loose_env.gap.output.result import EffectLocation, Gap, GapResult, NamedEffect
from loose_env.gap.residuals.physical_units import errors_by_quantity, rms
from loose_env.gap.residuals.progress import reported
from loose_env.gap.workflow.next_motion import choose_next, separating
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.gap.workflow.residual_diagnostics import ResidualDiagnostics, diagnose_residuals

NO_MOTION = "no next motion"
"""Beginning of the warning that says why none was written."""
Report = Callable[[Path, GapSolution, ResidualDiagnostics, GapResult], Path | None]
"""Writes a report into a folder; returns its file, or None where it cannot be made."""


def result_of(
    solution: GapSolution,
    evidence: ResidualDiagnostics | None = None,
    motion: NextMotionSummary | None = None,
) -> GapResult:
    """Summarise a search as a result.

    Parameters
    ----------
    solution : GapSolution
        The finished search.
    evidence : ResidualDiagnostics, optional
        Of `diagnose_residuals`; without, the result has no horizons, locations and residual tests.
    motion : NextMotionSummary, optional
        The motion that separates what the runs do not tell apart, for the warnings.
    """
    evidence = evidence or ResidualDiagnostics()
    solution = _with_probabilities(solution, evidence)
    problem, base, best = solution.problem, solution.base, solution.best
    held = problem.held_out_whole
    pairs = zip(evidence.before, evidence.after, strict=True)
    unexplained = solution.verdict == "unexplained"
    gap = Gap(
        before=rms(base.held_out_residual),
        after=rms(best.held_out_residual),
        by_channel=_by_channel(solution, evidence),
        by_horizon_s={f"{b.horizon:.1f}": (b.rms, a.rms) for b, a in pairs},
        by_quantity=errors_by_quantity(
            problem.machine, held, base.held_out_residual, best.held_out_residual
        ),
    )
    return GapResult(
        verdict=solution.verdict,
        gap=gap,
        effects=solution.effects,
        doubtful=solution.doubtful,
        held_out_runs=tuple(dict.fromkeys(file_of(trial.name) for trial in held.trials)),
        ranking=solution.ranking,
        code=correction_code(solution.corrected),
        nominal_parameters=solution.corrected.nominal_factors,
        location=evidence.location,
        location_words=tuple(
            location_notes(evidence.remaining_location, most=2, always=True)
            if unexplained
            else location_notes(evidence.location, most=2)
        ),
        remaining=()
        if solution.verdict == "no_gap"
        else tuple(
            remaining_notes(
                base,
                best,
                evidence.remaining_location,
                impact_fit=any(e.impact_power_explained is not None for e in solution.effects),
            )
        ),
        remaining_location=evidence.remaining_location,
        residual_tests=evidence.residual_tests,
        interval_factors={
            "size": stored_calibration().size_factor,
            "shape": stored_calibration().shape_factor,
        },
        identifiability=evidence.identifiability,
        warnings=(
            *solution.warnings,
            *unnamed_notes(solution.unnamed.pairs),
            *evidence.warnings,
            *identifiability_notes(evidence.identifiability, separating(motion)),
        ),
        preflight=solution.preflight,
        settings=asdict(problem.settings),
    )


def _with_probabilities(solution: GapSolution, evidence: ResidualDiagnostics) -> GapSolution:
    """Add the effects' probabilities; those less probable than not become doubtful."""
    gap = Gap(
        before=rms(solution.base.held_out_residual), after=rms(solution.best.held_out_residual)
    )
    found = evidence.identifiability
    tested = [with_probability(_with_confusable(e, found), gap) for e in solution.effects]
    named = tuple(effect for effect in tested if more_likely_than_not(effect))
    doubtful = [effect for effect in tested if not more_likely_than_not(effect)]
    return replace(
        solution,
        verdict="unexplained" if doubtful and not named else solution.verdict,
        effects=named,
        doubtful=(*doubtful, *(with_probability(e, gap) for e in solution.doubtful)),
    )


def _by_channel(
    solution: GapSolution, evidence: ResidualDiagnostics
) -> dict[str, tuple[float, float]]:
    """Residual by channel before and after; in features for runs compared by them."""
    held, found = solution.problem.held_out_whole, {}
    for c, channel in enumerate(held.channels):
        own = (held.rows.channel == c) & ~held.rows.is_feature
        parts = [
            np.concatenate(
                [residual[own], *(s.features for s in many if s.gap.channel == channel.name)]
            )
            for residual, many in (
                (solution.base.held_out_residual, evidence.features_before),
                (solution.best.held_out_residual, evidence.features_after),
            )
        ]
        if len(parts[0]):
            found[channel.name] = (rms(parts[0]), rms(parts[1]))
    return found


def _with_confusable(effect: NamedEffect, found: Identifiability) -> NamedEffect:
    """Add the confusable effects of an identified effect, beside those of the fit."""
    others = [
        EffectLocation(kind=pair.other_kind, where=pair.other_where)
        for pair in found.confusable
        if (pair.kind, pair.where) == (effect.kind, effect.where)
    ]
    return replace(effect, ambiguous_with=tuple(dict.fromkeys((*effect.ambiguous_with, *others))))


def write_gap(
    folder: str | Path,
    solution: GapSolution,
    *,
    report: Report = lambda *_: None,
    say: Callable[[str], None] = lambda _: None,
    next_motion: NextMotionSettings | None = None,
    earlier: GapResult | None = None,
) -> tuple[GapResult, list[Path]]:
    """Write ``model.xml``, the files it needs, a report and ``result.json``, the result last.

    Parameters
    ----------
    folder : str or Path
        Where they go; made where there is none.
    solution : GapSolution
        The finished search.
    report : callable
        Writes the report (`loose_env.report.write_gap_report`); none by default.
    say : callable
        Receives progress messages, line by line.
    next_motion : NextMotionSettings, optional
        Where given, the motion that best separates what the runs do not tell apart is written
        too, as ``next_motion.csv``, ``.parquet`` and ``.json``; none where nothing is left to
        separate.
    earlier : GapResult, optional
        Result of some of the runs, whose rivals are compared again.

    Returns
    -------
    tuple
        The result, and the files written.

    Raises
    ------
    InvalidData
        If the corrected model does not compile.
    """
    place, problem = Path(folder), solution.problem
    with reported(say) as told:
        evidence = diagnose_residuals(solution, say=told)
        solution = _with_probabilities(solution, evidence)
        chosen, none = None, tuple[str, ...]()
        if next_motion is not None:
            found = evidence.identifiability
            try:
                chosen = choose_next(solution, found, next_motion, earlier=earlier, say=told)
            except InvalidData as error:  # the result itself does not depend on it
                none = (f"{NO_MOTION}: {error}",)
    # An earlier motion must not stand beside a later result.
    for ending in ("json", "csv", "parquet"):
        place.joinpath(f"{NEXT_MOTION}.{ending}").unlink(missing_ok=True)
    summary, motions = None, list[Path]()
    if chosen is not None and next_motion is not None:
        place.mkdir(parents=True, exist_ok=True)
        summary, motions = write_next_motion(place, chosen, next_motion)
    result = result_of(solution, evidence, summary)
    if none:
        result = replace(result, warnings=(*result.warnings, *none))
    # An earlier result must not stand beside a later model if this run is cut short.
    place.joinpath("result.json").unlink(missing_ok=True)
    say("writing model, result and report")
    page = report(place, solution, evidence, result)
    models = write_model(
        place / "model.xml",
        problem.machine,
        solution.corrected,
        step=evidence.exported.step,
        source=problem.model_path,
        notes=model_notes(solution.effects, solution.unnamed.pairs, result.nominal_parameters),
    )
    file = result.write(place / "result.json")
    return result, [*models, *([] if page is None else [page]), *motions, file]
