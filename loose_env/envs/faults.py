"""Random draw of hidden faults, stops stiff enough to simulate; hypotheses in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

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

_FASTEST = 0.85 * FASTEST_TURN  # leaves room for the mismatch of masses


class SeatMasses:
    """Effective masses of seats of the nominal arm, over many poses.

    In the first pose the distal part is weighed.
    """

    def __init__(self, linear: LinearArm, poses: Sequence[Array]) -> None:
        self._step = linear.arm.timestep
        self.inertias = np.array([linear.at(pose).inertia for pose in poses])
        """Inertia matrix of the linear arm in every pose (poses, nv, nv)."""
        self._free = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        self._among = self.inertias[:, self._free[:, None], self._free]
        slides, hinges = linear.slide_dofs, linear.hinge_dofs[:, None]
        self._held = [self.inertias[0][own[:, None], own] for own in slides]
        self._reduced = np.array([self._released(own) for own in slides])
        at = hinges[:, 0]
        # Of each joint's play: held in the first pose, and the lightest over all poses.
        self._held_play = self.inertias[0][at, at]
        self._least_play = np.array([self._released(own).min() for own in hinges])

    def stops(self, places: IndexArray, along: Array, modes: Array, ratios: Array) -> Array:
        """Stiffness, then damping, of the lower and the upper stop of B seats (B, 2, 2).

        Each is the play of a joint where its direction (B, s) is zero, else a slide of a link.
        From the modes [Hz] of the distal part on each stop with the rest held (B, 2), and from the
        damping ratios (B, 2) against the seat's effective mass.
        """
        held, reduced = self._held_play[places - 1], self._least_play[places - 1]
        rows = np.flatnonzero(along.any(axis=1))
        u = along[rows]
        held[rows] = [own @ self._held[k - 1] @ own for own, k in zip(u, places[rows], strict=True)]
        # The lightest the seat gets over many poses, with every joint free. Written out, so that
        # the order of a sum never depends on the number of seats.
        masses, axes = self._reduced[places[rows] - 1], range(along.shape[1])
        light: Any = sum(
            u[:, i, None] * masses[..., i, j] * u[:, j, None] for i in axes for j in axes
        )
        reduced[rows] = light.min(axis=-1)
        stiffness = held[:, None] * (2 * np.pi * modes) ** 2
        softest = reduced * (_FASTEST / self._step) ** 2
        stiffness = np.minimum(stiffness, softest[:, None])
        return np.stack([stiffness, 2 * ratios * np.sqrt(stiffness * reduced[:, None])], axis=1)

    def _released(self, seats: IndexArray) -> Array:
        """Inertia of some degrees of freedom with every joint free, in every pose (p, s, s)."""
        across = self.inertias[:, self._free[:, None], seats]
        pull = across.transpose(0, 2, 1) @ np.linalg.solve(self._among, across)
        return np.asarray(self.inertias[:, seats[:, None], seats] - pull)

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
        across = np.einsum("pij,aj->pia", self.inertias[:, self._free], seats)
        masses = np.einsum("ai,pij,bj->pab", seats, self.inertias, seats)
        masses -= across.transpose(0, 2, 1) @ np.linalg.solve(self._among, across)
        return np.asarray(np.linalg.inv(masses))


Loose = Backlash | StructuralLooseness


def directions_from(turn: Array, height: Array, *, planar: bool) -> Array:
    """Turn uniform variates (B,) into uniform directions (B, 3): in the x-y plane, or in space."""
    angle = 2 * np.pi * turn
    z = np.zeros(len(turn)) if planar else 2 * height - 1
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=-1)


def uniform(limits: tuple[float, float], u: Array) -> Array:
    """Turn uniform variates into ones between two limits."""
    return limits[0] + (limits[1] - limits[0]) * u


def log_uniform(limits: tuple[float, float], u: Array) -> Array:
    """Turn uniform variates into log-uniform ones between two limits."""
    return np.asarray(np.exp(uniform((np.log(limits[0]), np.log(limits[1])), u)))


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
        kinds = [kind for kind in KINDS if self.probabilities.get(kind, 0.0) > 0]
        self._edges = np.cumsum([self.probabilities[kind] for kind in kinds])
        names = hypotheses(self.arm)
        self._choices = [[n for n in names if n.partition("@")[0] == kind] for kind in kinds]
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
        return self.draw_all([rng], [hypothesis])[0]

    def draw_all(
        self, rngs: Sequence[np.random.Generator], wanted: Sequence[str | None]
    ) -> list[Fault]:
        """Draw from each of B generators, as `draw`."""
        if unknown := [name for name in wanted if not (name is None or name in self._known)]:
            raise UnknownName(f"unknown hypothesis {unknown[0]!r}; they are {list(self._known)}")
        d, u = self.difficulty, np.array([rng.random(10) for rng in rngs]).reshape(-1, 10)
        chosen = np.searchsorted(self._edges, u[:, 0], side="right")
        among = [self._choices[k] for k in np.minimum(chosen, len(self._choices) - 1).tolist()]
        shares = u[:, 1].tolist()
        return self.faults(
            [
                own[min(int(share * len(own)), len(own) - 1)] if name is None else name
                for name, own, share in zip(wanted, among, shares, strict=True)
            ],
            gap=log_uniform(d.gap, u[:, 2]),
            ratio=log_uniform(d.friction, u[:, 3]),
            modes=uniform(d.contact_mode, u[:, 4:6]),
            damping=uniform(d.contact_damping, u[:, 6:8]),
            direction=u[:, 8:],
        )

    def faults(
        self,
        names: Sequence[str],
        *,
        gap: Array,
        ratio: Array,
        modes: Array,
        damping: Array,
        direction: Array,
    ) -> list[Fault]:
        """Faults of B hypotheses by their parameters; a healthy arm depends on none.

        Travel at the tool [m] and friction over the seat drive [1] (B,), modes [Hz] and damping
        ratios of the stops (B, 2), and two uniform variates of a slide's direction (B, 2).
        """
        arm, places = self.arm, np.array([place_of(name) or 1 for name in names], dtype=np.intp)
        slides = np.array([name.startswith("structural") for name in names], dtype=bool)
        along = directions_from(*direction.T, planar=len(arm.axes) == 2)
        axes = self.linear.slide_dofs.shape[1]
        felt = np.where(slides[:, None], along[:, :axes], 0.0)
        stops = self._masses.stops(places, felt, modes, damping).tolist()
        friction = self.drive.hinges[places - 1]
        friction[slides] = self.drive.slide(places[slides], along[slides])
        travel = np.where(slides | arm.sliding[places - 1], gap, gap / arm.reach)
        found: list[Fault] = []
        rows = zip(names, places.tolist(), along.tolist(), strict=True)
        for k, (name, place, towards) in enumerate(rows):
            if name == "healthy":
                found.append(Healthy())
                continue
            seat: dict[str, Any] = {
                "gap": float(travel[k]),
                "stiffness": tuple(stops[k][0]),
                "damping": tuple(stops[k][1]),
                "friction": float(ratio[k] * friction[k]),
            }
            loose = (
                StructuralLooseness(link=place, direction=tuple(towards), **seat)
                if slides[k]
                else Backlash(joint=place, **seat)
            )
            found.append(loose)
        return found

    def _seat(self, fault: Loose) -> Array:
        """Seat of a fault over all degrees of freedom (nv,)."""
        seat = np.zeros(self._masses.inertias.shape[1])
        if isinstance(fault, Backlash):
            seat[self.linear.hinge_dofs[fault.joint - 1]] = 1.0
        else:
            slides = self.linear.slide_dofs[fault.link - 1]
            seat[slides] = fault.direction[: len(slides)]
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
        share = self._masses.softening(
            np.array([self._seat(f) for f in faults]),
            np.array([max(f.stiffness) for f in faults]),
            np.array([max(f.damping) for f in faults]),
        )
        return SeveralFaults(faults=tuple(_softer(f, share) for f in faults))


def _softer(fault: Loose, share: float) -> Loose:
    """Multiply stiffness by a share, damping by its root: the damping ratios stay."""
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
    if hypothesis is None or hypothesis == UNSURE:
        return hypothesis or "no verdict"
    is_, has, rocks = ("was", "had", "rocked") if past else ("is", "has", "rocks")
    if hypothesis == SEVERAL_FAULTS:
        return f"there {'were' if past else 'are'} several faults"
    place = place_of(hypothesis)
    if place is None:
        return f"nothing {is_} loose"
    if hypothesis.startswith("backlash"):
        return f"joint {place} {has} play"
    return f"link {place} {is_} loose" + f" and {rocks}" * hypothesis.startswith("rotational")


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
