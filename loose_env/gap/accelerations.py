"""How accelerometers shook beyond the model, and in which pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ResidualAccelerations"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualAccelerations:
    """Measured less predicted accelerations."""

    joints: tuple[str, ...]
    """Names of the joints."""
    poses: Array
    """Their measured positions (K, joints) [rad, m]."""
    sites: tuple[str, ...]
    """Site of the accelerometer (K,)."""
    accelerations: Array
    """In the frame of the site (K, 3) [m/s²]."""
