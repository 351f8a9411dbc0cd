"""Durations in words, to two figures."""

from __future__ import annotations

__all__ = ["duration_words"]


def duration_words(seconds: float) -> str:
    """A duration to two figures, in the unit that suits it.

    Examples
    --------
    >>> [duration_words(s) for s in (0.0123, 1.41, 52.0, 740.0, 13_400.0, 130_000.0)]
    ['12 ms', '1.4 s', '52 s', '12 min', '3.7 h', '36 h']
    """
    for unit, length in (("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        # two minutes in seconds, two hours in minutes: still plain to read
        if seconds >= (1.0 if unit == "s" else 2.0) * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"
