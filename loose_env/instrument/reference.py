"""A suspect session against a healthy one of another day: what rings more, what became softer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.arm import PoseModel
from loose_env.instrument.motion import Gears, softening
from loose_env.instrument.records import Record
from loose_env.instrument.signals import Multisine
from loose_env.typing import Array, IndexArray

_NEAR = 0.05
"""Largest distance of a joint between two poses that are one [rad, m]: what a controller leaves."""


_CLEAR = 10.0
"""Power over its noise from which lines of distortion are compared [1]: below, a few lines scatter
by more than a decibel."""


def decibels(power: Array | float) -> Array:
    """Power in decibels; nothing is -140 dB."""
    found: Array = 10 * np.log10(np.maximum(np.asarray(power, dtype=float), 1e-14))
    return found


def pairs(records: Sequence[Record], reference: Sequence[Record]) -> list[tuple[int, int]]:
    """Indices of suspect and healthy records of a sensor, pose and level, by measured motion."""
    found, free = [], set(range(len(reference)))
    for k, record in enumerate(records):
        near = [
            (float(np.abs(record.pose - reference[r].pose).max()), r)
            for r in free
            if abs(np.log(record.level / reference[r].level)) < 0.1
            and record.sensor == reference[r].sensor
        ]
        if near and min(near)[0] < _NEAR:
            found.append((k, min(near)[1]))
            free.discard(min(near)[1])
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Features:
    """What a record says without any model, over the tool's motion (R,) [dB]."""

    top: Array
    """Energy that repeats in each band above the lines (R, B)."""
    even: Array
    """Even lines, which nothing excites: seats, and play under a one-sided load."""
    odd: Array
    """Odd lines left out: friction, and large play."""


def features(records: Sequence[Record], signal: Multisine) -> Features:
    """Ringing and distortion of every record."""
    even = np.arange(4, int(signal.excited.max()), 2, dtype=np.intp)

    def share(record: Record, lines: IndexArray) -> float:
        power = (np.abs(record.tool[lines]) ** 2).sum(1).mean()
        noise = record.tool_noise[lines].sum(1).mean()
        return float(max(power - noise, _CLEAR * noise) / max(record.motion**2, 1e-12))

    return Features(
        top=decibels(np.array([r.ring.levels / r.motion**2 for r in records])),
        even=decibels(np.array([share(r, even) for r in records])),
        odd=decibels(np.array([share(r, signal.silent) for r in records])),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What changed since the healthy session, in the pose and band that gained most [dB]."""

    top: float
    even: float
    odd: float
    softer: Array
    """Log of the tool motion left where no joint may be softer, over where this one may (n,)."""
    stiff: float
    """Tool motion left with the healthy gears, over what they left on the healthy day [1]."""
    payload_kg: float
    """Mass at the tool that explains it better than any softer joint; 0 where a joint does [kg]."""
    mount: tuple[str, float, float]
    """Axis of the accelerometer whose ringing rose most beside others of its frequencies in every
    pose, at which frequency [Hz], and by how much [dB]: modes of an arm move with the pose, a loose
    mount's do not."""


def change(
    records: Sequence[Record],
    healthy: Sequence[Record],
    models: Sequence[PoseModel],
    gears: Gears,
    known: Gears,
    signal: Multisine,
) -> Change:
    """Compare records of a suspect and of a healthy session, pose by pose."""
    now, then = features(records, signal), features(healthy, signal)
    left = softening(records, models, gears, signal)
    return Change(
        top=float((now.top - then.top).max()),
        even=float((now.even - then.even).max()),
        odd=float((now.odd - then.odd).max()),
        softer=np.log(left.none / np.maximum(left.joints, 1e-12)),
        stiff=left.none / max(known.left, 1e-12),
        payload_kg=left.payload_kg if left.payload < left.joints.min() else 0.0,
        mount=_mount(records, healthy),
    )


def _mount(records: Sequence[Record], healthy: Sequence[Record]) -> tuple[str, float, float]:
    """Axis, frequency and rise of what rings louder in every pose at that frequency alone."""
    spectra = [[r.ring.spectrum / r.motion**2 for r in own] for own in (records, healthy)]
    count = min(len(each) for own in spectra for each in own)
    now, then = (decibels(np.array([each[:count] for each in own])) for own in spectra)
    bands = records[0].ring.bands_hz
    hertz = np.arange(count) / records[0].ring.period_s
    inside = (hertz >= bands[-1][0]) & (hertz <= bands[0][1])
    rise = (now - then)[:, inside]
    alone = (rise - np.median(rise, axis=1, keepdims=True)).min(0)
    where, axis = np.unravel_index(alone.argmax(), alone.shape)
    return "xyz"[axis], float(hertz[inside][where]), float(alone[where, axis])
