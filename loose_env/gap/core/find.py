"""The way from a recording to the effects that its model lacks."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.arms import quiet
from loose_env.gap.core.balance import Balance, scaled
from loose_env.gap.core.catalogue import catalogue
from loose_env.gap.core.decision import Decision, decide, pruned
from loose_env.gap.core.evidence import whiten
from loose_env.gap.core.exact import Exact, ExactFit, leading
from loose_env.gap.core.motion import smooth
from loose_env.gap.core.selection import Selection
from loose_env.gap.core.tolerances import Tolerances, nuisances
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Recording


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a model lacks."""

    selection: Selection
    """Evidence and fits of sets of effects."""
    decision: Decision
    """Effects and verdicts."""
    exact: tuple[ExactFit, ...]
    """Leading sets in full simulation, the best first; empty for torque logs."""


def find_gap(
    recording: Recording,
    tolerances: Tolerances | None = None,
    *,
    simulate: bool = True,
) -> Answer:
    """Find which force was missing along the motion that was measured.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    tolerances : Tolerances, optional
        What the nominal model is known to.
    simulate : bool
        Whether full simulation decides among the leading sets, where there are commands.

    Raises
    ------
    InvalidData
        If the position of a joint was not read.
    """
    with quiet():
        machine = NominalModel(recording.spec())
        motion = smooth(recording, machine)
        balance = Balance(scaled(Balance(machine, motion)), motion)
        evidence = whiten(
            balance, catalogue(balance), nuisances(balance, tolerances or Tolerances())
        )
        selection = Selection(evidence)
        best = pruned(selection, selection.best())
        fits: tuple[ExactFit, ...] = ()
        if simulate and not balance.released.any():
            exact = Exact(recording, balance)
            sets = [pruned(selection, own) for own in leading(selection, best)]
            unlike = {frozenset(t.name for t in own.terms): own for own in reversed(sets)}
            fits = tuple(
                sorted(
                    (exact.fit(selection, own) for own in unlike.values()), key=lambda f: f.total
                )
            )
            best = fits[0].fit
        return Answer(selection=selection, decision=decide(selection, best, fits[:1]), exact=fits)
