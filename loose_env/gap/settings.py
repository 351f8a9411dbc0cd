"""Settings of `loose gap` and of its effect search, and its decision thresholds.

Of the thresholds: shares are of sums of squares; z-scores are in standard deviations over blocks of
time; residuals are in noise standard deviations of their channel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import inf
from numbers import Real

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.gap.core.tolerances import Tolerances

# Preparation
CHAOTIC_SHARE = 0.3
"""Share of a random run's incoherent part that a nudge redraws, from which the run counts as
chaotic: its samples carry no information then."""
CHAOTIC_POWER = 2.0
"""Incoherent power of such a run over that of the nominal model, noise in both; below, samples tell
more than features."""
MOVING = 30.0
"""Range of a joint's motion from which it counts as moved [standard deviations of its noise]."""
SPARE_BLOCKS = 1.5
"""Blocks of time wanted over the z² that a z-score of z takes at least."""
STEP_ERROR = 0.1
"""Integration error sought [noise standard deviations]: well below the noise."""
OWN_STEP_ERROR = 0.3
"""Integration error up to which the model's own step and integrator stay, where they are cheaper
[noise standard deviations]; above, the reader is warned."""

# Search
SCREENING_S = 6.0
"""Length of the windows on which candidates are screened, in all [s]; more where runs are many."""
SCREENING_RUNS = 6
"""Runs with a window each for that, where there are as many."""
SEARCH_Z = 3.0
"""Autocorrelation (z) of a residual below which it is white and nothing is searched in it."""
FITTED_CANDIDATES = 7
"""Candidates fitted to the windows, by predicted explained variance: a matter of cost."""
ALTERNATIVES = 4
"""Alternatives fitted to the windows: pairs, and what may take the place of an effect; cost."""
LEADING = 3
"""Leading candidates that are fitted from a second start, where there is one as good, and to all
search data; most effects of an answer for which swaps are fitted whatever they promise: cost."""
FURTHER = 2
"""Further ones, each for a reason of its own: by predicted z-score (small effects that act in every
block of time), kinds at several locations, sets for all search data, what is confusable with the
best, what lies at the same joint; effects that seem to be needed least, for a refit without
each; cost."""
LEAST_PREDICTED = 0.1
"""Predicted explained variance of a candidate over that of the best one, from which it is
fitted."""
SECOND_START = 0.5
"""Predicted explained variance of a second start over that of the first, from which it is kept."""
HOPELESS_COST = 2.0
"""Cost on the windows over that of the best candidate, from which one is dropped, if the best is
also better by `ACCEPTED_Z`."""
NEAR_COST = 1.25
"""The same for a fit to all search data."""
SINGLE_SHARE = 0.1
"""Share of the autocorrelated residual that the best single effect leaves, above which sets of
effects are fitted, too, where that is this share of the nominal model's, or above the noise: a
smaller second effect is found beside the first."""
SHARE_IN_SET = 0.05
"""Share of the sum of squares left without it that each effect of a proposed set explains at least:
as much as laws that are slightly off leave."""

# Acceptance
ACCEPTED_Z = 3.5
"""Larger of the z-scores on training and held-out runs from which an improvement is accepted: many
candidates are compared."""
CONFIRMED_Z = 2.0
"""Smaller of these z-scores: seen in both data sets."""
VISIBLE_FALL = 2.0
"""Fall of the sum of squares [standard deviations of a sum of as many squares of noise]."""
ACCEPTED_SHARE = 0.4
"""Share of the residual that an effect explains at least, or:"""
ACCEPTED_SHARE_OF_NOMINAL = 0.04
"""Share of the nominal model's autocorrelated residual, or:"""
CHANNEL_SHARE_OF_NOMINAL = 0.3
"""Share of it in one channel in which it is clearly autocorrelated, or:"""
CHANNEL_SHARE = 0.85
"""Share of the current residual in one such channel: a slightly wrong law elsewhere may leave more
than a second effect ever did."""
CHANNEL_Z = 10.0
"""Autocorrelation (z) of such a channel."""
FRICTION_LAW = 0.03
"""Friction over a larger one at the same joint, below which it is an error of that one's law: oil
thins as it is sheared, seals warm up."""
MASS_DISTRIBUTION = 0.1
"""Mass over that of a flexible link, below which it is an error of the mass distribution assumed
there."""
OWN_GAIN = 0.5
"""Share of an effect's gain that is its own: not that of its rigid limit, nor below the noise."""
EQUAL_LOG_LIKELIHOOD = 10.0
"""Difference in twice the log-likelihood below which two hypotheses are equal: above is very strong
evidence (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995, 773)."""
WORTH_PARAMETERS = 0.02
"""Share of the sum of squares below which further parameters are not worth it."""
WORTH_SHARE = 0.1
"""Share of a simpler hypothesis' residual that they explain even so."""
TIE_Z = 2.0
"""Improvement (z) on held-out runs below which two hypotheses are not distinguishable."""

# Deletion test
WORSE = 1.02
"""Error of a quantity on held-out runs with an answer over that without, above which it predicts
worse and is not given: rounding and the fit of initial states make less."""
WORSE_BY_IMPACTS = 1.45
"""The same of accelerations and forces beside parts with stops: two signals that are equally strong
and mistimed differ by the root of two."""
AT_BOUND = 0.001
"""Distance to a bound over the width of both, in free numbers, within which a parameter sits at
it."""

# Verdict and intervals
UNEXPLAINED_Z = 4.0
"""Autocorrelation (z) of a residual above which something is missing: stricter than to search."""
NOISE_RMS = 1.25
"""Residual up to which it counts as noise [noise standard deviations]: error of the noise
estimate."""
IMPACT_DOMINATED = 0.25
"""Autocorrelated share of what exceeds the noise, below which impacts dominate: these are not
autocorrelated."""
EXPLAINED = 0.88
"""Share of the residual from which the effects explain it together, and all are named; below, those
that explain `MATERIAL` of it somewhere: a law slightly off leaves a few percent, a proxy
more."""
MATERIAL = 0.8
"""Share of the residual without it, in all or in one channel, from which an effect is named
whatever else is missing: stand-ins for effects outside the catalogue explained 0.58 to 0.69 in
development cases, true effects beside others 0.85 and more."""
NAMED_PROBABILITY = 0.5
"""Probability of an effect, or of one that held-out runs do not tell from it, below which it is
doubtful: as likely as not. What stands in for a law that is slightly off passes every test and is
rarely this probable."""
EXPLAINED_BY_IMPACTS = 0.45
"""Share of it somewhere from which a part with stops is named: a mistimed impact counts twice."""
NARROWEST_INTERVAL = 0.005
"""Narrowest half interval over the value: no law of the catalogue is closer to a machine's."""
REFUTED_Z = 2.0
"""Improvement (z) over a value from which it lies outside the 95 % interval."""
IDENTIFIABLE_Z = 5.0
"""Length of a signature, or of what separates two, to be identifiable [standard deviations]: a
margin over `ACCEPTED_Z`."""
RIVAL_SHARE = 0.05
"""Share of the residual that a rival may leave beyond an identified effect, and still compete with
it."""

# Impacts and export
IMPACT_RMS = 1.5
"""Residual of a channel beside stops above which it counts as noise while the search goes on [noise
standard deviations]: it masks other effects."""
SUFFICIENT_Z = 5.0
"""Improvement (z) on training and held-out runs that is accepted there whatever its share: what a
proxy explains does not show in nearly every block of time."""
IMPACT_WINDOW_S = 0.05
"""Stretches over which impact power is computed [s]: independent of the moment of an impact."""
IMPACT_PREDICTED = 0.5
"""Share of the impact power that a start explains by itself, from which it is fitted."""
IMPACT_EXPLAINED = 0.85
"""Share of the impact power of held-out runs that identifies a part with stops."""
EXPORT_ERROR = 0.3
"""Departure of the exported file from the fit in a channel [noise standard deviations], or:"""
EXPORT_ERROR_SHARE = 0.1
"""Share of the residual there, where that is more."""

# Diagnostics
DEPENDENCE_Z = 3.0
"""z-score from which a dependence of a residual on motion or load is reported."""
DEPENDENCE_SHARE = 0.05
"""Share of a residual's power from which it is."""
DEPENDENCE_RMS = 0.15
"""Explained part from which it is, in the corrected model [noise standard deviations]."""
VISIBLE_RMS = 1.2
"""Residual of a channel from which it is reported [noise standard deviations], or:"""
SIMPLER_DEPENDENCE = 0.85
"""Share of the strongest dependence from which a simpler one is reported instead."""

# Bounds of the settings
_MOST_THREADS = 10_000


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of the comparison of a recording with its model.

    Examples
    --------
    >>> GapSettings(threads=-1)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: threads is a whole number, 0 to 10000, got -1
    """

    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered, such as coulomb_friction; by default the whole
    catalogue."""
    held_out: tuple[str, ...] = ()
    """Runs kept out of everything and predicted at the end: their files, or the beginning of their
    names. By default every run is held out once, in turn."""
    simulate: bool = True
    """Whether full simulation decides among the leading sets of effects, where there are
    commands; without it the force balance alone decides, in a fraction of the time."""
    threads: int = 0
    """Threads of the simulation; 0 for all processors."""
    tolerances: Tolerances = field(default_factory=Tolerances)
    """Standard deviations of what the nominal model states."""

    def __post_init__(self) -> None:
        """Check the values."""
        whole = isinstance(self.threads, int | np.integer) and not isinstance(self.threads, bool)
        if not (whole and 0 <= self.threads <= _MOST_THREADS):
            raise InvalidSetting(
                f"threads is a whole number, 0 to {_MOST_THREADS}, got {self.threads!r:.60}"
            )
        for name in ("kinds", "held_out"):
            value = getattr(self, name)
            listed = isinstance(value, tuple | list)
            if not (listed and all(isinstance(each, str) for each in value)):
                raise InvalidSetting(f"{name} is a tuple of words, got {value!r:.60}")
        for each in fields(self.tolerances):
            value = getattr(self.tolerances, each.name)
            if not (_is_number(value) and 0 < value < inf):
                raise InvalidSetting(f"tolerance {each.name} is a number above 0, got {value!r}")


def _is_number(value: object) -> bool:
    """Return whether a value is a number, and no bool."""
    return isinstance(value, Real) and not isinstance(value, bool)


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Parts of the effect search that differ between its passes.

    All other criteria are the constants above.
    """

    most_effects: int = 3
    """Most effects in the model."""
    sufficient_z: float = inf
    """Improvement (z) on training and held-out runs that is accepted whatever its share [standard
    deviations over blocks]."""
    swaps: bool = True
    """Whether confusable effects are swapped for those found; not where time matters most."""
    swap_stops: bool = True
    """Whether swaps are tried for a part with stops; not where its residual counts as noise, in
    which an effect that explains less fits as well."""
