"""Settings of the diagnosis environment: named difficulties, rewards and prices, choices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
from annotated_types import MinLen, Predicate

from loose_env.arms import Drift, Mismatch
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import SeatReference
from loose_env.faults import KINDS, UNSURE, FaultKind, checked_kinds
from loose_env.io import Checked, Count, NonNegative, Positive, Rule
from loose_env.sensors import SensorSuite

Range = Annotated[
    tuple[Positive, Positive],
    Rule("two finite numbers, 0 < low <= high", (Predicate(lambda ends: ends[0] <= ends[1]),)),
]


@dataclass(frozen=True, kw_only=True)
class Difficulty(Checked):
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
    travel itself."""
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
        super().__post_init__()
        if self.kinds is None:
            return
        checked_kinds(("healthy", *(kind for kind in self.kinds if kind != "healthy")))
        values = list(self.kinds.values())
        if min(values, default=-1.0) < 0 or not np.isclose(sum(values), 1.0):
            raise InvalidSetting(
                f"probabilities of the kinds must be >= 0 and sum to 1, got {dict(self.kinds)}"
            )

    def probabilities(self, kinds: Sequence[str] = KINDS) -> Mapping[str, float]:
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


def refuse_unknown(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that there are not."""
    if unknown := sorted(set(given) - set(known), key=str):
        raise UnknownName(f"unknown {what} {unknown}; known are {list(known)}")


Engine = Literal["mujoco", "reduced"]
"""Simulation engine of the arms."""


@dataclass(frozen=True, kw_only=True)
class Prices(Checked):
    """Rewards of verdicts and prices of measurements.

    At these prices it pays to be unsure where the best verdict is right with less than 37.5 %:
    there p * correct + (1 - p) * wrong falls below -0.25.
    """

    correct: float = 1.0
    """Reward for naming the right hypothesis."""
    wrong: float = -1.0
    """Reward for naming a wrong one, where the two below do not say otherwise."""
    false_alarm: float | None = None
    """Reward for naming a fault on a healthy arm; None: as `wrong`."""
    miss: float | None = None
    """Reward for calling a faulty arm healthy; None: as `wrong`."""
    unsure: float = -0.25
    """Reward for the verdict "unsure", whatever the truth: nothing is named."""
    record: NonNegative = 0.05
    """Price of one record."""
    second: NonNegative = 0.02
    """Price of one second of excitation."""
    level: NonNegative = 0.002
    """Price of one joint excited one level up, per record."""
    move: NonNegative = 0.0
    """Price of one joint moved before a record."""

    def verdict(self, named: str, truth: str) -> float:
        """Reward of a verdict.

        Parameters
        ----------
        named : str
            A hypothesis, or "unsure".
        truth : str
            Hypothesis under which the true arm falls. One that no verdict can name leaves every
            name wrong.

        Examples
        --------
        >>> prices = Prices(miss=-2.0)
        >>> prices.verdict("healthy", "several_faults"), prices.verdict("unsure", "healthy")
        (-2.0, -0.25)
        """
        if named == UNSURE:
            return self.unsure
        if named == truth:
            return self.correct
        if truth == "healthy" and self.false_alarm is not None:
            return self.false_alarm
        if named == "healthy" and self.miss is not None:
            return self.miss
        return self.wrong


_MOVES = Rule("finite degrees, 0 among them", (Predicate(lambda moves: 0.0 in moves),))
_DURATIONS = Rule("positive seconds, one or more", (MinLen(1),))


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings(Checked):
    """Everything about the environment but the arm itself.

    Examples
    --------
    >>> DiagnosisSettings(difficulty="hard", max_records=3).max_records
    3
    """

    difficulty: str | Difficulty = "default"
    """Ranges of the hidden faults: "easy", "default", "hard" or a Difficulty."""
    kinds: tuple[FaultKind, ...] = KINDS
    """Kinds of fault that are hypotheses, "healthy" always; their order does not matter."""
    prices: Prices = field(default_factory=Prices)
    """Rewards and prices."""
    max_records: Count = 12
    """Records an episode may take; after the last one only a verdict is left."""
    unsure_after: Count = 3
    """Measured records before "unsure" may be said; one is enough once the records have run out.

    At the default prices three make giving up blindly (-0.42) worth less than naming "healthy"
    blindly (-0.39)."""
    moves: Annotated[tuple[float, ...], _MOVES] = (-90.0, -45.0, 0.0, 45.0, 90.0)
    """Relative moves a joint can make before a record [deg]. A joint that slides goes in
    proportion through its range: 90 degrees are half of it."""
    max_excited: Count | None = None
    """Joints excited in one record; None: all of them may be. 1 is one exciter, as a workshop has.

    With fewer than the arm has joints, an action has an entry for each exciter in place of one for
    each joint."""
    max_moved: Count | None = None
    """Joints moved before one record; None: all of them may be.

    With fewer than the arm has joints, an action has an entry for each of the moves in place of
    one for each joint."""
    durations: Annotated[tuple[Positive, ...], _DURATIONS] = (0.2, 0.4, 1.2)
    """Record lengths to choose from [s]."""
    sensors: SensorSuite = field(default_factory=SensorSuite)
    """Sensors of the arm."""
    drift: Drift = field(default_factory=Drift)
    """Drift of joint zeros and drive gains of the true arm between records; none by default."""
    engine: Engine = "mujoco"
    """Simulation engine: MuJoCo's batched one, or "reduced", the same equations about
    the pose in a compiled loop: over 20 times faster, for faults of one degree of freedom. It
    needs numba."""
    rhythm: bool = False
    """True for a block in each record of how loudly it rang above the excited band, and how well
    knocks of each seat would explain it; see `loose_env.diagnosis.KnockRhythm`. The agent
    `rhythm` reads it."""
    raw: bool = False
    """True for an observation that is a Dict with the latest record's signals beside the
    statistics, and `info` carries the measurement itself."""

    def __post_init__(self) -> None:
        difficulty_named(self.difficulty).probabilities(self.kinds)
        object.__setattr__(self, "kinds", checked_kinds(self.kinds))
        super().__post_init__()

    @property
    def stay(self) -> int:
        """Index of the move that leaves a joint where it is."""
        return self.moves.index(0.0)
