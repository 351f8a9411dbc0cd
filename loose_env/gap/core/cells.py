"""Cells of all channels at once: what the coefficients of a set leave in them, and its slope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.core.evidence import Evidence, operator_noise
from loose_env.typing import Array


@dataclass(frozen=True, eq=False)
class _Columns:
    """Some columns in all channels, one behind the other; B bands, F parts of their noise."""

    rows: Array  # Whitened columns (R, K)
    moved: Array  # Change of what the nominal operator makes of the noise of motion (B, F, K)
    held: Array  # Relative change of the stiffness by which each drive holds its joint (joints, K)
    beside: Array  # Relative change of the noise that no operator has (C, K)

    def with_more(self, more: _Columns) -> _Columns:
        """With more columns behind its own."""
        names = ("rows", "moved", "held", "beside")
        return _Columns(
            *(np.concatenate([getattr(own, n) for own in (self, more)], axis=-1) for n in names)
        )


class Layout:
    """What all sets of some evidence have in common: cells, and products of the tolerances."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence, channels = evidence, evidence.channels
        counts = [len(c.count) for c in channels]
        before = np.cumsum([0, *counts])
        self.ends = before[1:-1]
        self.channel = np.repeat(np.arange(len(channels)), counts)
        rows = np.cumsum([0, *(len(c.residual) for c in channels)])
        self.first = np.concatenate([c.first + k for c, k in zip(channels, rows, strict=False)])
        self.cell = np.concatenate([c.cell + k for c, k in zip(channels, before, strict=False)])
        self.count = np.concatenate([c.count for c in channels])
        self.residual = np.concatenate([c.residual for c in channels])
        self.foretold = np.maximum(np.concatenate([c.foretold for c in channels]), 1e-12)
        joints = len(evidence.balance.machine.joints)
        self.read = np.array([c.joint >= joints for c in channels])[self.channel]
        each = [np.unique(c.turn, return_inverse=True) for c in channels]
        self._bands = [bands for bands, _ in each]
        places = np.cumsum([0, *map(len, self._bands)])
        self.band = np.concatenate([of + k for (_, of), k in zip(each, places, strict=False)])
        kept = np.arange(evidence.tolerances)
        self.still, self.tolerances = self._columns(kept)
        self.upper = np.triu_indices(len(kept))
        ends = [*self.first[1:], len(self.residual)]
        parts = (self.tolerances.rows[a:b] for a, b in zip(self.first, ends, strict=True))
        self.products = np.stack([(own.T @ own)[self.upper] for own in parts])
        """Products of the tolerances in each cell, the upper triangles (C, K (K + 1) / 2)."""

    def _columns(self, numbers: NDArray[np.intp]) -> tuple[Array, _Columns]:
        """Noise by the nominal operator (B, F), and some columns."""
        evidence = self.evidence
        rows, still, moved, held, beside = [], [], [], [], []
        for channel, bands in zip(evidence.channels, self._bands, strict=True):
            at = np.minimum(np.searchsorted(channel.columns, numbers), len(channel.columns) - 1)
            has = channel.columns[at] == numbers
            rows.append(channel.rows[:, at] * has)
            held.append(channel.held[at] * has)
            beside.append(channel.beside[:, at] * has)
            own = evidence.operators[numbers], evidence.delays[numbers]
            by_nominal, by_columns = operator_noise(evidence.balance, channel.joint, bands, *own)
            still.append(by_nominal)
            moved.append(by_columns * has)
        wide = max(own.shape[1] for own in still)  # readings have no operator
        pads = [(0, wide - own.shape[1]) for own in still]
        noise = [np.pad(own, ((0, 0), pad)) for own, pad in zip(still, pads, strict=True)]
        changes = [np.pad(own, ((0, 0), pad, (0, 0))) for own, pad in zip(moved, pads, strict=True)]
        found = _Columns(
            np.concatenate(rows), np.concatenate(changes), np.stack(held), np.concatenate(beside)
        )
        return np.concatenate(noise), found

    def of(self, numbers: NDArray[np.intp]) -> Cells:
        """Cells with some columns, all tolerances first."""
        more = self._columns(numbers[self.evidence.tolerances :])[1]
        return Cells(self, self.tolerances.with_more(more))

    def split(self, values: Array) -> tuple[Array, ...]:
        """Values of all cells, channel by channel."""
        return tuple(np.split(values, self.ends))


@dataclass(frozen=True, eq=False)
class State:
    """Cells at some coefficients."""

    left: Array  # Fitted less measured, row by row (R,)
    power: Array  # Residual sum of squares of each cell (C,)
    change: Array  # Change of what the operator makes of the noise of motion (B, F)
    noisier: Array  # Relative change of the noise that no operator has (C,)
    held: Array  # Stiffness by which each drive holds its joint, over the nominal one (channels,)
    scale: Array  # Power of the same motion over the nominal one (C,)
    excess: Array  # Power beyond the noise, of the same motion (C,)
    quieter: NDArray[np.bool_]  # Cells in which it is that of a noise that shrinks (C,)


@dataclass(frozen=True, eq=False)
class Cells:
    """All cells with the columns of a set."""

    layout: Layout
    columns: _Columns

    def state(self, values: Array) -> State:
        """The cells at some coefficients."""
        # A balance whose every term shrinks makes less noise, too, and gains nothing; nor does a
        # drive that holds less, whose discrepancy stays the same motion. What was read does not
        # shrink, and its discrepancy stays the same reading.
        own, all_ = self.columns, self.layout
        left = own.rows @ values - all_.residual
        power = np.add.reduceat(left**2, all_.first)
        change, beside = own.moved @ values, own.beside @ values
        noisier = beside / all_.foretold
        ratio = np.sum((2 * all_.still + change) * change, axis=1)[all_.band]
        ratio = np.maximum(ratio + 1 + (2 + noisier) * beside, 1e-12)
        held = np.maximum(1.0 + own.held @ values, 1e-6)
        beyond = power - all_.count * ratio
        least = np.minimum(np.minimum(ratio, held[all_.channel] ** 2), 1.0)
        least = np.where(all_.read, 1.0, least)
        quieter = (beyond <= 0) | (least == ratio) & ~all_.read
        scale = np.where(quieter, ratio, least)
        excess = np.maximum(beyond / scale, -all_.count)
        return State(left, power, change, noisier, held, scale, excess, quieter)

    def steps(self, at: State, weight: Array) -> tuple[Array, Array]:
        """Normal matrix and half the derivative of the weighted excess of all cells."""
        # Noise that grows with the operator is in the columns: least squares would attenuate their
        # coefficients (errors in variables).
        own, all_ = self.columns, self.layout
        weight = weight / at.scale
        softer = (at.scale < 1) & ~at.quieter
        noisy = weight * np.where(at.quieter, all_.count + at.excess, all_.count)
        growth = np.matmul((all_.still + at.change)[:, None], own.moved)[:, 0][all_.band]
        growth += (1 + at.noisier)[:, None] * own.beside
        kept, by_row = all_.evidence.tolerances, weight[all_.cell]
        normal = np.empty((own.rows.shape[1],) * 2)
        products = weight @ all_.products
        normal[all_.upper] = normal[all_.upper[::-1]] = products
        normal[kept:] = (own.rows[:, kept:] * by_row[:, None]).T @ own.rows
        normal[:kept, kept:] = normal[kept:, :kept].T
        if at.quieter.any():
            shrinks = growth[at.quieter]
            normal += (shrinks.T * noisy[at.quieter]) @ shrinks
        down = (by_row * at.left) @ own.rows - noisy @ growth
        beyond = np.bincount(
            all_.channel, weight * softer * np.maximum(at.excess, 0.0), len(own.held)
        )
        if beyond.any():
            normal += (own.held.T * beyond) @ own.held
            down -= (beyond * at.held) @ own.held
        return normal, down
