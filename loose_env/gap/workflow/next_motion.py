"""Next motion after a finished search: the one that best separates effects not told apart."""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest

import numpy as np

from loose_env.gap.experiment_design.next_motion import (
    NOTHING,
    NextMotion,
    NextMotionSettings,
    NextMotionSummary,
    Place,
    choose_motion,
    open_hypotheses,
)
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.output.evidence_schema import Identifiability
from loose_env.gap.output.result import GapResult
from loose_env.gap.settings import WORSE
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.typing import Array

_RANKED_RIVALS = 2
"""Candidates of a step of the ranking that are looked at beside its winner."""


def choose_next(
    solution: GapSolution,
    found: Identifiability,
    settings: NextMotionSettings,
    *,
    earlier: GapResult | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> NextMotion | None:
    """Choose the motion for the pairs that are still open; None where there is none.

    Looked at are the effects that the result lists as not told from one of the answer, those that
    its motions cannot tell from it, near candidates of the ranking, and rivals of an earlier
    result; besides, effects that the motions would not show.
    """
    rivals = _rivals(solution, found, earlier)[: settings.next_rivals]
    unseen = _unseen(solution, found)[: settings.next_unseen]
    say(f"next motion: evidence for the answer over {len(rivals)} rivals")
    comparison = solution.problem.fit
    hypotheses = open_hypotheses(comparison, solution.best.fitted, rivals, unseen, say=say)
    if not hypotheses.pairs:
        say("next motion: nothing is confusable with the answer; none is needed")
        return None
    chosen = choose_motion(comparison, hypotheses, settings, say=say)
    if chosen is None:
        names = " and ".join(f"{p.description}" for p in hypotheses.pairs)
        say(f"next motion: none separates {names} at the values that fit these runs")
    return chosen


def separating(motion: NextMotionSummary | None) -> Callable[[str, str], str | None]:
    """Words on a motion for a pair of effects, as `identifiability_notes` takes them."""

    def words(one: str, other: str) -> str | None:
        nats = None if motion is None else motion.gain_of(one, other)
        if motion is None or nats is None:
            return None
        what = "show it" if one == NOTHING else "separate them"
        return f"run {motion.file_description}: expected to {what} by {nats:.0f} nats"

    return words


def _rivals(
    solution: GapSolution, found: Identifiability, earlier: GapResult | None
) -> list[tuple[Place, list[Effect]]]:
    """Rivals of each effect of the answer, in every form, without those of the answer."""
    answer = {(e.kind, e.where) for e in solution.best.fitted.effects}
    listed: dict[tuple[Place, Place], None] = {}
    named = (*solution.effects, *solution.doubtful)
    before = () if earlier is None else (*earlier.effects, *earlier.doubtful)
    for effect in (*named, *before):
        for other in effect.ambiguous_with:
            listed[(effect.kind, effect.where), (other.kind, other.where)] = None
    for pair in found.confusable:
        listed[(pair.kind, pair.where), (pair.other_kind, pair.other_where)] = None
    listed |= dict.fromkeys(_near(solution))
    kinds = solution.problem.settings.kinds or None
    forms: dict[Place, list[Effect]] = {}
    for each in candidates(solution.problem.machine, kinds):
        forms.setdefault((each.kind, each.where), []).append(each)
    return [
        (own, forms[other])
        for own, other in listed
        if own in answer and other not in answer and other in forms
    ]


def _unseen(solution: GapSolution, found: Identifiability) -> list[tuple[Effect, Array]]:
    """Effects that the motions would not show, at sizes that matter; one of each kind first.

    Those with springs come last: a simulation takes many times as long.
    """
    sought: dict[Place, Effect] = {}
    for each in solution.problem.sought:
        sought.setdefault((each.kind, each.where), each)
    by_kind: dict[str, list[tuple[Effect, Array]]] = {}
    for one in found.unidentifiable:
        effect = sought.get((one.kind, one.where))
        if effect is None or {p.name for p in effect.parameters} != set(one.parameters):
            continue
        values = np.array([one.parameters[p.name] for p in effect.parameters])
        by_kind.setdefault(one.kind, []).append((effect, values))
    rounds = zip_longest(*by_kind.values())
    listed = [pair for one in rounds for pair in one if pair is not None]
    return sorted(listed, key=lambda pair: pair[0].adds_motion)


def _near(solution: GapSolution) -> list[tuple[Place, Place]]:
    """Near candidates of the ranking: those that leave hardly more in the step of an effect."""
    found: list[tuple[Place, Place]] = []
    named = [(e.kind, e.where) for e in (*solution.effects, *solution.doubtful)]
    for step in sorted({each.step for each in solution.ranking}):
        own = [each for each in solution.ranking if each.step == step and not each.together_with]
        winner = next((e for e in own if (e.kind, e.where) in named), None)
        if winner is None:
            continue
        near = [e for e in own if e is not winner and e.held_out <= WORSE * winner.held_out]
        found += [((winner.kind, winner.where), (e.kind, e.where)) for e in near[:_RANKED_RIVALS]]
    return found
