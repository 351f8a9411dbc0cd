"""Maximum a posteriori fit of one hypothesis to all runs, with its Laplace evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.inference import log_determinant, next_radius, shorter_radius, step_within
from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.seat_motion import (
    SHARES,
    Piece,
    Seat,
    band_terms,
    joint_readings,
    over_lines,
    seat_powers,
)
from loose_env.instrument.settings.thresholds import AVERAGED_DIRECTION_SD
from loose_env.statistics import axes_grid, tangents
from loose_env.typing import Array, ComplexArray

_AXES = 150
_STEPS = 30
_TRIALS = 5
_CONVERGED = 0.2
"""Gain of a step below which a fit ends [nats]."""
_FIRST_RADIUS = 2.0
"""Length of the first step [standard deviations of the priors]. The readings of a rigid arm change
with a spring's compliance, which there is next to nothing: a Newton step in its logarithm would
pass over all modes in the band, and there is no way back from beyond them."""
_UNSEEN = 1.0
"""Precision of a direction of which nothing is known [1/rad²]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunTerm:
    """Contribution of one run to the evidence of a hypothesis."""

    log_likelihood: float
    """At the fitted parameters."""
    misfit: float
    """Share of the accelerometers' power that the fit leaves unexplained by parameters, joints
    and the seat [1]."""
    effect: float
    """Share of the accelerometers' power that the seat's motion makes [1]."""
    shut: float = 1.0
    """Probability that the seat stayed shut [1]."""
    held: float = 1.0
    """The same before the readings are seen: by excitation, load and friction alone [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Maximum a posteriori fit of one hypothesis."""

    hypothesis: str
    evidence: float
    """Log evidence: parameters marginalised."""
    errors: Array
    """Errors of the model and of the runs' delays in standard deviations, as
    `UncertainArm.count` has them."""
    variances: Array
    """Variance components, in the order of `ComponentIndex`."""
    runs: Mapping[int, RunTerm]
    """What each run adds, by its number."""
    axis: Array | None
    """Direction in the link's frame (3,); [1] for play; None where nothing is loose."""
    normal: Array
    """Inverse covariance of the parameters (P, P)."""
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
    variances: Array
    axis: Array | None
    pieces: list[Piece]
    cost: float
    """Log-likelihood with shares summed out, and the priors of errors and variances."""


@dataclass(kw_only=True, eq=False)
class _System:
    """Normal equations of parameters and direction, and sums for the variance components."""

    normal: Array
    drive: Array
    explained: Array
    expected: Array
    misfit: dict[int, list[tuple[float, float, float]]]
    """Of each run's pieces the unexplained, whole and the seat's power; see `_unexplained`."""


def fit_hypothesis(
    evidence: Evidence,
    hypothesis: str,
    seat: Seat | None,
    *,
    start: Fit | None = None,
    width: float | None = 3.0,
    steps: int = _STEPS,
) -> Fit:
    """Fit nuisance parameters and direction, and marginalise the rest."""
    count = evidence.count
    errors = np.zeros(count) if evidence.known is None else evidence.known.errors
    if start is not None:
        errors = start.errors
    if width is not None:
        variances = evidence.start(width)
    elif start is not None:
        variances = start.variances
    else:
        raise ValueError("a fit needs a width or a start")
    axis = None
    if seat is not None:
        axis = np.ones(1)
        if start is not None and start.axis is not None:
            axis = start.axis
        elif seat.slides:
            grid = axes_grid(_AXES)
            pieces = evidence.pieces(errors, variances)
            axis = grid[int(np.argmax(evidence.seat_terms(pieces, seat, grid)))]
    now, radius = _state(evidence, seat, errors, variances, axis), _FIRST_RADIUS
    for step in range(steps):
        before = now.cost
        system = _system(evidence, now, seat)
        now, radius = _stepped(evidence, seat, now, system, radius)
        now = _rescaled(evidence, seat, now, system)
        if seat is not None and seat.slides and step in (1, 3):
            now = _looked_again(evidence, seat, now)
        if step > 2 and now.cost - before < _CONVERGED:
            break
    system = _system(evidence, now, seat)
    normal = system.normal
    value = now.cost - 0.5 * log_determinant(normal)
    covariance = None
    if seat is not None and seat.slides and now.axis is not None:
        covariance = np.asarray(np.linalg.inv(normal)[count:, count:])
        if float(np.linalg.eigvalsh(covariance)[-1]) > AVERAGED_DIRECTION_SD**2:
            # Too vague for a curvature: the mean over all directions instead.
            terms = evidence.seat_terms(now.pieces, seat, np.vstack([now.axis, axes_grid(_AXES)]))
            top = float(terms.max())
            mean = top + float(np.log(np.mean(np.exp(terms[1:] - top))))
            known = log_determinant(normal[:count, :count])
            value = now.cost - float(terms[0]) + mean - 0.5 * known
    return Fit(
        hypothesis=hypothesis,
        evidence=value,
        errors=now.errors,
        variances=now.variances,
        runs=_by_run(evidence, seat, now, system),
        axis=now.axis,
        normal=normal[:count, :count],
        covariance=covariance,
    )


def _state(
    evidence: Evidence, seat: Seat | None, errors: Array, variances: Array, axis: Array | None
) -> _State:
    pieces = evidence.pieces(errors, variances)
    cost = sum(piece.base for piece in pieces) - evidence.prior(errors)[0]
    cost += evidence.index.log_prior(variances)
    if seat is not None and axis is not None:
        cost += float(evidence.seat_terms(pieces, seat, axis[None])[0])
    return _State(errors=errors, variances=variances, axis=axis, pieces=pieces, cost=float(cost))


def _rescaled(evidence: Evidence, seat: Seat | None, now: _State, system: _System) -> _State:
    """Variances after a step toward those of highest posterior density."""
    index = evidence.index
    better = index.updated(now.variances, system.explained, system.expected)
    if evidence.known is not None:
        better[index.shared] = now.variances[index.shared]
    # Longer steps where they are better still: single ones are safe, but short.
    for power in (6.0, 2.0, 1.0):
        trial = index.within_bounds(now.variances * (better / now.variances) ** power)
        state = _state(evidence, seat, now.errors, trial, now.axis)
        if state.cost > now.cost:
            return state
    return now


def _by_run(
    evidence: Evidence, seat: Seat | None, now: _State, system: _System
) -> dict[int, RunTerm]:
    """Log-likelihood and misfit of each run."""
    value: dict[int, float] = {}
    shut: dict[int, float] = {}
    held: dict[int, float] = {}
    for piece in now.pieces:
        number = piece.lines.number
        value[number] = value.get(number, 0.0) + piece.base
    if seat is not None and now.axis is not None:
        terms = evidence.run_terms(now.pieces, seat, now.axis[None])
        for number, (ratio, while_shut) in terms.items():
            value[number] += float(ratio[0])
            shut[number] = float(np.exp(while_shut - ratio)[0])
            held[number] = float(np.exp(while_shut)[0])
    found = {}
    for number, log_likelihood in value.items():
        left, whole, seat_power = np.sum(system.misfit[number], axis=0)
        found[number] = RunTerm(
            log_likelihood=log_likelihood,
            misfit=float(np.clip(left / max(whole, 1e-30), 0.0, 1.0)),
            effect=float(seat_power / max(whole, 1e-30)),
            shut=shut.get(number, 1.0),
            held=held.get(number, 1.0),
        )
    return found


def fitted_pieces(evidence: Evidence, fit: Fit) -> list[Piece]:
    """Responses and weights at the parameters and variances of a fit."""
    return evidence.pieces(fit.errors, fit.variances)


def _looked_again(evidence: Evidence, seat: Seat, now: _State) -> _State:
    """Switch to another direction if its likelihood has become higher."""
    assert now.axis is not None
    grid = np.vstack([now.axis, axes_grid(_AXES)])
    values = evidence.seat_terms(now.pieces, seat, grid)
    best = int(np.argmax(values))
    if best == 0:
        return now
    return _state(evidence, seat, now.errors, now.variances, grid[best])


def best_powers(piece: Piece, seat: Seat, axis: Array) -> Array:
    """Maximum-likelihood powers of a seat's acceleration per line (K, 2).

    Of what samples follow, and of what they fold back; see `seat_powers`.
    """
    term = band_terms(piece, seat, axis[None])[0]
    share = SHARES[np.argmax(term, axis=1)][piece.bands]
    floating = over_lines(piece.response.floating(seat.columns, axis[None]) ** 2)[0]
    return np.maximum(np.stack(seat_powers(piece.response, share, floating), axis=1), 1e-30)


def _system(evidence: Evidence, now: _State, seat: Seat | None) -> _System:
    """Normal equations and sums over all pieces, seat motion marginalised."""
    count = evidence.count
    across = (
        tangents(now.axis) if seat is not None and seat.slides and now.axis is not None else None
    )
    size = count + (0 if across is None else len(across))
    normal, drive = np.zeros((size, size)), np.zeros(size)
    precision = evidence.prior(now.errors)[1]
    normal[:count, :count] = precision
    normal[np.arange(count, size), np.arange(count, size)] = _UNSEEN
    drive[:count] = -precision @ (now.errors - evidence.expected)
    explained, expected = np.zeros((2, len(now.variances)))
    misfit: dict[int, list[tuple[float, float, float]]] = {}
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
            moved = both @ seen
        else:
            moved = np.zeros((*residual.shape, 1))
        slopes = response.slopes(wide)
        if across is not None:
            turn = response.columns[:, :, seat.columns] @ across.T if seat is not None else slopes
            slopes = np.concatenate([slopes, turn * motion[:, None, None]], axis=2)
        heavy = weight @ slopes
        flat, weighed = _as_real(slopes.reshape(-1, size)), _as_real(heavy.reshape(-1, size))
        normal += 2 * piece.temper * (flat.T @ weighed)
        drive += 2 * piece.temper * (weighed.T @ _as_real(residual.ravel()))
        pulled = weight @ residual[:, :, None]
        along = np.abs(piece.patterns.conj().swapaxes(1, 2) @ pulled)[:, :, 0] ** 2
        alone = np.einsum(
            "kcq,kcq->kq", piece.patterns.conj(), weight @ piece.patterns, optimize=True
        ).real
        np.add.at(explained, piece.components, piece.temper * along.sum(axis=0))
        np.add.at(expected, piece.components, piece.temper * alone.sum(axis=0))
        own, power = pulled[:, :, 0], piece.reading_power
        diagonal = np.diagonal(weight, axis1=1, axis2=2).real
        read, foreseen = np.abs(own) ** 2 * power, diagonal * power
        explained[piece.reading] += piece.temper * float(np.sum(read))
        expected[piece.reading] += piece.temper * float(np.sum(foreseen))
        shares, error = now.variances[piece.components], now.variances[piece.reading]
        bands = evidence.index.bands(piece.lines.number)
        factor = now.variances[bands][piece.bands]
        for sums, part, whole in ((explained, along, read), (expected, alone, foreseen)):
            by_line = piece.temper * (part @ shares + error * whole.sum(axis=1)) / factor
            np.add.at(sums, bands[piece.bands], by_line)
        misfit.setdefault(piece.lines.number, []).append(
            _unexplained(piece, now.variances, moved[:, :, 0], pulled)
        )
    return _System(
        normal=normal, drive=drive, explained=explained, expected=expected, misfit=misfit
    )


def _as_real(values: ComplexArray) -> Array:
    """Real parts, then imaginary ones: products of these are real parts of complex ones."""
    return np.concatenate([values.real, values.imag])


def _unexplained(
    piece: Piece, variances: Array, moved: ComplexArray, pulled: ComplexArray
) -> tuple[float, float, float]:
    """Power of the accelerometers' residual, of their readings, and of the seat's motion in them.

    The residual is that without the seat's motion and the joints' own.
    """
    lines = piece.lines
    joints = joint_readings(piece, variances, pulled)
    rows = [k for k, (reading, _) in enumerate(lines.row) if reading.kind == "acceleration"]
    left = np.abs((piece.response.residual - moved - joints)[:, rows]) ** 2
    noise = lines.noise[:, rows]
    if lines.beside is not None:
        noise = noise + lines.beside.noise[:, rows]
    read = lines.read[:, rows]
    whole = np.abs(lines.readings[:, rows]) ** 2
    seat = np.abs(moved[:, rows]) ** 2
    sums = (np.sum(np.where(read, each, 0.0)) for each in (left - noise, whole, seat))
    unexplained, power, own = (float(each) for each in sums)
    return unexplained, power, own


def _stepped(
    evidence: Evidence, seat: Seat | None, now: _State, system: _System, radius: float
) -> tuple[_State, float]:
    """Gauss-Newton step within a trust region, and the region of the next one."""
    normal, drive = system.normal, system.drive
    count = len(now.errors)
    for _ in range(_TRIALS):
        step = step_within(normal, drive, count, radius)
        axis = now.axis
        if len(step) > count and axis is not None:
            turn = step[count:]
            size = float(np.linalg.norm(turn))
            axis = axis + turn / max(1.0, size / 0.3) @ tangents(axis)
            axis = axis / np.linalg.norm(axis)
        trial = _state(evidence, seat, now.errors + step[:count], now.variances, axis)
        if trial.cost > now.cost:
            foreseen = float(step @ drive - 0.5 * step @ normal @ step)
            return trial, next_radius(radius, trial.cost - now.cost, foreseen)
        radius = shorter_radius(step[:count])
    return now, radius
