"""Where something knocks: rhythm and direction of every link and joint against what was heard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument import knocks
from loose_env.instrument.arm import BOLTS, GEARS, ROCKS, PoseModel, SuspectArm, place_name
from loose_env.instrument.motion import Gears, accelerations, rotor_speeds
from loose_env.instrument.records import Record
from loose_env.instrument.ringing import GRID, amplitude
from loose_env.instrument.signals import Multisine
from loose_env.typing import Array, IndexArray

GAPS_MM = (0.001, 0.004, 0.015, 0.06, 0.25)
"""Clearances tried [mm]. Loads as measured hold the flight across a clearance already, as far as
the tool's lines follow it: then one as small as none tells the time of a knock."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Heard:
    """What rang in a session, and what loads it rang under; R records, B bands, n joints."""

    sensors: tuple[str, ...]
    """Accelerometer of each record."""
    amplitude: tuple[Array, ...]
    """Amplitude of what repeats in each band, in each pose (B, GRID)."""
    friction: tuple[Array, ...]
    """Amplitude that reversals of friction foretell in each (n, GRID)."""
    loads: tuple[knocks.Loads, ...]
    """Loads of the links in each."""
    free: tuple[knocks.Loads, ...]
    """Throws at the top band's frequency, where a spring takes off inertia."""
    slides: Array
    period_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Rhythm:
    """Agreement of every hypothesis with what was heard.

    H: seats by direction of the lattice, teeth, the base, seats by directions around the best.
    """

    labels: tuple[tuple[str, int, int], ...]
    """Kind, link or joint or n for the base, and index of the direction or turn (H,)."""
    directions: Array
    """Directions of seats, link frame: those of the lattice, and those around the best of each link
    (D + n K, 3)."""
    timing: Array
    """Correlation of foretold and heard amplitude beyond friction, all poses and bands together
    (H,)."""
    likelihood: Array
    """Log likelihood of a sample over that of noise (H,) [1]: the mean of two models between which
    an arm lies. In one a knock is as loud in every pose as foretold, in the other the links' modes
    give each pose a loudness of its own."""
    gap_mm: Array
    """Clearance at which that is highest (H,) [mm]."""
    throws: Array
    """Covariance of the tool's acceleration that each would make (R, H, 3, 3), trace 1."""
    chance: float
    """Highest correlation of any hypothesis with what was heard at other times [1]: a few strikes
    of a cable agree with some place by chance, and do so as well when they are shifted."""
    friction: float
    """Share of the variance heard that reversals of friction explain [1]."""
    reversing: Array
    """How far the load of each but the last ones reverses, over friction (R, H - n K)."""
    held: Array
    """The same as a load, in the pose where it is largest (H - n K,) [N, N·m]."""


def hear(
    arm: SuspectArm,
    records: Sequence[Record],
    models: Sequence[PoseModel],
    gears: Gears,
    signal: Multisine,
    *,
    healthy: Sequence[Record] | None = None,
) -> Heard:
    """Take the ringing of every record beside the loads that the arm carried then.

    Parameters
    ----------
    healthy : sequence of Record, optional
        Records of the healthy day, one for each, whose ringing is taken off.
    """
    period = signal.period_s
    ring = 2 * np.pi * 0.8 * records[0].ring.bands_hz[0][1]
    stiffening = gears.rotor - 0.5 * gears.spring / ring**2
    bands = range(min(len(r.ring.bands_hz) for r in (*records, *(healthy or ()))))
    rang, friction, free = [], [], []
    loads: list[knocks.Loads] = []
    for k, (record, model) in enumerate(zip(records, models, strict=True)):
        usual = (record if healthy is None else healthy[k]).ring
        energy = np.array([record.ring.repeating(b, spectrum=usual.spectrum) for b in bands])
        if healthy is not None:
            then = [usual.repeating(b, spectrum=usual.spectrum) for b in bands]
            energy -= _DAY * np.maximum(then, 0)
        rang.append(amplitude(energy))
        moved = accelerations(record, model, gears, k, period)
        loads.append(knocks.loads_of(model, moved, gears.rotor))
        speed = rotor_speeds(record, period)
        friction.append(np.sqrt(knocks.reversals(loads[-1], speed, period)))
        free.append(knocks.loads_of(model, np.zeros((1, arm.n)), stiffening))
    return Heard(
        sensors=tuple(record.sensor for record in records),
        amplitude=tuple(rang),
        friction=tuple(friction),
        loads=tuple(loads),
        free=tuple(free),
        slides=arm.slides,
        period_s=period,
    )


_DAY = 1.3
"""What a healthy arm rings on another day, over this one, in energy [1]: friction changes by 15 %
with temperature (Bittencourt and Gunnarsson 2012)."""


def rhythm_of(heard: Heard, directions: Array) -> Rhythm:
    """Correlate what was heard with what each hypothesis foretells.

    Parameters
    ----------
    directions : ndarray
        Directions of seats that are tried (D, 3), link frame; around the best of each link more
        are tried, since a true seat's rhythm is sharper than their lattice.
    """
    n, count = len(heard.slides), len(directions)
    wide = _compare(heard, directions)
    best = wide.likelihood[: n * count].reshape(n, count).argmax(1)
    finer = knocks.around(directions[best], _FINER, _AROUND / count)
    close = _compare(heard, finer)
    labels = tuple((BOLTS, i, d) for i in range(n) for d in range(count))
    labels += tuple((GEARS, j, -1) for j in range(n))
    labels += tuple((BOLTS, n, k) for k in range(ROCKS))
    labels += tuple((BOLTS, i, count + i * _FINER + d) for i in range(n) for d in range(_FINER))
    reversing = [knocks.reversing(own, directions, heard.slides) for own in heard.loads]
    resists = [knocks.friction_of(own, count, heard.slides) for own in heard.loads]

    def both(of_wide: Array, of_close: Array) -> Array:
        """What belongs to each hypothesis, in the order of the labels, along the last axis."""
        found: Array = np.concatenate([of_wide, of_close[..., : n * _FINER]], -1)
        return found

    throws = [
        both(knocks.thrown(own, directions).T, knocks.thrown(own, finer).T).T for own in heard.free
    ]
    return Rhythm(
        labels=labels,
        directions=np.concatenate([directions, finer.reshape(-1, 3)]),
        timing=both(wide.timing, close.timing),
        likelihood=both(wide.likelihood, close.likelihood),
        gap_mm=both(wide.gap_mm, close.gap_mm),
        throws=np.array(throws),
        chance=max(wide.chance, close.chance),
        friction=wide.friction,
        reversing=np.array(reversing),
        held=(np.array(reversing) * np.array(resists)[:, : len(reversing[0])]).max(0),
    )


_FINER, _AROUND = 40, 1.5
"""Directions tried around the best of each link, over so many times the share of one [1]: a degree
and a half apart, to the corners of its cell."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Agreement:
    """What `Rhythm` says of hypotheses in the order of `knocks.trains`."""

    timing: Array
    likelihood: Array
    gap_mm: Array
    chance: float
    friction: float


def _compare(heard: Heard, directions: Array) -> _Agreement:
    """Correlate what was heard with what is foretold at each clearance."""
    poses = range(len(heard.amplitude))
    count = len(heard.slides) * (directions.shape[-2] + 1) + ROCKS
    timing, likelihood = np.full(count, -1.0), np.full(count, -1.0)
    gap_mm, share, chance = np.zeros(count), 0.0, 0.0
    rng = np.random.default_rng(_SHIFTS)
    shifts = rng.integers(GRID, size=(_SHIFTS, len(poses)), dtype=np.intp)
    for gap in GAPS_MM:
        rung = knocks.trains(heard.loads, directions, gap, heard.slides, heard.period_s)
        told = [np.sqrt(own) for own in rung]
        found, share, other = correlation(
            heard.amplitude, told, heard.friction, shifts, heard.sensors
        )
        chance = max(chance, other)
        timing = np.maximum(timing, found)
        alone = [
            correlation([heard.amplitude[k]], [told[k]], [heard.friction[k]])[0] for k in poses
        ]
        gain = (log_likelihood(found) + np.mean([log_likelihood(r) for r in alone], 0)) / 2
        gap_mm[gain > likelihood] = gap
        likelihood = np.maximum(likelihood, gain)
    return _Agreement(
        timing=timing, likelihood=likelihood, gap_mm=gap_mm, chance=chance, friction=share
    )


def log_likelihood(found: Array) -> Array:
    """Log likelihood that a sample gains by a correlation that was fitted (H,)."""
    gain: Array = -0.5 * np.log(np.maximum(1 - found**2, 1e-4))
    return gain


def foretold(heard: Heard, rhythm: Rhythm, hypothesis: int) -> list[Array]:
    """Amplitude that one hypothesis foretells in each pose (GRID,)."""
    kind, i, d = rhythm.labels[hypothesis]
    n = len(heard.slides)
    row = 2 * n + d if i == n else i if kind == BOLTS else n + i
    own = rhythm.directions[[max(d, 0) * (i < n)]]
    gap_mm = float(rhythm.gap_mm[hypothesis])
    rung = knocks.trains(heard.loads, own, gap_mm, heard.slides, heard.period_s)
    return [np.sqrt(each[row]) for each in rung]


_SHIFTS = 16
"""Other times at which what was heard is compared too."""


def correlation(
    heard: Sequence[Array],
    told: Sequence[Array],
    friction: Sequence[Array],
    shifts: IndexArray | None = None,
    sensors: Sequence[str] = (),
) -> tuple[Array, float, float]:
    """Correlation of amplitudes over all poses together, what friction explains projected out.

    Parameters
    ----------
    heard : sequence of ndarray
        Amplitude in each band and pose (B, GRID).
    told : sequence of ndarray
        Amplitude that each hypothesis foretells (H, GRID).
    friction : sequence of ndarray
        Amplitude that reversals foretell (n, GRID).
    shifts : ndarray, optional
        Samples by which each pose is shifted for a comparison by chance (S, R).
    sensors : sequence of str
        Accelerometer of each (R,); by default one. Loudness is compared between poses of the same.

    Returns
    -------
    correlation : ndarray
        Of each hypothesis (H,), what it explains in each band taken together; 0 where friction
        foretells the same.
    share : float
        Of the variance heard in the highest band that friction explains.
    chance : float
        Highest correlation of any hypothesis with the shifted amplitudes; 0 without shifts.
    """
    own = np.array(sensors or [""] * len(heard))
    times = np.zeros((1, len(heard)), np.intp)  # in time first, then shifted
    times = times if shifts is None else np.vstack([times, shifts])
    unexplained, shares = np.ones(1), []
    names = dict.fromkeys(own.tolist())
    for name in names:
        group = np.flatnonzero(own == name).tolist()
        base = np.hstack([friction[k] for k in group])
        base = np.vstack([np.ones(base.shape[1]), base])
        base = base / np.maximum(np.linalg.norm(base, axis=1, keepdims=True), 1e-12)
        span = np.linalg.svd(base, full_matrices=False)[2]
        moved = [[np.roll(heard[k], t, -1) for k, t in zip(group, at[group], strict=True)]
                 for at in times]  # fmt: skip
        y = np.array([np.hstack(each) for each in moved])
        left = y - (y @ span.T) @ span
        norm = np.linalg.norm(left, axis=-1)
        shares.append(norm[0, 0] ** 2 / max(float(((y[0, 0] - y[0, 0].mean()) ** 2).sum()), 1e-30))
        # what is left is free of the span, so that hypotheses need not be projected themselves
        against = np.vstack([base[:1], span, left.reshape(-1, left.shape[-1])])
        parts = np.split(against, len(group), axis=1)
        products = np.sum([told[k] @ part.T for k, part in zip(group, parts, strict=True)], 0)
        power = np.sum([np.einsum("ht,ht->h", told[k], told[k]) for k in group], 0)
        before = power - products[:, 0] ** 2
        size = power - (products[:, 1 : 1 + len(span)] ** 2).sum(1)
        unit = np.where(size > 0.01 * before, 1 / np.sqrt(np.maximum(size, 1e-30)), 0.0)
        each = products[:, 1 + len(span) :].reshape(-1, *norm.shape) * unit[:, None, None]
        # Bands are unlike witnesses of the same knocks: what they leave unexplained multiplies.
        # Another sensor in their midst hears the same again: its mean with the others counts.
        alike = np.clip(each / np.maximum(norm, 1e-30), 0, 1)
        unexplained = unexplained * np.prod(1 - alike**2, axis=2) ** (1 / len(names))
    found = np.sqrt(1 - unexplained)
    return found[:, 0], 1 - float(shares[0]), float(found[:, 1:].max(initial=0.0))


def direction_scores(throws: Array, covariances: Sequence[Array]) -> Array:
    """Log likelihood of each hypothesis by pose and independent vector (R, H).

    Parameters
    ----------
    throws : ndarray
        Covariance that each hypothesis tells by pose (R, H, 3, 3), trace 1.
    covariances : sequence of ndarray
        Of what repeats in the highest band, the model's frame (3, 3) [m²/s⁴].
    """
    power = np.array([max(float(np.trace(c)), 1e-12) for c in covariances])
    # Poses that hardly rang say little about direction.
    weight = np.clip(power / power.max() * 20, 0, 1)
    found = []
    for told, c, w in zip(throws, covariances, weight, strict=True):
        values, axes = np.linalg.eigh(c)
        clean = (axes * np.maximum(values, 1e-14)) @ axes.T
        clean /= np.trace(clean)
        powers, ways = np.linalg.eigh(told)
        heard = np.einsum("hai,ab,hbi->hi", ways, clean, ways)
        shares = np.maximum(powers, 0) * (1 - _ASTRAY[:, None, None]) + _ASTRAY[:, None, None] / 3
        fit = -0.5 * (np.log(3 * shares) + heard / shares - 1).sum(-1)
        found.append(w * fit.max(0))
    return np.array(found)


_ASTRAY = np.geomspace(0.03, 1.0, 40)
"""Shares of a knock's ringing in all directions alike that are tried, modes of the links [1]."""


def names_of(arm: SuspectArm, rhythm: Rhythm) -> list[str]:
    """Place of every hypothesis (H,)."""
    return [
        place_name(kind, (*arm.links, arm.base)[i] if kind == BOLTS else arm.joints[i])
        for kind, i, _ in rhythm.labels
    ]
