"""Verdict of a diagnosis (healthy, faulty, open, wrong model), with reasons if unsettled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.inference.findings.direction_cones import cone
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.response.timing import ClockOffset
from loose_env.instrument.result import HEALTHY, Verdict
from loose_env.instrument.settings.thresholds import (
    FAULT_EFFECT,
    LEAST_RUNS,
    LEAST_TESTED,
    MISMATCH,
    SETTLED_CONE_DEG,
)


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Verdict, and reasons why it is not settled."""

    kind: Verdict
    reasons: tuple[str, ...] = ()


def verdict_of(
    comparison: ModelComparison, clocks: Sequence[ClockOffset], *, sure: float
) -> Judgement:
    """Decide whether a diagnosis is settled."""
    best = comparison.best
    probability = comparison.nothing_opened if best == HEALTHY else comparison.posterior[best]
    suspect = [one.number for one in comparison.lines if not one.healthy]
    paired = any(one.beside is not None for one in comparison.lines)
    blocked: list[str] = []
    misfit = comparison.misfit
    if misfit > MISMATCH:
        blocked.append(
            f"the model leaves {misfit:.0%} of the tool's motion in a run unexplained; at most "
            f"{MISMATCH:.0%} is allowed"
        )
    blocked += [f"{each.words}; it was corrected by an estimate" for each in clocks if each.noted]
    if best != HEALTHY:
        effects = sorted(comparison.fits[best].runs[run].effect for run in suspect)
        effect = float(np.sqrt(effects[-LEAST_RUNS:][0]))
        if effect < FAULT_EFFECT:
            blocked.append(
                f"in all but {LEAST_RUNS - 1} run the seat makes no more than {effect:.1%} of the "
                f"tool's motion; below {FAULT_EFFECT:.0%} other causes do as much"
            )
        _, half = cone(comparison.fits[best])
        if best.startswith("structural") and (half is None or half > SETTLED_CONE_DEG):
            blocked.append(
                f"the direction of the slide is known no better than {SETTLED_CONE_DEG:g} degrees"
            )
    elif comparison.tested < LEAST_TESTED:
        blocked.append(
            f"the runs would have opened {comparison.tested:.0%} of the seats that may be loose; "
            f"{LEAST_TESTED:.0%} are needed: shake harder, or take other poses"
        )
    if len(suspect) < LEAST_RUNS:
        blocked.append(f"{len(suspect)} run of the arm under test; {LEAST_RUNS} are needed")
    elif best != HEALTHY and probability > sure and _rests_on_one(comparison, best, suspect):
        blocked.append("the probability rests on one run: without it another cause is as likely")
    if misfit > MISMATCH and not paired:
        return Judgement(kind="model_mismatch", reasons=tuple(blocked))
    if probability <= sure:
        what = "that nothing opened in any run" if best == HEALTHY else f"of {best}"
        blocked.insert(0, f"the probability {what} is {probability:.3f}; {sure:g} is needed")
    if blocked:
        return Judgement(kind="open", reasons=tuple(blocked))
    return Judgement(kind="healthy" if best == HEALTHY else "faulty")


def _rests_on_one(comparison: ModelComparison, best: str, suspect: Sequence[int]) -> bool:
    """True if without some run the best hypothesis is no more likely than all others."""
    return any(
        comparison.after([run for run in suspect if run != left_out])[best] < 0.5
        for left_out in suspect
    )
