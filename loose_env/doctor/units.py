"""One comparison for all signals: ratio and sign of a channel to what another source expects of it.

    ratio = sign(x · e) sqrt(x · x / e · e),   correlation = x · e / sqrt(x · x  e · e)

of a channel x and its expectation e about zero, of all runs together where the runs agree. The
geometric mean of both regressions is used because noise in either does not pull it to zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from loose_env.doctor.corrections import Correction
from loose_env.doctor.findings import Defect, Finding
from loose_env.importing import ratio_of
from loose_env.typing import Array

# Units and signs
UNIT_MATCH = 0.2
"""Relative distance of a measured ratio from a unit's factor, up to which that unit is named:
gains, friction and damping change ratios by less."""
SCALE_NOTED = 1.25
"""Ratio of two records of one quantity, or its inverse, from which the reader is told where no unit
fits: sensitivities are known to 10 %."""
SCALE_WRONG = 5.0
"""Ratio of two signals, or its inverse, from which the reader is told where no unit fits: a soft
servo that swings its load stays below."""
SURE_CORRELATION = 0.8
"""Correlation of two channels, from which their sign and ratio are believed: friction and noise
explain a third of the power at most."""
LEAST_BLOCKS = 8
"""Samples by which signals are compared, at least: a ratio of fewer scatters by more than the
units' factors are told apart."""
LEAST_CHANGE = 0.3
"""Change of a needed torque over its rms, below which friction may hide the rest."""
FEWEST_POSES = 3
"""Runs in held poses, from which half of it is enough: friction does not follow gravity from pose
to pose."""
OPPOSITE = (0.7, 1.4)
"""Size of a ratio, between which a negative one is a wrong sign: beyond, friction or a wrong gain
has changed it."""

ANGLE: Mapping[str, float] = {"degrees instead of radians": 180 / np.pi}
"""Wrong units of an angle or of its rate, and what they multiply it by."""
LENGTH: Mapping[str, float] = {"millimetres instead of metres": 1e3}
"""The same of a length."""
ACCELERATION: Mapping[str, float] = {
    "g instead of m/s²": 1 / 9.80665,
    "mg instead of m/s²": 1e3 / 9.80665,
    "mm/s² instead of m/s²": 1e3,
}
"""The same of an acceleration."""
FORCE: Mapping[str, float] = {
    "N·mm instead of N·m": 1e3,
    "kN·m instead of N·m": 1e-3,
    "kgf·m instead of N·m": 1 / 9.80665,
}
"""The same of a torque."""

Part = TypeVar("Part")


class Pair(NamedTuple):
    """Channel and expectation of one run, shape (N,)."""

    measured: Array
    expected: Array


class _Reading(NamedTuple):
    ratio: float
    correlation: float
    words: str
    """Unit or sign that is wrong; "" for neither."""
    factor: float
    """Factor that takes it out."""


def contradictions(
    channel: str, noun: str, pairs: Mapping[str, Pair], units: Mapping[str, float], defect: Defect,
    *, odd: float = SCALE_WRONG, least: float = 0.0, friction: bool = False, fixed: bool = False,
) -> Iterator[Finding]:  # fmt: skip
    """Wrong unit or sign of a channel beside its expectation by run, or an odd ratio.

    Units are the wrong ones that are looked for; where none fits, a ratio from ``odd`` on, or its
    inverse, is a warning. An expectation whose rms is below ``least`` tells nothing; ``friction``
    may hide one that does not change. ``fixed`` columns are scaled by --fix.
    """
    usual = _rms(np.concatenate([pair.expected for pair in pairs.values()])) if friction else 0.0

    def read(parts: list[Pair]) -> _Reading | None:
        """Reading of runs together where it tells something; "" for words where all is well."""
        one = _reading(parts, units, least)
        if one is None or not friction or _varied(parts):
            return one
        # In one held pose friction may hide a torque or turn it round, but not multiply it.
        expected = _rms(np.concatenate([pair.expected for pair in parts]))
        hidden = one.ratio < 1 / SCALE_WRONG or expected < LEAST_CHANGE * usual
        return None if hidden else one

    alone = {run: read([pair]) for run, pair in pairs.items()}
    said = {
        run: one.words if one is not None and (one.words or 1 / odd < one.ratio < odd) else None
        for run, one in alone.items()
    }
    for run, parts in grouped(pairs, said):
        one = read(parts)
        if one is None or not (one.words or not 1 / odd < one.ratio < odd):
            continue
        found = f"{one.ratio:.3g} times {noun} (correlation {one.correlation:.2f}): "
        found += one.words or "another unit, gain or gear"
        check = "sign" if one.words == "the opposite sign" else "units"
        severity = (
            defect.severity if one.words else "note" if defect.severity == "note" else "warning"
        )
        fix = Correction(kind="scale", columns=(channel,), factor=one.factor).of(run)
        yield defect.at(
            channel, found, one.ratio, unit="1", run=run, check=check,
            severity=severity, fix=fix if fixed and one.words else None,
        )  # fmt: skip


def _reading(parts: list[Pair], units: Mapping[str, float], least: float) -> _Reading | None:
    """Ratio of runs together, and what it means; None where it tells nothing."""
    measured, expected = (np.concatenate(each) for each in zip(*parts, strict=True))
    own, power = float(measured @ measured), float(expected @ expected)
    if len(expected) < LEAST_BLOCKS or not own or power <= least**2 * len(expected):
        return None
    ratio, correlation = ratio_of(float(measured @ expected), power, own)
    if abs(correlation) < SURE_CORRELATION:
        return None
    words = named_unit(ratio, units) or ""
    factor = 1 / units.get(words, 1.0)
    if ratio < 0 and (words or OPPOSITE[0] <= -ratio <= OPPOSITE[1]):
        words, factor = f"{words}, and the opposite sign" if words else "the opposite sign", -factor
    return _Reading(ratio, correlation, words, factor)


def _varied(parts: list[Pair]) -> bool:
    """Return whether friction cannot be the reason: the torque changes, or poses do."""
    expected = np.concatenate([pair.expected for pair in parts])
    share = float(np.std(expected)) / _rms(expected)
    return share > LEAST_CHANGE * (0.5 if len(parts) >= FEWEST_POSES else 1.0)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def named_unit(ratio: float, units: Mapping[str, float]) -> str | None:
    """Wrong unit that a ratio of either sign stands for; None where none fits."""
    fits = (words for words, factor in units.items() if abs(abs(ratio) / factor - 1) <= UNIT_MATCH)
    return next(fits, None)


def grouped(
    parts: Mapping[str, Part], said: Mapping[str, object | None]
) -> list[tuple[str, list[Part]]]:
    """Parts of all runs together where the runs agree; else each run that tells something.

    All runs together scatter less; but a recorder that was set up anew between two runs leaves
    one of them in another unit, which a mean over all hides.

    Examples
    --------
    >>> grouped({"a": 1.0, "b": 1.1}, {"a": "rad", "b": None})
    [('', [1.0, 1.1])]
    >>> grouped({"a": 1.0, "b": 57.3}, {"a": "rad", "b": "deg"})
    [('a', [1.0]), ('b', [57.3])]
    """
    told = {name: word for name, word in said.items() if word is not None}
    if len(set(told.values())) > 1:
        return [(name, [parts[name]]) for name in told]
    return [("", list(parts.values()))] if parts else []
