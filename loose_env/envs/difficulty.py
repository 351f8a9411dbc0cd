"""How hard the hidden faults are to find: ranges from which they are drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.arms.response.linear import LinearArm
from loose_env.arms.response.mismatch import Mismatch
from loose_env.envs.faults.compound_seats import FurtherSeats, direction_from, log_uniform, uniform
from loose_env.envs.faults.seat_stops import SeatMasses
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import SeatDrive
from loose_env.faults import (
    DEFAULT_KINDS,
    KINDS,
    Backlash,
    Fault,
    Healthy,
    SeveralFaults,
    StructuralLooseness,
    checked_kinds,
    place_of,
)

__all__ = ["DIFFICULTIES", "Difficulty", "FaultSampler", "difficulty_named"]

Range = tuple[float, float]
Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Difficulty:
    """Ranges of the hidden fault and of the model's mismatch."""

    friction: Range = (0.02, 1.0)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
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
    """How far the nominal model is off."""
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


class FaultSampler:
    """Draws hidden faults for one arm.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm; it says how hard each seat is driven and what mass it carries.
    difficulty : Difficulty
        Ranges to draw from.
    kinds : sequence of str
        Kinds of fault that are hypotheses.

    Raises
    ------
    InvalidSetting
        If the difficulty gives probability to a kind that is none of them.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms.library import vera
    >>> sampler = FaultSampler(LinearArm(vera()), Difficulty())
    >>> sampler.draw(np.random.default_rng(0)).kind
    'structural_looseness'
    """

    def __init__(
        self, linear: LinearArm, difficulty: Difficulty, kinds: Sequence[str] = DEFAULT_KINDS
    ) -> None:
        self.arm: Arm = linear.arm
        self.difficulty = difficulty
        self.probabilities = difficulty.probabilities(kinds)
        self.drive = SeatDrive(linear)
        self.linear = linear
        """The nominal arm."""
        rng = np.random.default_rng(0)
        self._poses = [np.zeros(self.arm.n), *(self.arm.random_pose(rng) for _ in range(64))]
        self._masses = SeatMasses(linear, self._poses)

    @cached_property
    def further(self) -> FurtherSeats:
        """Draws of rotational and compound looseness, made ready when first needed."""
        return FurtherSeats(self.linear, self.difficulty, self._poses)

    def draw(self, rng: np.random.Generator, *, hypothesis: str | None = None) -> Fault:
        """Draw a fault, of one hypothesis if it is given.

        Every draw takes ten variates from ``rng``; rotational and compound looseness takes
        sixteen more. How these are drawn is said at `FurtherSeats`.
        """
        d = self.difficulty
        u = rng.random(10)
        if hypothesis is None:
            kinds = [k for k in KINDS if self.probabilities.get(k, 0.0) > 0]
            edges = np.cumsum([self.probabilities[k] for k in kinds])
            kind = kinds[min(int(np.searchsorted(edges, u[0], side="right")), len(kinds) - 1)]
            place = 1 + min(int(u[1] * self.arm.n), self.arm.n - 1)
        else:
            name, _, _ = hypothesis.partition("@")
            kind, place = name, place_of(hypothesis) or 1  # type: ignore[assignment]
        if kind == "healthy":
            return Healthy()
        if kind == "rotational_looseness":
            return self.further.rotation(place, u, rng.random(16))
        if kind == "compound_looseness":
            return self.further.compound(place, u, rng.random(16))
        gap = log_uniform(d.gap, u[2])
        ratio = log_uniform(d.friction, u[3])
        modes = np.array([uniform(d.contact_mode, v) for v in u[4:6]])
        ratios = np.array([uniform(d.contact_damping, v) for v in u[6:8]])
        seat = np.zeros(self._masses.size)
        if kind == "backlash":
            seat[self.linear.hinge_dofs[place - 1]] = 1.0
            stiffness, damping = self._masses.stops(seat, modes, ratios)
            return Backlash(
                joint=place,
                gap=gap if self.arm.sliding[place - 1] else gap / self.arm.reach,
                stiffness=stiffness,
                damping=damping,
                friction=ratio * self.drive.hinge(place),
            )
        direction = direction_from(u[8], u[9], planar=len(self.arm.axes) == 2)
        slides = self.linear.slide_dofs[place - 1]
        seat[slides] = direction[: len(slides)]
        stiffness, damping = self._masses.stops(seat, modes, ratios)
        return StructuralLooseness(
            link=place,
            direction=direction,
            gap=gap,
            stiffness=stiffness,
            damping=damping,
            friction=ratio * self.drive.slide(place, direction),
        )

    def several(self, rng: np.random.Generator, count: int = 2) -> SeveralFaults:
        """Draw faults at ``count`` places of different numbers, kinds as likely as in `draw`.

        Each is drawn as it would be alone. Where their stops would be too fast for the step if
        all were touched at once, all are softened alike.

        Raises
        ------
        InvalidSetting
            If the arm has fewer joints, or every arm is healthy here.
        """
        kinds = [k for k in KINDS if k != "healthy" and self.probabilities.get(k, 0.0) > 0]
        if not 2 <= count <= self.arm.n or not kinds:
            raise InvalidSetting(
                f"several faults are 2 to {self.arm.n} on arm {self.arm.name!r}, of kinds that "
                f"come up (here {kinds}); got {count!r}"
            )
        weights = np.array([self.probabilities[k] for k in kinds])
        places = 1 + rng.permutation(self.arm.n)[:count]
        faults = []
        for place in sorted(int(p) for p in places):
            kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
            part = "joint" if kind == "backlash" else "link"
            faults.append(self.draw(rng, hypothesis=f"{kind}@{part}{place}"))
        return self.further.softened(SeveralFaults(faults=tuple(faults)))  # type: ignore[arg-type]
