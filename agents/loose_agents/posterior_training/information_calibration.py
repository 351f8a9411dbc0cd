"""Calibration of expected information gain against the gain in a record bank.

The expected information rests on the nominal arm and on a rough idea of how seats open. How much
of it comes true depends on the record's length and on which joints are shaken. These few factors
are fitted on records of a bank, where the gain in the log-probability of the truth is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from loose_agents.core.base import PROBABILITY_FLOOR, Problem
from loose_agents.posterior_training.record_bank import RecordBank
from loose_env.diagnosis import AmortisedPosterior, InformationFactors, RecordInformation
from loose_env.typing import Array

__all__ = ["Transitions", "fit_factors", "transitions_of"]

_LAST_INFORMATIVE = 0.97
"""Largest probability [1] before a record whose gain is counted: agents have stopped by then."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Transitions:
    """Expected and realised information gain of N records of a bank."""

    expected: Array
    """Information without any factor [nat] (N,)."""
    gained: Array
    """Gain in the log-probability of the truth [nat] (N,)."""
    seconds: Array
    """Length of the record [s] (N,)."""
    excited: NDArray[np.bool_]
    """Joints that were shaken (N, n)."""


def transitions_of(
    problem: Problem,
    posterior: AmortisedPosterior,
    bank: RecordBank,
    rng: np.random.Generator,
    *,
    records: int = 3,
) -> Transitions:
    """Replay the episodes of a bank and predict the gain of each record.

    Parameters
    ----------
    problem : Problem
        Arm and rules of the bank.
    posterior : AmortisedPosterior
        What follows them.
    bank : RecordBank
        Episodes that the posterior was not trained on.
    rng : numpy.random.Generator
        Thins the beliefs.
    records : int
        Records of each episode.
    """
    information = RecordInformation(
        posterior.features, posterior.frictions, factors=InformationFactors()
    )
    rows = []
    for truth, taken in zip(bank.truth, bank.records(problem.layout), strict=True):
        belief = posterior.start()
        for record in taken[:records]:
            before = belief.probabilities
            if record is None or before.max() > _LAST_INFORMATIVE:
                break
            faults = information.imagine(belief.belief, rng)
            expected = information.of(faults, record.pose, record.torque, record.duration)
            belief = posterior.update(belief, record)
            after = belief.probabilities[truth]
            gained = np.log(max(after, PROBABILITY_FLOOR)) - np.log(
                max(before[truth], PROBABILITY_FLOOR)
            )
            rows.append((expected.information, gained, record.duration, record.excited))
    return Transitions(
        expected=np.array([r[0] for r in rows]),
        gained=np.array([r[1] for r in rows]),
        seconds=np.array([r[2] for r in rows]),
        excited=np.array([r[3] for r in rows]),
    )


def fit_factors(found: Transitions) -> InformationFactors:
    """Fit the factors by least squares to the mean information gain."""
    n = found.excited.shape[1]

    def factors(x: Array) -> InformationFactors:
        return InformationFactors(
            length=float(x[0]), together=float(x[1]), joints=tuple(float(v) for v in x[2:])
        )

    def misses(x: Array) -> Array:
        by = factors(x)
        scale = np.array([by.of(on, s) for on, s in zip(found.excited, found.seconds, strict=True)])
        # The pull towards zero decides where the records say nothing.
        return np.concatenate([scale * found.expected - found.gained, 0.5 * x])

    fitted = least_squares(misses, np.zeros(2 + n))
    return factors(fitted.x)
