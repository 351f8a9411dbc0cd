"""Likelihood of fault hypotheses over all runs, seat motion marginalised; prior of healthy runs.

At every line of a run the seat's acceleration is an unknown of its own, for gap, friction and stops
make of it what they like. What is known is its direction, and how strongly a seat that floats would
move: the power of its motion is that, times a share that varies over bands of the run and that
friction, gravity and stops decide. Errors of the parameters are normal; Gauss-Newton steps find the
most likely ones together with the direction, and the curvature there stands for all others
(Laplace). What no parameter can explain is in the covariance, as variance components.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.opening_probability import open_probability
from loose_env.instrument.inference.response.frequency_response import Response, respond
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.inference.seat_motion import BLIND, SHARES, Piece, Seat, band_terms
from loose_env.instrument.inference.variance_components import BANDS, ComponentIndex
from loose_env.instrument.settings.thresholds import (
    COMPLIANCE_HZ,
    CORRELATION_HZ,
    OPEN_SEAT_SHARE,
)
from loose_env.typing import Array

_FOLDS = 0.05
"""Frequency over the sampling rate at which sampling without a filter doubles the error."""
_OPEN_WEIGHT = (SHARES > OPEN_SEAT_SHARE) / np.sum(SHARES > OPEN_SEAT_SHARE)
"""Prior of the share of an open seat."""
_SPREAD = 1.0
"""Standard deviation of the log share of a band about that of its run."""
_NEAR = np.exp(-0.5 * (np.log(SHARES[:, None] / SHARES) / _SPREAD) ** 2)
_NEAR /= _NEAR.sum(axis=1, keepdims=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownArm:
    """What runs of the healthy arm say of its model: the prior of a suspect run."""

    errors: Array
    """Most probable nuisance parameters (P,)."""
    precision: Array
    """Their inverse covariance (P, P)."""
    variances: Array
    """Variance components (C,); those that all runs share are kept."""


@dataclass(kw_only=True, eq=False)
class Evidence:
    """Likelihood of the hypotheses over the spectral lines of all runs."""

    uncertain: UncertainArm
    lines: Sequence[Lines]
    correlation: float = CORRELATION_HZ
    known_runs: int = 0
    """Number of runs to allow for, if more than the lines have."""
    known: KnownArm | None = None
    """What healthy runs have told before; None where there are none."""
    _amplitude: list[Array] = field(default_factory=list)
    _last: tuple[bytes, list[Response]] | None = None

    def __post_init__(self) -> None:
        """Scale the patterns of the components by the motion of the nominal arm."""
        nominal = self.uncertain.nominal
        n = self.uncertain.arm.n
        for one in self.lines:
            response = respond(self.uncertain.at(one.pose), one, nominal)
            load, mass = response.across_seat(np.arange(7 * n))
            own = np.abs(np.diagonal(mass, axis1=1, axis2=2))
            floating = np.abs(load) / np.maximum(own, 1e-12)
            moved = (2 * np.pi * one.frequency[:, None]) ** 2 * np.abs(response.motion[:, :n])
            # A joint without a known drive may make all of the motion that is read.
            moved[:, one.blind] = response.acceleration[:, None]
            power = np.concatenate([moved, floating], axis=1) ** 2
            width = min(max(1, round(3.0 / one.spacing)), len(one.frequency))
            kernel = np.ones(width) / width
            smooth = np.stack([np.convolve(p, kernel, mode="same") for p in power.T], axis=1)
            smooth = np.maximum(smooth, 0.01 * smooth.max(axis=1, keepdims=True))
            # A tight connection gives way by its spring: a motion that floats takes none.
            smooth[:, n:] *= (one.frequency[:, None] / COMPLIANCE_HZ) ** 4
            self._amplitude.append(np.sqrt(smooth))

    @property
    def runs(self) -> int:
        """Number of runs, by the largest of their numbers."""
        numbers = [
            each.number for one in self.lines for each in (one, one.beside) if each is not None
        ]
        return max(1 + max(numbers, default=-1), self.known_runs)

    @cached_property
    def index(self) -> ComponentIndex:
        """The variance components."""
        return ComponentIndex(uncertain=self.uncertain, runs=self.runs)

    @property
    def count(self) -> int:
        """Number of nuisance parameters: of the arm, and delays of every run."""
        return self.uncertain.count(self.runs)

    @cached_property
    def expected(self) -> Array:
        """Prior medians of the nuisance parameters (P,)."""
        return self.uncertain.expected(self.runs) if self.known is None else self.known.errors

    def prior(self, errors: Array) -> tuple[float, Array]:
        """Negative log prior of parameters but for a constant, and its curvature (P, P).

        A tolerance is a guess of its own: beyond `UncertainArm.tails` the density falls
        exponentially (Huber). What healthy runs have told is normal (Laplace).
        """
        off = errors - self.expected
        if self.known is not None:
            return 0.5 * float(off @ self.known.precision @ off), self.known.precision
        size, tail = np.abs(off), self.uncertain.tails(self.runs)
        cost = np.where(size < tail, 0.5 * off**2, tail * (size - 0.5 * tail))
        return float(np.sum(cost)), np.diag(tail / np.maximum(size, tail))

    def start(self, width: float) -> Array:
        """Variances with which a fit starts; see `ComponentIndex.start` (C,)."""
        found = self.index.start(width)
        if self.known is not None:
            found[self.index.shared] = self.known.variances[self.index.shared]
        return found

    def _responses(self, errors: Array) -> list[Response]:
        """Responses of all lines; those of the last errors are kept."""
        key = errors.tobytes()
        if self._last is None or self._last[0] != key:
            found = []
            for one in self.lines:
                response = respond(self.uncertain.at(one.pose), one, errors)
                if one.beside is not None:
                    reference = respond(self.uncertain.at(one.beside.pose), one.beside, errors)
                    response = replace(response, beside=reference)
                found.append(response)
            self._last = (key, found)
        return self._last[1]

    def pieces(self, errors: Array, variances: Array) -> list[Piece]:
        """Responses and weights for given nuisance parameters and variance components."""
        found = []
        responses = self._responses(errors)
        for one, amplitude, response in zip(self.lines, self._amplitude, responses, strict=True):
            noise, change = one.noise, one.beside is not None
            if one.beside is not None:
                noise = noise + one.beside.noise
            # Readings of what is faster than the samples fold back; more of it the higher the line.
            folded = one.folded * (one.frequency * one.period / _FOLDS) ** 2
            of = self.uncertain
            patterns = np.concatenate([response.joint_columns(), response.columns], axis=2)
            count = len(one.frequency)
            bands = (np.arange(count) * BANDS // count).astype(np.intp)
            factor = variances[self.index.bands(one.number)][bands]
            patterns = patterns * (np.sqrt(factor)[:, None] * amplitude)[:, None, :]
            power = (factor * (1 + folded) ** 2)[:, None] * one.power
            components = self.index.columns(one.number, change=change)
            reading = self.index.reading(change=change)
            size = variances[components].copy()
            size[: of.arm.n][one.blind] = BLIND
            scaled = patterns * np.sqrt(size)
            covariance = scaled @ scaled.conj().swapaxes(1, 2)
            channel = np.arange(covariance.shape[1])
            covariance[:, channel, channel] += noise + variances[reading] * power
            if response.beside is not None:
                # Patterns of what has changed are known no better than the model the reference.
                unknown = min(response.beside.unexplained, 1.0)
                covariance[:, channel, channel] += unknown * np.sum(np.abs(scaled) ** 2, axis=2)
            # Readings have units: each is taken over its own standard deviation.
            unit = 1 / np.sqrt(covariance[:, channel, channel].real)
            units = unit[:, :, None] * unit[:, None, :]
            weight = units * np.linalg.inv(units * covariance)
            residual = response.residual
            weighted = (weight @ residual[:, :, None])[:, :, 0]
            misfit = np.sum(residual.conj() * weighted, axis=1).real
            size_of = np.linalg.slogdet(units * covariance)[1]
            size_of -= np.sum(np.log(unit**2 * noise), axis=1)
            temper = min(one.independent / 1.1, one.spacing / self.correlation)
            found.append(
                Piece(
                    response=response,
                    weight=weight,
                    patterns=patterns,
                    components=components,
                    reading_power=power,
                    reading=reading,
                    base=-temper * float(np.sum(misfit + size_of)),
                    temper=temper,
                    bands=bands,
                )
            )
        return found

    def seat_terms(self, pieces: Sequence[Piece], seat: Seat, axes: Array) -> Array:
        """Log-likelihood ratio of a seat against no fault, by axis."""
        terms = self.run_terms(pieces, seat, axes)
        return np.asarray(sum((ratio for ratio, _ in terms.values()), start=np.zeros(len(axes))))

    def run_terms(
        self, pieces: Sequence[Piece], seat: Seat, axes: Array
    ) -> dict[int, tuple[Array, Array]]:
        """Log-likelihood ratio of a seat by run and axis, and what of it is a shut one (U,) each.

        A seat that stays shut in a run moves no more than a tight one. The difference of the two is
        the log probability that it did.
        """
        by_run: dict[int, list[Array]] = {}
        opening: dict[int, Array] = {}
        for piece in pieces:
            if piece.lines.healthy:
                continue
            term = band_terms(piece, seat, axes)
            by_run.setdefault(piece.lines.number, []).append(term)
            opening[piece.lines.number] = open_probability(piece.response, seat.columns, axes)
        found = {}
        for run, terms in by_run.items():
            level = np.zeros((len(axes), len(SHARES)))
            for term in terms:
                most = term.max(axis=2, keepdims=True)
                inside = np.exp(term - most) @ _NEAR.T
                level += (np.log(inside) + most).sum(axis=1)
            top = level.max(axis=1)
            opened = np.log(np.exp(level - top[:, None]) @ _OPEN_WEIGHT) + top
            p = opening[run]
            found[run] = np.logaddexp(np.log(p) + opened, np.log(1 - p)), np.log(1 - p)
        return found
