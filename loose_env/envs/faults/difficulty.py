"""Difficulty of hidden faults: ranges from which they are drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import get_args

import numpy as np

from loose_env.arms import Mismatch
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import SeatReference
from loose_env.faults import DEFAULT_KINDS, KINDS, checked_kinds

__all__ = ["DIFFICULTIES", "Difficulty", "difficulty_named"]

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Difficulty:
    """Ranges of the hidden fault and of the model's mismatch.

    Examples
    --------
    >>> Difficulty(gap=(0.1e-3, 0.4e-3)).gap
    (0.0001, 0.0004)
    """

    friction: Range = (0.02, 1.0)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
    friction_over: SeatReference = "median"
    """Pose whose seat drive friction is compared to, the best single joint excited.

    "median" leaves some seats shut in most poses, a few of them in all. With "best" and friction
    below 1 every seat opens in some pose under some joint, gravity aside."""
    gap: Range = (0.02e-3, 0.4e-3)
    """Travel, log-uniform [m].

    Play in a joint that turns is this travel at the arm's full reach, in a joint that slides the
    travel itself; the angle of a rocking link is that of this travel at the tool."""
    contact_mode: Range = (300.0, 360.0)
    """Mode of the distal part on a stop with the rest held, uniform for each side [Hz].

    A stop is softer where its fastest local mode would outrun the simulation step."""
    contact_damping: Range = (0.05, 0.3)
    """Damping ratio of a stop against the seat's effective mass, uniform [1]."""
    mismatch: Mismatch = field(default_factory=Mismatch)
    """Model error of the nominal arm."""
    kinds: Mapping[str, float] | None = None
    """Probability of each kind of fault; places are uniform within a kind.

    None: equal for all kinds that are hypotheses, `DiagnosisSettings.kinds`."""

    def __post_init__(self) -> None:
        for name in ("friction", "gap", "contact_mode", "contact_damping"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise InvalidSetting(
                    f"difficulty {name} must be 0 < low <= high, got {(low, high)}"
                )
        if self.friction_over not in get_args(SeatReference):
            raise UnknownName(
                f"difficulty friction_over is one of {list(get_args(SeatReference))}, got "
                f"{self.friction_over!r}"
            )
        if self.kinds is None:
            return
        unknown = set(self.kinds) - set(KINDS)
        if unknown:
            raise UnknownName(f"unknown fault kind {sorted(unknown)}; kinds are {list(KINDS)}")
        values = list(self.kinds.values())
        if min(values, default=-1.0) < 0 or not np.isclose(sum(values), 1.0):
            raise InvalidSetting(
                f"probabilities of the kinds must be >= 0 and sum to 1, got {dict(self.kinds)}"
            )

    def probabilities(self, kinds: Sequence[str] = DEFAULT_KINDS) -> Mapping[str, float]:
        """Probability of each kind of fault where the given kinds are hypotheses.

        Raises
        ------
        InvalidSetting
            If a kind that comes up is none of the hypotheses.

        Examples
        --------
        >>> dict(Difficulty().probabilities(("healthy", "backlash")))
        {'healthy': 0.5, 'backlash': 0.5}
        """
        among = checked_kinds(kinds)
        if self.kinds is None:
            return MappingProxyType({kind: 1 / len(among) for kind in among})
        beyond = [k for k, share in self.kinds.items() if share > 0 and k not in among]
        if beyond:
            raise InvalidSetting(
                f"the difficulty hides {beyond}, but only {list(among)} are hypotheses: add these "
                "kinds to the settings' kinds, or give them no probability"
            )
        return self.kinds


DIFFICULTIES: Mapping[str, Difficulty] = MappingProxyType(
    {
        "easy": Difficulty(
            friction=(0.02, 0.2), gap=(0.1e-3, 0.4e-3), mismatch=Mismatch().scaled(0.3)
        ),
        "default": Difficulty(),
        "hard": Difficulty(friction=(0.1, 2.0), mismatch=Mismatch().scaled(1.5)),
        "reachable": Difficulty(friction=(0.1, 0.7), friction_over="best"),
    }
)
"""The named difficulties."""


def difficulty_named(difficulty: str | Difficulty) -> Difficulty:
    """Look up a difficulty by name; one given as such is returned.

    Raises
    ------
    UnknownName
        If there is no difficulty of that name.
    """
    if isinstance(difficulty, Difficulty):
        return difficulty
    if not isinstance(difficulty, str) or difficulty not in DIFFICULTIES:
        raise UnknownName(
            f"unknown difficulty {difficulty!r}; named ones are {list(DIFFICULTIES)}, or give a "
            "Difficulty"
        )
    return DIFFICULTIES[difficulty]
