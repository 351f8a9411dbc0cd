"""Fit of model errors to the lines of records, with a seat open or with none.

Every line has the seat's motion as an unknown of its own, so it does not matter how gap, friction
and stops make it move: only that it moves along one direction, and that the rest of the arm is
linear. Eliminating that motion projects each line's residual across the seat's column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.research.line_spectrum.record_lines import RecordLines
from loose_env.diagnosis.research.line_spectrum.uncertain_arm import Answer, UncertainArm
from loose_env.statistics import tangents
from loose_env.typing import Array, ComplexArray

__all__ = ["ErrorFit", "answers_of", "fit_errors", "healthy_misfit", "misfit_along", "residual_of"]


_DEGREES = 4.0
"""Lines whose squared misfit is far above this count with its logarithm: few lines, such as those
at a resonance that the model puts elsewhere, must not decide."""
_HALVINGS = 4
_ENOUGH = 1e-3  # relative fall of the cost below which the fit ends


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorFit:
    """A fit's outcome."""

    errors: Array
    """Errors of the model in standard deviations (P,)."""
    seat: Array | None
    """Unit combination of the seat's columns that moves (s,); None where no seat was open."""
    cost: float
    """Squared misfit of lines and errors, twice the negative log-likelihood."""


def answers_of(arm: UncertainArm, lines: Sequence[RecordLines], errors: Array) -> list[Answer]:
    """Answers of the arm with some errors, for every record."""
    return [arm.at(one.pose).answer(one.frequency, one.excited, errors) for one in lines]


def residual_of(one: RecordLines, answer: Answer) -> ComplexArray:
    """Residual of the healthy arm (K, c)."""
    if one.relative:
        return one.readings
    return np.asarray(one.readings - np.einsum("kcm,km->kc", answer.transfer, one.torque))


def misfit_along(
    lines: Sequence[RecordLines],
    answers: Sequence[Answer],
    columns: NDArray[np.intp],
    axes: Array,
    model_error: float,
) -> Array:
    """Cost of every axis along which a seat may slide, the seat's motion eliminated.

    Parameters
    ----------
    lines : sequence of RecordLines
        Records.
    answers : sequence of Answer
        Response of the arm to each.
    columns : ndarray (s,)
        The seat's columns among those of the answers.
    axes : ndarray (P, s)
        Unit vectors.
    model_error : float
        Model error over the power of each line [1].

    Returns
    -------
    ndarray (P,)
        Twice the negative log-likelihood, but for a constant.
    """
    cost = np.zeros(len(axes))
    for one, answer in zip(lines, answers, strict=True):
        root = np.sqrt(1 / (one.noise + model_error**2 * one.power))
        residual = root * residual_of(one, answer)
        seen = root[:, :, None] * answer.columns[:, :, columns]
        # In terms of the seat's own axes: |r|^2 - |u.(C^H r)|^2 / u.(C^H C) u.
        along = np.einsum("kcs,kc->ks", seen.conj(), residual) @ axes.T
        gram = np.einsum("kcs,kct->kst", seen.conj(), seen).real
        length = np.einsum("ps,kst,pt->kp", axes, gram, axes)
        total = np.sum(np.abs(residual) ** 2, axis=1)[:, None]
        explained = np.abs(along) ** 2 / np.maximum(length, 1e-30 * np.max(gram))
        cost += _robust(np.maximum(total - explained, 0.0)).sum(0)
    return cost


def healthy_misfit(
    lines: Sequence[RecordLines], answers: Sequence[Answer], model_error: float
) -> float:
    """Cost of no seat being open; see `misfit_along`."""
    found = 0.0
    for one, answer in zip(lines, answers, strict=True):
        weight = 1 / (one.noise + model_error**2 * one.power)
        left = np.abs(residual_of(one, answer)) ** 2
        found += float(_robust(np.sum(weight * left, axis=1)).sum())
    return found


def fit_errors(
    arm: UncertainArm,
    lines: Sequence[RecordLines],
    *,
    model_error: float,
    columns: NDArray[np.intp] | None = None,
    seat: Array | None = None,
    errors: Array | None = None,
    steps: int = 6,
) -> ErrorFit:
    """Fit the model's errors, and the seat's direction with them (Gauss-Newton, damped).

    Errors have a normal prior of one standard deviation each.

    Parameters
    ----------
    arm : UncertainArm
        The arm and its possible errors.
    lines : sequence of RecordLines
        Records, in one pose or in several.
    model_error : float
        Remaining model error at each line, relative to the power there [1].
    columns : ndarray (s,), optional
        Columns of the open seat; None for a healthy arm.
    seat : ndarray (s,), optional
        Direction to start from.
    errors : ndarray (P,), optional
        Errors to start from; none by default.
    steps : int
        Most Gauss-Newton steps.
    """
    theta = np.zeros(len(arm.names)) if errors is None else errors
    along = None if columns is None or seat is None else seat / np.linalg.norm(seat)
    if not len(theta) and (along is None or len(along) == 1):
        steps = 0
    answers = answers_of(arm, lines, theta)
    cost = _cost(lines, answers, theta, columns, along, model_error)
    for _ in range(steps):
        normal, drive = _equations(arm, lines, answers, theta, columns, along, model_error)
        size = len(theta)
        normal[:size, :size] += np.eye(size)
        drive[:size] -= theta
        normal[np.diag_indices(len(normal))] += 1e-9 * np.trace(normal) / len(normal)
        step = np.linalg.solve(normal, drive)
        best = None
        for halving in range(_HALVINGS):
            part = step / 2**halving
            trial = theta + part[:size]
            turned = None if along is None else _turned(along, part[size:])
            answers = answers_of(arm, lines, trial)
            reached = _cost(lines, answers, trial, columns, turned, model_error)
            if reached < cost:
                best = trial, turned, reached
                break
        if best is None:
            break
        fall = cost - best[2]
        theta, along, cost = best
        if fall < _ENOUGH * abs(cost):
            break
    return ErrorFit(errors=theta, seat=along, cost=cost)


def _robust(squared: Array) -> Array:
    return np.asarray(2 * _DEGREES * np.log1p(squared / _DEGREES))


def _turned(along: Array, by: Array) -> Array:
    moved = along + by @ tangents(along) if len(along) > 1 else along
    return np.asarray(moved / np.linalg.norm(moved))


def _cost(
    lines: Sequence[RecordLines],
    answers: Sequence[Answer],
    errors: Array,
    columns: NDArray[np.intp] | None,
    along: Array | None,
    model_error: float,
) -> float:
    if columns is not None and along is not None:
        found = float(misfit_along(lines, answers, columns, along[None], model_error)[0])
    else:
        found = healthy_misfit(lines, answers, model_error)
    return found + float(errors @ errors)


def _equations(
    arm: UncertainArm,
    lines: Sequence[RecordLines],
    answers: Sequence[Answer],
    errors: Array,
    columns: NDArray[np.intp] | None,
    along: Array | None,
    model_error: float,
) -> tuple[Array, Array]:
    """Normal equations of errors, then of the seat's turn, from all lines."""
    size = len(errors)
    turns = 0 if along is None else len(along) - 1
    normal, drive = np.zeros((size + turns, size + turns)), np.zeros(size + turns)
    across = tangents(along) if along is not None and turns else np.zeros((0, 1))
    for one, answer in zip(lines, answers, strict=True):
        root = np.sqrt(1 / (one.noise + model_error**2 * one.power))
        residual = residual_of(one, answer)
        torque = np.zeros_like(one.torque) if one.relative else one.torque
        motion = np.einsum("kvm,km->kv", answer.by_torque, torque)
        unit = np.zeros_like(residual)
        slide = np.zeros(len(residual), dtype=complex)
        if columns is not None and along is not None:
            column = answer.columns[:, :, columns] @ along
            length = np.sqrt(np.sum(np.abs(root * column) ** 2, axis=1))[:, None]
            unit = root * column / np.maximum(length, 1e-30)
            slide = np.sum(unit.conj() * (root * residual), axis=1) / np.maximum(
                length[:, 0], 1e-30
            )
            residual = residual - column * slide[:, None]
            motion = motion + (answer.by_seat[:, :, columns] @ along) * slide[:, None]
        slopes = arm.at(one.pose).slopes(one.frequency, one.excited, errors, answer, motion, torque)
        if turns and columns is not None:
            turn = np.einsum("kcs,ts,k->tkc", answer.columns[:, :, columns], across, slide)
            slopes = np.concatenate([slopes, turn])
        slopes = root * slopes
        slopes = slopes - np.sum(unit.conj() * slopes, axis=2, keepdims=True) * unit
        left = root * residual
        robust = 2 / (1 + np.sum(np.abs(left) ** 2, axis=1) / _DEGREES)
        weighted = (slopes * np.sqrt(robust)[:, None]).reshape(len(slopes), -1)
        left = (left * np.sqrt(robust)[:, None]).ravel()
        rows = np.concatenate([weighted.real, weighted.imag], axis=1)
        normal += rows @ rows.T
        drive += rows @ np.concatenate([left.real, left.imag])
    return normal, drive
