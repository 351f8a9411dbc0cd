"""Where something knocks: rhythm and direction of every link and joint against what was heard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument2 import knocks
from loose_env.instrument2.arm import BOLTS, GEARS, PoseModel, SuspectArm, place_name
from loose_env.instrument2.motion import Gears, accelerations, rotor_speeds
from loose_env.instrument2.records import Record
from loose_env.instrument2.signals import Multisine
from loose_env.typing import Array

GAPS_MM = (0.02, 0.06, 0.12, 0.25)
"""Clearances tried [mm]: a knock's time hardly depends on them, its loudness little."""
RIGID_GAPS_MM = (0.01, 0.04)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rhythm:
    """Agreement of every hypothesis with the top band; H hypotheses: seats by direction, teeth."""

    labels: tuple[tuple[str, int, int], ...]
    """Kind, joint or link, and index of the direction (H,)."""
    directions: Array
    """Directions of seats (D, 3), link frame."""
    timing: Array
    """Correlation of foretold and measured envelope beyond friction, all poses (H,)."""
    moments: Array
    """Of it by pose: covariance, power foretold, power measured (R, 3, H)."""
    throws: Array
    """Direction in which each would throw the tool (R, H, 3)."""
    friction: float
    """Share of the envelope's variance that reversals of friction explain [1]."""
    reversing: Array
    """How far each hypothesis' load reverses, over friction (R, H)."""


def rhythm_of(
    arm: SuspectArm,
    records: Sequence[Record],
    models: Sequence[PoseModel],
    gears: Gears,
    signal: Multisine,
    *,
    quiet: Sequence[Array] | None = None,
    directions: Array | None = None,
) -> Rhythm:
    """Correlate the envelope of every record with what each hypothesis foretells.

    Parameters
    ----------
    quiet : sequence of ndarray, optional
        Envelope of each pose on the healthy day (GRID,), which is taken off.
    """
    grid = knocks.sphere(knocks.DIRECTIONS) if directions is None else directions
    period = signal.period_s
    n = arm.n
    labels = tuple((BOLTS, i, d) for i in range(n) for d in range(len(grid)))
    labels += tuple((GEARS, j, -1) for j in range(n))
    heard = [
        np.sqrt(np.maximum(r.envelope - (r.floor if quiet is None else 1.3 * quiet[k]), 0))
        for k, r in enumerate(records)
    ]
    free = gears.rotor - 0.5 * gears.spring / (2 * np.pi * 200.0) ** 2
    best: Array | None = None
    share, moments = 0.0, np.zeros((len(records), 3, len(labels)))
    frictions, throws, reversing = [], [], []
    foretold: dict[bool, list[knocks.Loads]] = {False: [], True: []}
    for index, (record, model) in enumerate(zip(records, models, strict=True)):
        for rigid in (False, True):
            qdd = accelerations(record, model, gears, index, period, rigid=rigid)
            foretold[rigid].append(knocks.loads_of(model, qdd, gears.rotor))
        loads = foretold[False][-1]
        speed = rotor_speeds(record, period)
        frictions.append(np.sqrt(knocks.reversals(loads, speed, period)))
        throws.append(knocks.thrown(knocks.loads_of(model, np.zeros((1, n)), free), grid))
        reversing.append(knocks.reversing(loads, grid, arm.slides))
    for rigid, gaps in ((False, GAPS_MM), (True, RIGID_GAPS_MM)):
        for gap in gaps:
            told = [
                np.sqrt(knocks.trains(loads, grid, gap, arm.slides, period))
                for loads in foretold[rigid]
            ]
            timing, parts, explained = correlation(heard, told, frictions)
            if best is None:
                best, share, moments = timing, explained, parts
            better = timing > best
            best = np.maximum(best, timing)
            moments = np.where(better, parts, moments)
    assert best is not None
    return Rhythm(
        labels=labels,
        directions=grid,
        timing=best,
        moments=moments,
        throws=np.array(throws),
        friction=share,
        reversing=np.array(reversing),
    )


def correlation(
    heard: Sequence[Array], told: Sequence[Array], friction: Sequence[Array]
) -> tuple[Array, Array, float]:
    """Correlation of amplitudes over all poses together, what friction explains projected out.

    Parameters
    ----------
    heard : sequence of ndarray
        Amplitude of the top band in each pose (GRID,).
    told : sequence of ndarray
        Amplitude that each hypothesis foretells (H, GRID).
    friction : sequence of ndarray
        Amplitude that reversals foretell (n, GRID).

    Returns
    -------
    correlation : ndarray
        Of each hypothesis (H,); 0 where friction foretells the same.
    moments : ndarray
        Covariance, power foretold and power heard by pose (R, 3, H).
    share : float
        Of the variance heard that friction explains.
    """
    y = np.concatenate(heard)
    base = np.vstack([np.ones(len(y)), np.concatenate(friction, 1)])
    base = base / np.maximum(np.linalg.norm(base, axis=1, keepdims=True), 1e-12)
    span = np.linalg.svd(base, full_matrices=False)[2]
    x = np.concatenate(told, 1)
    before = np.linalg.norm(x - x.mean(1, keepdims=True), axis=1)
    variance = float(((y - y.mean()) ** 2).sum())
    y = y - span.T @ (span @ y)
    x = x - (x @ span.T) @ span
    size = np.linalg.norm(x, axis=1)
    clear = size > 0.1 * before
    found = np.where(clear, x @ y / np.maximum(size * np.linalg.norm(y), 1e-30), 0.0)
    parts, at = [], 0
    for own in heard:
        s = slice(at, at + len(own))
        at += len(own)
        power = np.full(len(x), float(y[s] @ y[s]))
        parts.append([x[:, s] @ y[s], (x[:, s] ** 2).sum(1), power])
    return found, np.array(parts), 1 - float(y @ y) / max(variance, 1e-30)


def direction_score(throws: Array, covariances: Sequence[Array], *, degrees: float = 3.0) -> Array:
    """Log likelihood of each hypothesis (H,): the ringing along one direction in every pose.

    Parameters
    ----------
    throws : ndarray
        Direction of each hypothesis by pose (R, H, 3).
    covariances : sequence of ndarray
        Of the top band, noise taken off (3, 3) [m²/s⁴].
    degrees : float
        Independent vectors that a pose's ringing counts for.
    """
    power = np.array([max(float(np.trace(c)), 1e-12) for c in covariances])
    # Poses that hardly rang say little about direction.
    weight = np.clip(power / power.max() * 20, 0, 1)
    found = np.zeros(throws.shape[1])
    for u, c, w in zip(throws, covariances, weight, strict=True):
        values, axes = np.linalg.eigh(c)
        clean = (axes * np.maximum(values, 1e-14)) @ axes.T
        clean /= np.trace(clean)
        along = np.clip(np.einsum("ha,ab,hb->h", u, clean, u), 1 / 3, 1 - _SPREAD)
        found -= (
            0.5 * degrees * w * (np.log(along) + 2 * np.log((1 - along) / 2) - 3 * np.log(1 / 3))
        )
    return found


_SPREAD = 0.02
"""Share of a knock's ringing that goes astray, modes of the links [1]."""


def names_of(arm: SuspectArm, rhythm: Rhythm) -> list[str]:
    """Place of every hypothesis (H,)."""
    return [
        place_name(kind, arm.links[i] if kind == BOLTS else arm.joints[i])
        for kind, i, _ in rhythm.labels
    ]
