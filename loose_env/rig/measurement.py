"""One measurement: sensor readings and commands, without ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.excitation import Excitation
from loose_env.typing import Array

__all__ = ["Measurement", "Rig"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """Readings of one record in one pose.

    All channels are sampled together at ``rate``. Encoder channels have one sample more at
    either end, so that accelerations can be formed by differences.
    """

    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What was played."""
    rate: float
    """Sampling rate [Hz]."""
    command: Array
    """Random part of the commanded torque [N·m] (n, N)."""
    encoder: Array
    """Encoder readings, motor side [rad] (n, N + 2)."""
    tool: Array
    """Tool accelerometer, tool frame, proper acceleration [m/s²] (d, N)."""
    links: Array | None = None
    """Link accelerometers, link frames [m/s²] (L, d, N); None where there are none.

    One for each of the L links that carry one, base first; d is 1 where they are tangential."""
    probes: Mapping[str, Array] = field(default_factory=dict)
    """Further accelerometers by their site, along its own axes [m/s²] (3, N) each."""
    shaker_force: Array | None = None
    """Commanded force of the shaker [N] (N,); None where there is no shaker."""
    failure: str | None = None
    """Why the record is worthless; None for a good one."""

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Whether each joint was excited (n,)."""
        return np.array(self.excitation.excited)


class Rig(Protocol):
    """Protocol of a rig: a simulated arm, a recording or a real arm."""

    def measure(self, pose: Array, excitation: Excitation) -> Measurement:
        """Move the arm to a pose, apply the excitation, and return the readings."""
        ...
