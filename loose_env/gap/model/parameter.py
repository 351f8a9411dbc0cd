"""Bounded scalar parameter (unit, bounds, scale, prior), mapped to a free number and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A bounded scalar parameter.

    A fit works on a dimensionless free number: the value over its scale, or where ``log`` is set,
    the logarithm of the value over the scale.

    Examples
    --------
    >>> stiffness = Parameter(
    ...     name="stiffness", unit="N·m/rad", low=10, high=1e6, scale=100, log=True
    ... )
    >>> round(stiffness.free(1000.0), 3), round(stiffness.value(stiffness.free(1000.0)), 6)
    (2.303, 1000.0)
    """

    name: str
    """Name, as in the result file."""
    unit: str
    """Unit of the value, "" for a ratio."""
    low: float
    """Smallest value allowed."""
    high: float
    """Largest value allowed."""
    scale: float = 1.0
    """A change of the value that matters; positive."""
    log: bool = False
    """Whether the scale is logarithmic; needs a positive ``low``."""
    centre: float | None = None
    """Prior mean; None for a uniform prior."""
    spread: float | None = None
    """Prior standard deviation about ``centre``, in free units."""

    usual: float | None = None
    """Size of a change that would not surprise; None: ten times the scale."""

    natural_low: bool = False
    """Whether nothing below ``low`` exists: a fit may end there. Zero is such a bound by itself."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not self.low < self.high or self.scale <= 0 or (self.log and self.low <= 0):
            raise InvalidSetting(
                f"parameter {self.name!r} needs low < high, scale > 0, and low > 0 if it is "
                f"logarithmic; got {self.low:g} to {self.high:g}, scale {self.scale:g}"
            )
        if (self.centre is None) != (self.spread is None):
            raise InvalidSetting(f"parameter {self.name!r} has a centre and a spread, or neither")

    def free(self, value: float) -> float:
        """Convert a value to a free number."""
        return float(np.log(value / self.scale)) if self.log else value / self.scale

    def value(self, free: float) -> float:
        """Convert a free number to a value, within the bounds."""
        raw = self.scale * np.exp(np.clip(free, -50, 50)) if self.log else self.scale * free
        return float(np.clip(raw, self.low, self.high))

    def clipped(self, value: float) -> float:
        """Clip a value to the bounds."""
        return float(np.clip(value, self.low, self.high))

    @property
    def unsurprising(self) -> float:
        """Size of a change that would not surprise."""
        return 10 * self.scale if self.usual is None else self.usual

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the free number."""
        return self.free(self.low), self.free(self.high)


def free_of(parameters: tuple[Parameter, ...], values: Array) -> Array:
    """Convert values (P,) to free numbers."""
    return np.array([p.free(float(v)) for p, v in zip(parameters, values, strict=True)])


def values_of(parameters: tuple[Parameter, ...], free: Array) -> Array:
    """Convert free numbers (P,) to values."""
    return np.array([p.value(float(f)) for p, f in zip(parameters, free, strict=True)])
