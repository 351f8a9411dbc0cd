"""Decision: which effects of a fitted set are named, and what is said of every joint.

Held-out stretches and whole held-out runs decide. An effect is named where it is probable, its
interval excludes no effect, and the likelihood of data it was not fitted to rises.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

from loose_env.gap.core.balance import USUAL, Balance
from loose_env.gap.core.catalogue import Term, at_joint, neighbours, terms_of
from loose_env.gap.core.evidence import append, stretches_of
from loose_env.gap.core.exact import LARGE, Exact, ExactFit
from loose_env.gap.core.selection import (
    EXPLAINED,
    KIND,
    Form,
    Selection,
    Set,
    SetFit,
    kinds_of,
    stepped,
)
from loose_env.gap.model.effect import Mountings, free_of, values_of
from loose_env.gap.model.effects.inertia import MountedPayload, Payload
from loose_env.gap.model.effects.sensors import SensorQuantisation
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.result import ChannelVerdict, ChannelWord, EffectLocation
from loose_env.inference import log_determinant
from loose_env.recording import Recording
from loose_env.statistics import resolution_of
from loose_env.typing import Array

NAMED = 0.5
"""Probability from which an effect is named: as likely as not."""
HELD_OUT = 4.0
"""Rise of twice the held-out log likelihood for an effect: a factor of e² in likelihood, positive
evidence (Kass and Raftery 1995)."""
CONTRADICTED = -10.0
"""The same below which one of the ways to hold out refutes it: very strong evidence (Kass and
Raftery 1995)."""
_RIVAL = 0.05  # probability from which another effect is a rival
_Z = 1.96  # half width of a 95 % interval in standard deviations
_ASIDE, _HIGH, _NEARER = 0.25, 12.0, 5
"""Relative step of a shape over which the fall of its evidence is read, at most; the fall from
which it is halved, for beyond three standard deviations it is no parabola, and how often."""
_MOST = 0.5  # share of a channel's power beyond its noise that is most of it
_NOISE = 1.6
"""Held-out residual up to which nothing more is needed [noise standard deviations]: noise alone,
where its estimate is a third too small."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One effect of the answer."""

    term: Term  # The effect with its shape
    values: Array  # Parameter values (P,)
    low: Array  # Lower ends of their 95 % intervals (P,)
    high: Array  # Upper ends (P,)
    probability: float  # Probability that the machine has it, or one of `confusable` in its place
    alone: float  # Probability that the machine has it
    confusable: tuple[tuple[str, str], ...]
    """Other effects near its place that may be there without it."""
    z: float  # Largest coefficient over its standard deviation
    by_run: float  # Rise of twice the log likelihood of held-out runs
    by_stretch: float  # The same of held-out stretches of all runs
    doubt: str  # Reason why it is not named, "" if it is

    @property
    def named(self) -> bool:
        """Whether it is named."""
        return not self.doubt


@dataclass(frozen=True, kw_only=True, eq=False)
class Decision:
    """Effects and verdicts."""

    findings: tuple[Finding, ...]  # All members of the set, named or not
    channels: tuple[ChannelVerdict, ...]  # Verdicts by joint and reading, of the whole set
    fit: SetFit  # The set
    rivals: tuple[tuple[float, str, str], ...]
    """Probability, kind and location of effects outside the set."""
    simulated: bool = False  # Whether full simulation decided of joints


def decide(selection: Selection, fit: SetFit, exact: ExactFit | None = None) -> Decision:
    """Say what of a pruned set is named, with the values of an exact fit if there is one."""
    gains = _gains(selection, fit)
    near = _near(selection, fit, exact is not None)
    chances: dict[tuple[str, str], float] = {}
    for names, weight in near:
        for name in names:
            chances[name] = chances.get(name, 0.0) + weight
    before, after = held_out_rms(selection, fit)
    open_ = _unexplained(before, after)
    freely, sized = selection.sized(fit)
    covariance = _covariance(freely, sized)
    findings = []
    for number, term in enumerate(fit.terms):
        own = fit.places(selection.evidence.columns_of(term))
        x, spread = sized.values[own], covariance[np.ix_(own, own)]
        values = term.values(x)
        ends = _ends(term, x, spread)
        ends = _with_shapes(selection, fit, term, ends)
        if exact is not None:
            # the values of the simulation, as uncertain as there or as the cells disagree
            wide = (ends.max(axis=0) - ends.min(axis=0)) / 2
            values = exact.values[number]
            ends = np.stack([*_simulated_ends(exact, number), values - wide, values + wide])
        bounds = np.transpose([(p.low, p.high) for p in term.effect.parameters])
        ends = np.vstack([ends, np.where(term.undetermined, bounds, ends[:1])])
        z = _deviation(x, spread)
        by_run, by_stretch = (float(g[number]) for g in gains)
        alike = _confusable(selection, term, chances)
        chance = sum(weight for names, weight in near if names & alike)
        without = [(names, weight) for names, weight in near if term.name not in names]
        instead = [n for n in alike if sum(w for names, w in without if n in names) > _RIVAL]
        held = max(by_run, by_stretch) if min(by_run, by_stretch) > CONTRADICTED else -np.inf
        findings.append(
            Finding(
                term=term, values=values, low=ends.min(axis=0), high=ends.max(axis=0),
                probability=chance, alone=min(chances[term.name], chance),
                confusable=tuple(sorted(instead)),
                z=z, by_run=by_run, by_stretch=by_stretch,
                doubt=_doubt(
                    chance, z > _Z, held, bool(open_[_main(selection, fit, term)]),
                    _at_end(term, values, ends),
                ),
            )
        )  # fmt: skip
    return _decision(selection, fit, findings, chances, before, after)


def rounded(recording: Recording, machine: NominalModel, zero: float) -> tuple[Finding, ...]:
    """Encoders whose readings are whole steps of more than twice the tolerance of a zero."""
    # They show it by themselves: rounding is noise, which no force tells from other noise.
    found = []
    for name in machine.encoders:
        read = [run.sensors[name] for run in recording.runs if name in run.sensors]
        values = np.concatenate([np.empty(0), *read])
        step = resolution_of(values)
        if step <= 2 * zero:
            continue
        effect = SensorQuantisation(machine, name)
        levels = np.unique(values[np.isfinite(values)])
        count = np.round((levels - levels[0]) / step)
        slope, first = np.polyfit(count, levels, 1)
        off = float(np.max(np.abs(levels - first - slope * count)))
        off = max(off, float(np.spacing(np.abs(levels).max())))  # as fine as it is written
        gain = 2 * len(levels) * log(slope / off)
        value = np.array([slope])
        found.append(
            Finding(
                term=Term(effect, ((float(slope),),), "", True, ()), values=value,
                low=value - off, high=value + off, probability=1.0, alone=1.0, confusable=(),
                z=np.inf, by_run=gain, by_stretch=gain, doubt="",
            )
        )  # fmt: skip
    return tuple(found)


def with_rounded(decision: Decision, found: Iterable[Finding]) -> Decision:
    """The decision with verdicts of joints whose encoders show whole steps."""
    each = list(decision.channels)
    for finding in found:
        joint = finding.term.effect.machine.encoders[finding.term.effect.where]
        own = EffectLocation(kind=finding.term.effect.kind, where=finding.term.effect.where)
        for k, channel in enumerate(each):
            if channel.channel == joint and channel.verdict in ("named", "not needed"):
                effects = (*channel.effects, own) if channel.verdict == "named" else (own,)
                each[k] = replace(channel, verdict="named", effects=effects)
    return replace(decision, channels=tuple(each))


def _decision(
    selection: Selection,
    fit: SetFit,
    findings: Sequence[Finding],
    chances: Mapping[tuple[str, str], float],
    before: Array,
    after: Array,
) -> Decision:
    """Findings with the rivals beside them, and the verdict of each channel."""
    members = {term.name for term in fit.terms}
    likely = ((p, *name) for name, p in chances.items() if name not in members and p > _RIVAL)
    rivals = tuple(sorted(likely, reverse=True))
    channels = tuple(_verdicts(selection, findings, rivals, before, after))
    return Decision(findings=tuple(findings), channels=channels, fit=fit, rivals=rivals)


def _deviation(x: Array, covariance: Array) -> float:
    """Standard deviations by which coefficients together differ from zero: Wald's test."""
    # Axes may be nearly parallel: none of their coefficients is known then, while their sum is.
    return float(-ndtri(chdtrc(len(x), x @ np.linalg.solve(covariance, x)) / 2))


def _at_end(term: Term, values: Array, ends: Array) -> bool:
    """Whether the interval of a value has no width at an end of its parameter's range."""
    pairs = zip(term.effect.parameters, values, np.ptp(ends, axis=0), strict=True)
    return any(width == 0 and value in (p.low, p.high) for p, value, width in pairs)


def _doubt(chance: float, sure: bool, gain: float, left: bool, at_end: bool = False) -> str:
    """Reason why an effect of some probability and held-out gain is not named; "" if it is."""
    # What leaves most of its channel as it was is beside something that nothing explains.
    reasons = {
        "improbable": chance < NAMED,
        "its interval includes no effect": not sure,
        "held-out data do not confirm it": gain < HELD_OUT,
        "most of what it acts on stays unexplained": left,
        "its value lies at the end of what is possible": at_end,
    }
    return "; ".join(words for words, applies in reasons.items() if applies)


def _simulated_ends(fit: ExactFit, number: int) -> list[Array]:
    """Ends of the 95 % intervals of a member's parameters in simulation."""
    parameters = fit.terms[number].effect.parameters
    free = free_of(parameters, fit.values[number])
    half = _Z * fit.spreads[number]
    return [values_of(parameters, free + side * half) for side in (-1, 1)]


def decide_simulated(
    selection: Selection,
    exact: Exact,
    visited: Sequence[ExactFit],
    nominal: ExactFit,
) -> Decision:
    """Say what is named of the best set that was searched for in simulation, the first visited."""
    best = visited[0]
    gains, left, without = _simulated_gains(selection, exact, best)
    while len(gains) > 1 and gains.min() < HELD_OUT:  # as in the cells, the worst first
        best = exact.only(selection, best, [k for k in range(len(gains)) if k != gains.argmin()])
        gains, left, without = _simulated_gains(selection, exact, best)
    fit = _in_cells(selection, best)
    weights = np.exp(-0.5 * np.array([f.total - visited[0].total for f in visited]))
    chances: dict[tuple[str, str], float] = {}
    for other, weight in zip(visited, weights / weights.sum(), strict=True):
        for term in other.terms:
            chances[term.name] = chances.get(term.name, 0.0) + float(weight)
    wide = _left_to_cells(selection, fit)
    before, after = held_out_rms(selection, fit)
    simulated = exact.by_joint()
    for k, channel in enumerate(selection.evidence.channels):
        if channel.joint in simulated:
            number = simulated[channel.joint]
            before[k], after[k] = nominal.rms[number], left[number]
    open_ = _unexplained(before, after)
    shown = {term.name: open_[_main(selection, fit, term)] for term in fit.terms}
    for term, own in zip(best.terms, without, strict=True):
        if term.effect.has_stops:  # no column has its knocks: by what it explains in simulation
            share = 1 - (left**2 - 1) / np.maximum(own**2 - 1, 1e-9)
            shown[term.name] = not np.any(share[own > LARGE] > _MOST)
    findings = []
    for number, (term, values) in enumerate(zip(best.terms, best.values, strict=True)):
        off = np.stack(_simulated_ends(best, number)) - values
        ends = values + np.sign(off) * np.hypot(off, wide.get(term.name, 0.0))
        sure = not term.effect.interval_includes_null(ends.min(axis=0), ends.max(axis=0))
        gain, chance = float(gains[number]), min(chances[term.name], 1.0)
        findings.append(
            Finding(
                term=term, values=values, low=ends.min(axis=0), high=ends.max(axis=0),
                probability=chance, alone=chance, confusable=(), z=np.inf if sure else 0.0,
                by_run=gain, by_stretch=gain,
                doubt=_doubt(chance, sure, gain, bool(shown.get(term.name))),
            )
        )  # fmt: skip
    return replace(_decision(selection, fit, findings, chances, before, after), simulated=True)


def _in_cells(selection: Selection, fit: ExactFit) -> SetFit:
    """The set in the cells, each effect at its simulated values."""
    evidence, terms = selection.evidence, []
    for term, values in zip(fit.terms, fit.values, strict=True):
        shape = (tuple(map(float, values)),)
        for own in terms_of(evidence.balance, term.effect, shape, True, contacts=(USUAL,)):
            append(evidence, own)
            terms.append(own)
    return selection.solve(tuple(terms))


def _simulated_gains(
    selection: Selection, exact: Exact, fit: ExactFit
) -> tuple[Array, Array, Array]:
    """Rise of twice the held-out log likelihood by each member; residuals with all, without it."""
    # By halves of the runs, of a lone run by alternate windows.
    names = [trial.name for trial in exact.simulator.trials]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    order = [number[name] for name in names] if len(number) > 1 else range(len(names))
    gains, left = np.zeros(len(fit.terms)), np.zeros(len(fit.rms))
    without = np.zeros((len(fit.terms), len(fit.rms)))
    for half in (0, 1):
        train, test = (
            exact.on([k for k, place in enumerate(order) if place % 2 == side])
            for side in (half, 1 - half)
        )
        score, rms = test.score(train.refit(selection, fit.terms, fit.values, 1))
        left += rms**2 / 2
        for k in range(len(fit.terms)):
            rest = [i for i in range(len(fit.terms)) if i != k]
            other, rms = test.score(train.only(selection, fit, rest))
            gains[k] += other - score
            without[k] += rms**2 / 2
    return gains, np.sqrt(left), np.sqrt(without)


def pruned(selection: Selection, fit: SetFit) -> SetFit:
    """Drop members that do not help on data they were not fitted to, the worst first."""
    while fit.terms:
        by_run, by_stretch = _gains(selection, fit)
        low, high = np.minimum(by_run, by_stretch), np.maximum(by_run, by_stretch)
        gain = np.where(low < CONTRADICTED, low, high)
        worst = int(np.argmin(gain))
        if gain[worst] >= HELD_OUT:
            break
        rest = tuple(t for k, t in enumerate(fit.terms) if k != worst)
        fit = selection.solve(rest, fit.powers)
    return fit


def folds_of(selection: Selection, terms: Set) -> list[list[list[NDArray[np.bool_]]]]:
    """Held-out cells, scheme by scheme and fold by fold: whole runs, and alternate stretches."""
    # Stretches alone of a set by which runs differ: a run that is held out would say nothing of it.
    channels = selection.evidence.channels
    schemes = []
    runs = sorted({int(r) for c in channels for r in c.run})
    if len(runs) > 1 and not any(term.effect.mountings for term in terms):
        groups = [runs[k :: min(len(runs), 4)] for k in range(min(len(runs), 4))]
        schemes.append([[np.isin(c.run, group) for c in channels] for group in groups])
    # alternate ones of all runs, of each way in which they differ by themselves
    ways = [way for term in terms for way in term.effect.mountings]
    seen: Counter[tuple[bool, ...]] = Counter()
    half = []
    for run, _ in stretches_of(selection.evidence.balance):
        name = selection.evidence.balance.motion.runs[run].name
        own = tuple(name in way for way in ways)
        half.append(seen[own] % 2)
        seen[own] += 1
    halves = [[np.array(half)[c.stretch] == k for c in channels] for k in (0, 1)]
    schemes.append(halves)
    return schemes if len(schemes) == 2 else [halves, halves]


def _held_out(
    selection: Selection, fit: SetFit, folds: Sequence[Sequence[NDArray[np.bool_]]]
) -> float:
    """Minus twice the log likelihood of held-out cells given the others, with tolerances' cost."""
    # That is what evidence these cells add: they say little where they depend on tolerances that no
    # other cell determines.
    total, tolerances = 0.0, slice(0, selection.evidence.tolerances)
    for held in folds:
        own = selection.without(held, fit)
        total += fit.cost - own.cost
        total += float(own.values[tolerances] @ own.values[tolerances]) / len(folds)
    return total


def _gains(selection: Selection, fit: SetFit) -> tuple[Array, Array]:
    """Rise of twice the held-out log likelihood with each member, by runs and by stretches."""
    rests = (tuple(t for t in fit.terms if t is not term) for term in fit.terms)
    sets = [fit, *(selection.solve(rest, fit.powers) for rest in rests)]
    one, other = (
        np.array([_held_out(selection, own, folds) for own in sets])
        for folds in folds_of(selection, fit.terms)
    )
    return one[1:] - one[0], other[1:] - other[0]


def _near(
    selection: Selection, fit: SetFit, simulated: bool
) -> list[tuple[set[tuple[str, str]], float]]:
    """Effects and probability of the sets near the answer."""
    # Of unlike kinds that cells prefer simulations have decided.
    form = Form(selection, fit.powers, fit)
    forms = {t.form for t in fit.terms}
    pool = [t for t in selection.evidence.terms if t.form not in forms]
    for _, term in selection.screened(form, fit.terms, pool)[:12]:
        selection.solve((*fit.terms, term), fit.powers)
    for term in fit.terms:
        rest = tuple(t for t in fit.terms if t is not term)
        selection.solve(rest, fit.powers)
        for other in selection.alternatives(form, rest, term)[:3]:
            selection.solve((*rest, other), fit.powers)
    own = kinds_of(fit)
    near = [
        each
        for each in selection.fits.values()
        if each.allowed and not (simulated and each.total < fit.total and kinds_of(each) != own)
    ]
    near.append(fit)
    least = min(f.total for f in near)
    weights = np.exp(-0.5 * np.array([f.total - least for f in near]))
    weights /= weights.sum()
    return [({t.name for t in f.terms}, float(w)) for f, w in zip(near, weights, strict=True)]


def _confusable(
    selection: Selection, term: Term, chances: dict[tuple[str, str], float]
) -> set[tuple[str, str]]:
    """An effect and those at its place that may stand in for it."""
    near = neighbours(selection.evidence.balance.machine, term.effect.where)
    members = {t.name for t in selection.evidence.terms}
    return {term.name} | {
        name
        for name, chance in chances.items()
        if chance > _RIVAL and chance < 1 - _RIVAL and name[1] in near and name in members
    }


def _left_to_cells(selection: Selection, fit: SetFit) -> dict[tuple[str, str], Array]:
    """Half widths of intervals by what a simulation holds: tolerances, and what laws miss (P,)."""
    # Of the effects that the cells show: not of a limit below the force that the motion took.
    _, sized = selection.sized(fit)
    own = np.arange(len(sized.numbers)) >= selection.evidence.tolerances
    covariance, effects = _missed(selection, sized), np.ix_(own, own)
    covariance[effects] += np.linalg.inv(sized.normal)[effects]
    covariance[effects] -= np.linalg.inv(sized.normal[effects])
    found = {}
    for term in fit.terms:
        at = sized.places(selection.evidence.columns_of(term))
        low, high = _ends(term, sized.values[at], covariance[np.ix_(at, at)])
        found[term.name] = np.abs(high - low) / 2
    return found


def _ends(term: Term, x: Array, covariance: Array) -> Array:
    """Ends of the 95 % intervals of an effect's parameters (2, P), by the delta method."""
    sd = np.sqrt(np.diag(covariance))
    if len(x) == 1:
        return np.stack([term.values(x + side * _Z * sd) for side in (-1, 1)])
    # coefficients of several ways add up to one mass: a deviation of one alone may leave none
    sd = sd * (1e-2 if term.effect.mountings else 1.0)
    values, steps = term.values(x), np.diag(sd)
    slopes = (
        np.stack([(term.values(x + row) - term.values(x - row)) / 2 for row in steps]) / sd[:, None]
    )
    half = _Z * np.sqrt(np.einsum("kp,kl,lp->p", slopes, covariance, slopes))
    return np.stack([values - half, values + half])


def _with_shapes(selection: Selection, fit: SetFit, term: Term, ends: Array) -> Array:
    """Ends with those of the parameters that shape a law: where the evidence falls off."""
    found = ends.copy()
    if len(term.effect.parameters) == 1 and term.effect.null_values is not None:
        return found  # its coefficient says it; a limit has none
    missed = 0.5 * float(
        np.max(selection.evidence.inexact[list(selection.evidence.columns_of(term))])
    )
    shaped = selection.shaped(term)
    if not shaped:
        return found
    spreads = np.sqrt(np.diag(np.linalg.inv(_curvature(selection, fit, term, shaped))))
    for k, spread in zip(shaped, np.hypot(spreads, missed), strict=True):
        half = min(_Z * float(spread), _Z)
        found[:, k] = [
            stepped(term.effect.parameters[k], term.axes[0][k], s * half) for s in (-1, 1)
        ]
    return found


def _curvature(selection: Selection, fit: SetFit, term: Term, shaped: Sequence[int]) -> Array:
    """Half the second derivatives of the evidence by relative steps of a member's shape (K, K)."""
    # Of the shapes beside each other: one may make up for another.

    def rise(*steps: tuple[int, float]) -> float:
        own = selection.reshaped(fit, term, dict(steps))
        return np.inf if own is None else max(own.total - fit.total, 0.0)

    count = len(shaped)
    found, aside = np.zeros((count, count)), np.full(count, _ASIDE)
    for i, k in enumerate(shaped):
        rises = [rise((k, side * aside[i])) for side in (-1, 1)]
        for _ in range(_NEARER - 1):
            if max(rises) < _HIGH:
                break
            aside[i] /= 2
            rises = [rise((k, side * aside[i])) for side in (-1, 1)]
        low = min(rises) if np.isinf(max(rises)) else float(np.mean(rises))
        found[i, i] = min(low, 1e9) / aside[i] ** 2 + 1e-6
    for i, j in combinations(range(count), 2):
        corners = [rise((shaped[i], aside[i]), (shaped[j], s * aside[j])) for s in (-1, 1)]
        mixed = (corners[1] - corners[0]) / (4 * aside[i] * aside[j])
        most = 0.99 * np.sqrt(found[i, i] * found[j, j])
        found[i, j] = found[j, i] = np.clip(mixed, -most, most) if np.isfinite(mixed) else 0.0
    return found


def _covariance(selection: Selection, fit: SetFit) -> Array:
    """Covariance of the coefficients: Laplace's, wider where the jackknife's deviations are."""
    # A discrepancy that repeats makes stretches disagree by more than their noise does (Efron and
    # Stein, Annals of Statistics 9, 1981).
    laplace = np.linalg.inv(fit.normal)
    channels = selection.evidence.channels
    stretches = sorted({int(s) for c in channels for s in c.stretch})
    if len(stretches) < 3:
        return np.asarray(laplace + _missed(selection, fit))
    left_out = np.stack(
        [
            selection.on([c.stretch != s for c in channels]).fit(fit.terms, fit, 2).values
            for s in stretches
        ]
    )
    count = len(stretches)
    jackknife = np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean(axis=0)) ** 2, 0))
    wider = np.maximum(jackknife / np.sqrt(np.diag(laplace)), 1.0)
    return np.asarray(laplace * np.outer(wider, wider) + _missed(selection, fit))


def _missed(selection: Selection, fit: SetFit) -> Array:
    """Covariance by what the columns of tolerances and laws miss."""
    # Of what a law misses about half looks like more or less of the effect; and a torque constant
    # scales what the effects take, not only what the nominal model needs.
    evidence = selection.evidence
    missed = 0.5 * evidence.inexact[fit.numbers] * fit.values
    found = np.diag(missed**2)
    effects = np.where(fit.numbers < evidence.tolerances, 0.0, fit.values)
    widths = dict(n.scaled for n in evidence.nuisances if n.scaled)
    for k, channel in enumerate(evidence.channels):
        own, at, local = np.intersect1d(fit.numbers, channel.columns, return_indices=True)
        if channel.joint not in widths or not len(own):
            continue
        rows = channel.rows[:, local]
        weight = selection.weights(k, fit.powers[k])[channel.cell]
        slope = np.zeros(len(fit.numbers))
        slope[at] = rows.T @ (weight * (rows @ effects[at]))
        moved = widths[channel.joint] * np.linalg.solve(fit.normal, slope)
        found += np.outer(moved, moved)
    return found


def _unexplained(before: Array, after: Array) -> NDArray[np.bool_]:
    """Channels of which most is left (C,)."""
    share = 1 - (after / before) ** 2
    return np.asarray((after > LARGE) & (share < EXPLAINED))


def left_open(selection: Selection, before: Array, after: Array) -> list[int]:
    """Joints and readings left open: much is left, or most of the time says nothing of a joint."""
    unexplained = _unexplained(before, after)
    joints = len(selection.evidence.balance.machine.joints)
    return [
        channel.joint
        for channel, most in zip(selection.evidence.channels, unexplained, strict=True)
        if most or (channel.joint < joints and channel.blanked > 0.5)
    ]


def _main(selection: Selection, fit: SetFit, term: Term) -> int:
    """Channel that shows most of an effect."""
    sizes = []
    for channel in selection.evidence.channels:
        own = [k for k, n in enumerate(channel.columns) if n in selection.evidence.columns_of(term)]
        x = fit.values[fit.places(channel.columns[own])]
        sizes.append(float(np.mean((channel.rows[:, own] @ x) ** 2)) if own else 0.0)
    return int(np.argmax(sizes))


def _verdicts(
    selection: Selection,
    findings: Sequence[Finding],
    rivals: Sequence[tuple[float, str, str]],
    before: Array,
    after: Array,
) -> Iterable[ChannelVerdict]:
    """One verdict for each channel of the evidence."""
    unexplained = _unexplained(before, after)
    for k, channel in enumerate(selection.evidence.channels):
        places = places_of(selection.evidence.balance, channel.joint)
        own = [f for f in findings if f.term.effect.where in places]
        named = [f.term.name for f in own if f.named]
        open_ = [f.term.name for f in own if not f.named]
        open_ += [(kind, where) for _, kind, where in rivals if where in places]
        if unexplained[k]:
            verdict: ChannelWord = "unexplained"
        elif named:
            verdict = "named"
        elif after[k] < _NOISE or (not open_ and after[k] <= LARGE):
            verdict = "not needed"
        else:
            verdict = "cannot tell"
        yield ChannelVerdict(
            channel=selection.evidence.balance.channels[channel.joint], verdict=verdict,
            effects=tuple(EffectLocation(kind=kind, where=where) for kind, where in named or open_),
            before=float(before[k]), after=float(after[k]),
        )  # fmt: skip


def places_of(balance: Balance, channel: int) -> set[str]:
    """Locations of the effects that a channel shows: a reading's own, or all at a joint."""
    name, joints = balance.channels[channel], balance.machine.joints
    if channel >= len(joints):
        return {name.removeprefix("sensor.").split(".")[0]}
    return at_joint(balance.machine, name) | {"all", "tool", "base"}


def held_out_rms(selection: Selection, fit: SetFit) -> Array:
    """Residual of each channel on held-out data, run by run if there are several (2, C)."""
    # Without the set's effects, with the tolerances as beside them, and with them. Alone,
    # tolerances would be pulled far to stand in for what is missing.
    evidence = selection.evidence
    total, count = np.zeros((2, len(evidence.channels))), np.zeros(len(evidence.channels))
    for held in folds_of(selection, fit.terms)[0]:
        own = selection.without(held, fit)
        for k, (channel, power) in enumerate(zip(evidence.channels, own.powers, strict=True)):
            at = channel.columns[channel.columns < evidence.tolerances]
            left = channel.residual - channel.rows[:, : len(at)] @ own.values[at]
            total[:, k] += [p[held[k]].sum() for p in (channel.by_cell(left**2), power)]
            count[k] += channel.count[held[k]].sum()
    return np.asarray(np.sqrt(total / count))


# Payloads by runs

_MOST_RUNS = 16  # runs among which payloads are told apart, at most: cost
_INERTIA = {"payload", "link_mass", "link_com", "gravity_compensation", "base_tilt"}
"""Kinds that stand in for a payload of some runs."""

Ways = tuple[tuple[int, ...], ...]


def by_runs(selection: Selection, best: SetFit) -> SetFit:
    """The best set with a payload that differs between runs, where data ask for it; else itself."""
    # Each run gets columns of a payload of its own. Of the Gaussian posterior of their
    # coefficients, mass and first moments run by run, runs that agree are merged step by step, down
    # to one mass with a centre each way. The most probable way is a term like any other, and pays
    # for its choice.
    evidence = selection.evidence
    runs = tuple(dict.fromkeys(run.name for run in evidence.balance.motion.runs))
    known = any(isinstance(term.effect, Payload) for term in evidence.terms)
    if not known or not 1 < len(runs) <= _MOST_RUNS:
        return best
    before = list(evidence.terms)
    each = [term for run in runs for term in _terms(selection, ((run,),), runs)]
    evidence.terms[:] = before
    if len(each) < len(runs):  # one of them does not feel a payload
        return best
    trial, found, tried = selection.on(selection.used), best, set[Mountings]()
    for kinds in ({"payload"}, _INERTIA):
        rest = tuple(term for term in best.terms if term.effect.kind not in kinds)
        ways = tuple(tuple(runs[k] for k in way) for way in _ways(trial, rest, each))
        if ways in ((), (runs,)) or ways in tried:
            continue
        tried.add(ways)
        for term in _terms(trial, ways, runs):
            state = trial.settled(trial.solve((*rest, term)))
            if any(t.effect.mountings for t in state.terms) and state.total < best.total + KIND:
                state = pruned(trial, trial.search(state.terms))
                found = min(found, state, key=lambda f: f.total)
    mounted = [term for term in found.terms if term.effect.mountings]
    evidence.terms[:] = before
    if not mounted:
        return best
    halves = folds_of(selection, found.terms)[-1]
    costs = [_held_out(selection, fit, halves) for fit in (best, found)]
    if costs[0] - costs[1] < HELD_OUT:
        return best
    evidence.terms += mounted
    selection.fits.update(trial.fits)
    return found


def _terms(selection: Selection, ways: Mountings, runs: Sequence[str]) -> list[Term]:
    """Add the columns of a payload that runs have in some ways."""
    balance = selection.evidence.balance
    effect = MountedPayload(balance.machine, "tool", ways, runs)
    found = terms_of(balance, effect, effect.axes, False)
    append(selection.evidence, *found)
    return found


def _ways(selection: Selection, rest: tuple[Term, ...], each: Sequence[Term]) -> Ways:
    """Runs of each way in which the payload is most probably mounted, beside some effects."""
    evidence = selection.evidence
    fit = selection.fit((*rest, *each))
    columns = [k for term in each for k in evidence.columns_of(term)]
    at = fit.places(columns)
    prior = evidence.precision[columns]
    # what the data say of the coefficients, without their prior
    precision = np.linalg.inv(np.linalg.inv(fit.normal)[np.ix_(at, at)])
    slope = precision @ fit.values[at]
    precision = precision - np.diag(prior)
    first = [_by_moments(term) for term in each]
    edges = np.cumsum([0, *(len(own) for own in first)])
    width = float(np.mean(prior))

    def cost(ways: Ways) -> float:
        design = np.zeros((len(prior), 1 + 3 * len(ways)))
        for number, way in enumerate(ways):
            for run in way:
                rows = slice(edges[run], edges[run + 1])
                design[rows, 0] = first[run][:, 0]
                design[rows, 1 + 3 * number : 4 + 3 * number] = first[run][:, 1:]
        normal = design.T @ precision @ design + width * np.eye(design.shape[1])
        along = design.T @ slope
        gain = float(along @ np.linalg.solve(normal, along))
        gain -= log_determinant(normal) - len(normal) * log(width)
        return 2 * len(each) * log(len(ways) + 1) - gain

    ways: Ways = tuple((k,) for k in range(len(each)))
    visited = [ways]
    while ways:
        ways = min(_fewer(ways), key=cost)
        visited.append(ways)
    return min(visited, key=cost)


def _fewer(ways: Ways) -> Iterator[Ways]:
    """Ways with one way less: its runs go to another one, or have no payload."""
    for k, way in enumerate(ways):
        others = (*ways[:k], *ways[k + 1 :])
        yield others
        for other in ways[:k]:
            yield tuple(sorted((*w, *way)) if w is other else w for w in others)  # type: ignore[misc]


def _by_moments(term: Term) -> Array:
    """Coefficients of a run's payload for a mass at the tool and for each first moment (K, 4)."""
    axes = np.array(term.effect.axes)
    kept = [k for k, axis in enumerate(axes) if tuple(axis) in term.axes]
    shares = np.eye(4)
    shares[0, 1:] = -1.0  # a moment is a mass beside the tool less one at it
    return np.asarray(shares[kept])
