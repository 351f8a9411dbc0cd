"""Settings of `loose gap`."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import inf
from numbers import Real

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.gap.core.tolerances import Tolerances

_MOST_THREADS = 10_000
"""Bound of the threads."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of the comparison of a recording with its model.

    Examples
    --------
    >>> GapSettings(threads=-1)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: threads is a whole number, 0 to 10000, got -1
    """

    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered, such as coulomb_friction; by default the whole
    catalogue."""
    held_out: tuple[str, ...] = ()
    """Runs kept out of everything and predicted at the end: their files, or the beginning of their
    names. By default every run is held out once, in turn."""
    simulate: bool = True
    """Whether full simulation decides among the leading sets of effects, where there are
    commands; without it the force balance alone decides, in a fraction of the time."""
    threads: int = 0
    """Threads of the simulation; 0 for all processors."""
    tolerances: Tolerances = field(default_factory=Tolerances)
    """Standard deviations of what the nominal model states."""

    def __post_init__(self) -> None:
        """Check the values."""
        whole = isinstance(self.threads, int | np.integer) and not isinstance(self.threads, bool)
        if not (whole and 0 <= self.threads <= _MOST_THREADS):
            raise InvalidSetting(
                f"threads is a whole number, 0 to {_MOST_THREADS}, got {self.threads!r:.60}"
            )
        for name in ("kinds", "held_out"):
            value = getattr(self, name)
            listed = isinstance(value, tuple | list)
            if not (listed and all(isinstance(each, str) for each in value)):
                raise InvalidSetting(f"{name} is a tuple of words, got {value!r:.60}")
        for each in fields(self.tolerances):
            value = getattr(self.tolerances, each.name)
            if not (_is_number(value) and 0 < value < inf):
                raise InvalidSetting(f"tolerance {each.name} is a number above 0, got {value!r}")


def _is_number(value: object) -> bool:
    """Return whether a value is a number, and no bool."""
    return isinstance(value, Real) and not isinstance(value, bool)
