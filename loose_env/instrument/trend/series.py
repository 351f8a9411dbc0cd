"""Series over sessions: levels of transmission, log odds of a fault, free travel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.instrument.result import HEALTHY, Diagnosis, TransmissionSpectrum
from loose_env.instrument.settings.thresholds import (
    CLEARANCE_ERROR,
    ODDS_SCATTER,
    REPEATABILITY,
    SAME_BAND,
    SAME_DRIVE,
    SAME_POSE,
    TREND_BANDS,
)
from loose_env.typing import Array

Quantity = Literal["transmission", "probability", "free_travel"]
"""Compared quantities: log amplitude, log odds that the arm is faulty, log free travel."""
_CERTAIN = 1e-9
"""Probabilities are kept this far from 0 and 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Values of one quantity over the sessions."""

    quantity: Quantity
    """The quantity."""
    joint: str
    """Excited joint of a transmission; joint or link of the free travel; "" for the probability."""
    channel: str
    """Sensor and axis of a transmission; else ""."""
    band_hz: tuple[float, float] | None
    """Band of a transmission [Hz]."""
    pose: Mapping[str, float]
    """Pose of a transmission [rad, m where a joint slides]; else empty."""
    values: Array
    """Value of each session (n,): natural logarithm of amplitude or travel, or log odds; NaN where
    a session has none."""
    least_scatter: float
    """Smallest standard deviation between sessions that is believed, in the unit of ``values``."""


def joints_and_links(diagnosis: Diagnosis) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joints and links of a diagnosed arm, base first.

    Examples
    --------
    >>> from loose_env.instrument.result import Fault
    >>> joints_and_links(
    ...     Diagnosis(
    ...         fault=Fault(kind="healthy"),
    ...         probability=0.8,
    ...         posterior={"healthy": 0.8, "structural_looseness@arm": 0.1, "backlash@elbow": 0.1},
    ...     )
    ... )
    (('elbow',), ('arm',))
    """
    names = [name.partition("@") for name in diagnosis.posterior]
    joints = tuple(where for kind, _, where in names if kind == "backlash")
    links = tuple(where for kind, _, where in names if kind == "structural_looseness")
    return joints, links


def series_over(sessions: Sequence[Diagnosis]) -> list[Series]:
    """Series of what the last session measured, over all sessions.

    A transmission is compared with those of the same joint and axis in the same pose, under a
    signal of the same band and level; of repeated runs the mean counts.
    """
    last = sessions[-1]
    found = []
    groups: list[list[TransmissionSpectrum]] = []
    for own in _under_test(last):
        like = next((g for g in groups if _alike(last, g[0], last, own)), None)
        if like is None:
            groups.append([own])
        else:
            like.append(own)
    for group in groups:
        first = group[0]
        edges = _edges(first)
        levels = np.array([_levels(last, first, edges, session) for session in sessions])
        whole = _whole(last, first, edges)
        found += [
            Series(
                quantity="transmission",
                joint=first.joint,
                channel=first.channel,
                band_hz=(float(edges[b]), float(edges[b + 1])),
                pose=last.records[first.record].pose,
                values=levels[:, b],
                least_scatter=_least_scatter(levels[:, b], float(whole[b])),
            )
            for b in range(len(edges) - 1)
        ]
    healthy = np.array([s.posterior.get(HEALTHY, np.nan) for s in sessions])
    healthy = np.clip(healthy, _CERTAIN, 1 - _CERTAIN)
    found.append(_of_arm("probability", "", np.log((1 - healthy) / healthy)))
    if last.fault.where is not None and last.fault.gap_m:
        travels = np.array([_travel(session, last) for session in sessions])
        found.append(_of_arm("free_travel", last.fault.where, travels))
    return found


def _of_arm(quantity: Quantity, where: str, values: Array) -> Series:
    return Series(
        quantity=quantity,
        joint=where,
        channel="",
        band_hz=None,
        pose={},
        values=values,
        least_scatter=ODDS_SCATTER if quantity == "probability" else CLEARANCE_ERROR,
    )


def _whole(session: Diagnosis, first: TransmissionSpectrum, edges: Array) -> Array:
    """Rms transmission to the whole sensor, all its axes together, in each band."""
    bands = len(edges) - 1
    power = np.zeros(bands)
    for own in session.spectra:
        if own.record == first.record and own.joint == first.joint:
            at = np.clip(np.searchsorted(edges, own.frequency_hz, side="right") - 1, 0, bands - 1)
            count = np.maximum(np.bincount(at, minlength=bands), 1)
            power += np.bincount(at, weights=np.square(own.measured), minlength=bands) / count
    return np.asarray(np.sqrt(power))


def _least_scatter(levels: Array, whole: float) -> float:
    """Smallest scatter of an axis's log amplitude: a share of what the whole sensor moves.

    An axis across the motion reads what mounting and pose let leak into it, and its logarithm
    scatters by as much more as it is weaker.
    """
    known = levels[np.isfinite(levels)]
    own = float(np.exp(np.median(known))) if len(known) else whole
    return REPEATABILITY * max(whole / max(own, 1e-300), 1.0)


def _travel(session: Diagnosis, last: Diagnosis) -> float:
    same = session.fault.hypothesis == last.fault.hypothesis
    return float(np.log(session.fault.gap_m)) if same and session.fault.gap_m else np.nan


def _under_test(session: Diagnosis) -> list[TransmissionSpectrum]:
    return [
        s
        for s in session.spectra
        if s.record < len(session.records) and session.records[s.record].condition != HEALTHY
    ]


def _alike(
    first: Diagnosis, one: TransmissionSpectrum, second: Diagnosis, other: TransmissionSpectrum
) -> bool:
    """True if two spectra are of one joint, axis, pose and signal."""
    if (one.joint, one.channel, one.unit) != (other.joint, other.channel, other.unit):
        return False
    poses = first.records[one.record].pose, second.records[other.record].pose
    if set(poses[0]) != set(poses[1]):
        return False
    if any(abs(poses[0][joint] - poses[1][joint]) > SAME_POSE for joint in poses[0]):
        return False
    ends = [(s.frequency_hz[0], s.frequency_hz[-1]) for s in (one, other)]
    if any(abs(a - b) > SAME_BAND * ends[0][1] for a, b in zip(*ends, strict=True)):
        return False
    low, high = sorted((one.drive_rms, other.drive_rms))
    return low > 0 and high <= SAME_DRIVE * low


def _edges(spectrum: TransmissionSpectrum) -> Array:
    """Ends of the bands in which a spectrum is followed [Hz]."""
    bands = min(TREND_BANDS, len(spectrum.frequency_hz))
    low, high = spectrum.frequency_hz[0], spectrum.frequency_hz[-1]
    return np.linspace(low, high, bands + 1) if high > low else np.array([low, low + 1.0])


def _levels(
    last: Diagnosis, first: TransmissionSpectrum, edges: Array, session: Diagnosis
) -> Array:
    """Mean log amplitude in each band, of a session's runs like one of the last session's."""
    bands = len(edges) - 1
    levels: list[Array] = []
    for own in _under_test(session):
        if not _alike(last, first, session, own):
            continue
        at = np.clip(np.searchsorted(edges, own.frequency_hz, side="right") - 1, 0, bands - 1)
        amplitude = np.array(own.measured)
        level = np.full(bands, np.nan)
        for b in range(bands):
            inside = amplitude[(at == b) & (amplitude > 0)]
            if len(inside):
                level[b] = float(np.log(inside).mean())
        levels.append(level)
    return np.mean(levels, axis=0) if levels else np.full(bands, np.nan)
