"""Payloads that some runs lack, or that are turned between runs.

Each run gets columns of a payload of its own. Of the Gaussian posterior of their coefficients, mass
and first moments run by run, runs that agree are merged step by step, down to one mass with a
centre each way. The most probable way is a term like any other, and pays for its choice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import log

import numpy as np

from loose_env.gap.core.catalogue import Term, terms_of
from loose_env.gap.core.decision import HELD_OUT, held_out_gain, pruned
from loose_env.gap.core.evidence import append
from loose_env.gap.core.selection import KIND, Selection, SetFit
from loose_env.gap.model.effect import Mountings
from loose_env.gap.model.effects.inertia import MountedPayload, Payload
from loose_env.inference import log_determinant
from loose_env.typing import Array

_MOST_RUNS = 16
"""Runs among which payloads are told apart, at most: cost."""
_INERTIA = {"payload", "link_mass", "link_com", "gravity_compensation", "base_tilt"}
"""Kinds that stand in for a payload of some runs."""

Ways = tuple[tuple[int, ...], ...]


def by_runs(selection: Selection, best: SetFit) -> SetFit:
    """The best set with a payload that differs between runs, where data ask for it; else itself."""
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
            state = trial.thinned(trial.settled(trial.solve((*rest, term))))
            if any(t.effect.mountings for t in state.terms) and state.total < best.total + KIND:
                state = pruned(trial, trial.search(state.terms))
                found = min(found, state, key=lambda f: f.total)
    mounted = [term for term in found.terms if term.effect.mountings]
    if not mounted or held_out_gain(selection, best, found) < HELD_OUT:
        mounted, found = [], best
    evidence.terms[:] = [*before, *mounted]
    if not mounted:
        return best
    selection.fits.update(trial.fits)
    return found


def _terms(selection: Selection, ways: Mountings, runs: Sequence[str]) -> list[Term]:
    """Add the columns of a payload that runs have in some ways."""
    balance = selection.evidence.balance
    effect = MountedPayload(balance.machine, "tool", ways, runs)
    found = terms_of(balance, effect, effect.axes, False)
    for term in found:
        append(selection.evidence, term)
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
