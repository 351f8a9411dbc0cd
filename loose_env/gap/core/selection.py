"""Selection of sets of effects by their marginal likelihood, with an inferred discrepancy.

Each cell of the evidence has a Student likelihood: its residual beyond the noise may be a
discrepancy that nothing explains, so that a channel with something unmodelled says less and does
not rule the others. Sets are searched by adding, exchanging and removing, to a local optimum.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb, exp, log

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from loose_env.gap.core.balance import USUAL
from loose_env.gap.core.catalogue import Axes, Claim, Term, neighbours, terms_of
from loose_env.gap.core.cells import Cells, Layout
from loose_env.gap.core.evidence import Channel, Evidence, append, cell_powers
from loose_env.gap.core.tolerances import Nuisance
from loose_env.gap.model.effect import Parameter
from loose_env.inference import log_determinant
from loose_env.typing import Array

KIND = 10.0
"""Minus twice the log prior of one more kind of effect: one in 150 is missing, for a model in four
lacks one of 37."""
FORM = 4.6
"""The same of a place whose friction has more than the simplest form: about 1 in 10."""
LEAST_VALUES = 1.5
"""Values of a cell's discrepancy at least: one that repeats has an amplitude, and half a number for
its shape."""
SHARE_VALUES = 0.02
"""The same at most, as a share of a cell's values: discrepancies repeat to some per cent."""
_ROUNDS, _HALVINGS = 8, 4  # reweighted rounds of one fit, and steps that are tried in each
LEAST_GAIN = 0.5  # fall of minus twice the log evidence for which a step is taken
_SCREENED = 14  # candidates that are fitted in one step
_FITTED = 4  # sets that are fitted for each weighting: the best at fixed weights
_MOST = 40  # steps of a search
_STARTS = 3  # kinds that are searched from
EXPLAINED = 0.9
"""Share of what there is to explain that explains it: of a channel's power, less than a third of
the amplitude is left; a set with such a share of the best one's evidence is a rival."""
_SETTLED, _SECANTS = 2, 4  # sets of a step that are relinearised, and how often
_NOTHING = 0.01  # share of a noise variance below which a balance has shrunk to nothing
_RIDGE = 1e-12  # relative share of a normal matrix that is added: two columns may be the same
_BENT = 4.0
"""Noise variances, two standard deviations, by which an effect may differ from its columns."""
_SIZES = 10.0  # widths of the prior of a size that values are given
_STEP, _SHAPES = 0.3, 25  # relative step of a shape, and shapes tried for each of its parameters

Set = tuple[Term, ...]


@dataclass(frozen=True, eq=False)
class SetFit:
    """A set of effects, fitted to the cells."""

    terms: Set  # The effects
    numbers: NDArray[np.intp]  # Columns in the fit: tolerances first
    values: Array  # Their coefficients
    powers: tuple[Array, ...]
    """Residual sum of squares of each cell, channel by channel, in units of its noise."""
    normal: Array  # Precision of the coefficients
    cost: float  # Minus twice the log evidence
    total: float  # The same with the prior of the set
    allowed: bool  # Whether all coefficients lie within their bounds

    def places(self, columns: Iterable[int]) -> NDArray[np.intp]:
        """Where columns of the set stand among its coefficients."""
        return np.searchsorted(self.numbers, list(columns))


class Selection:
    """Search over sets of effects in the cells of some evidence."""

    def __init__(self, evidence: Evidence, say: Callable[[str], None] = lambda _: None) -> None:
        self.evidence, self.say, self.layout = evidence, say, Layout(evidence)
        self.used: list[NDArray[np.bool_]] = [
            np.ones(len(c.count), bool) for c in evidence.channels
        ]
        self.values = [_values(c, 0.0) for c in evidence.channels]
        self.values = [
            _values(c, float(np.sum(c.count) / np.sum(p)))
            for c, p in zip(evidence.channels, self.rich, strict=True)
        ]
        self.fits: dict[frozenset[int], SetFit] = {}
        self._replaced: dict[tuple[object, ...], Term | None] = {}
        self._off: dict[tuple[object, ...], dict[int, Array]] = {}

    def consider(self, *terms: Term) -> None:
        """Add candidates, which count in the prior as the others do."""
        append(self.evidence, *terms)
        for counted in ("_places", "_shapes"):
            self.__dict__.pop(counted, None)

    # ---- the prior of sets

    @cached_property
    def _places(self) -> Counter[Claim]:
        """Number of locations of each claim."""
        where = {(term.claim, term.effect.where) for term in self.evidence.terms}
        return Counter(claim for claim, _ in where)

    @cached_property
    def _shapes(self) -> Counter[tuple[str, str]]:
        """Number of shapes of each effect."""
        return Counter(term.name for term in self.evidence.terms)

    def prior(self, terms: Iterable[Term]) -> float:
        """Minus twice the log prior of a set: its kinds, how many and which places, shapes."""
        # A kind that extends another one is a form of it; one at all places at once is another
        # claim than one at some. Neighbouring shapes share the evidence: of k shapes about the root
        # of k differ.
        own = tuple(terms)
        cost = 0.0
        for claim, count in Counter(t.claim for t in own).items():
            places = self._places.get(claim, count)
            cost += KIND + 2 * log(places) + 2 * log(comb(places, min(count, places))) + count
        cost += sum(FORM * bool(t.effect.extends) + 2 * log(t.effect.choices) for t in own)
        return cost + sum(log(max(self._shapes[t.name], 1)) for t in own)

    # ---- fits of a set

    def columns(self, terms: Iterable[Term]) -> NDArray[np.intp]:
        """Columns of a set, those of the tolerances first."""
        own = sorted({k for term in terms for k in self.evidence.columns_of(term)})
        return np.array([*range(self.evidence.tolerances), *own], dtype=int)

    def weights(self, channel: int, power: Array) -> Array:
        """Weights of a channel's cells at some power."""
        excess = power - self.evidence.channels[channel].count
        return _weights(self.values[channel], excess, self.used[channel])

    def on(self, used: Sequence[NDArray[np.bool_]]) -> Selection:
        """The same selection on some of the cells."""
        found = copy(self)
        found.used, found.fits = list(used), {}
        return found

    def without(self, held: Sequence[NDArray[np.bool_]], fit: SetFit) -> SetFit:
        """A set, fitted to all cells but those that are held out."""
        return self.on([~cells for cells in held]).fit(fit.terms, fit)

    def sized(self, fit: SetFit) -> tuple[Selection, SetFit]:
        """A set with hardly any prior of sizes: how large an effect is, once it is there."""
        # Selection needs that prior; values would be drawn to nothing by it, where a tolerance is
        # nearly the same column.
        found, evidence = self.on(self.used), copy(self.evidence)
        evidence.precision = np.where(
            (evidence.centre == 0) & (np.arange(len(evidence.centre)) >= evidence.tolerances),
            _SIZES**-2 * evidence.precision, evidence.precision,
        )  # fmt: skip
        found.evidence = evidence
        fitted = found.fit(fit.terms, fit)
        return (found, fitted) if fitted.allowed else (self, fit)

    def shares(self, fit: SetFit, term: Term) -> Array:
        """Coefficients of a member."""
        return fit.values[fit.places(self.evidence.columns_of(term))]

    def values_in(self, fit: SetFit) -> tuple[Array, ...]:
        """Parameter values of each member."""
        return tuple(term.values(self.shares(fit, term)) for term in fit.terms)

    def pulls(self, fit: SetFit) -> list[tuple[Nuisance, float]]:
        """Tolerances with the standard deviations by which a fit pulls them."""
        pulls = self.evidence.mixed @ fit.values[: self.evidence.tolerances]
        return list(zip(self.evidence.nuisances, pulls.tolist(), strict=True))

    def solve(self, terms: Sequence[Term], start: Sequence[Array] | None = None) -> SetFit:
        """Fit a set, from the weights of a start."""
        key = frozenset(id(term) for term in terms)
        if key not in self.fits:
            # the likelihood has several optima: also from nothing but noise, and from no set
            starts = [[c.count for c in self.evidence.channels], None, *([start] if start else [])]
            cells = self.layout.of(self.columns(terms))
            fits = [self.fit(tuple(terms), own, cells=cells) for own in starts]
            self.fits[key] = min(fits, key=lambda f: (not f.allowed, f.cost))
        return self.fits[key]

    def fit(
        self,
        terms: Set,
        start: SetFit | Sequence[Array] | None = None,
        rounds: int = _ROUNDS,
        cells: Cells | None = None,
    ) -> SetFit:
        """Fit a set by reweighted least squares, from the weights of a start, or from a fit."""
        evidence, layout, numbers = self.evidence, self.layout, self.columns(terms)
        cells = cells or layout.of(numbers)
        precision, centre = evidence.precision[numbers], evidence.centre[numbers]
        used, level = np.concatenate(self.used), np.concatenate(self.values)
        found = np.zeros(len(numbers))
        if isinstance(start, SetFit):
            _, here, there = np.intersect1d(numbers, start.numbers, return_indices=True)
            found[here], start = start.values[there], start.powers
        state = cells.state(found)
        given = [c.power for c in evidence.channels] if start is None else start
        excess = np.concatenate(list(given)) - layout.count
        best, last, stale = np.inf, np.inf, 0
        for round_ in range(rounds):
            normal, down = cells.steps(state, _weights(level, excess, used))
            normal += np.diag(precision)
            pull = precision * (centre - found) - down
            scale = 1 / np.sqrt(np.diag(normal))
            even = normal * np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
            step = np.linalg.solve(even, pull * scale) * scale
            for part_of_it in 0.5 ** np.arange(_HALVINGS):  # where noise shrinks, steps go too far
                moved = found + part_of_it * step
                state = cells.state(moved)
                cost = level * np.log1p(np.maximum(state.excess, 0.0) / level)
                value = float(precision @ (moved - centre) ** 2)
                value += float((cost + np.minimum(state.excess, 0.0))[used].sum())
                if float(state.scale.min()) < _NOTHING:
                    value = np.inf  # no machine is left
                if value < last + LEAST_GAIN:
                    break
            found, last, excess, stale = moved, value, state.excess, stale + 1
            if value < best - 0.05 or round_ == 0:
                best, values, costs, curvature, stale = value, found, cost, normal, 0
                powers = layout.split(layout.count + excess)
            if stale > 1:
                break
        # values follow the noise down; as evidence, what lies below it is no better
        cost_ = float(costs[used].sum()) + float(precision @ (values - centre) ** 2)
        cost_ += log_determinant(curvature) - float(np.log(precision).sum())
        effects = slice(evidence.tolerances, None)
        low, high = evidence.low[numbers][effects], evidence.high[numbers][effects]
        slack = 1e-3 * np.maximum(np.abs(low), 1e-9)
        allowed = bool(np.all((values[effects] >= low - slack) & (values[effects] <= high)))
        allowed &= bool(np.isfinite(cost_))
        for term in terms:
            if term.effect.axes:  # a mass of nothing weighs nothing, wherever it is
                x = values[np.searchsorted(numbers, evidence.columns_of(term))]
                allowed &= bool(np.any(term.values(x) != term.effect.null_values))
        return SetFit(
            terms, numbers, values, powers, curvature, cost_, cost_ + self.prior(terms), allowed
        )

    # ---- many sets at fixed weights

    def predicted(self, form: Reduced, terms: Sequence[Term]) -> float:
        """Total of a set at fixed weights; infinite where a coefficient is out of bounds."""
        evidence, at = self.evidence, self.columns(terms)[self.evidence.tolerances :]
        place = np.searchsorted(form.columns, at)
        normal, slope = form.normal[np.ix_(place, place)], form.slope[place]
        try:
            half, values, determinant = _solved(normal, slope)
        except np.linalg.LinAlgError:
            return np.inf
        gained = half @ half
        if not np.all(_near_bounds(values, evidence, at)):
            inside = _clipped(values, evidence, at)
            free = inside == values  # the others beside those that stand at their bounds
            values = inside
            values[free] = np.linalg.solve(
                normal[np.ix_(free, free)],
                slope[free] - normal[np.ix_(free, ~free)] @ inside[~free],
            )
            if not np.all(_near_bounds(values, evidence, at)):
                return np.inf
            gained = 2 * slope @ values - values @ normal @ values
        precision = evidence.precision[at]
        prior = precision @ evidence.centre[at] ** 2 - np.log(precision).sum()
        return float(form.rest + determinant - gained + prior + self.prior(terms))

    def screened(
        self, form: Form, terms: Sequence[Term], pool: Iterable[Term]
    ) -> list[tuple[float, Term]]:
        """Gain of each candidate beside a set at fixed weights, the largest first."""
        evidence, at = self.evidence, self.columns(terms)
        beside, slope = form.near(at), form.slope
        inverse = np.linalg.inv(beside[:, at])
        spread = inverse @ beside
        left = slope - beside.T @ (inverse @ slope[at])
        own = np.maximum(form.diagonal - np.sum(beside * spread, axis=0), 1e-300)
        precision, centre = evidence.precision, evidence.centre
        gains = left**2 / own + np.log(precision / own) - precision * centre**2
        near = _near_bounds(left / own, evidence, slice(None))
        known, found = set(at.tolist()), []
        for term in pool:
            new = np.array([k for k in evidence.columns_of(term) if k not in known], int)
            if len(new) == 1 and near[new[0]]:
                gain = float(gains[new[0]])
            elif len(new) > 1:
                several = form.around(new) - beside[:, new].T @ spread[:, new]
                values = _clipped(np.linalg.solve(several, left[new]), evidence, new)
                if not np.all(_near_bounds(values, evidence, new)):
                    continue
                gain = float(2 * left[new] @ values - values @ several @ values)
                gain += float(np.log(precision[new]).sum())
                gain -= float(precision[new] @ centre[new] ** 2 + np.linalg.slogdet(several)[1])
            else:
                continue
            found.append((gain - log(self._shapes[term.name]), term))
        return sorted(found, key=lambda pair: -pair[0])

    # ---- the search

    @cached_property
    def rich(self) -> tuple[Array, ...]:
        """Residuals with every linear effect beside the drives at once: hardly any set is below."""
        # Gains of drives are left out, since a balance without drives has nothing to explain.
        pool: dict[tuple[str, str], Term] = {}
        for term in self.evidence.terms:
            if not term.law and not term.effect.drives and term.contact in ("", USUAL):
                pool.setdefault(term.name, term)
        start = [channel.count for channel in self.evidence.channels]
        return self.fit(tuple(pool.values()), start).powers

    @cached_property
    def leading(self) -> list[SetFit]:
        """Best sets from several starts, of unlike kinds, that explain about as much."""
        # The shapes of the best one's laws are refined.
        starts, found = self.starts(), list[SetFit]()
        for number, start in enumerate(starts, start=1):
            self.say(f"search {number} of {len(starts)}")
            found.append(self.search(start))
        found.sort(key=lambda f: f.total)
        best = found[0]
        for _ in range(2):
            refined = self.refined(best)
            if refined is best:
                break
            best = self.search(refined.terms)
        nothing = self.solve(()).total
        alike = {kinds_of(best): best}
        for fit in found:
            if nothing - fit.total > EXPLAINED * (nothing - best.total):
                alike.setdefault(kinds_of(fit), fit)
        return list(alike.values())

    def starts(self) -> list[Set]:
        """Sets to start from: none, and the kinds that alone at all their places explain most."""
        # One kind at a time may be led astray: where friction is missing as well, a lag that halves
        # every drive explains more than the true delay.
        form = Form(self, self.rich)
        single = _by_kind(t for _, t in self.screened(form, (), self.evidence.terms))
        fits = [fit for fit in (self.solve(s, self.rich) for s in single) if fit.allowed]
        chosen: dict[str, Set] = {}
        for fit in sorted(fits, key=lambda f: f.total):
            chosen.setdefault(fit.terms[0].form[0], fit.terms)
        return [(), *list(chosen.values())[:_STARTS]]

    def refined(self, state: SetFit) -> SetFit:
        """Shapes of the members by a simplex, each beside the others."""
        # Where a motion is short, the parameters of a shape make up for each other: a ripple of
        # more periods for one of another phase.
        for term in state.terms:
            state = self._refined(state, term)
        return state

    def _refined(self, state: SetFit, term: Term) -> SetFit:
        shaped, found = self.shaped(term), [state]

        def total(steps: Array) -> float:
            if not np.any(steps):
                return state.total
            own = self.reshaped(state, term, dict(zip(shaped, steps.tolist(), strict=True)))
            found.append(own or state)
            return np.inf if own is None else own.total

        if shaped:
            simplex = np.vstack([np.zeros(len(shaped)), _STEP * np.eye(len(shaped))])
            options = {"initial_simplex": simplex, "maxfev": _SHAPES * len(shaped),
                       "fatol": LEAST_GAIN, "xatol": _STEP / 10}  # fmt: skip
            minimize(total, simplex[0], method="Nelder-Mead", options=options)
        return min(found, key=lambda f: f.total)

    @staticmethod
    def shaped(term: Term) -> list[int]:
        """Parameters that shape a law, which its coefficient does not say."""
        if _is_linear(term):
            return []
        return [k for k in range(len(term.effect.parameters)) if k != term.effect.proportional]

    def reshaped(self, state: SetFit, term: Term, steps: Mapping[int, float]) -> SetFit | None:
        """Fit with shape parameters of a member changed; None if that is out of bounds."""
        values = np.array(term.axes[0])
        for parameter, step in steps.items():
            own = term.effect.parameters[parameter]
            values[parameter] = stepped(own, float(values[parameter]), step)
        axes = (tuple(float(v) for v in values),)
        if axes == term.axes:
            return None
        return self.replaced(state, term, axes)

    def relinearised(self, state: SetFit, term: Term) -> SetFit:
        """Secant of a linear effect to its fitted value, where that explains more."""
        # A tilt of 0.1 rad takes half a per cent off gravity, which another effect would explain.
        shares = self.shares(state, term)
        axes = list(term.axes)
        # two digits: a secant to a value nearby is as good, and is already there
        secant = tuple(float(f"{value:.1e}") for value in term.values(shares))
        axes[int(np.argmax(np.abs(shares)))] = secant
        if tuple(axes) == term.axes or not self._bent(term, shares, state.powers):
            return state
        new = self.replaced(state, term, tuple(axes))
        return new if new is not None and new.total < state.total else state

    def _bent(self, term: Term, shares: Array, powers: Sequence[Array]) -> bool:
        """Whether an effect differs from its columns by more than the data's doubt of it."""
        key = id(term), *(f"{value:.1e}" for value in term.values(shares))
        if key not in self._off:
            balance = self.evidence.balance
            direction = balance.directions[term.contact or USUAL]
            exact = balance.forces(term.effect, term.values(shares)).with_contact(direction)
            parts = zip(shares, term.columns, strict=True)
            off = balance.folded(exact) - sum(
                share * column.change.whole() for share, column in parts
            )
            self._off[key] = self._cells(off)
        return self._felt(self._off[key], powers)

    def inexact(self, fit: SetFit) -> dict[str, Array]:
        """What the law of each effect of a set misses of its force (T, channels)."""
        found = {}
        for term in fit.terms:
            at = list(self.evidence.columns_of(term))
            shares = self.evidence.inexact[at] * self.shares(fit, term)
            if shares.any():
                parts = zip(shares, term.columns, strict=True)
                name = "{} at {}".format(*term.name)
                found[name] = np.asarray(sum(x * column.change.whole() for x, column in parts))
        return found

    def feels(self, missed: Iterable[Nuisance], fit: SetFit) -> bool:
        """Whether any of some tolerances is more than the data's doubt of it beside a set."""
        return any(self._felt(self._cells(n.change.whole()), fit.powers) for n in missed)

    def _cells(self, change: Array) -> dict[int, Array]:
        """Powers of a change of the balance (T, channels) in the cells that it reaches."""
        return {
            k: cell_powers(self.evidence.balance, channel.joint, change)
            for k, channel in enumerate(self.evidence.channels)
            if np.any(change[:, channel.joint])
        }

    def _felt(self, cells: Mapping[int, Array], powers: Sequence[Array]) -> bool:
        """Whether such powers are more than the data's doubt."""
        felt = sum(self.weights(k, powers[k]) @ own for k, own in cells.items())
        return float(felt) > _BENT

    def replaced(self, state: SetFit, term: Term, axes: Axes) -> SetFit | None:
        """Fit with a member's columns along other axes; None if that is out of bounds."""
        new = self._along(term, axes)
        if new is None:
            return None
        fit = self.fit((*(t for t in state.terms if t is not term), new), state.powers)
        return fit if fit.allowed else None

    def _along(self, term: Term, axes: Axes) -> Term | None:
        """An effect's columns along other axes; None if there are none."""
        evidence, key = self.evidence, (*term.effect.key, axes, term.contact)
        if key not in self._replaced:
            found = terms_of(evidence.balance, term.effect, axes, term.law, (term.contact,))
            new = replace(found[0], unseen=term.unseen) if found else None
            self._replaced[key] = new
            if new is not None:
                append(evidence, new)
        return self._replaced[key]

    def approached(self, fit: SetFit) -> SetFit:
        """The same set with shapes where out of bounds coefficients point, until they stay."""
        # Between two shapes that are tried may lie one that explains more than both.
        for _ in range(0 if fit.allowed else _SECANTS):
            terms = []
            for term, values in zip(fit.terms, self.values_in(fit), strict=True):
                pairs = zip(term.effect.parameters, values, strict=True)
                shape = tuple(float(f"{p.clipped(float(v)):.2e}") for p, v in pairs)
                if term.law and shape != term.axes[0]:
                    term = self._along(term, (shape,)) or term
                terms.append(term)
            fit = self.fit(tuple(terms), fit.powers)
            if fit.allowed:
                break
        return fit

    def search(self, start: Sequence[Term] = ()) -> SetFit:
        """Best set by steps from a start."""
        state = self.solve(start)
        for _ in range(_MOST):
            better = self._grown(state)
            better = self.polished(state if better is None else better)
            if better.total > state.total - LEAST_GAIN:
                break
            state, count = better, len(better.terms)
            gained, several = self.solve(()).total - state.total, "s" * (count != 1)
            if count:
                self.say(f"{count} effect{several}: twice the log evidence +{gained:.0f}")
        return state

    def _weightings(self, state: SetFit) -> list[Sequence[Array]]:
        """Residuals by whose weights steps are judged: of a set, of all effects, and between."""
        # What a set leaves of a channel hides what another set would explain of it.
        between = [np.sqrt(a * b) for a, b in zip(state.powers, self.rich, strict=True)]
        return [state.powers, between, self.rich]

    def _grown(self, state: SetFit) -> SetFit | None:
        """Best set with one more effect, or one more kind at all its places."""
        forms = {term.form for term in state.terms}
        pool = [term for term in self.evidence.terms if term.form not in forms]
        weightings = self._weightings(state)
        sets: dict[frozenset[int], Set] = {}
        for powers in weightings:
            seen: Counter[tuple[str, str]] = Counter()
            screened = self.screened(Form(self, powers, state), state.terms, pool)
            for _, term in screened:
                if seen[term.name] < 2 and len(seen) < _SCREENED:
                    seen[term.name] += 1
                    sets[frozenset([id(term)])] = (term,)
            for several in _by_kind(term for _, term in screened):
                if 1 < len(several) >= self._places[several[0].claim] - 1:
                    sets[frozenset(map(id, several))] = several
        moves = [(*state.terms, *new) for new in sets.values()]
        fitted = self.fitted(state, moves, weightings, _FITTED)
        best = min(fitted, key=lambda f: f.total, default=None)
        return best if best and best.total <= state.total - LEAST_GAIN else None

    def fitted(
        self, state: SetFit, sets: Sequence[Set], weightings: Sequence[Sequence[Array]], most: int
    ) -> list[SetFit]:
        """Fits of the sets that look best at fixed weights."""
        chosen: dict[int, Sequence[Array]] = {}
        for powers in weightings:
            every = (k for own in sets for k in self.columns(own))
            form = Form(self, powers, state).beside_tolerances(every)
            likely = sorted((self.predicted(form, s), k) for k, s in enumerate(sets))[:most]
            for total, k in likely:
                if np.isfinite(total):
                    chosen.setdefault(k, powers)
        found = [self.solve(sets[k], powers) for k, powers in chosen.items()]
        found = [self.approached(f) if f.total < state.total else f for f in found]
        order = sorted((fit for fit in found if fit.allowed), key=lambda f: f.total)
        # a kind too many is not made up for by a bend
        near = [fit for fit in order[:_SETTLED] if fit.total < state.total + KIND]
        return [*map(self.settled, near), *order[len(near) :]]

    def settled(self, fit: SetFit) -> SetFit:
        """The same set with its effects relinearised where they were fitted, until they stay."""
        for _ in range(_SECANTS):
            before = fit
            for term in filter(_is_linear, fit.terms):
                fit = self.relinearised(fit, term)
            if fit.total > before.total - LEAST_GAIN:
                break
        return fit

    def polished(self, state: SetFit) -> SetFit:
        """Remove, reshape and exchange members until nothing helps."""
        while True:
            weightings = self._weightings(state)
            moves = self._exchanges(state, weightings)
            fitted = self.fitted(state, moves, weightings, 5)
            best = min(fitted, key=lambda f: f.total, default=state)
            if best.total > state.total - 0.3:
                return state
            state = best

    def alternatives(self, form: Form, rest: Set, term: Term) -> list[Term]:
        """Other kinds at the place of a member, or at the links and drives beside it."""
        machine, forms = self.evidence.balance.machine, {t.form for t in rest}
        near = neighbours(machine, term.effect.where)
        others = [
            t
            for t in self.evidence.terms
            if t.effect.kind != term.effect.kind and t.form not in forms and t.effect.where in near
        ]
        return [t for _, t in self.screened(form, rest, others)]

    def _exchanges(self, state: SetFit, weightings: Sequence[Sequence[Array]]) -> list[Set]:
        """Sets with a member removed, reshaped or exchanged, or a kind exchanged everywhere."""
        forms = [Form(self, powers, state) for powers in weightings]
        found, everything = [], self.evidence.terms
        for term in state.terms:
            rest = tuple(t for t in state.terms if t is not term)
            found.append(rest)
            found += [(*rest, t) for t in everything if t.name == term.name and t is not term]
            for form in forms:
                found += [(*rest, t) for t in self.alternatives(form, rest, term)[:2]]
        for claim, count in Counter(t.claim for t in state.terms).items():
            if count < 2:
                continue
            rest = tuple(t for t in state.terms if t.claim != claim)
            found.append(rest)
            taken = {t.form for t in rest}
            places = {t.effect.where for t in state.terms if t.claim == claim}
            pool = [t for t in everything if t.effect.where in places and t.form not in taken]
            for form in forms:
                others = _by_kind(t for _, t in self.screened(form, rest, pool) if t.claim != claim)
                found += [(*rest, *own) for own in others if len(own) == count]
        return [*{frozenset(map(id, own)): own for own in found}.values()]


def _by_kind(terms: Iterable[Term]) -> list[Set]:
    """The first term at each location, kind by kind; one at all of them is by itself."""
    kinds: dict[Claim, dict[str, Term]] = {}
    for term in terms:
        claim = term.effect.kind, term.effect.where == "all"
        kinds.setdefault(claim, {}).setdefault(term.effect.where, term)
    return [tuple(places.values()) for places in kinds.values()]


def kinds_of(fit: SetFit) -> frozenset[str]:
    """Kinds of effect in a set, forms of friction as one."""
    return frozenset(term.form[0] for term in fit.terms)


def _is_linear(term: Term) -> bool:
    """Whether an effect's columns are its derivatives; else they have a shape."""
    return bool(term.effect.axes) or not (term.law or term.effect.proportional is not None)


def stepped(parameter: Parameter, value: float, step: float) -> float:
    """Value of a shape parameter a relative step away; of either sign, by shares of its scale."""
    sized = parameter.low >= 0 and value > 0
    return parameter.clipped(value * exp(step) if sized else value + step * parameter.scale)


def _weights(values: Array, excess: Array, used: NDArray[np.bool_]) -> Array:
    """Weights of cells by the power beyond their noise."""
    return np.asarray(values / (values + np.maximum(excess, 0.0)) * used)


def _values(channel: Channel, noisy: float) -> Array:
    """Values of each cell's discrepancy, by the share of noise in what hardly any set explains."""
    # Half of all values where there is nothing but noise, which then says what chi-square does; few
    # where a discrepancy repeats the motion.
    least = np.minimum(LEAST_VALUES, channel.count / 2) + SHARE_VALUES * channel.count
    most = np.maximum(channel.count / 2, least)
    return np.asarray(least + min(noisy, 1.0) * (most - least))


@dataclass(frozen=True, eq=False)
class Reduced:
    """Quadratic form of some columns with the tolerances eliminated."""

    columns: NDArray[np.intp]  # The columns, ascending (K,)
    normal: Array  # Their normal matrix (K, K)
    slope: Array  # Their slope (K,)
    rest: float  # Part of the total that no column of an effect changes


class Form:
    """Quadratic form of all columns at the weights of some powers, made where it is asked for.

    Around a fitted set its noise is that of the set's operator.
    """

    def __init__(
        self, selection: Selection, powers: Sequence[Array], fit: SetFit | None = None
    ) -> None:
        self._evidence = evidence = selection.evidence
        self._weights = [selection.weights(k, p) for k, p in enumerate(powers)]
        self.slope = evidence.precision * evidence.centre
        self.diagonal = evidence.precision.copy()
        self._guards: list[Array] = []
        every = np.zeros(len(evidence.precision))
        if fit is not None:
            every[fit.numbers] = fit.values
        for channel, weight, power in zip(evidence.channels, self._weights, powers, strict=True):
            at = channel.columns
            self.slope[at] += weight @ channel.slope
            self.diagonal[at] += weight @ channel.square
            # what a candidate explains leaves noise to be guarded
            noise = weight * np.minimum(channel.count, power)
            moved = channel.growth @ every[at] if fit is not None else 0 * noise
            guard = np.where(moved < -1e-12, noise, 0.0)
            self.slope[at] += (guard + noise * np.where(moved > 0, 1 + moved, 0.0)) @ channel.growth
            self.diagonal[at] += guard @ channel.growth**2
            self._guards.append(guard)
        self._beside: dict[int, Array] = {}
        self._around: dict[tuple[int, ...], Array] = {}

    def near(self, at: NDArray[np.intp]) -> Array:
        """Normal matrix between some columns and all."""
        new = np.array([k for k in at if k not in self._beside], dtype=int)
        beside = self.between(new, np.arange(len(self.slope)))
        self._beside.update(zip(new.tolist(), beside, strict=True))
        return np.stack([self._beside[k] for k in at])

    def around(self, columns: NDArray[np.intp]) -> Array:
        """Normal matrix of the columns of a term."""
        key = tuple(columns.tolist())
        if key not in self._around:
            found = np.diag(self._evidence.precision[columns])
            channels, cells = self._evidence.channels, self._evidence.products_of(key)
            for (place, products), weight, guard, channel in zip(
                cells, self._weights, self._guards, channels, strict=True
            ):
                growth = channel.growth[:, np.isin(channel.columns, columns)]
                own = np.tensordot(weight, products, 1) + (growth.T * guard) @ growth
                found[np.ix_(place, place)] += own
            self._around[key] = found
        return self._around[key]

    def beside_tolerances(self, columns: Iterable[int]) -> Reduced:
        """The form of some columns of effects with the tolerances eliminated."""
        count = self._evidence.tolerances
        own = np.unique(np.fromiter(columns, dtype=int))
        at = np.concatenate([np.arange(count), own[own >= count]])
        normal, slope = self.between(at, at), self.slope[at]
        root = np.linalg.cholesky(normal[:count, :count])
        across = solve_triangular(root, normal[:count, count:], lower=True)
        half = solve_triangular(root, slope[:count], lower=True)
        return Reduced(
            columns=at[count:],
            normal=normal[count:, count:] - across.T @ across,
            slope=slope[count:] - across.T @ half,
            rest=float(2 * np.log(np.diag(root)).sum() - half @ half),
        )

    def between(self, left: NDArray[np.intp], right: NDArray[np.intp]) -> Array:
        """Normal matrix of some columns with others."""
        precision = self._evidence.precision
        found = np.where(left[:, None] == right, precision[left][:, None], 0.0)
        channels = zip(self._evidence.channels, self._weights, self._guards, strict=True)
        for channel, weight, guard in channels:
            place = np.full(len(precision), -1)
            place[channel.columns] = np.arange(len(channel.columns))
            one, other = place[left], place[right]
            rows, columns = np.flatnonzero(one >= 0), np.flatnonzero(other >= 0)
            if not (len(rows) and len(columns)):
                continue
            own = channel.products(weight, one[rows], other[columns])
            if guard.any():
                growth, kept = channel.growth, guard > 0
                more = growth[np.ix_(kept, one[rows])].T * guard[kept]
                own = own + more @ growth[kept][:, other[columns]]
            found[np.ix_(rows, columns)] += own
        return found


def _solved(normal: Array, slope: Array) -> tuple[Array, Array, float]:
    """Half-solved and solved system of a positive definite matrix, and its log determinant."""
    scale = 1 / np.sqrt(np.diag(normal))
    root = np.linalg.cholesky(normal * np.outer(scale, scale))
    half = solve_triangular(root, slope * scale, lower=True, check_finite=False)
    values = solve_triangular(root.T, half, lower=False, check_finite=False) * scale
    return half, values, float(2 * np.log(np.diag(root)).sum() - 2 * np.log(scale).sum())


def _clipped(values: Array, evidence: Evidence, at: NDArray[np.intp]) -> Array:
    """Coefficients within bounds where they have no law: other weights may lead them back."""
    inside = np.clip(values, evidence.low[at], evidence.high[at])
    return np.where(evidence.centre[at] > 0, values, inside)


def _near_bounds(
    values: Array, evidence: Evidence, at: NDArray[np.intp] | slice
) -> NDArray[np.bool_]:
    """Which coefficients lie within bounds, with room for other weights."""
    low, high, law = evidence.low[at], evidence.high[at], evidence.centre[at] > 0
    room = np.where(law, 0.15, 0.5 * np.abs(np.where(np.isfinite(low), low, 0.0)))
    return np.asarray((values >= low - room) & (values <= high + np.where(law, 0.15, np.inf)))
