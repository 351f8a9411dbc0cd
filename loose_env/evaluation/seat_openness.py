"""How far a hidden seat could be driven open at all, friction and gravity against it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import predict_seats
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, Fault, StructuralLooseness

__all__ = ["SeatOpenness"]


class SeatOpenness:
    """Drives the seats of an arm as hard as its levels allow, in a number of poses.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    poses : int
        Random poses tried; they are the same every time.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> openness = SeatOpenness(LinearArm(planar(2)))
    >>> seat = StructuralLooseness(
    ...     link=2, direction=(0, 1, 0), gap=1e-4, stiffness=(1e4, 1e4), friction=10.0
    ... )
    >>> openness.ratio(seat) > 1
    True
    """

    def __init__(self, linear: LinearArm, poses: int = 12) -> None:
        self._arm = arm = linear.arm
        self._linear = LinearArm(arm, points=8, remember=poses)
        rng = np.random.default_rng(0)
        self._drives: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        top = np.full(arm.n, arm.levels[-1])
        for _ in range(poses):
            pose = arm.random_pose(rng)
            played, _share = at_levels(self._linear.at(pose), top, duration=1.0)
            torque = np.array(played.torque_rms)
            if torque.any():  # not where gravity leaves the drives nothing
                self._drives.append((pose, torque))

    def ratio(self, fault: Fault) -> float | None:
        """Rms force on the shut seat over friction and gravity's load, in the best pose [1].

        All joints are shaken at the top level. None for faults without one seat that slides.
        """
        n = self._arm.n
        if isinstance(fault, StructuralLooseness):
            u = np.asarray(fault.direction, dtype=float)[: len(self._arm.axes)]
            place = self._arm.link_number(fault.link) - 1
        elif isinstance(fault, Backlash):
            u = np.eye(len(self._arm.axes))[0]
            place = n + self._arm.link_number(fault.joint) - 1
        else:
            return None
        direction = (u / np.linalg.norm(u))[None]
        best = 0.0
        for pose, torque in self._drives:
            channels = int((torque > 0).sum()) + len(self._arm.axes)
            seat = predict_seats(
                self._linear.at(pose),
                torque,
                direction,
                np.zeros(channels),
                places=np.array([place]),
            )
            held = fault.friction + float(seat.load[0])
            best = max(best, float(seat.force[0]) / held if held > 0 else np.inf)
        return best
