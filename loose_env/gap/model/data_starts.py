"""Hooks by which an effect proposes starting values from residual torques, accelerations, limits.

An effect that overrides one of them is asked.
"""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualAccelerations:
    """Measured less predicted accelerations."""

    joints: tuple[str, ...]
    """Names of the joints."""
    poses: Array
    """Measured joint positions (K, joints) [rad, m]."""
    sites: tuple[str, ...]
    """Site of the accelerometer (K,)."""
    accelerations: Array
    """Residual in the frame of the site (K, 3) [m/s²]."""


class StartsFromData:
    """Part of an effect: what it proposes from data; by default nothing."""

    def propose_from(self, resolution: float) -> tuple[tuple[float, ...], ...]:
        """Propose starts from the resolution of its sensor's readings; 0 if they have none."""
        return ()

    def propose_stiffness(self, stiffness: float) -> tuple[tuple[float, ...], ...]:
        """Propose starts from the stiffness that measured torques suggest for its joint."""
        return ()

    def propose_limit(
        self, speed: Array, asked: Array, needed: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose starts of a limit from what its drive was asked for and what it gave."""
        return ()

    def propose_along(self, residual: ResidualAccelerations) -> tuple[tuple[float, ...], ...]:
        """Propose starts from accelerometer residuals; none where they are uninformative."""
        return ()

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose starts from data, in place of `starts`; empty where there are none."""
        return ()
