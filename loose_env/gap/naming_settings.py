"""When an effect counts as found, and how much is tried."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

__all__ = ["NamingSettings"]


@dataclass(frozen=True, kw_only=True)
class NamingSettings:
    """When an effect counts as found."""

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
