"""Candidate effects with their columns in the force balance.

A column is the change of the balance by an effect, per unit of a share of one of its axes. Effects
that are linear in their parameters have a column for each; others are laws of a given shape, whose
column has the coefficient one where the shape is right, or the size of its proportional parameter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.core.balance import CONTACTS, USUAL, Balance, Change, Forces
from loose_env.gap.model.effect import Effect, WeightedEffect
from loose_env.gap.model.effects.catalogue import EFFECTS, candidates
from loose_env.gap.model.effects.drives import CommandInterpolation, DriveLimit
from loose_env.gap.model.effects.sensors import SensorBias
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_MOVING = 2.0
"""Speed over its noise from which a joint moves: three quarters of its power are motion."""
_BINS = 50  # frequencies at which that noise is averaged
LAW_WIDTH = 0.15
"""Prior standard deviation of a law's coefficient about one: a shape midway between two that are
tried, ln(1.7) / 2 away, is two of them off."""
USUAL_SHARE = 0.3
"""Prior standard deviation of an effect's force over the drive's: it matters, and does not rule."""
_LADDER = 1.7  # ratio of neighbouring sizes of a law: about two widths of its coefficient
_LOOKED_AT = 1000  # samples in which an effect looks for its starts
_REACHED = 0.7  # lowest limit of a drive over the force that the motion took by the nominal model
_ALIKE = 1e-3
"""Part of a column that the columns before it lack, over the whole, for it to be told from them."""
_LINEAR = 0.05
"""Largest relative deviation of a column over a range of sizes, for an effect to be linear."""


Late = tuple[int, float] | None
"""Joint and delay, or none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """One column of the balance with the prior of its coefficient."""

    change: Change  # Change of the balance by a coefficient of one (T, joints)
    operator: Array  # Change of the mean inertia, damping and stiffness (3, joints, joints)
    centre: float  # Prior mean of the coefficient
    spread: float  # Prior standard deviation
    low: float  # Smallest coefficient
    high: float  # Largest coefficient
    eased: Array | float = 0.0  # Share of the time in which a drive holds nothing (joints,)
    late: Late = None  # Joint whose positions are read late, and by how much [s]


Axes = tuple[tuple[float, ...], ...]
"""Parameter values whose changes are the columns of an effect."""
Claim = tuple[str, bool]
"""Kind, and whether it is said of all places at once."""


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate: an effect, the axes that its coefficients share out, and its columns."""

    effect: Effect  # The effect
    axes: Axes  # Parameter values whose changes are the columns
    contact: str  # Direction of sliding that its dry friction has; "" without dry friction
    law: bool  # Whether it is a law with a coefficient of about one
    columns: tuple[Column, ...]  # Columns, one for each axis
    unseen: Axes = ()  # Axes that the motion does not tell from these

    @property
    def name(self) -> tuple[str, str]:
        """Kind and location."""
        return self.effect.kind, self.effect.where

    @property
    def form(self) -> tuple[str, str]:
        """Kind that it is, or is a form of, and location: a place has one form of a kind."""
        return self.effect.extends or self.effect.kind, self.effect.where

    @property
    def claim(self) -> Claim:
        """Kind that it is, or is a form of, and whether one number says it of all places."""
        return self.form[0], self.effect.where == "all"

    def values(self, coefficients: Array) -> Array:
        """Parameter values for the coefficients of its columns."""
        effect, axes = self.effect, np.array(self.axes)
        if self.law and effect.null_values is not None and len(effect.parameters) == 1:
            # to first order: a delay that is a tenth too short has a coefficient of 1.1
            found = _null(effect) + coefficients[0] * (axes[0] - _null(effect))
        elif self.law:
            found = np.array(axes[0])
        elif effect.proportional is not None and not effect.axes:
            found = np.array(axes[0])
            found[effect.proportional] *= coefficients[0]
        elif effect.axes:
            along = np.stack([effect.shares_of(axis) for axis in axes])
            found = np.array(effect.combined(coefficients @ along))
        else:
            null = _null(effect)
            found = null + coefficients @ (axes - null)
        return np.array(
            [p.clipped(float(v)) for p, v in zip(effect.parameters, found, strict=True)]
        )

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """Which parameters (P,) only axes change that the motion does not tell from its own."""
        # A size is known as it would be at zero of its coordinates.
        effect = self.effect
        if not self.unseen:
            return np.zeros(len(effect.parameters), bool)
        still = np.array(effect.axes[0]) if isinstance(effect, WeightedEffect) else _null(effect)
        return np.asarray(np.any([np.array(axis) != still for axis in self.unseen], axis=0))


def catalogue(balance: Balance, kinds: Iterable[str] | None = None) -> list[Term]:
    """List all effects that the balance shows, at all locations, in all variants and shapes."""
    return shown(balance, candidates(balance.machine, EFFECTS if kinds is None else kinds))


def shown(balance: Balance, effects: Iterable[Effect]) -> list[Term]:
    """List those of some effects that the balance shows, in all shapes."""
    found = (e for e in effects if shows(balance, e))
    each = ((e, axes, law) for e in found for axes, law in shapes(balance, e))
    return [term for own in each for term in terms_of(balance, *own)]


def shows(balance: Balance, effect: Effect) -> bool:
    """Whether a force balance shows an effect: it changes forces, with motors off as well or not.

    Sensors show where their readings are compared; rounding is noise, which readings show by
    themselves; stops are the business of the exact fit.
    """
    if effect.is_read_off:
        return False
    if effect.part == "sensor":
        if isinstance(effect, SensorBias) and effect.where in balance.encoders:
            # where no drive uses the reading, it is the zero of the joint, another effect
            return not balance.released.all()
        return effect.where in balance.encoders or effect.where in dict(balance.readings.sensors)
    if isinstance(effect, CommandInterpolation):  # the commands may be known to be lines
        motion = balance.motion
        return not np.array_equal(motion.stacked("straight"), motion.stacked("commands"))
    senses = effect.overrides("sensed_torque")
    if effect.has_stops or not (effect.moves or senses):
        return False
    joint = effect.where if effect.part == "joint" else ""
    if isinstance(effect, DriveLimit):
        joint = effect.joint
    # at rest all forces are constant
    if joint and not moves_at(balance, balance.machine.joint_number(joint)):
        return False
    if effect.drives and balance.released.all():
        return senses and bool((balance.forms == "inverse").any())
    return True


def moves_at(balance: Balance, joint: int) -> bool:
    """Whether a joint moves clearly more than its noise in some run."""
    motion = balance.motion
    turn = 2 * np.pi * np.linspace(0.0, motion.band, _BINS)
    noise = turn**2 / motion.precision(turn)[:, joint]
    share = 2 * motion.band * motion.step  # of a sample's noise, in the band
    moved = max(float(np.var(run.speed[:, joint])) for run in motion.runs)
    return moved > _MOVING**2 * share * float(np.mean(noise))


def shapes(balance: Balance, effect: Effect) -> list[tuple[Axes, bool]]:
    """Axes of every shape in which an effect is tried, and whether it is a law."""
    if effect.axes:
        return [(effect.axes, False)]
    starts = _dense(effect, _starts(balance, effect))
    if effect.null_values is None or effect.proportional is not None or len(starts) == 0:
        size = effect.proportional
        alike = {tuple(v for k, v in enumerate(s) if k != size): s for s in reversed(starts)}
        return [((values,), size is None) for values in alike.values()]
    if _is_linear(balance, effect, starts):
        null, scales = _null(effect), [p.scale for p in effect.parameters]
        axes = null + np.diag(scales)
        return [(tuple(tuple(float(v) for v in row) for row in axes), False)]
    return [((values,), True) for values in starts]


def _starts(balance: Balance, effect: Effect) -> Sequence[tuple[float, ...]]:
    """Starts of an effect, those from the data where it proposes any."""
    if effect.adds_motion:
        return (*effect.starts, *balance.resonances(effect))
    if effect.part == "joint" and effect.overrides("propose"):
        joint = balance.machine.joint_number(effect.where)
        rows = np.flatnonzero(balance.seen[:, joint])
        rows = rows[:: max(1, len(rows) // _LOOKED_AT)]
        if not len(rows):  # a follower: its forces are those of other joints
            return () if effect.needs_data_starts else effect.starts
        motion = balance.position, balance.speed, balance.acceleration, balance.residual
        proposed = effect.propose(*(values[rows, joint] for values in motion))
        return proposed if effect.needs_data_starts else (*effect.starts, *proposed)
    if isinstance(effect, DriveLimit):
        signals = (x[:, effect.number] for x in (balance.speed, balance.given, balance.needed))
        return (*effect.starts, *effect.propose_limit(*signals))
    return effect.starts


def _dense(effect: Effect, starts: Sequence[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Insert sizes between the starts of an effect that differ in a positive first parameter."""
    alike = len({s[1:] for s in starts}) == 1 and all(s[0] > 0 for s in starts)
    if not starts or not alike or len(effect.parameters) != 1:
        return list(starts)
    sizes = sorted({s[0] for s in starts})
    if effect.is_time_shift:  # down to what a fraction of a sample does
        sizes = [sizes[0] / 6, sizes[0] / 2.5, *sizes]
    dense = [sizes[0]]
    for low, high in pairwise(sizes):
        steps = max(1, round(log(high / low) / log(_LADDER)))
        dense += [float(x) for x in np.geomspace(low, high, steps + 1)[1:]]
    return [(size, *starts[0][1:]) for size in dense]


def _is_linear(balance: Balance, effect: Effect, starts: list[tuple[float, ...]]) -> bool:
    """Whether the columns of small and large sizes agree."""
    if len(effect.parameters) > 1:
        return True
    null = float(_null(effect)[0])
    starts = [s for s in starts if s[0] != null]
    small, large = (pick(starts, key=lambda s: abs(s[0] - null)) for pick in (min, max))
    if effect.parameters[0].log or small == large:
        return not effect.parameters[0].log
    one, other = (
        np.hstack([f.smooth + f.dry, f.readings]) / (s[0] - null)
        for f, s in ((balance.forces(effect, np.array(s)), s) for s in (small, large))
    )
    size = float(np.sqrt(np.mean(one**2)))
    return size > 0 and float(np.sqrt(np.mean((one - other) ** 2))) < _LINEAR * size


def _null(effect: Effect) -> Array:
    return np.array(effect.null_values if effect.null_values is not None else (0.0,))


def neighbours(machine: NominalModel, where: str) -> set[str]:
    """Joint, link, drive and encoder of one place; "all", the tool and the base are beside any."""
    found = {where, "all", "tool", "base"}
    for joint in machine.joints:
        own = at_joint(machine, joint)
        if where in own:
            found |= own
    return found


def at_joint(machine: NominalModel, joint: str) -> set[str]:
    """Joint, its link, its drives and its encoders."""
    parts = (*machine.actuated_joint.items(), *machine.encoders.items())
    return {joint, machine.body_of(joint), *(name for name, own in parts if own == joint)}


def terms_of(
    balance: Balance,
    effect: Effect,
    axes: Axes,
    law: bool,
    contacts: Iterable[str] = tuple(CONTACTS),
) -> list[Term]:
    """Terms of an effect of one shape: one for each contact where it has dry friction."""
    if isinstance(effect, DriveLimit) and axes[0][0] < _reached(balance, effect):
        return []
    forces = [balance.forces(effect, np.array(values)) for values in axes]
    if not all(np.isfinite(f.smooth).all() for f in forces):
        return []
    dry = any(np.any(f.dry) for f in forces)
    found = []
    for contact in contacts if dry else ("",):
        direction = balance.directions[contact or USUAL]
        columns = tuple(
            _column(balance, effect, law, values, f, direction)
            for values, f in zip(axes, forces, strict=True)
        )
        kept = _independent(columns)
        own, unseen = (
            tuple(axis for k, axis in enumerate(axes) if (k in kept) is seen)
            for seen in (True, False)
        )
        if kept:
            columns = tuple(columns[k] for k in kept)
            found.append(Term(effect, own, contact, law, columns, unseen))
    return found


def _reached(balance: Balance, effect: DriveLimit) -> float:
    """Force of an actuator that the motion took: its limit cannot be far below."""
    usual = float(np.percentile(np.abs(balance.needed[:, effect.number]), 99))
    return _REACHED * usual / abs(effect.gear)


def _independent(columns: Sequence[Column]) -> list[int]:
    """Columns that the motion tells from those before; a planar arm does not feel every axis."""
    kept: list[int] = []
    basis: list[Array] = []
    for k, column in enumerate(columns):
        own = column.change.whole().ravel()
        size = float(np.linalg.norm(own))
        left = own - sum((b @ own) * b for b in basis) if basis else own
        rest = float(np.linalg.norm(left))
        if size > 0 and rest > _ALIKE * size:
            kept.append(k)
            basis.append(left / rest)
    return kept


def _column(
    balance: Balance,
    effect: Effect,
    law: bool,
    values: tuple[float, ...],
    forces: Forces,
    direction: Array,
) -> Column:
    """Column with the prior and the bounds of its coefficient."""
    change = forces.with_contact(direction)
    if law:
        width, joint = LAW_WIDTH, balance.encoders.get(effect.where)
        late = (joint, values[0]) if effect.is_time_shift and joint is not None else None
        return Column(
            change=balance.change(change), operator=forces.operator, centre=1.0, spread=width,
            low=1 - 2.3 * width, high=1 + 2.3 * width, eased=forces.eased, late=late,
        )  # fmt: skip
    readings = np.sqrt(np.mean(balance.readings.foretold**2, axis=0))
    typical = np.maximum(np.concatenate([balance.machine.load_scales, readings]), 1e-9)
    share = float(np.max(np.sqrt(np.mean(change**2, axis=0)) / typical))
    low, high = -np.inf, np.inf
    spread = USUAL_SHARE / max(share, 1e-12)
    if effect.proportional is not None and not effect.axes:
        low = 0.0
    elif (
        # sizes at several places add up to one: none of them has bounds of its own
        not (isinstance(effect, WeightedEffect) and len(effect.axes) > 1)
        and len(effect.parameters) == len(values)
        and effect.null_values is not None
    ):
        null = _null(effect)
        along = np.flatnonzero(np.array(values) != null)
        if len(along) == 1:
            parameter, step = effect.parameters[along[0]], values[along[0]] - null[along[0]]
            low, high = sorted(
                ((parameter.low - null[along[0]]) / step, (parameter.high - null[along[0]]) / step)
            )
            spread = min(spread, abs(parameter.unsurprising / step))
    return Column(
        change=balance.change(change), operator=forces.operator, centre=0.0, spread=spread, low=low,
        high=high, eased=forces.eased,
    )  # fmt: skip
