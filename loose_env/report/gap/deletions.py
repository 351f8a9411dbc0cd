"""Deletion tests in sentences: what is lost without each effect."""

from __future__ import annotations

from loose_env.gap import GapResult, NamedEffect
from loose_env.report.gap.text import effect_words

__all__ = ["deletion_words", "doubtful_words"]


def deletion_words(effect: NamedEffect) -> str:
    """What is lost without an effect, in a sentence; "" where that was not tested.

    Examples
    --------
    >>> from loose_env.gap import DeletionTest
    >>> test = DeletionTest(
    ...     held_out_z=5.4,
    ...     training_z=9.0,
    ...     share_of_error=0.7,
    ...     share_without=0.98,
    ...     share_in_channel=0.99,
    ... )
    >>> deletion_words(NamedEffect(kind="payload", where="tool", parameters={}, deletion=test))
    'explains 98 % of what is left without it (z 5.4 on held-out runs, 9.0 on fitted ones)'
    """
    test = effect.deletion
    if test is None:
        return ""
    share = 100 * max(0.0, test.share_without)
    words = f"explains {share:.0f} % of what is left without it"
    if test.share_in_channel > test.share_without + 0.05:
        words += f", {100 * test.share_in_channel:.0f} % in one channel"
    runs = f"z {test.held_out_z:.1f} on held-out runs, {test.training_z:.1f} on fitted ones"
    return f"{words} ({runs})"


def doubtful_words(result: GapResult) -> list[str]:
    """Effects that reduce the error and were not identified, one sentence each."""
    return [
        f"{effect_words(effect.kind, effect.where)}: {deletion_words(effect)}; too little to tell "
        "it from a stand-in for something else"
        for effect in result.doubtful
    ]
