"""Quick look: location of a model error and ranked candidates, from short windows of the runs.

One step of the search, on windows of some seconds: it ranks and does not decide. Nothing is
refitted to whole runs, no effect is tested by taking it out again, and there are no intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from loose_env.arms import quiet
from loose_env.gap.diagnostics.joint_torque_residual import joint_motion
from loose_env.gap.diagnostics.localisation import locate, location_notes
from loose_env.gap.fitting.holdout_score import ScoredFit, improvement_of
from loose_env.gap.fitting.model_structure import nuisance_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of
from loose_env.gap.output.result import EffectLocation
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.residuals.progress import reported
from loose_env.gap.residuals.windows import screening_seconds, windows_as_runs
from loose_env.gap.selection.forward_selection import Selection, select_effects
from loose_env.gap.selection.ranking import added_to
from loose_env.gap.settings import GapSettings, SearchSettings
from loose_env.io import json_text
from loose_env.recording import Recording
from loose_env.typing import Array

FORMAT = "loose-gap-quick/1"
_SHOWN = 3
"""Hypotheses that are shown."""
_ZERO = 1e-3
"""Distance from where an effect changes nothing [free numbers] below which it is not there."""


@dataclass(frozen=True, kw_only=True)
class QuickCandidate:
    """One effect that may be missing, or several that explain together."""

    effects: tuple[EffectLocation, ...]
    """Kinds and places."""
    parameters: tuple[Mapping[str, float], ...]
    """Values fitted to the windows, effect by effect."""
    units: tuple[Mapping[str, str], ...]
    """Units of these."""
    explained: float
    """Share of the autocorrelated residual that it explains, held-out windows included."""
    held_out_z: float
    """Improvement (z) on the held-out windows."""
    held_out: float
    """Residual there, root mean square in noise standard deviations."""


@dataclass(frozen=True, kw_only=True)
class QuickLook:
    """What a quick look shows."""

    before: float
    """Residual of the nominal model on held-out windows, in noise standard deviations."""
    candidates: tuple[QuickCandidate, ...] = ()
    """The most promising, best first; none where the residual is noise."""
    location_words: tuple[str, ...] = ()
    """Where the model is wrong, in sentences."""
    warnings: tuple[str, ...] = ()
    """Cautions for the reader."""
    format: str = FORMAT
    """Format of the JSON document."""

    def to_json(self) -> str:
        """Format as JSON."""
        return json_text(asdict(self))


def quick_look(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> QuickLook:
    """Locate a model error, and rank what may explain it, on windows of the runs.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    say : callable
        Receives progress messages, line by line.

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.

    Examples
    --------
    >>> from loose_env.recording import read_recording
    >>> quick_look(read_recording("recordings/arm")).candidates  # doctest: +SKIP
    (QuickCandidate(effects=(EffectLocation(kind='coulomb_friction', where='joint2'),), ...)
    """
    with quiet(), reported(say) as told:
        problem = prepare(recording, settings or GapSettings())
        seconds = screening_seconds(problem.search)
        search = windows_as_runs(problem.search, seconds)
        held_out = windows_as_runs(problem.held_out, seconds)
        nuisance = nuisance_of(search, tolerance=problem.settings.tolerance)
        found = select_effects(
            search,
            held_out,
            nuisance,
            problem.sought,
            settings=SearchSettings(most_effects=1, swaps=False),
            say=told,
        )
        return QuickLook(
            before=found.base.held_out_rms,
            candidates=_leading(found),
            location_words=_where(problem, found.base),
            warnings=tuple(problem.warnings),
        )


def _leading(found: Selection) -> tuple[QuickCandidate, ...]:
    """The hypotheses that leave least, each once, and none of which a part is zero."""
    if not found.rivals:
        return ()
    accepted = [(step, improvement_of(step, found.base)) for step in found.steps]
    tried = sorted([*found.rivals[0], *accepted], key=lambda each: each[0].total)
    leading: list[QuickCandidate] = []
    listed = set()
    for scored, improvement in tried:
        new = added_to(found.base, scored)
        values = {effect.key: own for effect, own in scored.fitted.hypothesis.pairs}
        same = frozenset((effect.kind, effect.where) for effect in new)
        if same in listed or any(_is_null(effect, values[effect.key]) for effect in new):
            continue
        if len(leading) == _SHOWN:
            break
        listed.add(same)
        leading.append(
            QuickCandidate(
                effects=tuple(EffectLocation(kind=e.kind, where=e.where) for e in new),
                parameters=tuple(
                    dict(zip((p.name for p in e.parameters), values[e.key].tolist(), strict=True))
                    for e in new
                ),
                units=tuple({p.name: p.unit for p in e.parameters} for e in new),
                explained=improvement.share,
                held_out_z=improvement.held_out,
                held_out=scored.held_out_rms,
            )
        )
    return tuple(leading)


def _is_null(effect: Effect, values: Array) -> bool:
    """Return whether an effect changes nothing at these values (P,)."""
    if effect.null_values is None:
        return False
    off = free_of(effect.parameters, values) - free_of(
        effect.parameters, np.array(effect.null_values)
    )
    return bool(np.max(np.abs(off)) < _ZERO)


def _where(problem: GapProblem, base: ScoredFit) -> tuple[str, ...]:
    """Where the nominal model is wrong, in sentences; of whole runs."""
    runs = problem.search
    residual = runs.residuals([base.fitted.hypothesis.of_model])[0]
    motions = [joint_motion(problem.machine, t, runs.channels, runs.floors) for t in runs.trials]
    found = locate(residual, runs.rows, runs.trials, runs.channels, motions)
    return tuple(location_notes(found, most=2))
