"""From rhythm, direction and change to a verdict for the arm and for each of its places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from loose_env.instrument.arm import BOLTS, SuspectArm
from loose_env.instrument.locate import Rhythm, direction_scores, log_likelihood, names_of
from loose_env.instrument.motion import Gears
from loose_env.instrument.records import Record
from loose_env.instrument.reference import Change
from loose_env.instrument.ringing import REPEATS
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Numbers that decide, set on development machines.

    `python -m scripts.suites.instrument.run --ablate` leaves each out on judged recordings.
    """

    healthy: float = 4.0
    """Arms that are shaken and tight, to one with a loose place [1]: 4 to 1 asks for 3.3 nats of
    seven places and 4.1 of fifteen. Of twelve tight arms heard before the best place had 3.2 at
    most, with a healthy session 1.2; of 21 with a fault that opens all but two 3.8 and 4.5."""
    top_db: float = 2.0
    """Rise of what repeats in some band over the healthy session that must go with it [dB]: another
    day's friction makes 1.2 dB (15 %)."""
    samples: float = 60.0
    """Independent samples of a band's rhythm in a session [1]: knocks ring for some 5 ms, and loads
    change sign some ten times a second in each of six poses."""
    vectors: float = 1.25
    """Independent vectors that a pose's ringing counts for [1]: an arm rings in a few modes, and in
    much the same in all poses."""
    softer: float = 10.0
    """Weight of a joint's softening against a healthy session [1]: lines that see it alone."""
    stiff: float = 1.6
    """Growth of the tool motion left by the healthy gears from which a joint became softer [1]."""
    believed: float = 0.33
    """Share of the log likelihood that counts [1]: what the model of an arm lacks is wrong alike in
    all samples. It, `vectors` and `softer` are likeliest for the places of faults heard before."""
    sure: float = 0.6
    """Probability of a place from which it is settled [1]: three to two against all others, of
    which 27 of 29 were right on machines heard before."""


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
    knocks: Mapping[str, float]
    """Evidence of each for its rhythm alone [nats]."""


def cost(rhythm: Rhythm, numbers: Numbers) -> Array:
    """What the numbers that a hypothesis was fitted by cost in log likelihood (H,).

    A seat's direction is two, the turn of a base's plate one; half the log of the samples each, in
    expectation (Schwarz 1978).
    """
    n = max(i for kind, i, _ in rhythm.labels if kind == BOLTS)
    fitted = [0 if kind != BOLTS else 1 if i == n else 2 for kind, i, _ in rhythm.labels]
    found: Array = 0.5 * np.log(max(numbers.samples, 1.0)) * np.array(fitted)
    return found


def knock_evidence(rhythm: Rhythm, numbers: Numbers) -> Array:
    """Log likelihood of each hypothesis' rhythm against none, less its cost (H,) [nats]."""
    found: Array = numbers.samples * rhythm.likelihood - cost(rhythm, numbers)
    return found


def knock_limit(places: int, healthy: float = Numbers.healthy) -> float:
    """Evidence from which one of some places knocks: as likely then as that none does [nats]."""
    return float(np.log(healthy * places))


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
    found -= cost(rhythm, numbers)
    names = np.array(names_of(arm, rhythm))
    members = {place: np.flatnonzero(names == place) for place in arm.places}
    best = {place: int(own[found[own].argmax()]) for place, own in members.items()}
    each = np.array([found[h] for h in best.values()])
    shares = softmax(each) if np.isfinite(each).any() else np.full(len(each), 1 / len(each))
    probability = dict(zip(best, shares.tolist(), strict=True))
    order = sorted(arm.places, key=lambda place: -probability[place])
    own = knock_evidence(rhythm, numbers)
    knocks = {place: float(own[of].max()) for place, of in members.items()}
    return Scores(probability=probability, order=tuple(order), best=best, knocks=knocks)


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

    The evidence is that which places it: of the best place against none.

    Parameters
    ----------
    repeats : float
        Correlation between periods of what rings. A steady rhythm agrees with itself at other times
        too: only what does not repeat is held against agreement by chance.
    """
    timing, knocks = float(rhythm.timing.max()), float(knock_evidence(rhythm, numbers).max())
    limit, rose = knock_limit(len({label[:2] for label in rhythm.labels}), numbers.healthy), True
    evidence = {"knocks": knocks, "rhythm": timing, "chance": rhythm.chance}
    evidence |= {"friction": rhythm.friction}
    if change is not None:
        rose = change.top > numbers.top_db
        evidence |= {"top_db": change.top, "even_db": change.even, "odd_db": change.odd}
        evidence |= {"stiff": change.stiff}
        if change.stiff > numbers.stiff and change.payload_kg:
            evidence |= {"payload_kg": change.payload_kg}
    chance = 0.0 if repeats >= REPEATS else rhythm.chance
    by_chance = numbers.samples * float(log_likelihood(np.array(chance)))
    by_chance = max(by_chance - float(cost(rhythm, numbers).max()), 0.0)
    masked = bool(rose and by_chance > limit)
    loose = bool(rose and knocks > limit + by_chance and not masked)
    words = f"correlation {timing:.2f}, evidence {knocks:.1f} nats (limit {limit:.1f})"
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


_HEARD = "the tool rings in the rhythm of a knock"
_UNHEARD = "the rhythm of no place is heard"
