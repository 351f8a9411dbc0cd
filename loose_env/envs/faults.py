"""Random draw of hidden faults, stops stiff enough to simulate; hypotheses in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from loose_env.arms import FASTEST_TURN, Arm, LinearArm
from loose_env.envs.settings import Difficulty
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import SeatDrive
from loose_env.faults import (
    KINDS,
    SEVERAL_FAULTS,
    UNSURE,
    Backlash,
    Fault,
    Healthy,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    hypotheses,
    hypothesis_at,
    parts_of,
    place_of,
    places_of_kind,
)
from loose_env.typing import Array, IndexArray

Stops = tuple[tuple[float, float], tuple[float, float]]
"""Stiffness, then damping, of the lower and the upper stop."""

_FASTEST = 0.85 * FASTEST_TURN  # leaves room for the mismatch of masses


class SeatMasses:
    """Effective masses of seats of the nominal arm, over many poses.

    A seat is given as a vector over the degrees of freedom of the linear arm; in the first pose
    the distal part is weighed.
    """

    def __init__(self, linear: LinearArm, poses: Sequence[Array]) -> None:
        self._step = linear.arm.timestep
        self._inertias = np.array([linear.at(pose).inertia for pose in poses])
        self._free = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        self._among = self._inertias[:, self._free[:, None], self._free]
        self._remembered: dict[bytes, Array] = {}

    @property
    def size(self) -> int:
        """Number of degrees of freedom of the linear arm."""
        return int(self._inertias.shape[1])

    def stops(self, seat: Array, modes: Array, ratios: Array) -> Stops:
        """Stops of a seat (nv,) loose in one way.

        From the modes [Hz] of the distal part on each stop with the rest held (2,), and from the
        damping ratios (2,) against the seat's effective mass.
        """
        own = np.flatnonzero(seat)
        along = seat[own]
        held = float(along @ self._inertias[0][np.ix_(own, own)] @ along)
        # The lightest the seat gets over many poses, with every joint free.
        reduced = float(np.min(np.einsum("i,pij,j->p", along, self._reduced(own), along)))
        stiffness = held * (2 * np.pi * modes) ** 2
        softest = reduced * (_FASTEST / self._step) ** 2
        stiffness = np.minimum(stiffness, softest)
        return _pair(stiffness), _pair(2 * ratios * np.sqrt(stiffness * reduced))

    def _reduced(self, seats: IndexArray) -> Array:
        """Inertia of some degrees of freedom with every joint free, in every pose (p, s, s)."""
        key = seats.tobytes()
        found = self._remembered.get(key)
        if found is None:
            across = self._inertias[:, self._free[:, None], seats]
            pull = across.transpose(0, 2, 1) @ np.linalg.solve(self._among, across)
            found = self._inertias[:, seats[:, None], seats] - pull
            self._remembered[key] = found
        return found

    def softening(self, seats: Array, stiffness: Array, damping: Array) -> float:
        """Factor on stiffness, and by its root on damping, that leaves seats slow enough together.

        At 1 they are slow enough as they are. Stiffness and damping (p,) are the larger ones of
        each seat's two stops.
        """
        mobility = self._mobility(seats)

        def fastest(diagonal: Array) -> float:
            root = np.sqrt(diagonal)
            return float(np.linalg.eigvalsh(root[:, None] * mobility * root).max())

        spring = fastest(stiffness * self._step**2)
        damper = fastest(2 * damping * self._step)
        # The largest eigenvalue of a sum is at most the sum of the largest ones. With s for the
        # root of the factor, spring s² + damper s stays below what explicit stepping bears.
        most = 4 * (_FASTEST / FASTEST_TURN) ** 2
        both = (np.sqrt(damper**2 + 4 * spring * most) - damper) / (2 * spring)
        return float(min(1.0, both**2, _FASTEST**2 / spring))

    def _mobility(self, seats: Array) -> Array:
        """Inverse of the inertia of seats with everything free, in every pose (poses, p, p)."""
        across = np.einsum("pij,aj->pia", self._inertias[:, self._free], seats)
        masses = np.einsum("ai,pij,bj->pab", seats, self._inertias, seats)
        masses -= across.transpose(0, 2, 1) @ np.linalg.solve(self._among, across)
        return np.asarray(np.linalg.inv(masses))


def _pair(values: Array) -> tuple[float, float]:
    return (float(values[0]), float(values[1]))


Vector = tuple[float, float, float]
Loose = Backlash | StructuralLooseness


def direction_from(turn: float, height: float, *, planar: bool) -> Vector:
    """Turn two uniform variates into a uniform direction: in the x-y plane, or in space."""
    angle = 2 * np.pi * turn
    z = 0.0 if planar else 2 * height - 1
    flat = np.sqrt(1 - z**2)
    return (float(flat * np.cos(angle)), float(flat * np.sin(angle)), float(z))


def uniform(limits: tuple[float, float], u: float) -> float:
    """Turn a uniform variate into one between two limits."""
    return limits[0] + (limits[1] - limits[0]) * float(u)


def log_uniform(limits: tuple[float, float], u: float) -> float:
    """Turn a uniform variate into a log-uniform one between two limits."""
    return float(np.exp(uniform((np.log(limits[0]), np.log(limits[1])), u)))


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
        self, linear: LinearArm, difficulty: Difficulty, kinds: Sequence[str] = KINDS
    ) -> None:
        self.arm: Arm = linear.arm
        self.difficulty = difficulty
        self.probabilities = self._with_a_place(difficulty.probabilities(kinds))
        self.drive = SeatDrive(linear, over=difficulty.friction_over)
        self.linear = linear
        """The nominal arm."""
        self._known = hypotheses(self.arm, everywhere=True)
        rng = np.random.default_rng(0)
        poses = [np.zeros(self.arm.n), *(self.arm.random_pose(rng) for _ in range(64))]
        self._masses = SeatMasses(linear, poses)

    def _with_a_place(self, shares: Mapping[str, float]) -> Mapping[str, float]:
        """Shares of the kinds that can be somewhere, of one together."""
        arm = self.arm
        found = {k: p for k, p in shares.items() if k == "healthy" or places_of_kind(arm, k)}
        if len(found) == len(shares):
            return shares
        total = sum(found.values())
        return {kind: share / total for kind, share in found.items()}

    def draw(self, rng: np.random.Generator, *, hypothesis: str | None = None) -> Fault:
        """Draw a fault, of one hypothesis if it is given.

        Every draw takes ten variates from ``rng``.

        Raises
        ------
        UnknownName
            If the arm has no such hypothesis.
        """
        if not (hypothesis is None or hypothesis in self._known):
            raise UnknownName(f"unknown hypothesis {hypothesis!r}; they are {list(self._known)}")
        d = self.difficulty
        u = rng.random(10)
        if hypothesis is None:
            kinds = [k for k in KINDS if self.probabilities.get(k, 0.0) > 0]
            edges = np.cumsum([self.probabilities[k] for k in kinds])
            kind = kinds[min(int(np.searchsorted(edges, u[0], side="right")), len(kinds) - 1)]
            places = places_of_kind(self.arm, kind)
            place = places[min(int(u[1] * len(places)), len(places) - 1)]
            hypothesis = hypothesis_at(kind, place) if kind != "healthy" else kind
        if hypothesis == "healthy":
            return Healthy()
        return self.fault(
            hypothesis,
            gap=log_uniform(d.gap, u[2]),
            ratio=log_uniform(d.friction, u[3]),
            modes=np.array([uniform(d.contact_mode, v) for v in u[4:6]]),
            damping=np.array([uniform(d.contact_damping, v) for v in u[6:8]]),
            direction=(u[8], u[9]),
        )

    def fault(
        self,
        hypothesis: str,
        *,
        gap: float,
        ratio: float,
        modes: Array,
        damping: Array,
        direction: tuple[float, float],
    ) -> Loose:
        """Play or a loose link by its parameters.

        Travel at the tool [m], friction over the seat drive [1], modes [Hz] (2,) and damping ratios
        (2,) of the stops, and two uniform variates of a slide's direction.
        """
        place, play = place_of(hypothesis) or 1, hypothesis.startswith("backlash")
        along = direction_from(*direction, planar=len(self.arm.axes) == 2)
        seat = self._seat(place, None if play else along)
        stiffness, dampers = self._masses.stops(seat, modes, damping)
        if play:
            return Backlash(
                joint=place,
                gap=gap if self.arm.sliding[place - 1] else gap / self.arm.reach,
                stiffness=stiffness,
                damping=dampers,
                friction=ratio * self.drive.hinge(place),
            )
        return StructuralLooseness(
            link=place,
            direction=along,
            gap=gap,
            stiffness=stiffness,
            damping=dampers,
            friction=ratio * self.drive.slide(place, along),
        )

    def _seat(self, place: int, along: Vector | None) -> Array:
        """Seat over all degrees of freedom (nv,): of a link along a direction, or of a joint."""
        seat = np.zeros(self._masses.size)
        if along is None:
            seat[self.linear.hinge_dofs[place - 1]] = 1.0
        else:
            slides = self.linear.slide_dofs[place - 1]
            seat[slides] = along[: len(slides)]
        return seat

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
        faults: list[Loose] = []
        for place in sorted(int(p) for p in places):
            here = weights * [place in places_of_kind(self.arm, k) for k in kinds]
            kind = kinds[int(rng.choice(len(kinds), p=here / here.sum()))]
            faults.append(self.draw(rng, hypothesis=hypothesis_at(kind, place)))  # type: ignore[arg-type]
        seats = [self._seat(f.place, getattr(f, "direction", None)) for f in faults]
        share = self._masses.softening(
            np.array(seats),
            np.array([max(f.stiffness) for f in faults]),
            np.array([max(f.damping) for f in faults]),
        )
        return SeveralFaults(faults=tuple(_softer(f, share) for f in faults))


def _softer(fault: Loose, share: float) -> Loose:
    """Multiply stiffness by a share, damping by its root: the damping ratios stay."""
    if share == 1:
        return fault
    (low, high), (slow, fast) = fault.stiffness, fault.damping
    root = float(np.sqrt(share))
    return replace(fault, stiffness=(share * low, share * high), damping=(root * slow, root * fast))


def hypothesis_words(hypothesis: str | None, *, past: bool = False) -> str:
    """Say a hypothesis, or what was the matter once the episode is over.

    Examples
    --------
    >>> hypothesis_words("structural_looseness@link2")
    'link 2 is loose'
    >>> hypothesis_words("backlash@joint1", past=True)
    'joint 1 had play'
    >>> hypothesis_words(None), hypothesis_words("unsure")
    ('no verdict', 'unsure')
    """
    if hypothesis is None:
        return "no verdict"
    if hypothesis == UNSURE:
        return "unsure"
    if hypothesis == SEVERAL_FAULTS:
        return f"there {'were' if past else 'are'} several faults"
    place = place_of(hypothesis)
    if place is None:
        return f"nothing {'was' if past else 'is'} loose"
    if hypothesis.startswith("backlash"):
        return f"joint {place} {'had' if past else 'has'} play"
    verb = "was" if past else "is"
    if hypothesis.startswith("rotational"):
        return f"link {place} {verb} loose and {'rocked' if past else 'rocks'}"
    if hypothesis.startswith("compound"):
        return f"link {place} {verb} loose in several directions"
    return f"link {place} {verb} loose"


def fault_words(fault: Fault, arm: Arm | None = None) -> str:
    """Say what was wrong with an arm, with the travel of the loose seat.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> from loose_env.faults import Healthy
    >>> fault_words(Healthy())
    'nothing was loose'
    >>> fault_words(Backlash(joint=3, gap=1e-4, stiffness=(1e5, 1e5)), scara())
    'joint 3 had play (0.1 mm)'
    """
    if isinstance(fault, SeveralFaults):
        return "; ".join(fault_words(one, arm) for one in fault.faults)
    words = hypothesis_words(fault.hypothesis, past=True)
    travel = ", ".join(t for t in (_travel(part, arm) for part in parts_of(fault)) if t)
    return f"{words} ({travel})" if travel else words


def _travel(part: Fault, arm: Arm | None) -> str:
    """Travel of one loose degree of freedom, in millimetres or degrees."""
    if isinstance(part, Backlash):
        slides = arm is not None and bool(arm.sliding[part.joint - 1])
        return f"{1e3 * part.gap:.2g} mm" if slides else f"{np.degrees(part.gap):.2g}°"
    if isinstance(part, RotationalLooseness):
        return f"{np.degrees(part.gap):.2g}°"
    return f"{1e3 * part.gap:.2g} mm" if isinstance(part, StructuralLooseness) else ""
