"""Random draw of hidden faults, stops stiff enough to simulate; hypotheses in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np

from loose_env.arms import FASTEST_TURN, Arm, LinearArm
from loose_env.envs.settings import Difficulty
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatDrive
from loose_env.faults import (
    DEFAULT_KINDS,
    KINDS,
    SEVERAL_FAULTS,
    UNSURE,
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    LooseFault,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    part_seats,
    parts_of,
    place_of,
    places_of_kind,
    twist_of,
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

    def stops_together(self, seats: Array, modes: Array, ratios: Array) -> tuple[Stops, ...]:
        """Stops of a seat that is loose in several ways at once.

        The effective mass of each part is that with all other parts free. Where parts that rest
        on their stops together would be too fast for the step, all stops are softened alike.
        Seats (p, nv), modes and ratios (p, 2), as for `stops`.
        """
        held = np.einsum("ai,ij,aj->a", seats, self._inertias[0], seats)
        mobility = self._mobility(seats)
        lightest = 1 / np.einsum("paa->pa", mobility).max(axis=0)
        stiffness = held[:, None] * (2 * np.pi * modes) ** 2
        stiffness = np.minimum(stiffness, lightest[:, None] * (_FASTEST / self._step) ** 2)
        root = np.sqrt(stiffness.max(axis=1))
        turn = self._step**2 * np.linalg.eigvalsh(root[:, None] * mobility * root).max()
        stiffness = stiffness * min(1.0, _FASTEST**2 / float(turn))
        damping = 2 * ratios * np.sqrt(stiffness * lightest[:, None])
        return tuple((_pair(k), _pair(c)) for k, c in zip(stiffness, damping, strict=True))

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


Part = StructuralLooseness | RotationalLooseness
Vector = tuple[float, float, float]

PIVOT = (0.025, 0.075)
"""Distance of a rocking axis from the joint, over the arm's reach: 2 to 6 cm for 0.8 m, where
a flange has its bolts and edges. Estimates."""
SHORTEST_LEVER = 0.1
"""Least distance from a seat to the tool that turns a travel into an angle, over the reach."""

_OPEN = ((1.0, 1.0), (0.0, 0.0))  # stops of a part while its own are not known yet


class FurtherSeats:
    """Draws rotational and compound looseness for one arm.

    A rotation's axis is uniform on the sphere, for an arm in the plane its normal. It passes
    the joint at a distance out of `PIVOT`, in a uniform direction: about the joint's own axis
    the rocking of an arm in the plane would be play of the joint. The travel is drawn as for a
    slide and is that at the tool: the angle is the travel over the largest distance that the tool
    has from the link's frame, or over `SHORTEST_LEVER` times the reach if that is more. A
    compound seat has two slides across each other or a slide and a rotation, as likely; its two
    parts have gap, friction and stops of their own.
    """

    def __init__(self, linear: LinearArm, ranges: Difficulty, poses: Sequence[Array]) -> None:
        self.arm = arm = linear.arm
        self.ranges = ranges
        self._linear = full = LinearArm(arm, points=len(linear.frequency), rotations=True)
        self.drive = SeatDrive(full, over=ranges.friction_over)
        self._masses = SeatMasses(full, poses)
        self._levers = np.maximum(_tool_distances(linear, poses), SHORTEST_LEVER * arm.reach)

    def rotation(self, link: int, u: Array, v: Array) -> RotationalLooseness:
        """Turn uniform variates into a rocking link: ``u`` (10,) as for a slide, ``v`` (16,)."""
        return self._finished([self._rotation(link, u, v)], [u])[0]  # type: ignore[return-value]

    def compound(self, link: int, u: Array, v: Array) -> CompoundLooseness:
        """Turn uniform variates into a link loose in two ways: as `rotation`."""
        planar = len(self.arm.axes) == 2
        first = self._slide(link, u, direction_from(u[8], u[9], planar=planar))
        w = v[6:]
        second: Part
        if v[3] < 0.5:
            second = self._slide(link, w, _across(first.direction, w[8], planar=planar))
        else:
            second = self._rotation(link, w, v)
        return CompoundLooseness(link=link, parts=tuple(self._finished([first, second], [u, w])))

    def softened(self, faults: SeveralFaults) -> SeveralFaults:
        """Soften the stops of all faults alike where they are too fast for the step together."""
        parts = parts_of(faults)
        links, _ = part_seats(faults)
        seats = np.zeros((len(parts), self._masses.size))
        for seat, part, link in zip(seats, parts, links, strict=True):
            seat[self._linear.twist_dofs[link - 1]] = twist_of(self.arm, part)
        stops = [part for part in parts if not isinstance(part, (Healthy, Preload))]
        share = self._masses.softening(
            seats,
            np.array([max(part.stiffness) for part in stops]),
            np.array([max(part.damping) for part in stops]),
        )
        if share == 1:
            return faults
        return replace(faults, faults=tuple(_softer(one, share) for one in faults.faults))

    def _slide(self, link: int, u: Array, direction: Vector) -> StructuralLooseness:
        gap = log_uniform(self.ranges.gap, u[2])
        return StructuralLooseness(link=link, direction=direction, gap=gap, stiffness=_OPEN[0])

    def _rotation(self, link: int, u: Array, v: Array) -> RotationalLooseness:
        arm = self.arm
        planar = len(arm.axes) == 2
        joint = arm.model.joint(arm.joints[link - 1])
        anchor = np.zeros(3) if arm.sliding[link - 1] else joint.pos
        away = np.array(direction_from(v[0], v[1], planar=planar))
        pivot = anchor + uniform(PIVOT, v[2]) * arm.reach * away
        return RotationalLooseness(
            link=link,
            axis=(0.0, 0.0, 1.0) if planar else direction_from(u[8], u[9], planar=False),
            gap=log_uniform(self.ranges.gap, u[2]) / float(self._levers[link - 1]),
            stiffness=_OPEN[0],
            pivot=(float(pivot[0]), float(pivot[1]), float(pivot[2])),
        )

    def _finished(self, parts: Sequence[Part], variates: Sequence[Array]) -> list[Part]:
        """Give parts of one seat their stops and friction."""
        arm, ranges, link = self.arm, self.ranges, parts[0].link
        twists = [twist_of(arm, part) for part in parts]
        seats = np.zeros((len(parts), self._masses.size))
        seats[:, self._linear.twist_dofs[link - 1]] = twists
        modes = np.array([[uniform(ranges.contact_mode, x) for x in u[4:6]] for u in variates])
        ratios = np.array([[uniform(ranges.contact_damping, x) for x in u[6:8]] for u in variates])
        stops = self._masses.stops_together(seats, modes, ratios)
        frictions = [
            log_uniform(ranges.friction, u[3]) * self.drive.twist(link, twist)
            for u, twist in zip(variates, twists, strict=True)
        ]
        return [
            _with(part, stop, friction)
            for part, stop, friction in zip(parts, stops, frictions, strict=True)
        ]


def _softer(fault: LooseFault, share: float) -> LooseFault:
    """Multiply stiffness by a share, damping by its root: the damping ratios stay."""
    if isinstance(fault, CompoundLooseness):
        parts = tuple(_softer(part, share) for part in fault.parts)
        return replace(fault, parts=parts)  # type: ignore[arg-type]
    (low, high), (slow, fast) = fault.stiffness, fault.damping
    root = float(np.sqrt(share))
    return replace(fault, stiffness=(share * low, share * high), damping=(root * slow, root * fast))


def _with(part: Part, stops: Stops, friction: float) -> Part:
    figures = {"stiffness": stops[0], "damping": stops[1], "friction": friction}
    return type(part)(**{**vars(part), **figures})


def _tool_distances(linear: LinearArm, poses: Sequence[Array]) -> Array:
    """Largest distance of the tool from each link's frame [m] (n,)."""
    arm, model = linear.arm, linear.arm.model
    data = mujoco.MjData(model)
    most = np.zeros(arm.n)
    for pose in poses:
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(model, data)
        frames = np.array([data.body(name).xpos for name in arm.seat_bodies])
        distances = np.linalg.norm(data.site(arm.tool).xpos - frames, axis=1)
        most = np.maximum(most, distances)
    return most


def direction_from(turn: float, height: float, *, planar: bool) -> Vector:
    """Turn two uniform variates into a uniform direction: in the x-y plane, or in space."""
    angle = 2 * np.pi * turn
    z = 0.0 if planar else 2 * height - 1
    flat = np.sqrt(1 - z**2)
    return (float(flat * np.cos(angle)), float(flat * np.sin(angle)), float(z))


def _across(direction: Vector, turn: float, *, planar: bool) -> Vector:
    """Direction square to another: the one in the plane, or any of those in space."""
    first = np.array(direction)
    if planar:
        return (-float(first[1]), float(first[0]), 0.0)
    second = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    second = second / np.linalg.norm(second)
    third = np.cross(first, second)
    angle = 2 * np.pi * turn
    x, y, z = np.cos(angle) * second + np.sin(angle) * third
    return (float(x), float(y), float(z))


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
        part = "joint" if kind == "backlash" else "link"
        return self.fault(
            f"{kind}@{part}{place}",
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
    ) -> Backlash | StructuralLooseness:
        """Play or a loose link by its parameters.

        Travel at the tool [m], friction over the seat drive [1], modes [Hz] (2,) and damping ratios
        (2,) of the stops, and two uniform variates of a slide's direction.
        """
        place = place_of(hypothesis) or 1
        seat = np.zeros(self._masses.size)
        if hypothesis.startswith("backlash"):
            seat[self.linear.hinge_dofs[place - 1]] = 1.0
            stiffness, dampers = self._masses.stops(seat, modes, damping)
            return Backlash(
                joint=place,
                gap=gap if self.arm.sliding[place - 1] else gap / self.arm.reach,
                stiffness=stiffness,
                damping=dampers,
                friction=ratio * self.drive.hinge(place),
            )
        along = direction_from(*direction, planar=len(self.arm.axes) == 2)
        slides = self.linear.slide_dofs[place - 1]
        seat[slides] = along[: len(slides)]
        stiffness, dampers = self._masses.stops(seat, modes, damping)
        return StructuralLooseness(
            link=place,
            direction=along,
            gap=gap,
            stiffness=stiffness,
            damping=dampers,
            friction=ratio * self.drive.slide(place, along),
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
