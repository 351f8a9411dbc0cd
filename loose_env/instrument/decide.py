"""From rhythm, direction and change to a verdict for the arm and for each of its places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from loose_env.instrument.arm import BOLTS, SuspectArm
from loose_env.instrument.locate import Rhythm, direction_scores, names_of
from loose_env.instrument.motion import Gears
from loose_env.instrument.records import Record
from loose_env.instrument.reference import Change
from loose_env.instrument.ringing import REPEATS


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Numbers that decide, set on development machines.

    `python -m scripts.suites.instrument.run --ablate` leaves each out on judged recordings.
    """

    rhythm: float = 0.40
    """Correlation of foretold and heard amplitude, of all bands, from which something knocks [1]:
    17 healthy development machines of five kinds had 0.20 with a deviation of 0.05, 0.31 at most,
    two seven-axis arms 0.35 and 0.37."""
    rhythm_beside: float = 0.25
    """The same where it rings louder than in a healthy session, whose ringing is taken off [1]:
    there they had 0.20 at most."""
    top_db: float = 2.0
    """Rise of what repeats in some band over the healthy session that must go with it [dB]: another
    day's friction makes 1.2 dB (15 %)."""
    samples: float = 60.0
    """Independent samples of a band's rhythm in a session [1]: knocks ring for some 5 ms, and loads
    change sign some ten times a second in each of six poses."""
    vectors: float = 2.5
    """Independent vectors that a pose's ringing counts for [1]: it rings in a few modes alone."""
    softer: float = 30.0
    """Weight of a joint's softening against a healthy session [1]: lines that see it."""
    stiff: float = 1.6
    """Growth of the tool motion left by the healthy gears from which a joint became softer [1]."""
    believed: float = 0.33
    """Share of the log likelihood that counts [1]: what the model of an arm lacks is wrong alike in
    all samples. It, `vectors` and `softer` are likeliest for the places of faults heard before."""
    sure: float = 0.75
    """Probability of a place from which it is settled [1]."""


FEWEST_POSES = 3
"""Poses that a verdict needs: fewer do not tell places apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Probability of every place if something is loose."""

    probability: Mapping[str, float]
    order: tuple[str, ...]
    """Places, best first."""
    best: Mapping[str, int]
    """Best hypothesis of each place."""


def score(
    arm: SuspectArm,
    rhythm: Rhythm,
    records: Sequence[Record],
    gears: Gears,
    *,
    numbers: Numbers,
    change: Change | None = None,
    healthy: Sequence[Record] | None = None,
) -> Scores:
    """Score rhythm, direction and softening of every hypothesis together, as log likelihoods."""
    covariances = [
        gears.rotation[k]
        @ (r.ring.covariance - (0 if healthy is None else healthy[k].ring.covariance))
        @ gears.rotation[k].T
        for k, r in enumerate(records)
    ]
    found = numbers.samples * rhythm.likelihood
    found += numbers.vectors * direction_scores(rhythm.throws, covariances).sum(0)
    if change is not None and change.stiff > numbers.stiff and not change.payload_kg:
        for h, (kind, i, _) in enumerate(rhythm.labels):
            if kind != BOLTS:
                found[h] += numbers.softer * change.softer[i]
    # A place that no pose lets knock is not heard, whatever the direction of the ringing.
    found = numbers.believed * np.where(rhythm.likelihood > 0, found, -np.inf)
    # A direction is two numbers more, which cost this much in expectation (Schwarz 1978).
    searched = np.array([kind == BOLTS for kind, _, _ in rhythm.labels])
    found -= searched * np.log(max(numbers.samples, 1.0))
    names = np.array(names_of(arm, rhythm))
    members = {place: np.flatnonzero(names == place) for place in arm.places}
    best = {place: int(own[found[own].argmax()]) for place, own in members.items()}
    each = np.array([found[h] for h in best.values()])
    shares = softmax(each) if np.isfinite(each).any() else np.full(len(each), 1 / len(each))
    probability = dict(zip(best, shares.tolist(), strict=True))
    order = sorted(arm.places, key=lambda place: -probability[place])
    return Scores(probability=probability, order=tuple(order), best=best)


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """Whether something knocks, and what said so."""

    loose: bool
    reasons: tuple[str, ...]
    """What said so, or what came nearest, in sentences."""
    evidence: Mapping[str, float]
    """Each statistic by its name."""
    louder: bool = False
    """True if it rings louder than on the healthy day, but nothing knocks: the sensor's mount, a
    cable or a payload changed."""
    mount: str = ""
    """How the accelerometer's mount shows in what is louder; "" where it does not."""
    masked: bool = False
    """True if what rings agrees with some place at any time: strikes of something else hide the
    rhythm."""


def repeats(records: Sequence[Record]) -> float:
    """Correlation between periods of what rings, loud poses by their power."""
    power = [float(r.ring.levels[0]) for r in records]
    return float(np.average([r.repeats for r in records], weights=power))


def detect(
    rhythm: Rhythm,
    numbers: Numbers,
    *,
    change: Change | None = None,
    repeats: float = 0.0,
) -> Alarm:
    """Say whether something knocks: by its rhythm, and by whether it rose over the healthy session.

    Parameters
    ----------
    repeats : float
        Correlation between periods of what rings. A steady rhythm agrees with itself at other times
        too: only what does not repeat is held against agreement by chance.
    """
    timing = float(rhythm.timing.max())
    evidence = {"rhythm": timing, "chance": rhythm.chance, "friction": rhythm.friction}
    limit, rose = numbers.rhythm, True
    if change is not None:
        limit, rose = numbers.rhythm_beside, change.top > numbers.top_db
        evidence |= {"top_db": change.top, "even_db": change.even, "odd_db": change.odd}
        evidence |= {"stiff": change.stiff}
        if change.stiff > numbers.stiff and change.payload_kg:
            evidence |= {"payload_kg": change.payload_kg}
    chance = 0.0 if repeats >= REPEATS else rhythm.chance
    masked = rose and chance > numbers.rhythm
    sd = 1 / np.sqrt(max(numbers.samples, 1.0))  # of a correlation's arctanh (Fisher)
    clear = np.arctanh(min(timing, 0.999)) - np.arctanh(min(chance, 0.999)) > _TENTH * sd
    loose = bool(rose and timing > limit and clear and not masked)
    words = f"correlation {timing:.2f} (limit {limit:.2f})"
    if masked:
        words = (
            f"what rings agrees with some place at any time: correlation {chance:.2f} when "
            f"shifted, {timing:.2f} in time"
        )
    elif change is None:
        words = f"{_HEARD if loose else _UNHEARD}: {words}"
    elif not rose:
        words = (
            f"the tool rings at most {change.top:.1f} dB louder than on the healthy day (limit "
            f"{numbers.top_db:g} dB)"
        )
    else:
        words = (
            f"the tool rings {change.top:.1f} dB louder than on the healthy day, in the rhythm "
            f"of {'a knock' if loose else 'no place'}: {words}"
        )
    louder, mount = change is not None and rose and not loose and not masked, ""
    if change is not None and louder and change.mount[2] > numbers.top_db:
        axis, hertz, rise = change.mount
        mount = f"its {axis} axis rings {rise:.0f} dB louder at {hertz:.0f} Hz in every pose"
    return Alarm(
        loose=loose, reasons=(words,), evidence=evidence, louder=louder, mount=mount, masked=masked
    )


_TENTH = 1.28
"""Standard deviations that one in ten exceeds [1]: a rhythm stands out from chance."""
_HEARD = "the tool rings in the rhythm of a knock"
_UNHEARD = "the rhythm of no place is heard"
