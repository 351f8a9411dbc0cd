"""Stops for drawn seats: as stiff as their contact modes ask, no stiffer than the step allows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.arms import LinearArm
from loose_env.faults import FASTEST_STOP
from loose_env.typing import Array

__all__ = ["SeatMasses", "Stops"]

Stops = tuple[tuple[float, float], tuple[float, float]]
"""Stiffness, then damping, of the lower and the upper stop."""

_FASTEST = 0.85 * FASTEST_STOP  # leaves room for the mismatch of masses


class SeatMasses:
    """What seats of the nominal arm carry, over many poses.

    A seat is given as a vector over the degrees of freedom of the linear arm.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    poses : sequence of ndarray (n,)
        Poses to look at; in the first one the distal part is weighed.
    """

    def __init__(self, linear: LinearArm, poses: Sequence[Array]) -> None:
        self._step = linear.arm.timestep
        self._inertias = np.array([linear.at(pose).inertia for pose in poses])
        self._free = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        self._among = self._inertias[:, self._free[:, None], self._free]

    @property
    def size(self) -> int:
        """Number of degrees of freedom of the linear arm."""
        return int(self._inertias.shape[1])

    def stops(self, seat: Array, modes: Array, ratios: Array) -> Stops:
        """Stops of a seat that is loose in one way.

        Parameters
        ----------
        seat : ndarray (nv,)
            Its direction among the degrees of freedom of the linear arm.
        modes : ndarray (2,)
            Mode of the distal part on each stop with the rest held [Hz].
        ratios : ndarray (2,)
            Damping ratio against the seat's effective mass [1].
        """
        held = float(seat @ self._inertias[0] @ seat)
        # The lightest the seat gets over many poses, with every joint free.
        across = self._inertias[:, self._free] @ seat
        solved = np.linalg.solve(self._among, across[..., None])[..., 0]
        masses = np.einsum("i,pij,j->p", seat, self._inertias, seat)
        reduced = float(np.min(masses - np.einsum("pi,pi->p", across, solved)))
        stiffness = held * (2 * np.pi * modes) ** 2
        softest = reduced * (_FASTEST / self._step) ** 2
        stiffness = np.minimum(stiffness, softest)
        return _pair(stiffness), _pair(2 * ratios * np.sqrt(stiffness * reduced))

    def stops_together(self, seats: Array, modes: Array, ratios: Array) -> tuple[Stops, ...]:
        """Stops of a seat that is loose in several ways at once.

        The effective mass of each part is that with all other parts free. Where parts that rest
        on their stops together would be too fast for the step, all stops are softened alike.

        Parameters
        ----------
        seats : ndarray (p, nv)
            Direction of each part among the degrees of freedom of the linear arm.
        modes, ratios : ndarray (p, 2)
            As for `stops`.
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

        At 1 they are slow enough as they are.

        Parameters
        ----------
        seats : ndarray (p, nv)
            Direction of each seat among the degrees of freedom of the linear arm.
        stiffness, damping : ndarray (p,)
            Largest of each seat's two stops [N/m and N·s/m, N·m/rad and N·m·s/rad].
        """
        mobility = self._mobility(seats)

        def fastest(diagonal: Array) -> float:
            root = np.sqrt(diagonal)
            return float(np.linalg.eigvalsh(root[:, None] * mobility * root).max())

        spring = fastest(stiffness * self._step**2)
        damper = fastest(2 * damping * self._step)
        # The largest eigenvalue of a sum is at most the sum of the largest ones. With s for the
        # root of the factor, spring s² + damper s stays below what explicit stepping bears.
        most = 4 * (_FASTEST / FASTEST_STOP) ** 2
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
