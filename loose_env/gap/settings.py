"""How a recording is compared with its model: what a caller may choose."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np

from loose_env.errors import InvalidSetting

__all__ = ["GapSettings"]

_MOST_EFFECTS, _MOST_THREADS, _SEEDS = 30, 10_000, 2**63
"""Bounds of settings: most effects and threads, and above all seeds."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """How a recording is compared with its model.

    Examples
    --------
    >>> GapSettings(search_seconds=0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: search_seconds is a time above 0 s, got 0
    """

    tolerance: float = 0.03
    """Within which nominal masses, inertias, dampings and gains are known, as a share."""
    most_effects: int = 18
    """Most effects that are named."""
    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered; all of the catalogue if none is given."""
    held_share: float = 0.25
    """Share of the runs that is held out to judge by, in whole families of motions: runs whose
    names begin with the same word."""
    held_out: tuple[str, ...] = ()
    """Files of the runs that are held out in place of those, or how their names begin."""
    search_seconds: float = 90.0
    """How much of the recording is fitted to while effects are sought, in all; of longer ones a
    window of every run [s]."""
    fit_seconds: float = 240.0
    """How much of it the effects that were found are fitted to in the end [s]."""
    held_seconds: float = 60.0
    """How much of it judges while effects are sought; the result is of whole runs [s]."""
    seed: int = 1
    """Seed of the intervals' bootstrap."""
    threads: int = 0
    """Threads of the simulation; 0: all processors."""

    def __post_init__(self) -> None:
        """Check.

        Raises
        ------
        InvalidSetting
            If a setting is of another type, or out of its range.
        """
        for name, most in (("tolerance", 0.5), ("held_share", 1.0)):
            value = getattr(self, name)
            if not (_is_number(value) and 0 < value < most):
                raise InvalidSetting(f"{name} is a share above 0 and below {most:g}, got {value!r}")
        for name in ("search_seconds", "fit_seconds", "held_seconds"):
            value = getattr(self, name)
            if not (_is_number(value) and value > 0):
                raise InvalidSetting(f"{name} is a time above 0 s, got {value!r}")
        for name, least, most in (
            ("most_effects", 1, _MOST_EFFECTS),
            ("seed", 0, _SEEDS - 1),
            ("threads", 0, _MOST_THREADS),
        ):
            value = getattr(self, name)
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not (whole and least <= value <= most):
                upper = f"to {most}" if most < _SEEDS - 1 else "or more, below 2**63"
                raise InvalidSetting(
                    f"{name} is a whole number, {least} {upper}, got {value!r:.60}"
                )
        for name in ("kinds", "held_out"):
            value = getattr(self, name)
            listed = isinstance(value, tuple | list)
            if not (listed and all(isinstance(each, str) for each in value)):
                raise InvalidSetting(f"{name} is a tuple of words, got {value!r:.60}")


def _is_number(value: object) -> bool:
    """Whether a value is a number, and no truth value."""
    return isinstance(value, Real) and not isinstance(value, bool)
