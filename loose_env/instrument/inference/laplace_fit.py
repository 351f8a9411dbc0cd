"""Laplace approximation of the evidence of one hypothesis over all runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.inference.evidence import (
    SHARES,
    Evidence,
    Piece,
    Seat,
    band_terms,
    seat_powers,
)
from loose_env.instrument.settings.thresholds import AVERAGED_DIRECTION_SD
from loose_env.statistics import axes_grid, tangents
from loose_env.typing import Array

__all__ = ["MODEL_ERRORS", "Fit", "best_powers", "fit_hypothesis", "seats_of"]


MODEL_ERRORS = np.geomspace(0.01, 0.32, 6)
"""Relative errors that the model may have at a line beside those of its parameters."""
_EXPECTED, _DECADES = 0.015, 0.4
"""Most likely of them beforehand, and the standard deviation of its decimal logarithm."""
_AXES = 150
_STEPS = 6
_HALVINGS = 4
_FIRST = 0.08
"""Model error with which a fit starts: no single line dominates before the parameters fit."""
_UNSEEN = 1.0
"""Precision of a direction of which nothing is known [1/rad²]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Maximum a posteriori fit of one hypothesis."""

    hypothesis: str
    evidence: float
    """Log evidence: parameters marginalised."""
    errors: Array
    """Errors of the model and of the runs' delays in standard deviations, as
    `UncertainArm.count` has them."""
    model_error: float
    """Relative model error at a line beside them."""
    axis: Array | None
    """Direction in the link's frame (3,); [1] for play; None where nothing is loose."""
    covariance: Array | None
    """Of the direction across itself, with errors of model and sensors [rad²] (2, 2)."""


def seats_of(hypotheses: Sequence[str], joints: int) -> dict[str, Seat | None]:
    """Seat of each hypothesis, in the order of `InstrumentedArm.hypotheses`."""
    found: dict[str, Seat | None] = {hypotheses[0]: None}
    for k in range(joints):
        name = hypotheses[1 + k]
        found[name] = Seat(hypothesis=name, columns=np.arange(3 * k, 3 * k + 3, dtype=np.intp))
    for k in range(joints):
        name = hypotheses[1 + joints + k]
        columns = np.array([3 * joints + k], dtype=np.intp)
        found[name] = Seat(hypothesis=name, columns=columns)
    return found


@dataclass(kw_only=True, eq=False)
class _State:
    errors: Array
    model_error: float
    axis: Array | None
    pieces: list[Piece]
    cost: float
    """Log-likelihood with shares summed out, and the priors of errors and model error."""


def fit_hypothesis(
    evidence: Evidence,
    hypothesis: str,
    seat: Seat | None,
    *,
    start: Fit | None = None,
    steps: int = _STEPS,
) -> Fit:
    """Fit nuisance parameters and direction, and marginalise the rest.

    Parameters
    ----------
    evidence : Evidence
        The runs.
    hypothesis : str
        Its name.
    seat : Seat or None
        Loose seat; None for a healthy arm.
    start : Fit, optional
        A fit of the same hypothesis to fewer runs.
    steps : int
        Most Gauss-Newton steps.
    """
    count = evidence.count
    errors = np.zeros(count)
    if start is not None:
        errors[: len(start.errors)] = start.errors[:count]
    allowed = _FIRST if start is None else start.model_error
    axis = None
    if seat is not None:
        axis = np.ones(1)
        pieces = evidence.pieces(errors, allowed)
        if seat.slides:
            grid = axes_grid(_AXES)
            axis = grid[int(np.argmax(evidence.seat_terms(pieces, seat, grid)))]
    now = _state(evidence, seat, errors, allowed, axis)
    for step in range(steps):
        before = now.cost
        system = _system(evidence, now, seat)
        now = _stepped(evidence, seat, now, system)
        if step in (0, 1, 3, steps - 1):
            now = _eased(evidence, seat, now)
        if seat is not None and seat.slides and step in (1, 3):
            now = _looked_again(evidence, seat, now)
        if step > 2 and now.cost - before < 0.05:
            break
    normal, _ = _system(evidence, now, seat)
    value = now.cost - 0.5 * float(np.linalg.slogdet(normal)[1])
    covariance = None
    if seat is not None and seat.slides and now.axis is not None:
        covariance = np.asarray(np.linalg.inv(normal)[count:, count:])
        if float(np.linalg.eigvalsh(covariance)[-1]) > AVERAGED_DIRECTION_SD**2:
            # Too vague for a curvature: the mean over all directions instead.
            terms = evidence.seat_terms(now.pieces, seat, np.vstack([now.axis, axes_grid(_AXES)]))
            top = float(terms.max())
            mean = top + float(np.log(np.mean(np.exp(terms[1:] - top))))
            known = float(np.linalg.slogdet(normal[:count, :count])[1])
            value = now.cost - float(terms[0]) + mean - 0.5 * known
    return Fit(
        hypothesis=hypothesis,
        evidence=value,
        errors=now.errors,
        model_error=now.model_error,
        axis=now.axis,
        covariance=covariance,
    )


def _state(
    evidence: Evidence, seat: Seat | None, errors: Array, allowed: float, axis: Array | None
) -> _State:
    pieces = evidence.pieces(errors, allowed)
    cost = sum(piece.base for piece in pieces) - 0.5 * float(errors @ errors)
    cost -= 0.5 * (np.log10(allowed / _EXPECTED) / _DECADES) ** 2
    if seat is not None and axis is not None:
        cost += float(evidence.seat_terms(pieces, seat, axis[None])[0])
    return _State(errors=errors, model_error=allowed, axis=axis, pieces=pieces, cost=float(cost))


def _eased(evidence: Evidence, seat: Seat | None, now: _State) -> _State:
    """Step to a neighbouring model error while the log posterior density improves."""
    for _ in range(len(MODEL_ERRORS)):
        at = int(np.argmin(np.abs(np.log(MODEL_ERRORS / now.model_error))))
        near = [k for k in (at - 1, at + 1) if 0 <= k < len(MODEL_ERRORS)]
        better = None
        for k in near:  # the smaller first: fits get better
            trial = _state(evidence, seat, now.errors, float(MODEL_ERRORS[k]), now.axis)
            if trial.cost > now.cost:
                better = trial
                break
        if better is None:
            return now
        now = better
    return now


def _looked_again(evidence: Evidence, seat: Seat, now: _State) -> _State:
    """Switch to another direction if its likelihood has become higher."""
    assert now.axis is not None
    grid = np.vstack([now.axis, axes_grid(_AXES)])
    values = evidence.seat_terms(now.pieces, seat, grid)
    best = int(np.argmax(values))
    if best == 0:
        return now
    return _state(evidence, seat, now.errors, now.model_error, grid[best])


def best_powers(piece: Piece, seat: Seat, axis: Array) -> Array:
    """Maximum-likelihood powers of a seat's acceleration per line (K, 2).

    Of what samples follow, and of what they fold back; see `seat_powers`.
    """
    term = band_terms(piece, seat, axis[None])[0]
    share = SHARES[np.argmax(term, axis=1)][piece.bands]
    floating = _mean(piece.response.floating(seat.columns, axis[None])[0]) ** 2
    return np.maximum(np.stack(seat_powers(piece.response, share, floating), axis=1), 1e-30)


def _system(evidence: Evidence, now: _State, seat: Seat | None) -> tuple[Array, Array]:
    """Normal equations of parameters and direction, seat motion marginalised."""
    count = evidence.count
    across = (
        tangents(now.axis) if seat is not None and seat.slides and now.axis is not None else None
    )
    size = count + (0 if across is None else len(across))
    normal, drive = np.zeros((size, size)), np.zeros(size)
    normal[np.arange(count), np.arange(count)] = 1.0
    normal[np.arange(count, size), np.arange(count, size)] = _UNSEEN
    drive[:count] = -now.errors
    for piece in now.pieces:
        response, weight = piece.response, piece.weight
        residual = response.residual
        wide = np.zeros((len(residual), response.columns.shape[2]), dtype=complex)
        motion = np.zeros(len(residual), dtype=complex)
        if seat is not None and now.axis is not None and not piece.lines.healthy:
            powers = best_powers(piece, seat, now.axis)
            column = response.columns[:, :, seat.columns] @ now.axis
            sudden = response.sudden[:, seat.columns] @ now.axis
            both = np.stack([column, np.broadcast_to(sudden, column.shape)], axis=2)
            weighted = weight @ both
            inside = both.conj().swapaxes(1, 2) @ weighted
            inside[:, [0, 1], [0, 1]] += 1 / powers
            lean = np.linalg.inv(inside)
            seen = lean @ (weighted.conj().swapaxes(1, 2) @ residual[:, :, None])
            motion = seen[:, 0, 0]
            wide[:, seat.columns] = motion[:, None] * now.axis
            weight = weight - weighted @ lean @ weighted.conj().swapaxes(1, 2)
        slopes = response.slopes(wide)
        if across is not None:
            turn = response.columns[:, :, seat.columns] @ across.T if seat is not None else slopes
            slopes = np.concatenate([slopes, turn * motion[:, None, None]], axis=2)
        heavy = weight @ slopes
        flat = slopes.reshape(-1, size)
        normal += 2 * piece.temper * (flat.conj().T @ heavy.reshape(-1, size)).real
        drive += 2 * piece.temper * (heavy.reshape(-1, size).conj().T @ residual.ravel()).real
    return normal, drive


def _mean(values: Array) -> Array:
    width = min(9, len(values))
    padded = np.pad(values**2, (width // 2, width - 1 - width // 2), mode="edge")
    return np.asarray(np.sqrt(np.convolve(padded, np.ones(width) / width, mode="valid")))


def _stepped(
    evidence: Evidence, seat: Seat | None, now: _State, system: tuple[Array, Array]
) -> _State:
    """Damped Gauss-Newton step by line search."""
    normal, drive = system
    count = len(now.errors)
    step = np.linalg.solve(normal, drive)
    for halving in range(_HALVINGS):
        part = step / 2**halving
        axis = now.axis
        if len(part) > count and axis is not None:
            turn = part[count:]
            size = float(np.linalg.norm(turn))
            axis = axis + turn / max(1.0, size / 0.3) @ tangents(axis)
            axis = axis / np.linalg.norm(axis)
        trial = _state(evidence, seat, now.errors + part[:count], now.model_error, axis)
        if trial.cost > now.cost:
            return trial
    return now
