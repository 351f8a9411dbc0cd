"""How hard the hidden faults are to find: ranges from which they are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.arms.linear import LinearArm
from loose_env.arms.mismatch import Mismatch
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import SeatDrive
from loose_env.faults import (
    FASTEST_STOP,
    Backlash,
    Fault,
    FaultKind,
    Healthy,
    StructuralLooseness,
    place_of,
)

__all__ = ["DIFFICULTIES", "Difficulty", "FaultSampler", "difficulty_named"]

_KINDS: tuple[FaultKind, ...] = ("healthy", "structural_looseness", "backlash")
_EQUAL: Mapping[str, float] = MappingProxyType({kind: 1 / 3 for kind in _KINDS})

Range = tuple[float, float]
Array = NDArray[np.float64]
_FASTEST = 0.85 * FASTEST_STOP  # leaves room for the mismatch of masses


@dataclass(frozen=True, kw_only=True)
class Difficulty:
    """Ranges of the hidden fault and of the model's mismatch."""

    friction: Range = (0.02, 1.0)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
    gap: Range = (0.02e-3, 0.4e-3)
    """Travel, log-uniform [m]; play in a joint is this travel at the arm's full reach."""
    contact_mode: Range = (300.0, 360.0)
    """Mode of the distal part on a stop with the rest held, uniform for each side [Hz].

    A stop is softer where its fastest local mode would outrun the simulation step."""
    contact_damping: Range = (0.05, 0.3)
    """Damping ratio of a stop against the seat's effective mass, uniform [1]."""
    mismatch: Mismatch = field(default_factory=Mismatch)
    """How far the nominal model is off."""
    kinds: Mapping[str, float] = field(default_factory=lambda: _EQUAL)
    """Probability of each kind of fault; places are uniform within a kind."""

    def __post_init__(self) -> None:
        for name in ("friction", "gap", "contact_mode", "contact_damping"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise InvalidSetting(
                    f"difficulty {name} must be 0 < low <= high, got {(low, high)}"
                )
        unknown = set(self.kinds) - set(_KINDS)
        if unknown:
            raise UnknownName(f"unknown fault kind {sorted(unknown)}; kinds are {list(_KINDS)}")
        values = list(self.kinds.values())
        if min(values, default=-1.0) < 0 or not np.isclose(sum(values), 1.0):
            raise InvalidSetting(
                f"probabilities of the kinds must be >= 0 and sum to 1, got {dict(self.kinds)}"
            )


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

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import vera
    >>> sampler = FaultSampler(LinearArm(vera()), Difficulty())
    >>> sampler.draw(np.random.default_rng(0)).kind
    'structural_looseness'
    """

    def __init__(self, linear: LinearArm, difficulty: Difficulty) -> None:
        self.arm: Arm = linear.arm
        self.difficulty = difficulty
        self.drive = SeatDrive(linear)
        self._linear = linear
        rng = np.random.default_rng(0)
        poses = [np.zeros(self.arm.n), *(self.arm.random_pose(rng) for _ in range(64))]
        self._inertias = np.array([linear.at(pose).inertia for pose in poses])
        self._free = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        self._among = self._inertias[:, self._free[:, None], self._free]

    def draw(self, rng: np.random.Generator, *, hypothesis: str | None = None) -> Fault:
        """Draw a fault, of one hypothesis if it is given.

        Every draw takes the same number of variates from ``rng``.
        """
        d = self.difficulty
        u = rng.random(10)
        if hypothesis is None:
            kinds = [k for k in _KINDS if d.kinds.get(k, 0.0) > 0]
            edges = np.cumsum([d.kinds[k] for k in kinds])
            kind = kinds[min(int(np.searchsorted(edges, u[0], side="right")), len(kinds) - 1)]
            place = 1 + min(int(u[1] * self.arm.n), self.arm.n - 1)
        else:
            name, _, _ = hypothesis.partition("@")
            kind, place = name, place_of(hypothesis) or 1  # type: ignore[assignment]
        if kind == "healthy":
            return Healthy()
        gap = _log_uniform(d.gap, u[2])
        ratio = _log_uniform(d.friction, u[3])
        modes = np.array([_uniform(d.contact_mode, v) for v in u[4:6]])
        ratios = np.array([_uniform(d.contact_damping, v) for v in u[6:8]])
        if kind == "backlash":
            seat = np.zeros(self._inertias.shape[1])
            seat[self._linear.hinge_dofs[place - 1]] = 1.0
            stiffness, damping = self._stops(seat, modes, ratios)
            return Backlash(
                joint=place,
                gap=gap / self.arm.reach,
                stiffness=stiffness,
                damping=damping,
                friction=ratio * self.drive.hinge(place),
            )
        direction = self._direction(u[8], u[9])
        seat = np.zeros(self._inertias.shape[1])
        slides = self._linear.slide_dofs[place - 1]
        seat[slides] = direction[: len(slides)]
        stiffness, damping = self._stops(seat, modes, ratios)
        return StructuralLooseness(
            link=place,
            direction=direction,
            gap=gap,
            stiffness=stiffness,
            damping=damping,
            friction=ratio * self.drive.slide(place, direction),
        )

    def _stops(
        self, seat: Array, modes: Array, ratios: Array
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Stiffness and damping of both stops of a seat, a direction of the open arm (nv,)."""
        held = float(seat @ self._inertias[0] @ seat)
        # The lightest the seat gets over many poses, with every joint free.
        across = self._inertias[:, self._free] @ seat
        solved = np.linalg.solve(self._among, across[..., None])[..., 0]
        masses = np.einsum("i,pij,j->p", seat, self._inertias, seat)
        reduced = float(np.min(masses - np.einsum("pi,pi->p", across, solved)))
        stiffness = held * (2 * np.pi * modes) ** 2
        softest = reduced * (_FASTEST / self.arm.timestep) ** 2
        stiffness = np.minimum(stiffness, softest)
        return _pair(stiffness), _pair(2 * ratios * np.sqrt(stiffness * reduced))

    def _direction(self, turn: float, height: float) -> tuple[float, float, float]:
        """Uniform direction of the link frame: in the plane, or in space."""
        angle = 2 * np.pi * turn
        z = 0.0 if len(self.arm.axes) == 2 else 2 * height - 1
        flat = np.sqrt(1 - z**2)
        return (float(flat * np.cos(angle)), float(flat * np.sin(angle)), float(z))


def _uniform(limits: Range, u: float) -> float:
    return limits[0] + (limits[1] - limits[0]) * float(u)


def _log_uniform(limits: Range, u: float) -> float:
    return float(np.exp(_uniform((np.log(limits[0]), np.log(limits[1])), u)))


def _pair(values: Array) -> tuple[float, float]:
    return (float(values[0]), float(values[1]))
