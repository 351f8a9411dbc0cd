"""Lower bounds on the mean number of records at a given error rate.

Two bounds, each as good as the figure that goes into it. Both count a verdict of "unsure" as an
error, and hold for any choice of records and any stopping rule.

Information (Fano): to err on a share δ of the arms the records must bring
H(prior) - h(δ) - δ ln(K - 1) nat about the hypothesis (Cover and Thomas, Elements of Information
Theory, 2nd edition, theorem 2.10.1). What all records bring is the sum of what each brings given
those before it, so with at most I nat a record, on average over the arms still measured,
E[records] >= (H(prior) - h(δ) - δ ln(K - 1)) / I.

Success: let s_k be the highest share of right verdicts that k records allow. Who is right on
1 - δ of the arms is right within k records on at most s_k of them, so
P(records > k) >= 1 - δ - s_k, and E[records] is the sum of P(records > k) over k = 0, 1, ...
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = ["entropy", "least_records", "needed_information"]


def entropy(probabilities: ArrayLike) -> float:
    """Entropy of a distribution [nat].

    Parameters
    ----------
    probabilities : array_like (K,)
        Not negative, with the sum 1.

    Raises
    ------
    InvalidData
        If it is no distribution.

    Examples
    --------
    >>> round(entropy([0.5, 0.25, 0.25]), 4)
    1.0397
    """
    p = np.asarray(probabilities, dtype=float)
    if p.ndim != 1 or not len(p) or not (p >= 0).all() or not np.isclose(p.sum(), 1.0):
        raise InvalidData(
            f"probabilities must be 0 or more and sum to 1, got {np.asarray(probabilities)!r}"
        )
    some = p[p > 0]
    return float(-np.sum(some * np.log(some)))


def needed_information(prior: ArrayLike, error: ArrayLike) -> Array:
    """Least information about the hypothesis that an error rate takes, by Fano [nat].

    Parameters
    ----------
    prior : array_like (K,)
        Probability of each hypothesis beforehand.
    error : array_like
        Share of wrong verdicts, "unsure" among them, 0 to 1.

    Returns
    -------
    ndarray, as ``error``
        Zero where a guess errs as little as that bound can tell.

    Raises
    ------
    InvalidData
        If the prior is no distribution.
    InvalidSetting
        If an error lies outside 0 to 1.

    Examples
    --------
    >>> needed_information([0.25] * 4, [0.0, 0.1, 0.75]).round(3).tolist()
    [1.386, 0.951, 0.0]
    """
    delta = np.asarray(error, dtype=float)
    if not ((delta >= 0) & (delta <= 1)).all():
        raise InvalidSetting(f"an error rate is 0 to 1, got {error!r}")
    most, count = entropy(prior), int(np.count_nonzero(np.asarray(prior, dtype=float)))
    if count < 2:
        return np.zeros_like(delta)
    # Beyond this error, that of a guess among equals, the right side falls again.
    delta = np.minimum(delta, (count - 1) / count)
    inside = np.clip(delta, 1e-300, 1.0)
    binary = -inside * np.log(inside) - (1 - delta) * np.log1p(-delta)
    return np.asarray(np.maximum(most - binary - delta * np.log(count - 1), 0.0))


def least_records(
    error: ArrayLike,
    prior: ArrayLike,
    *,
    information: float | None = None,
    success: ArrayLike | None = None,
) -> Array:
    """Fewest records, on average, that an error rate takes: the larger of the two bounds.

    Parameters
    ----------
    error : array_like
        Share of wrong verdicts, "unsure" among them, 0 to 1.
    prior : array_like (K,)
        Probability of each hypothesis beforehand.
    information : float, optional
        Most that one record says about the hypothesis on average [nat], above 0.
    success : array_like (R,), optional
        Highest share of right verdicts after 1 to R records. More records than R are not
        counted, which can only lower the bound.

    Returns
    -------
    ndarray, as ``error``
        At least 1: the environment takes no verdict before the first record.

    Raises
    ------
    InvalidData
        If the prior is no distribution, or a success is no share or falls.
    InvalidSetting
        If an error lies outside 0 to 1, or the information is not above 0.

    Examples
    --------
    Nine hypotheses, records of at most 0.5 nat, right on 60, 80 and 85 % after 1 to 3 of them.

    >>> prior = np.full(9, 1 / 9)
    >>> least_records([0.1, 0.3], prior, information=0.5).round(2).tolist()
    [3.33, 1.93]
    >>> least_records([0.1, 0.3], prior, success=[0.6, 0.8, 0.85]).round(2).tolist()
    [1.45, 1.1]
    """
    needed = needed_information(prior, error)
    found = np.ones_like(needed)
    if information is not None:
        if not information > 0:
            raise InvalidSetting(f"the information of a record is above 0 nat, got {information!r}")
        found = np.maximum(found, needed / information)
    if success is not None:
        s = np.asarray(success, dtype=float)
        if s.ndim != 1 or not ((s >= 0) & (s <= 1)).all() or (np.diff(s) < 0).any():
            raise InvalidData(f"success after 1, 2, ... records is 0 to 1 and never falls: {s!r}")
        short = np.maximum(1.0 - np.asarray(error, dtype=float)[..., None] - s, 0.0)
        # P(records > 0) is 1: there is no verdict before the first record.
        found = np.maximum(found, 1.0 + short.sum(-1))
    return np.asarray(found)
