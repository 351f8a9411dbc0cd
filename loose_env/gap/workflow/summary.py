"""Result of a finished comparison: evidence, corrected model and result file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.gap.diagnostics.experiment_advice import identifiability_words
from loose_env.gap.diagnostics.feature_localisation import (
    StruckChannel,
    struck_channels,
    struck_left,
)
from loose_env.gap.diagnostics.identifiability import identifiability
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import locate, where_it_lives
from loose_env.gap.diagnostics.prediction_horizon import HorizonError, horizon_errors
from loose_env.gap.diagnostics.remaining_error import left_motions, left_words
from loose_env.gap.diagnostics.residual_tests import left_over
from loose_env.gap.fitting.gauss_newton import UNNAMED
from loose_env.gap.fitting.holdout_score import Judged, machine_part
from loose_env.gap.fitting.uncertain_parameters import NominalFigures
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.output.evidence_schema import Identifiability, LeftOver, Location
from loose_env.gap.output.export_check import Exported, exported
from loose_env.gap.output.export_mjcf import (
    correction_code,
    model_notes,
    nameless_words,
    write_model,
)
from loose_env.gap.output.result import Gap, GapResult, NamedEffect, Place, Ranked, Verdict
from loose_env.gap.preparation.integrator_choice import corrected_step_words
from loose_env.gap.residuals.physical_units import errors_by_quantity, rms
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import GapFound
from loose_env.recording import Recording
from loose_env.typing import Array

__all__ = ["Evidence", "GapOutputs", "gather", "outputs_of", "result_of", "write_model_and_result"]

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class GapOutputs:
    """Outputs of a finished comparison."""

    machine: Machine
    """The nominal model, with the chosen step."""
    fit: Comparison
    """The training runs."""
    held: Comparison
    """The held-out runs."""
    base: Judged
    """The nominal model, fitted within the tolerance."""
    best: Judged
    """The model with the identified effects, or those nearly accepted."""
    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    effects: tuple[NamedEffect, ...] = ()
    """Identified effects, with intervals and confusable effects."""
    ranking: tuple[Ranked, ...] = ()
    """Ranking of all fitted hypotheses."""
    warnings: tuple[str, ...] = ()
    """Notes for the reader."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Provenance: all inputs of the result besides the recording."""
    model_path: Path | None = None
    """File of the nominal model; its meshes are copied."""
    recording: str = ""
    """Name of the recording, for the report."""
    threads: int = 0
    """Threads of the simulation; 0: all processors."""

    @cached_property
    def exported(self) -> Exported:
        """Export form of the corrected model."""
        return exported(self.held, machine_part(self.best), self.best.held_residual)

    @property
    def added(self) -> tuple[tuple[Effect, Array], ...]:
        """Effects of the best hypothesis with their values, nominal parameters first."""
        hypothesis = machine_part(self.best)
        return tuple(zip(hypothesis.effects, hypothesis.values, strict=True))

    @property
    def nameless(self) -> tuple[tuple[Effect, Array], ...]:
        """Effects in the corrected model that are not reported as identified."""
        named = {(effect.kind, effect.where) for effect in self.effects}
        return tuple(
            (effect, values)
            for effect, values in self.added
            if effect.kind not in UNNAMED and (effect.kind, effect.where) not in named
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Evidence shown beside the verdict of a comparison."""

    motions_held: tuple[JointMotion, ...]
    """Residual size on the held-out runs."""
    location: Location
    """Localised residual of the nominal model, on all runs."""
    before: tuple[HorizonError, ...]
    """Open-loop errors of the nominal model on the held-out runs."""
    after: tuple[HorizonError, ...]
    """Open-loop errors of the corrected model."""
    left_over: tuple[LeftOver, ...]
    """Residual tests on the held-out runs."""
    left_location: Location
    """Localised residual of the corrected model."""
    struck_before: tuple[StruckChannel, ...] = ()
    """Of the nominal model: channels of held-out runs that are compared by features."""
    struck_after: tuple[StruckChannel, ...] = ()
    """The same for the corrected model."""
    identifiability: Identifiability = field(default_factory=Identifiability)
    """Effects that the motions could not show, or distinguish."""
    warnings: tuple[str, ...] = ()
    """Notes found along the way."""


def outputs_of(found: GapFound, recording: Recording, settings: GapSettings) -> GapOutputs:
    """Collect outputs of a finished search for the report and the files."""
    prepared = found.prepared
    return GapOutputs(
        machine=prepared.machine,
        fit=prepared.fit,
        held=prepared.whole_held,
        base=found.base,
        best=found.best,
        verdict=found.verdict,
        effects=found.effects,
        ranking=found.ranking,
        warnings=(*prepared.warnings, *([found.struck.words] if found.struck else [])),
        settings=asdict(settings),
        model_path=recording.model_path,
        recording=recording.folder.name,
        threads=settings.threads,
    )


def gather(outputs: GapOutputs, *, say: Say = lambda _: None) -> Evidence:
    """Localise the residual, compute open-loop errors, and test for whiteness."""
    say("where the gap is")
    machine, motions, struck = _with_figures(outputs), {}, {}
    before, corrected = machine_part(outputs.base), machine_part(outputs.best)
    for name, comparison in (("fit", outputs.fit), ("held", outputs.held)):
        motions[name] = tuple(
            joint_motion(machine, trial, comparison.channels, comparison.floors)
            for trial in comparison.trials
        )
        struck[name] = struck_channels(comparison, before, motions[name])
    struck_after = struck_channels(outputs.held, corrected, motions["held"])
    parts = [
        _located(outputs.fit, outputs.base.fitted.residual, motions["fit"]),
        _located(outputs.held, outputs.base.held_residual, motions["held"]),
    ]
    left = [
        _left(outputs, comparison, residual, motions[name])
        for name, comparison, residual in (
            ("fit", outputs.fit, outputs.best.fitted.residual),
            ("held", outputs.held, outputs.best.held_residual),
        )
    ]
    struck_fit = struck_channels(outputs.fit, corrected, motions["fit"])
    say("open-loop errors by horizon")
    errors = [
        horizon_errors(
            outputs.machine,
            outputs.held.trials,
            outputs.held.channels,
            outputs.held.floors,
            hypothesis,
            threads=outputs.threads,
        )
        for hypothesis in (before, corrected)
    ]
    say("what these motions can show")
    kinds = outputs.settings.get("kinds") or None
    shown = identifiability(outputs.fit, outputs.best.fitted, candidates(outputs.machine, kinds))
    say("tests of what is left")
    held = outputs.held
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
            *left_over(
                outputs.best.held_residual, held.rows, held.trials, held.channels, motions["held"]
            ),
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
        warnings=(
            *corrected_step_words(outputs.held, corrected),
            *outputs.exported.words(),
            *identifiability_words(shown),
        ),
    )


def _with_figures(outputs: GapOutputs) -> Machine:
    """Return the nominal machine with its parameters fitted within the tolerance."""
    spec = outputs.machine.spec.copy()
    hypothesis = machine_part(outputs.base)
    for effect, values in zip(hypothesis.effects, hypothesis.values, strict=True):
        effect.edit(spec, values)
    return replace(outputs.machine, spec=spec)


def _located(comparison: Comparison, residual: Array, motions: Sequence[JointMotion]) -> Location:
    return locate(residual, comparison.rows, comparison.trials, comparison.channels, motions)


def _left(
    outputs: GapOutputs, comparison: Comparison, residual: Array, motions: Sequence[JointMotion]
) -> Location:
    """Localised residual of the corrected model; torques only where these are known."""
    own = left_motions(outputs.machine, comparison, machine_part(outputs.best))
    found = _located(comparison, residual, own or motions)
    return found if own else Location(channels=found.channels)


def result_of(outputs: GapOutputs, evidence: Evidence) -> GapResult:
    """Summarise a comparison as a result."""
    held = outputs.held
    before, after = outputs.base.held_residual, outputs.best.held_residual
    pairs = zip(evidence.before, evidence.after, strict=True)
    effects, values = zip(*outputs.added, strict=True)
    unexplained = outputs.verdict == "unexplained"
    return GapResult(
        verdict=outputs.verdict,
        gap=Gap(
            before=rms(before),
            after=rms(after),
            by_channel=_by_channel(outputs, evidence),
            by_horizon_s={f"{b.horizon:.1f}": (b.over_floor, a.over_floor) for b, a in pairs},
            by_quantity=errors_by_quantity(outputs.machine, held, before, after),
        ),
        effects=tuple(_with_alike(e, evidence.identifiability) for e in outputs.effects),
        held_out_runs=tuple(trial.name for trial in held.trials),
        ranking=outputs.ranking,
        code=correction_code(effects, values),
        nominal_figures=_figures(outputs),
        location=evidence.location,
        where_it_lives=tuple(
            where_it_lives(evidence.left_location, most=2, always=True)
            if unexplained
            else where_it_lives(evidence.location, most=2)
        ),
        left=()
        if outputs.verdict == "no_gap"
        else tuple(
            left_words(
                outputs.base,
                outputs.best,
                evidence.left_location,
                struck=any(e.powers_explained is not None for e in outputs.effects),
            )
        ),
        left_location=evidence.left_location,
        left_over=evidence.left_over,
        identifiability=evidence.identifiability,
        warnings=(*outputs.warnings, *nameless_words(outputs.nameless), *evidence.warnings),
        settings=outputs.settings,
    )


def _by_channel(outputs: GapOutputs, evidence: Evidence) -> dict[str, tuple[float, float]]:
    """Residual by channel before and after; in features for runs compared by them."""
    held, found = outputs.held, {}
    for c, channel in enumerate(held.channels):
        own = (held.rows.channel == c) & ~held.rows.white
        parts = [
            np.concatenate(
                [residual[own], *(s.features for s in many if s.gap.channel == channel.name)]
            )
            for residual, many in (
                (outputs.base.held_residual, evidence.struck_before),
                (outputs.best.held_residual, evidence.struck_after),
            )
        ]
        if len(parts[0]):
            found[channel.name] = (rms(parts[0]), rms(parts[1]))
    return found


def _with_alike(effect: NamedEffect, found: Identifiability) -> NamedEffect:
    """Add the confusable effects of an identified effect, beside those of the fit."""
    others = [
        Place(kind=pair.other_kind, where=pair.other_where)
        for pair in found.alike
        if (pair.kind, pair.where) == (effect.kind, effect.where)
    ]
    return replace(effect, ambiguous_with=tuple(dict.fromkeys((*effect.ambiguous_with, *others))))


def _figures(outputs: GapOutputs) -> dict[str, float]:
    """Factors on nominal parameters."""
    return {
        parameter.name: float(value)
        for effect, values in outputs.added
        if isinstance(effect, NominalFigures)
        for parameter, value in zip(effect.parameters, values, strict=True)
    }


def write_model_and_result(folder: Path, outputs: GapOutputs, result: GapResult) -> list[Path]:
    """Write ``model.xml``, the files it needs, and ``result.json``, the result last."""
    effects, values = zip(*outputs.added, strict=True)
    notes = model_notes(outputs.effects, outputs.nameless, result.nominal_figures)
    written = write_model(
        folder / "model.xml",
        outputs.machine,
        effects,
        values,
        step=outputs.exported.step,
        source=outputs.model_path,
        notes=notes,
    )
    return [*written, result.write(folder / "result.json")]
