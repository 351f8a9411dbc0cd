"""Sampler of hidden faults for one arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from loose_env.arms import Arm, LinearArm
from loose_env.envs.faults.difficulty import Difficulty
from loose_env.envs.faults.seats import (
    FurtherSeats,
    SeatMasses,
    direction_from,
    log_uniform,
    uniform,
)
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatDrive
from loose_env.faults import (
    DEFAULT_KINDS,
    KINDS,
    Backlash,
    Fault,
    Healthy,
    SeveralFaults,
    StructuralLooseness,
    place_of,
    places_of_kind,
)

__all__ = ["FaultSampler"]


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
    >>> from loose_env.arms import vera
    >>> sampler = FaultSampler(LinearArm(vera()), Difficulty())
    >>> sampler.draw(np.random.default_rng(0)).kind
    'structural_looseness'
    """

    def __init__(
        self, linear: LinearArm, difficulty: Difficulty, kinds: Sequence[str] = DEFAULT_KINDS
    ) -> None:
        self.arm: Arm = linear.arm
        self.difficulty = difficulty
        self.probabilities = self._with_a_place(difficulty.probabilities(kinds))
        self.drive = SeatDrive(linear, over=difficulty.friction_over)
        self.linear = linear
        """The nominal arm."""
        rng = np.random.default_rng(0)
        self._poses = [np.zeros(self.arm.n), *(self.arm.random_pose(rng) for _ in range(64))]
        self._masses = SeatMasses(linear, self._poses)

    def _with_a_place(self, shares: Mapping[str, float]) -> Mapping[str, float]:
        """Shares of the kinds that can be somewhere, of one together."""
        arm = self.arm
        found = {k: p for k, p in shares.items() if k == "healthy" or places_of_kind(arm, k)}
        if len(found) == len(shares):
            return shares
        total = sum(found.values())
        return {kind: share / total for kind, share in found.items()}

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
            places = places_of_kind(self.arm, kind)
            place = places[min(int(u[1] * len(places)), len(places) - 1)]
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
            here = weights * [place in places_of_kind(self.arm, k) for k in kinds]
            kind = kinds[int(rng.choice(len(kinds), p=here / here.sum()))]
            part = "joint" if kind == "backlash" else "link"
            faults.append(self.draw(rng, hypothesis=f"{kind}@{part}{place}"))
        return self.further.softened(SeveralFaults(faults=tuple(faults)))  # type: ignore[arg-type]
