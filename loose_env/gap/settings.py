"""Settings of `loose gap`, and acceptance criteria of its effect search."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from numbers import Real

import numpy as np

from loose_env.errors import InvalidSetting

__all__ = ["GapSettings", "NamingSettings"]

_MOST_EFFECTS, _MOST_THREADS, _SEEDS = 30, 10_000, 2**63
"""Bounds of settings: most effects and threads, and above all seeds."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of the comparison of a recording with its model.

    Examples
    --------
    >>> GapSettings(search_seconds=0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: search_seconds is a time above 0 s, got 0
    """

    tolerance: float = 0.03
    """Within which nominal masses, inertias, dampings and gains are known, as a share."""
    most_effects: int = 18
    """Most effects that are named."""
    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered; all of the catalogue if none is given."""
    held_share: float = 0.25
    """Share of the runs that is held out to judge by, in whole families of motions: runs whose
    names begin with the same word."""
    held_out: tuple[str, ...] = ()
    """Files of the runs that are held out in place of those, or how their names begin."""
    search_seconds: float = 90.0
    """How much of the recording is fitted to while effects are sought, in all; of longer ones a
    window of every run [s]."""
    fit_seconds: float = 240.0
    """How much of it the effects that were found are fitted to in the end [s]."""
    held_seconds: float = 60.0
    """How much of it judges while effects are sought; the result is of whole runs [s]."""
    seed: int = 1
    """Seed of the intervals' bootstrap."""
    threads: int = 0
    """Threads of the simulation; 0: all processors."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises
        ------
        InvalidSetting
            If a setting is of another type, or out of its range.
        """
        for name, most in (("tolerance", 0.5), ("held_share", 1.0)):
            value = getattr(self, name)
            if not (_is_number(value) and 0 < value < most):
                raise InvalidSetting(f"{name} is a share above 0 and below {most:g}, got {value!r}")
        for name in ("search_seconds", "fit_seconds", "held_seconds"):
            value = getattr(self, name)
            if not (_is_number(value) and value > 0):
                raise InvalidSetting(f"{name} is a time above 0 s, got {value!r}")
        for name, least, most in (
            ("most_effects", 1, _MOST_EFFECTS),
            ("seed", 0, _SEEDS - 1),
            ("threads", 0, _MOST_THREADS),
        ):
            value = getattr(self, name)
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not (whole and least <= value <= most):
                upper = f"to {most}" if most < _SEEDS - 1 else "or more, below 2**63"
                raise InvalidSetting(
                    f"{name} is a whole number, {least} {upper}, got {value!r:.60}"
                )
        for name in ("kinds", "held_out"):
            value = getattr(self, name)
            listed = isinstance(value, tuple | list)
            if not (listed and all(isinstance(each, str) for each in value)):
                raise InvalidSetting(f"{name} is a tuple of words, got {value!r:.60}")


def _is_number(value: object) -> bool:
    """Return whether a value is a number, and no bool."""
    return isinstance(value, Real) and not isinstance(value, bool)


@dataclass(frozen=True, kw_only=True)
class NamingSettings:
    """Acceptance criteria of effects, and sizes of the search."""

    most: int = 3
    """Most effects named."""
    sorting: float = 6.0
    """How much of the runs is used to sort candidates, in all [s]; more where runs are many."""
    sorted_runs: int = 6
    """Runs of which a window each is used for that, where there are as many."""
    candidates: int = 7
    """Candidates that are fitted to that."""
    surer: int = 2
    """Further ones that promise less and are surer than all of those."""
    twice: int = 3
    """How many of them are fitted from a second start where one promises about as much."""
    further: int = 6
    """Further candidates that are fitted if none of those will do and much is left."""
    finalists: int = 3
    """Candidates that are fitted to whole runs."""
    kin: int = 2
    """Further candidates fitted to whole runs because the best one may be mistaken for them."""
    exchanged: int = 4
    """Candidates that are fitted in the place of each named effect, once all are there."""
    exchanged_there: int = 2
    """Further ones at the same joint."""
    exchanges: int = 3
    """Most effects that are exchanged in this way; many of one kind are not looked at singly."""
    hopeless: float = 2.0
    """Sum of squares on what sorts candidates, over that of the best of them, from which on one is
    not fitted to whole runs, if the best one is surely ahead of it (`sureness`)."""
    alone: float = 0.4
    """Share of what is still to be explained below which no effect by itself will do, and one kind
    at several places is tried."""
    much: float = 0.2
    """Share of what there was to explain at first that must be left for that."""
    loud: float = 3.0
    """Or what is left of the held-out runs for that [noise standard deviations]."""
    mixed: float = 1.25
    """What must be left of the held-out runs for all frictions of a joint to be tried at once
    [noise standard deviations]."""
    families: int = 6
    """Kinds that are tried at several places."""
    several: int = 3
    """Places from which on an effect that explains much at one of them alone is one of a machine
    that lacks it all over."""
    nearly: float = 0.8
    """Share of what is still to be explained that these places have to explain together; else they
    stand in for another effect."""
    promise: float = 0.1
    """Share of the best candidate's promise from which on another is fitted too."""
    structure: float = 3.0
    """Sureness with which a residual has to hang together in time for anything to be sought in
    it [standard deviations]."""
    sureness: float = 3.5
    """Lead from which on an effect is believed, on the runs fitted to or on those held out
    [standard deviations]."""
    held: float = 2.0
    """Lead that it needs on either."""
    visible: float = 2.0
    """By how much it has to lower the sum of squares, on the runs held out or on all [standard
    deviations of the sum of as many squares of noise]."""
    exchanges_stops: bool = True
    """Whether a part with stops is exchanged, too; not where what it leaves counts as noise, for
    in that what explains less does as well."""
    everywhere: float = inf
    """Lead on the runs fitted to and on those held out that will do in the place of any share
    [standard deviations]."""
    left: float = 1.5
    """Root mean square of a channel that a part with stops may leave [noise standard deviations];
    where it leaves more, what it leaves counts as noise while others are sought."""
    share: float = 0.4
    """Share of what is still to be explained that it has to explain; or else:"""
    base_share: float = 0.04
    """Share of what there was to explain at first that it has to explain; or else:"""
    channel_share: float = 0.3
    """Share of what there was to explain at first in one channel in which it hung together surely
    (`channel_sureness`)."""
    channel_whole: float = 0.85
    """Share of what is still to be explained in one such channel that will do, too: a law that is
    a little wrong elsewhere may leave more than a second effect ever did."""
    channel_sureness: float = 10.0
    """Mean product of a residual of that channel with itself a little later, over what white
    noise shows by chance [standard deviations]."""
    same: float = 10.0
    """Difference in twice the log-likelihood below which two hypotheses leave the same: more than
    that is very strong evidence (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995, 773)."""
    worth: float = 0.02
    """Share of the sum of squares below which further parameters are of little worth."""
    more: float = 0.1
    """Share of what a simpler hypothesis leaves that they have to explain even so."""
    tie: float = 2.0
    """Lead on held-out runs below which two hypotheses cannot be told apart."""
