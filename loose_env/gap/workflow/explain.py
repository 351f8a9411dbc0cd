"""`loose gap` as one call (explain_gap), and the held-out prediction error of a model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loose_env.arms import quiet
from loose_env.gap.fitting.initial_state import InitialStates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.output.checkpoints import Stage, fresh
from loose_env.gap.output.result import GapResult
from loose_env.gap.residuals.physical_units import rms
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import find_gap
from loose_env.gap.workflow.residual_diagnostics import diagnose_residuals
from loose_env.gap.workflow.summary import result_of, write_gap
from loose_env.recording import Recording


def explain_gap(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    folder: str | Path | None = None,
    say: Callable[[str], None] = lambda _: None,
    stages: Stage = fresh,
) -> GapResult:
    """Identify effects that a model lacks, and the reduction of the residual.

    The effects are fitted to a recording and scored on held-out runs.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    folder : str or Path, optional
        Gets ``model.xml``, the corrected model with the files it needs, and ``result.json``; made
        where there is none. By default nothing is written.
    say : callable
        Receives progress messages, line by line.
    stages : callable
        Checkpoints of stages, such as `loose_env.gap.output.checkpoints.Stages`; an interrupted
        run goes on from there.

    Returns
    -------
    GapResult
        Content of ``result.json``. `loose_env.explain_gap` also shows it, as text and in notebooks.

    Raises
    ------
    InvalidData
        If the recording has too few runs, a run lacks what its comparison needs, or the corrected
        model does not compile.

    Examples
    --------
    Over half a minute, on a recording of one's own:

    >>> from loose_env.recording import read_recording
    >>> result = explain_gap(read_recording("recordings/arm"))  # doctest: +SKIP
    >>> result.verdict, [(effect.kind, effect.where) for effect in result.effects]
    ... # doctest: +SKIP
    ('named', [('coulomb_friction', 'joint2')])
    """
    solution = find_gap(recording, settings, say=say, stages=stages)
    if folder is not None:
        return write_gap(folder, solution, say=say)[0]
    return result_of(solution, diagnose_residuals(solution, say=say))


def prediction_error(
    recording: Recording, model: Hypothesis, settings: GapSettings | None = None
) -> float:
    """Error of a model on the held-out runs of a recording, nothing of it refitted.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    model : Hypothesis
        Effects and nominal parameters, such as ``corrected`` of a `GapSolution` of another
        recording of the same machine. Initial states alone are fitted.
    settings : GapSettings, optional
        Settings of the comparison.

    Returns
    -------
    float
        Root mean square in noise standard deviations.

    Raises
    ------
    InvalidData
        If the recording cannot be compared.
    """
    with quiet():
        problem = prepare(recording, settings or GapSettings())
        held = problem.held_out_whole
        starts = InitialStates(problem.machine, held.trials, held.channels)
        return rms(starts.fitted(held, model)[1])
