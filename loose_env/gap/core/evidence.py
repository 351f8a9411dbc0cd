"""Evidence: residual and columns whitened into cells of channel, band and stretch.

A cell holds rows of its columns in noise standard deviations. Every set of effects, every held-out
part and every question of identifiability is then a small linear problem in their Gram matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal.windows import tukey

from loose_env.gap.core.balance import USUAL, Balance, Change
from loose_env.gap.core.catalogue import Late, Term, moves_at
from loose_env.gap.core.tolerances import Nuisance, together
from loose_env.gap.model.effect import Effect
from loose_env.typing import Array, ComplexArray

BANDS = 7
"""Bands of a channel, the first around zero, the others of equal ratio: three or four a decade, for
motion, its harmonics and resonances lie apart."""
STRETCHES = 8
"""Stretches of a recording, about: two of each of four runs tell whether a residual repeats."""
_MOST_STRETCHES = 16  # stretches whose cells are apart; of more runs, several share theirs
_SHORTEST_S = 4.0  # shortest stretch [s]: some periods of slow motion
KNOCK = 16.0
"""Mean square residual over its local median beyond which a stretch is a knock: four times the
usual amplitude is no motion of the machine's own."""
_WITHIN = 3  # frequencies of a band at which noise of motion is looked up
_NOISE = 1.1
"""Noise that is believed over its estimate, which takes it for white: filters and rounding colour
it by some per cent."""
_REST = 0.01
"""Speed over the typical one below which a joint is at rest (or four times its noise): presliding,
in which dry friction takes any value."""
_LEAST_SHARE = 0.01  # mean square of a window below which a stretch has no cells
_FELT = 0.05
"""Squared noise standard deviations of a standard deviation of tolerance below which it is not
felt."""


@dataclass(eq=False, kw_only=True)
class Cut:
    """Cells into which the rows of a channel are cut."""

    cell: NDArray[np.intp]  # Cell of each row (R,)
    count: Array  # Independent values of each cell (C,)
    stretch: NDArray[np.intp]  # Stretch of each cell (C,)
    run: NDArray[np.intp]  # Run of each cell (C,)
    turn: Array  # Centre of each cell's band [rad/s] (C,)


@dataclass(eq=False, kw_only=True)
class Channel(Cut):
    """Whitened rows and Gram matrices of one joint's balance."""

    joint: int  # Index of the joint
    columns: NDArray[np.intp]  # Which columns of the problem it has (K,)
    rows: Array  # Whitened columns (R, K)
    residual: Array  # Whitened residual (R,)
    growth: Array
    """Relative change of each cell's noise by a coefficient of one of each column (C, K)."""
    held: Array
    """Relative change of the stiffness by which the drive holds the joint, by each column (K,)."""
    beside: Array
    """Part of `growth` that no operator has, of foretold readings (C, K)."""
    foretold: Array
    """Share of each cell's noise that `beside` changes: not a reading's own (C,)."""
    blanked: float  # Share of the time that is left out: rest, and knocks
    first: NDArray[np.intp] = field(init=False)  # First row of each cell (C,)
    slope: Array = field(init=False)  # Products with the residual (C, K)
    square: Array = field(init=False)  # Products of each column with itself (C, K)
    power: Array = field(init=False)  # Residual sums of squares (C,)

    def __post_init__(self) -> None:
        """Sum products over each cell."""
        self.first = np.searchsorted(self.cell, np.arange(len(self.count)))
        self.slope = self.by_cell(self.rows * self.residual[:, None])
        self.square = self.by_cell(self.rows**2)
        self.power = self.by_cell(self.residual**2)

    def add(self, columns: NDArray[np.intp], rows: Array, noise: Mapping[str, Array]) -> None:
        """Add columns behind its own, with what they change of its noise."""
        self.columns = np.concatenate([self.columns, columns])
        self.rows = _widened(self.rows, rows)
        self.slope = _widened(self.slope, self.by_cell(rows * self.residual[:, None]))
        self.square = _widened(self.square, self.by_cell(rows**2))
        for name, part in noise.items():
            setattr(self, name, np.concatenate([getattr(self, name), part], axis=-1))

    def by_cell(self, values: Array) -> Array:
        """Sums of rows over each cell."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def by_products(self, left: Array, right: Array) -> Array:
        """Products of rows of some columns with others, summed over each cell (C, left, right)."""
        ends = zip(self.first, [*self.first[1:], len(left)], strict=True)
        return np.stack([left[a:b].T @ right[a:b] for a, b in ends])

    def products(self, weight: Array, left: NDArray[np.intp], right: NDArray[np.intp]) -> Array:
        """Weighted products of some columns of its own with others, summed over cells."""
        own = self.rows[:, left] * weight[self.cell][:, None]
        return np.asarray(own.T @ (self.rows if len(right) == len(self.columns) else
                                   self.rows[:, right]))  # fmt: skip


@dataclass(eq=False, kw_only=True)
class Evidence:
    """All channels, with the priors of the columns."""

    balance: Balance  # The balance that they show
    channels: list[Channel]  # Channels that were measured and move
    terms: list[Term]  # Candidates
    places: dict[int, tuple[int, ...]]  # Columns of each term, by its identity
    centre: Array  # Prior means of the coefficients (K,)
    precision: Array  # Prior precisions (K,)
    low: Array  # Smallest coefficients (K,)
    high: Array  # Largest coefficients (K,)
    inexact: Array  # Part of its force that the law of each column misses (K,)
    operators: Array  # Change of the operator by each column (K, 3, joints, joints)
    delays: Array
    """By how much each column reads a joint's position late, at once and by its rate [s] (K, 2,
    joints)."""
    law: float  # What the law of an effect of a joint or a drive misses, as a share of its force
    tolerances: int  # How many of the columns, the first ones, are combinations of tolerances
    mixed: Array  # Tolerances in each of these combinations (tolerances, combinations)
    nuisances: tuple[Nuisance, ...]  # The tolerances

    _products: dict[tuple[int, ...], list[tuple[NDArray[np.intp], Array]]] = field(
        default_factory=dict, init=False
    )

    def columns_of(self, term: Term) -> tuple[int, ...]:
        """Columns of a term."""
        return self.places[id(term)]

    def products_of(self, columns: tuple[int, ...]) -> list[tuple[NDArray[np.intp], Array]]:
        """Products of a term's columns in each channel: which it has, and their cells' sums."""
        if columns not in self._products:
            found = []
            for channel in self.channels:
                at = [np.flatnonzero(channel.columns == k) for k in columns]
                place = np.array([i for i, own in enumerate(at) if len(own)], dtype=int)
                rows = channel.rows[:, [int(own[0]) for own in at if len(own)]]
                found.append((place, channel.by_products(rows, rows)))
            self._products[columns] = found
        return self._products[columns]


def whiten(
    balance: Balance,
    terms: Sequence[Term],
    tolerances: Sequence[Nuisance],
    *,
    law: float = 0.0,
    missed: Sequence[Nuisance] = (),
) -> Evidence:
    """Whiten the residual, the tolerances and the columns of all terms into cells."""
    # Less what the effects found change together beyond the sum of what each does; with what their
    # laws may have missed, each by itself.
    residual, count = balance.residual - together(balance), len(tolerances)
    every = (*tolerances, *missed)
    operators = np.stack([n.operator for n in every])
    delays = _delays(balance, [n.read_late for n in every], by_rate=True)
    moved = np.array([not n.of_commands for n in every])
    rows = {
        joint: _rows(balance, joint, [n.change for n in every], residual[:, [joint]])
        for joint in range(len(balance.channels))
        if _compared(balance, joint)
    }
    # combinations of unit prior width that the data feel, beside the true effects: beside what the
    # nominal model leaves most would not be felt
    grams = (own[:, :count].T @ own[:, :count] for own in rows.values())
    values, vectors = np.linalg.eigh(sum(grams, np.zeros((count, count))))
    mixed = block_diag(vectors[:, values > _FELT], np.eye(len(missed)))
    kept = mixed.shape[1]
    channels = []
    for joint, own in rows.items():
        grid = grid_of(balance, joint)
        noise = _noise_of(balance, joint, grid.turn, moved * own[:, :-1], operators, delays)
        channels.append(
            Channel(
                **{each.name: getattr(grid, each.name) for each in fields(Cut)}, joint=joint,
                columns=np.arange(kept), rows=own[:, :-1] @ mixed, residual=own[:, -1],
                **{name: part @ mixed for name, part in noise.items()},
                foretold=_foretold(balance, joint, grid.turn).sum(axis=1),
                blanked=float(np.mean(weight_of(balance, joint) < 0.5)),
            )
        )  # fmt: skip
    evidence = Evidence(
        balance=balance, channels=channels, terms=[], places={}, centre=np.zeros(kept),
        precision=np.ones(kept), low=np.full(kept, -np.inf), high=np.full(kept, np.inf),
        inexact=np.zeros(kept), operators=np.tensordot(mixed.T, operators, 1),
        delays=np.tensordot(mixed.T, delays, 1), law=law, tolerances=kept, mixed=mixed,
        nuisances=every,
    )  # fmt: skip
    append(evidence, *terms)
    return evidence


def is_exact(effect: Effect) -> bool:
    """Whether the law of an effect misses nothing: rigid bodies and sensors are as they are."""
    return effect.exact_law or effect.is_time_shift or effect.part not in ("joint", "actuator")


def _compared(balance: Balance, channel: int) -> bool:
    """Whether a channel is compared: a reading, or a joint that moves and whose force is known."""
    if channel >= len(balance.machine.joints):
        return True
    if balance.seen[:, channel].mean() <= 0.5 or not moves_at(balance, channel):
        return False
    return len(grid_of(balance, channel).pieces) > 0


def append(evidence: Evidence, *terms: Term) -> None:
    """Add the columns of more terms."""
    columns = [column for term in terms for column in term.columns]
    if not columns:
        return
    first, balance = len(evidence.centre), evidence.balance
    for term in terms:
        evidence.places[id(term)] = tuple(range(first, first + len(term.columns)))
        first += len(term.columns)
    first = len(evidence.centre)
    evidence.terms += terms
    changes = np.stack([c.operator for c in columns])
    delays = _delays(balance, [c.late for c in columns])
    for channel in evidence.channels:
        own = [k for k, c in enumerate(columns) if c.change.reaches(channel.joint)]
        if not own:
            continue
        new = _rows(balance, channel.joint, [columns[k].change for k in own])
        noise = _noise_of(
            balance, channel.joint, channel.turn, new, changes[own], delays[own],
            [columns[k].eased for k in own],
        )  # fmt: skip
        channel.add(first + np.array(own), new, noise)
    for name in ("centre", "low", "high"):
        more = [getattr(c, name) for c in columns]
        setattr(evidence, name, np.concatenate([getattr(evidence, name), more]))
    spreads = np.array([c.spread for c in columns])
    evidence.precision = np.concatenate([evidence.precision, spreads**-2])
    laws = (np.full(len(t.columns), 0.0 if is_exact(t.effect) else evidence.law) for t in terms)
    evidence.inexact = np.concatenate([evidence.inexact, *laws])
    evidence.operators = np.concatenate([evidence.operators, changes])
    evidence.delays = np.concatenate([evidence.delays, delays])


def _delays(balance: Balance, late: Sequence[Late], *, by_rate: bool = False) -> Array:
    """By how much columns read each joint's position late, see `Evidence.delays`."""
    found = np.zeros((len(late), 2, len(balance.machine.joints)))
    for k, own in enumerate(late):
        if own is not None:
            found[k, int(by_rate), own[0]] = own[1]
    return found


def _noise_of(
    balance: Balance,
    joint: int,
    turn: Array,
    rows: Array,
    operators: Array,
    delays: Array,
    eased: Sequence[Array | float] = (),
) -> dict[str, Array]:
    """Relative changes of a channel's noise and of what its drive holds, by each column."""
    beside = noise_beside(balance, joint, turn, rows)
    held = _held(balance, joint, operators, eased or [0.0] * len(operators))
    bands, band = np.unique(turn, return_inverse=True)
    still, moved = operator_noise(balance, joint, bands, operators, delays)
    growth = np.einsum("bj,bjk->bk", still, moved)[band] + beside
    return {"growth": growth, "held": held, "beside": beside}


def _widened(known: Array, more: Array) -> Array:
    """Append columns, into spare room behind an array where it has some."""
    rows, width = known.shape
    whole = width + more.shape[1]
    base = known.base
    spare = base is not None and base.ndim == 2 and base.shape[1] >= whole and base.shape[0] == rows
    if not spare:
        base = np.empty((rows, int(1.2 * whole) + 32))
        base[:, :width] = known
    assert base is not None
    base[:, width:whole] = more
    return np.asarray(base[:, :whole])


def _rows(balance: Balance, joint: int, wide: Sequence[Change], *more: Array) -> Array:
    """Whitened rows of some columns at a channel, and of more of them (T, K)."""
    stacked = np.column_stack([*(change.at(joint) for change in wide), *more])
    return grid_of(balance, joint).whitened(stacked)


@dataclass(eq=False, kw_only=True)
class Grid(Cut):
    """How a channel is cut into cells."""

    pieces: list[tuple[slice, Array, Array, NDArray[np.intp]]]
    """Samples, taper, scale and kept frequencies of each stretch."""
    order: NDArray[np.intp]  # Order of the rows by cells
    width: float  # End of a band over its beginning

    def whitened(self, stacked: Array) -> Array:
        """Columns (T, K) of the channel as rows in noise standard deviations (R, K)."""
        parts = []
        for rows, window, scale, kept in self.pieces:
            spectrum = np.fft.rfft(stacked[rows] * window, axis=0)[kept] * scale
            parts += [spectrum.real, spectrum.imag]
        return np.asarray(np.concatenate(parts)[self.order])


def grid_of(balance: Balance, joint: int, *, taper: float = 0.25) -> Grid:
    """Cut a channel into cells, once, with a taper over a share of a stretch at either end."""
    cache: dict[int, Grid] = balance.__dict__.setdefault("_grids", {})
    if joint in cache:
        return cache[joint]
    motion, edges, whole = balance.motion, _edges(balance), stretches_of(balance)
    weight, pieces, cells = weight_of(balance, joint), [], []
    first = np.cumsum([0, *(len(run.position) for run in motion.runs)])
    keys: dict[tuple[int, int], int] = {}
    counts: dict[tuple[int, int], float] = {}
    for number, (run, own) in enumerate(whole):
        rows = slice(int(first[run]) + own.start, int(first[run]) + own.stop)
        window = tukey(own.stop - own.start, 2 * taper) * weight[rows]
        if np.mean(window**2) < _LEAST_SHARE:
            continue
        frequency = np.asarray(np.fft.rfftfreq(len(window), motion.step), float)
        band = np.searchsorted(edges, frequency, side="right") - 1
        noise = np.where(band < BANDS, _NOISE * balance.noise(joint, frequency), 0.0)
        scale = 1 / np.sqrt(_windowed(noise**2, window) / 2 + 1e-300)
        scale[0] /= np.sqrt(2)
        kept = np.flatnonzero(band < BANDS)
        at = []
        for k in kept:
            key = int(band[k]), number % _MOST_STRETCHES
            at.append(keys.setdefault(key, len(keys)))
            counts[key] = counts.get(key, 0.0) + (1.0 if k == 0 else 2.0)
        cells += [at, at]
        pieces.append((rows, window[:, None], scale[kept, None], kept))
    cell = np.concatenate([np.empty(0), *cells]).astype(int)
    order = np.argsort(cell, kind="stable")
    stretch = np.array([piece for _, piece in keys], dtype=int)
    pooled = len(whole) > _MOST_STRETCHES
    runs = np.array([k if pooled else run for k, (run, _) in enumerate(whole)])
    bands = np.array([band for band, _ in keys], dtype=int)
    centres = 2 * np.pi * np.sqrt(np.maximum(edges[:-1], edges[1] / 2) * edges[1:])
    cache[joint] = Grid(
        cell=cell[order], count=np.array(list(counts.values())), stretch=stretch,
        run=runs[stretch], turn=centres[bands], pieces=pieces, order=order,
        width=float(edges[-1] / edges[-2]),
    )  # fmt: skip
    return cache[joint]


def _windowed(variance: Array, window: Array) -> Array:
    """Expected square of the spectrum of noise in a window (F,), of a variance by frequency."""
    # Noise of positions grows with the square of the frequency in a balance, and a window that ends
    # within a few samples spreads it over all frequencies.
    count = len(window)
    alike = np.fft.irfft(np.abs(np.fft.rfft(window)) ** 2, count)
    return np.asarray(np.fft.rfft(np.fft.irfft(variance, count) * alike).real)


def stretches_of(balance: Balance) -> list[tuple[int, slice]]:
    """Stretches of all runs: run and samples."""
    found, runs = [], balance.motion.runs
    each = max(1, round(STRETCHES / len(runs)))
    for number, run in enumerate(runs):
        count = len(run.position)
        pieces = int(np.clip(count * run.step / _SHORTEST_S, 1, each))
        edges = np.linspace(0, count, pieces + 1).astype(int)
        found += [(number, slice(a, b)) for a, b in pairwise(edges)]
    return found


def _edges(balance: Balance) -> Array:
    longest = max(rows.stop - rows.start for _, rows in stretches_of(balance))
    top = balance.motion.band
    low = min(3 / (longest * balance.motion.step), top / 4)
    return np.concatenate([[0.0], np.geomspace(low, 1.02 * top, BANDS)])


def cell_powers(balance: Balance, channel: int, change: Array) -> Array:
    """Power of a change of the balance in each cell of a channel, in noise variances (C,)."""
    grid = grid_of(balance, channel)
    rows = grid.whitened(change[:, [channel]])[:, 0]
    return np.bincount(grid.cell, rows**2, len(grid.count)).astype(float)


def _held(balance: Balance, joint: int, operators: Array, eased: Sequence[Array | float]) -> Array:
    """Relative change of the stiffness by which a drive holds a joint (K,); 0 without a servo."""
    if joint >= len(balance.machine.joints) or balance.released.any():
        return np.zeros(len(operators))
    stiffness = balance.operator[2, joint, joint]
    if abs(balance.stiffness[joint]) <= 0.5 * abs(stiffness):
        return np.zeros(len(operators))
    free = np.array([np.broadcast_to(own, len(balance.stiffness))[joint] for own in eased])
    return np.asarray(operators[:, 2, joint, joint] / stiffness - free)


def _parts(balance: Balance, channel: int) -> Array:
    """Inverse of the rows of each joint's part of a reading, and of its two rates (3 J, R)."""
    cache: dict[int, Array] = balance.__dict__.setdefault("_foretold", {})
    if channel not in cache:
        motion, reading = balance.motion, channel - len(balance.machine.joints)
        parts = balance.readings.by_joint[:, :, reading].T
        orders = parts, motion.rates(parts), motion.rates(parts, 2)
        rows = grid_of(balance, channel).whitened(np.hstack(orders))
        size = np.sqrt(np.sum(rows**2, axis=0)) + 1e-300
        cache[channel] = np.linalg.pinv(rows / size, rcond=1e-6) / size[:, None]
    return cache[channel]


def _foretold(balance: Balance, channel: int, turn: Array) -> Array:
    """Share of a reading's noise that the foretold one has by each joint (F, J); 1 of a balance."""
    number, frequency = channel - len(balance.machine.joints), turn / (2 * np.pi)
    if number < 0:
        return np.ones((len(turn), 1))
    foretold = balance.readings.foretold_variance(number, frequency)
    return np.asarray(foretold / balance.noise(channel, frequency)[:, None] ** 2)


def noise_beside(balance: Balance, channel: int, turn: Array, rows: Array) -> Array:
    """Relative change of a reading's noise by that of the foretold one (C, K)."""
    # A column that is a share of a joint's part of it takes as much of that joint's noise away; one
    # of its second rate, as a delay and its slope have together, at high frequencies.
    if channel < len(balance.machine.joints):
        return np.zeros((len(turn), rows.shape[1]))
    still, _, bent = np.split(_parts(balance, channel) @ rows, 3)
    every = _within(balance, channel, turn)
    noise = _foretold(balance, channel, every.ravel()).reshape(*every.shape, -1)
    bend = np.mean(every[..., None] ** 2 * noise, axis=1)
    return np.asarray(noise.mean(axis=1) @ still - bend @ bent)


def _within(balance: Balance, channel: int, turn: Array) -> Array:
    """Frequencies in the band around each (B, F): all of a band count alike."""
    half = grid_of(balance, channel).width ** 0.5
    return np.linspace(turn / half, turn * half, 2 * _WITHIN + 1, axis=1)[:, 1::2]


def operator_noise(
    balance: Balance, joint: int, turn: Array, operators: Array, delays: Array
) -> tuple[Array, Array]:
    """What an operator makes of the noise of motion in some bands; its change by columns."""
    # In the channel's noise standard deviations, in phase and a quarter period ahead, at several
    # frequencies of each band: (B, F) and (B, F, K), of which the squares add up.
    joints = len(balance.machine.joints)
    if joint >= joints:
        return np.zeros((len(turn), 1)), np.zeros((len(turn), 1, len(operators)))
    within = _within(balance, joint, turn).reshape(-1, 1)
    usual = np.sqrt(_WITHIN * balance.motion.precision(within[:, 0]))
    usual *= balance.noise(joint, within[:, 0] / (2 * np.pi), floor=False)[:, None]

    def response(own: Array) -> ComplexArray:
        mass, damping, stiffness = (part[..., None, :] for part in np.moveaxis(own, -2, 0))
        return np.asarray((stiffness + 1j * within * damping - within**2 * mass) / usual)

    def parts(own: ComplexArray) -> Array:
        both = np.stack([own.real, own.imag], axis=-1)
        return both.reshape(*own.shape[:-2], len(turn), 2 * _WITHIN * own.shape[-1])

    still, moved = response(balance.operator[:, joint]), response(operators[:, :, joint])
    late = np.any(delays, axis=(1, 2))
    turned = 1j * within * delays[late, :, None]
    moved[late] += (np.exp(turned[:, 0]) - 1 + turned[:, 1]) * still
    return parts(still), np.moveaxis(parts(moved), 0, -1)


def weight_of(balance: Balance, joint: int) -> Array:
    """Weight of each sample (T,): none at rest, in knocks, or where a drive is at its limit."""
    # At rest dry friction takes any value within its bound, so a balance says nothing. Knocks are
    # short stretches in which everything at once leaves many times the usual residual. A limit cuts
    # what is faster than the band.
    if joint >= len(balance.machine.joints):
        return np.ones(len(balance.residual))
    cache = balance.__dict__.setdefault("_quiet", {})
    if joint not in cache:
        parts = _knocks(balance, joint), _sliding(balance, joint), _unlimited(balance, joint)
        cache[joint] = np.prod(parts, axis=0)
    return np.asarray(cache[joint])


def _knocks(balance: Balance, joint: int) -> Array:
    motion, step = balance.motion, balance.motion.step
    v, a, q = (x[:, joint] for x in (balance.speed, balance.acceleration, balance.position))
    known = [np.ones_like(q), v, a, v * np.abs(v), np.tanh(v / (0.04 * np.std(v) + 1e-12))]
    known += [balance.directions[USUAL][:, joint], balance.bias[:, joint], q]
    known += [np.sin(q), np.cos(q)]
    columns = np.stack(known, axis=1)
    columns = columns / (np.sqrt(np.mean(columns**2, axis=0)) + 1e-12)
    y = balance.residual[:, joint]
    width = max(int(1 / motion.band / step), 2)
    kernel = _bell(width)
    weight, bad = np.ones(len(y)), np.zeros(len(y), bool)
    for _ in range(2):
        normal = (columns * weight[:, None]).T @ columns + 1e-4 * len(y) * np.eye(columns.shape[1])
        left = y - columns @ np.linalg.solve(normal, columns.T @ (weight * y))
        level, usual = np.convolve(left**2, kernel, "same"), []
        half = max(int(6 / step), 8 * width)
        for own in motion.split(level):
            middles = np.arange(min(half, len(own) // 2), len(own), half)
            medians = [np.median(own[max(m - half, 0) : m + half]) for m in middles]
            usual.append(np.interp(np.arange(len(own)), middles, medians))
        bad = level > KNOCK * np.concatenate(usual)
        weight = np.where(bad, 0.0, 1.0)
    if bad.mean() > 0.3:
        return np.ones(len(y))
    return _without(np.convolve(bad, np.ones(width + 1), "same") > 0.5, kernel)


def _bell(width: int) -> Array:
    """Weights of a smooth fade over so many samples."""
    kernel = np.hanning(2 * width + 3)
    return np.asarray(kernel / kernel.sum())


def _without(marked: NDArray[np.bool_], kernel: Array) -> Array:
    """Weight that fades to nothing where samples are marked."""
    return np.asarray(1 - np.clip(np.convolve(marked, kernel, "same"), 0, 1))


def _sliding(balance: Balance, joint: int) -> Array:
    motion, speed = balance.motion, balance.speed[:, joint]
    found = []
    turn = 2 * np.pi * motion.band
    noisy = float(motion.noise[0, joint]) * turn * np.sqrt(2 * motion.band * motion.step / 3)
    limit = max(4 * noisy, _REST * balance.usual[joint])
    width = max(int(1 / motion.band / motion.step), 2)
    kernel = _bell(width)
    span = np.ones(max(width, 3))
    for run, own in zip(motion.runs, motion.split(speed), strict=True):
        still = np.convolve(np.abs(own) < limit, span, "same") > len(span) - 0.5
        still = np.convolve(still, span, "same") > 0.5
        # a joint at rest for nearly a whole run is held by its drive, or by friction without one
        if still.mean() <= 0.01 or (still.mean() >= 0.85 and run.form != "free"):
            found.append(np.ones(len(own)))
        else:
            found.append(_without(still, kernel))
    return np.concatenate(found)


def _unlimited(balance: Balance, joint: int) -> Array:
    """Weight of samples, none within one and a half periods of the band from a drive's limit."""
    motion = balance.motion
    width = max(int(1.5 / motion.band / motion.step), 1)
    near = np.ones(2 * width + 1)
    limited = (np.convolve(run.limited[:, joint], near, "same") > 0 for run in motion.runs)
    return np.concatenate([_without(own, _bell(width)) for own in limited])
