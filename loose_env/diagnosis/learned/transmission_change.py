"""Change of the tool's motion per command against the nominal arm, with its errors by source."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.typing import Array

__all__ = ["TransmissionChange"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransmissionChange:
    """Change of the tool's in-step motion per command, as far as the transmission makes it."""

    measured: Array
    """As measured [m/s²] (d m,)."""
    open: Array
    """As each seat would make it by floating [m/s²] (P, d m)."""
    nominal: Array
    """The motion itself in the nominal arm [m/s²] (d m,)."""
    covariance: Array
    """Covariance by model and sampling errors, to first order [m²/s⁴] (d m, d m)."""
    residual: Array | None = None
    """Covariance by sampling of the motion per command, one joint alone [m²/s⁴] (d, d)."""
    arm_errors: Array | None = None
    """The part of it by errors of joint zeros and springs, one standard deviation each: the same
    at every sensor and in every record of an arm [m/s²] (K, d m); None where none is known."""
    sensor_errors: Array | None = None
    """The part by errors of the sensor and its levers: the same in every record (L, d m)."""
