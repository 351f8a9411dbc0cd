"""What a recording could show: excitation of joints, and the smallest visible size of effects.

Both are queries on the Gram matrices of the evidence, before any effect is selected. An effect is
visible at the size at which its rise of the log likelihood pays for its prior probability, with
all tolerances fitted beside it, and beside any other effect near it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loose_env.gap.core.balance import USUAL
from loose_env.gap.core.catalogue import Term, neighbours
from loose_env.gap.core.selection import Form, Selection
from loose_env.gap.output.result import (
    EffectLocation,
    Identifiability,
    JointExcitation,
    VisibleEffect,
)
from loose_env.typing import Array


def identifiability(selection: Selection) -> Identifiability:
    """Ask what the recording of some evidence could show of every joint and every effect."""
    return Identifiability(joints=_joints(selection), effects=_effects(selection))


def unexplained(
    square: Array, cross: Array, normal: Array, prior: Array, centre: Array | None = None
) -> Array:
    """Squared distance of forces from what some columns can do, and what that costs (I,)."""
    # By the squares of the forces in noise standard deviations (I,), products of the columns with
    # them (K, I) and with each other (K, K), and the precision of the coefficients about a centre.
    # What it rises by with a motion is the expected gain of that motion: twice the log evidence by
    # which the machine with these forces is told from one with these columns.
    pulled = np.zeros(len(prior)) if centre is None else prior @ centre
    slope = cross + pulled[:, None]
    cost = 0.0 if centre is None else float(centre @ pulled)
    gained = np.sum(slope * np.linalg.solve(normal + prior, slope), axis=0)
    return np.asarray(square + cost - gained)


def _joints(selection: Selection) -> tuple[JointExcitation, ...]:
    """How much each joint moves."""
    balance = selection.evidence.balance
    used = {channel.joint: 1 - channel.blanked for channel in selection.evidence.channels}
    return tuple(
        JointExcitation(
            joint=joint,
            unit="rad" if balance.machine.turns(joint) else "m",
            travel=float(np.ptp(balance.position[:, k])),
            speed=float(balance.usual[k]),
            acceleration=float(np.percentile(np.abs(balance.acceleration[:, k]), 95)),
            used=float(used.get(k, 0.0)),
        )
        for k, joint in enumerate(balance.machine.joints)
    )


@dataclass(frozen=True, eq=False)
class _Shown:
    """One shape of an effect with the precision of its coefficients beyond the tolerances."""

    term: Term
    at: list[int]
    precision: Array
    prior: Array  # Prior precisions of the coefficients
    needed: float  # Number of standard deviations at which it pays for its prior

    @cached_property
    def inverse(self) -> Array:
        """Covariance of the coefficients."""
        return np.asarray(np.linalg.inv(self.precision + np.diag(self.prior)))

    def smallest(self, precision: Array) -> Array:
        """Smallest visible coefficients (..., K) at some precisions (..., K, K)."""
        own = np.diagonal(precision, axis1=-2, axis2=-1)
        inverse = np.linalg.pinv(precision, hermitian=True)
        spread = np.sqrt(np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1), 0.0))
        seen = own > 1e-9 * np.maximum(own.sum(axis=-1, keepdims=True), 1e-300)
        return np.where(seen, self.needed * spread, np.inf)

    def shares(self, precisions: Array) -> Array:
        """Smallest visible coefficient over the usual one, of the axis that shows best (...,)."""
        return np.asarray(np.min(self.smallest(precisions) / self.usual, axis=-1))

    @property
    def usual(self) -> Array:
        """Usual sizes of the coefficients: prior standard deviations, or one of a law."""
        return np.array([1.0 if self.term.law else column.spread for column in self.term.columns])


def _effects(selection: Selection) -> tuple[VisibleEffect, ...]:
    """Every effect that the catalogue has for this recording."""
    evidence, kept = selection.evidence, selection.evidence.tolerances
    every = np.arange(len(evidence.precision))
    data = Form(selection, selection.rich).between(every, every)
    data -= np.diag(evidence.precision)  # without the priors of the effects
    inverse = np.linalg.inv(data[:kept, :kept] + np.eye(kept))
    beyond = data - data[:, :kept] @ inverse @ data[:kept]
    groups: dict[tuple[str, str], list[_Shown]] = {}
    for term in evidence.terms:
        if term.contact in ("", USUAL) and not term.effect.mountings:
            at = list(evidence.columns_of(term))
            precision = beyond[np.ix_(at, at)]
            prior = evidence.precision[at]
            gain = np.log1p(np.max(np.diag(precision) / prior))
            needed = float(np.sqrt(selection.prior((term,)) + max(gain, 0.0)))
            groups.setdefault(term.name, []).append(_Shown(term, at, precision, prior, needed))
    chosen = {name: _best(shapes) for name, shapes in groups.items()}
    found = []
    for name, shapes in groups.items():
        shown = chosen[name]
        visible = bool(shown.shares(shown.precision) <= 1)
        near = neighbours(evidence.balance.machine, name[1])
        rivals = [o for n, o in chosen.items() if n != name and n[1] in near]
        rival = _rival(shapes, rivals, beyond) if visible else None
        found.append(
            VisibleEffect(
                kind=name[0], where=name[1], smallest=_sizes(shown),
                units={p.name: p.unit for p in shown.term.effect.parameters},
                below="high" in dict(shown.term.effect.limit).values(),
                visible=visible, confusable_with=rival,
            )
        )  # fmt: skip
    return tuple(found)


def _best(shapes: Sequence[_Shown]) -> _Shown:
    """Smallest visible shape of a law, or the shape that shows best."""
    shares = [float(s.shares(s.precision)) for s in shapes]
    seen = [k for k, share in enumerate(shares) if share <= 1]
    if shapes[0].term.law and seen:
        return shapes[max(seen, key=lambda k: shares[k])]
    return shapes[int(np.argmin(shares))]


def _rival(
    shapes: Sequence[_Shown], rivals: Sequence[_Shown], beyond: Array
) -> EffectLocation | None:
    """Effect beside which no shape is visible any more; that which hides most."""
    if not rivals:
        return None
    hidden = []
    for shape in shapes:
        cross = (beyond[np.ix_(shape.at, other.at)] for other in rivals)
        taken = [c @ other.inverse @ c.T for c, other in zip(cross, rivals, strict=True)]
        hidden.append(shape.shares(shape.precision - np.stack(taken)))
    shares = np.min(hidden, axis=0)
    worst = int(np.argmax(shares))
    if not shares[worst] > 1:
        return None
    kind, where = rivals[worst].term.name
    return EffectLocation(kind=kind, where=where)


def _sizes(shown: _Shown) -> dict[str, float]:
    """Smallest visible change of each parameter, the others as without the effect."""
    effect, term = shown.term.effect, shown.term
    names = [p.name for p in effect.parameters]
    if term.law:
        null = np.array(effect.null_values or 0.0)
        return dict(zip(names, np.abs(np.array(term.axes[0]) - null).tolist(), strict=True))
    nothing = term.values(np.zeros(len(term.axes)))
    found: dict[str, float] = {}
    for k, size in enumerate(shown.smallest(shown.precision)):
        if not np.isfinite(size):
            continue
        values = term.values(size * np.eye(len(term.axes))[k])
        changed = [j for j, v in enumerate(values) if v != nothing[j]]
        if effect.proportional is not None:
            changed = [effect.proportional]
        if changed:
            first = changed[0]
            found.setdefault(names[first], float(abs(values[first] - nothing[first])))
    return found
