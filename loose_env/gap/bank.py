"""Evidence of an arm's motions before they are made: columns of all effects along each of them.

The nominal model plays each motion once. Along it the core makes the columns of two force balances,
of the commands and of the measured torques, and whitens them as those of a recording. Readings of a
machine along the same motion give the residual that these columns explain.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import log
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.core.balance import USUAL, Balance, Forces, scaled
from loose_env.gap.core.catalogue import Axes, Term, shapes, terms_of
from loose_env.gap.core.evidence import Grid, grid_of
from loose_env.gap.core.find import Say, silent
from loose_env.gap.core.identifiability import unexplained
from loose_env.gap.core.motion import Motion as Measured
from loose_env.gap.core.motion import RunMotion, low_passed, rates
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.motions import Motion, check_motion, motion_library
from loose_env.gap.servo_arm import RATE, ServoArm
from loose_env.recording import CommandTiming
from loose_env.typing import Array, IndexArray

EXCLUDED = (
    "structural_looseness", "backlash", "sensor_quantisation", "torque_constant", "torque_limit",
    "voltage_limit", "speed_limit", "gear_eccentricity",
)  # fmt: skip
"""Kinds that are no candidates of encoders and torque sensors on the drives' side: looseness needs
an accelerometer beyond the joint; play under a load that keeps its side shows the stiffness of its
stops alone; quantisation changes nothing but the noise; the torque constant acts where torque is
compared with motion; limits do nothing until they are reached; an
eccentric gear shifts a reading and the servo that follows it alike."""
_AXES = ("base_compliance", "link_flexibility")
"""Kinds whose variants are directions in the arm; those of others are richer laws of one effect,
of which the plain one is a candidate."""
_TIMES, _LEAST_S = ("actuator_lag", "command_delay", "sensor_delay"), 3e-4
"""Kinds that are a time, and the least of it [s]: less says on which side of a step a sample is."""
_STIFFEST = {"joint_compliance": 1 / 6}
"""Largest stiffness over that of the stiffest start: a stiffer one rings faster than the steps."""
_RATIO = 1.5
"""Ratio of neighbouring stiffnesses of a spring, within two standard deviations of a law."""
_CONTACTS = ("sliding 0.2%", "sliding 1%", "sliding 4%", "presliding 0.2%")
"""Ways in which dry friction turns at a reversal."""
_BAND_HZ = 20.0
"""End of the band in which a motion and its forces are compared [Hz]: that of the fastest chirp."""
_TAPER = 0.05  # taper of a stretch: these motions begin and end at rest
_STEP = 1e-3  # relative step of derivatives by nominal parameters
_SPREAD = 0.6
"""Prior standard deviation of nominal parameters, as a share of their tolerance (of a uniform
distribution: 0.58)."""
VISIBLE = (12.0, 160.0)
"""Visibility that a candidate must reach, and the largest that is considered [noise sd]."""
_INDISTINGUISHABLE_Z = 2.0
"""Length of a signature beside that of another candidate below which both are one [noise sd]."""
_FORMAT = "gap evidence 8"  # version of what is stored; a change of the computation changes it
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "loose_env" / "gap"
"""Folder of stored evidence."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a candidate, with its columns in the bank."""

    term: Term  # Effect, axes and columns along the battery
    at: tuple[int, ...]  # Its columns in the bank

    @property
    def name(self) -> str:
        """Kind and location, as a verdict names them."""
        return "{}@{}".format(*self.term.name)

    @cached_property
    def centre(self) -> Array:
        """Prior means of its coefficients."""
        return np.array([column.centre for column in self.term.columns])

    def values(self, coefficients: Array) -> Array:
        """Parameter values for its coefficients; a spring that acts more is softer."""
        found, effect = self.term.values(coefficients), self.term.effect
        if self.term.law and dict(effect.limit).get(effect.parameters[0].name) == "high":
            size = float(self.term.axes[0][0] / max(coefficients[0], 1e-3))
            found[0] = effect.parameters[0].clipped(size)
        return found


@dataclass(frozen=True, eq=False)
class MotionEvidence:
    """Whitened columns along one motion: nominal parameters first, then all shapes."""

    rows: NDArray[np.float32]  # Columns in noise standard deviations (R, V)
    nominal: Array  # Residuals of the nominal model by commands and by torques (2, T, J) [N·m, N]
    grids: tuple[Grid, ...]  # How each joint is whitened, of one balance and then of the other
    seconds: float  # Machine time [s]
    wear: float  # Integral of the squared torque shares [s]

    @cached_property
    def _basis(self) -> NDArray[np.float32]:
        """Orthonormal directions of the columns (R, K)."""
        return np.linalg.qr(self.rows / (np.linalg.norm(self.rows, axis=0) + 1e-6))[0]

    def rest(self, residual: Array) -> float:
        """Root mean square of a residual that no column spans [noise sd]."""
        inside = self._basis.T @ residual
        left = max(float(residual @ residual - inside @ inside), 0.0)
        return float(np.sqrt(left / max(len(residual) - len(inside), 1)))

    @cached_property
    def gram(self) -> Array:
        """Products of the columns (V, V)."""
        rows = self.rows.astype(float)
        return np.asarray(rows.T @ rows)

    def whitened(self, series: Array) -> Array:
        """Series of both balances (2, T, J, ...) as rows (R, ...)."""
        each = (own[:, j].reshape(len(own), -1) for own in series for j in range(series.shape[2]))
        whole = [grid.whitened(own) for grid, own in zip(self.grids, each, strict=True)]
        return np.concatenate(whole).reshape(-1, *series.shape[3:])

    def residual(self, measured: Along) -> Array:
        """Residual of a measured motion in the rows of the columns (R,)."""
        return self.whitened(measured.residual - self.nominal)


@dataclass(frozen=True, eq=False)
class MotionBank:
    """Candidates of an arm, a library of motions, and the evidence of each."""

    arm: ServoArm
    library: tuple[Motion, ...]
    shapes: tuple[Shape, ...]
    evidence: tuple[MotionEvidence, ...]  # By motion
    reference: tuple[int, ...]  # Motions on which effects are sized

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Candidates, kind and location."""
        return tuple(dict.fromkeys(shape.name for shape in self.shapes))

    @cached_property
    def candidate(self) -> IndexArray:
        """Index of the candidate of each shape (H,)."""
        return np.array([self.names.index(shape.name) for shape in self.shapes], dtype=np.intp)

    @property
    def nuisances(self) -> int:
        """Number of nominal parameters: the first columns."""
        return len(self.arm.uncertain)

    @cached_property
    def priors(self) -> Array:
        """Precision, centre, low and high of each coefficient, and of none (4, V + 1)."""
        columns = [column for shape in self.shapes for column in shape.term.columns]
        known = [(c.spread**-2, c.centre, c.low, c.high) for c in columns]
        none = (1.0, 0.0, -np.inf, np.inf)
        return np.array([none] * self.nuisances + known + [none]).T

    @cached_property
    def padded(self) -> IndexArray:
        """Columns of every shape, those of narrower ones filled up by none (H, Q)."""
        width = max(len(shape.at) for shape in self.shapes)
        none = self.priors.shape[1] - 1
        return np.array([[*s.at, *[none] * (width - len(s.at))] for s in self.shapes])

    @cached_property
    def beyond(self) -> Array:
        """Products on the motions of reference that no nominal parameter explains (V, V)."""
        return beyond(np.sum([self.evidence[k].gram for k in self.reference], 0), self.nuisances)

    def visibility(self, shape: Shape, coefficients: Array) -> float:
        """Length of the signature on the motions of reference [noise standard deviations]."""
        own = self.beyond[np.ix_(shape.at, shape.at)]
        return float(np.sqrt(max(float(coefficients @ own @ coefficients), 0.0)))

    @property
    def seconds(self) -> Array:
        """Machine time of each motion [s] (M,)."""
        return np.array([found.seconds for found in self.evidence])

    @property
    def wear(self) -> Array:
        """Integral of the squared torque shares of each motion [s] (M,)."""
        return np.array([found.wear for found in self.evidence])

    def strength(self, shape: Shape, axis: int = 0) -> float:
        """Length of a column on the motions of reference [noise standard deviations]."""
        k = shape.at[axis]
        return float(np.sqrt(sum(self.evidence[m].gram[k, k] for m in self.reference)))

    def unit(self, shape: Shape, axis: int) -> float:
        """Coefficient of one column at which it has a visibility of one."""
        return float(max(self.beyond[shape.at[axis], shape.at[axis]], 1e-300) ** -0.5)


def beyond(gram: Array, free: int) -> Array:
    """Products of columns that the first ones, with unit priors, do not explain (V, V)."""
    inside = np.linalg.solve(gram[:free, :free] + np.eye(free), gram[:free])
    return np.asarray(gram - gram[:, :free] @ inside)


def motion_bank(
    arm: ServoArm,
    library: Sequence[Motion],
    kinds: Sequence[str] = (),
    *,
    reference: Sequence[Motion] | None = None,
    cache: Path | None = _CACHE,
    say: Say = lambda _: None,
) -> MotionBank:
    """Make the evidence of all candidates along a library of motions.

    Parameters
    ----------
    arm : ServoArm
        The arm.
    library : sequence of Motion
        The motions.
    kinds : sequence of str
        Kinds of effect; none for the catalogue without `EXCLUDED`.
    reference : sequence of Motion, optional
        Motions of the library on which effects are sized; the fixed battery by default.
    cache : Path, optional
        Folder of joblib's cache; None to store nothing. Each motion is an entry of its own: a
        computation that was cut short goes on, and a library may grow.
    say : callable
        Receives progress messages, line by line.

    Raises
    ------
    UnknownName
        If the catalogue has no such kind.
    InvalidData
        If no effect can be seen on the motions of reference.
    """
    import joblib  # its start takes a quarter of a second

    on = motion_library(arm, "battery") if reference is None else reference
    at = tuple(k for k, motion in enumerate(library) if motion in on) or (0,)
    memory = joblib.Memory(cache, verbose=0)
    along = memory.cache(_evidence, ignore=["arm", "shaped", "say", "words"])
    with silent():
        shaped = _shapes_of(arm, [library[k] for k in at], kinds)
        stated = [(shape.name, shape.term.axes, shape.term.contact) for shape in shaped]
        key = joblib.hash((_FORMAT, arm.key, stated)) or ""
        evidence, begin = [], time.monotonic()
        for k, motion in enumerate(library):
            spent = time.monotonic() - begin
            left = f", about {spent / k * (len(library) - k):.0f} s left" if k else ""
            words = f"motion {k + 1} of {len(library)}{left}"
            evidence.append(along(key, motion, arm, shaped, say, words))
    bank = MotionBank(arm, tuple(library), tuple(shaped), tuple(evidence), at)
    bank = _only(bank, _seen(bank))
    if not bank.shapes:
        raise InvalidData("no candidate effect can be seen on the battery of this arm")
    twins = _indistinguishable(bank)
    return _only(bank, {k for k, c in enumerate(bank.candidate) if bank.names[c] not in twins})


def _played(
    arm: ServoArm, controls: Array, readings: Array, form: str, early: float = 0.0
) -> Measured:
    """Motion of one run by its readings, in the band of all motions, for one balance."""
    step, joints, own = 1.0 / RATE, len(arm.joints), arm.driven
    thin = max(1, int(RATE / (6 * _BAND_HZ)))
    whole = np.tile(arm.rest[0], (len(readings), 1))
    whole[:, own] = low_passed(readings[:, :joints], _BAND_HZ, step)
    torques = np.full_like(whole, np.nan)
    torques[:, own] = low_passed(readings[:, joints:], _BAND_HZ, step)
    position, speed, acceleration = (
        np.ascontiguousarray(x[::thin]) for x in (whole, rates(whole, step), rates(whole, step, 2))
    )
    lines = [CommandTiming(mode="linear", shift_s=-early)] * controls.shape[1]
    given = low_passed(controls, _BAND_HZ, step, lines)[::thin]
    run = RunMotion(
        name="motion", form=form, step=step * thin, position=position, speed=speed,
        acceleration=acceleration, derived=speed, readings=np.zeros((len(position), 0)),
        commands=given, sampled=given, straight=given, torques=torques[::thin],
        limited=np.zeros_like(position), log_step=step, begin=0.0,
    )  # fmt: skip
    noise = np.full((3, whole.shape[1]), np.inf)
    noise[0] = arm.noise[0]
    noise[0, own] = arm.noise[:joints]
    if form == "inverse":
        noise[2, own] = arm.noise[joints:]
    return Measured(
        runs=(run,), band=_BAND_HZ, noise=noise / np.sqrt(thin), sensors=(),
        sensor_noise=np.zeros(0),
    )  # fmt: skip


def _shapes_of(arm: ServoArm, motions: Sequence[Motion], kinds: Sequence[str]) -> list[Shape]:
    """Shapes of all candidates, with the priors that they have along some motions."""
    each = [
        _played(arm, arm.controls(commands), arm.simulate(Hypothesis(), commands), "forward")
        for commands in (motion.commands(arm.limits) for motion in motions)
    ]
    measured = replace(each[0], runs=tuple(run for own in each for run in own.runs))
    balance = Balance(scaled(Balance(arm.machine, measured)), measured)
    balance.residual[:] = 0.0
    found: list[Shape] = []
    at = len(arm.uncertain)
    driven = {"all", *(arm.model.actuator(int(k)).name for k in arm.servos[1])}
    wanted = kinds or [kind for kind in CATALOGUE if kind not in EXCLUDED]
    for effect in candidates(balance.machine, wanted):
        first = type(effect).variants_at(balance.machine, effect.where)[0]
        plain = effect.variant == first or effect.kind in _AXES
        if plain and (effect.part != "actuator" or effect.where in driven):
            for axes, law in _axes_of(balance, effect):
                for term in terms_of(balance, effect, axes, law, _CONTACTS):
                    found.append(Shape(term, tuple(range(at, at + len(term.columns)))))
                    at = found[-1].at[-1] + 1
    return found


def _axes_of(balance: Balance, effect: Effect) -> Iterator[tuple[Axes, bool]]:
    """Axes of every shape, springs in a ladder of stiffnesses."""
    if not effect.adds_motion:
        least = _LEAST_S if effect.kind in _TIMES else 0.0
        yield from ((a, law) for a, law in shapes(balance, effect) if a[0][0] >= least or not law)
        return
    softest, stiffest = effect.starts[0], effect.starts[-1]
    high = stiffest[0] * _STIFFEST.get(effect.kind, 1.0)
    steps = max(2, round(log(high / softest[0]) / log(_RATIO)))
    for stiffness in np.geomspace(softest[0], high, steps + 1):
        yield ((float(stiffness), *softest[1:]),), True


class Along:
    """Both force balances along a motion whose readings (n, 2 J) are positions and torques."""

    def __init__(self, arm: ServoArm, motion: Motion, readings: Array) -> None:
        self.arm, controls = arm, arm.controls(motion.commands(arm.limits))
        # a torque is read at the beginning of a step, whose command is that of its middle
        half = 0.5 * arm.machine.time_step
        *self.balances, self._read = (
            Balance(arm.machine, _played(arm, controls, readings, form, early))
            for form, early in (("forward", 0.0), ("inverse", 0.0), ("forward", half))
        )

    @property
    def residual(self) -> Array:
        """Missing forces by commands and by torques (2, T, J)."""
        return np.stack([own.residual[:, self.arm.driven] for own in self.balances])

    def tolerances(self, sizes: Array) -> Array:
        """Change by nominal parameters that are off by some standard deviations (2, T, J)."""
        spec = self.arm.off(1 + _STEP * _SPREAD * self.arm.tolerance * sizes)
        acting, needed, read = (
            balance.edited(spec).smooth[:, self.arm.driven] / _STEP
            for balance in (*self.balances, self._read)
        )
        return np.stack([acting, needed + acting - read])

    def columns(self, terms: Iterable[Term]) -> Iterator[Array]:
        """Change by every column of some terms (2, T, J)."""

        @cache
        def forces(effect: Effect, values: tuple[float, ...]) -> list[Forces]:
            found = [own.forces(effect, np.array(values)) for own in self.balances]
            if effect.drives:  # measured torques are those of the drives, whatever these lack
                found[1] = found[0].less(self._read.forces(effect, np.array(values)))
            return found

        for term in terms:
            ways = [own.directions[term.contact or USUAL] for own in self.balances]
            for values in term.axes:
                pairs = zip(forces(term.effect, values), ways, strict=True)
                whole = [each.with_contact(way)[:, self.arm.driven] for each, way in pairs]
                yield np.nan_to_num(whole)


def _evidence(
    key: str, motion: Motion, arm: ServoArm, shaped: Sequence[Shape], say: Say, words: str
) -> MotionEvidence:
    """Play a motion with the nominal model, and whiten the columns of all shapes along it."""
    say(f"columns of {len(shaped)} shapes along {words}: {motion.description}")
    planned, _ = check_motion(motion, arm)
    along = Along(arm, motion, arm.simulate(Hypothesis(), motion.commands(arm.limits)))
    nominal = along.residual
    for balance in along.balances:
        balance.residual[:] = 0.0  # what the nominal model leaves is no knock
    pairs = ((balance, int(j)) for balance in along.balances for j in arm.driven)
    grids = tuple(grid_of(*each, taper=_TAPER) for each in pairs)
    wear = float(np.sum((planned.torque / arm.torque_limits) ** 2)) / RATE
    seconds, nothing = len(planned.desired) / RATE, np.empty((0, 0), np.float32)
    found = MotionEvidence(nothing, nominal, grids, seconds, wear)
    own, terms = np.eye(len(arm.uncertain)), (shape.term for shape in shaped)
    series = np.stack([*map(along.tolerances, own), *along.columns(terms)], axis=-1)
    return replace(found, rows=found.whitened(series).astype(np.float32))


def _seen(bank: MotionBank) -> set[int]:
    """Shapes that show on the motions of reference, of candidates that are clearly visible."""
    found = {}
    for k, shape in enumerate(bank.shapes):
        ends = np.minimum(np.abs([(c.low, c.high) for c in shape.term.columns]), 1e9).max(axis=1)
        sizes = [shape.centre] if shape.term.law else np.diag(ends)
        seen = max(bank.visibility(shape, own) for own in sizes)
        if seen > VISIBLE[0] / 4 and not (shape.term.law and seen >= 4 * VISIBLE[1]):
            found[k] = seen
    clear = {bank.shapes[k].name for k, seen in found.items() if seen > VISIBLE[0]}
    return {k for k in found if bank.shapes[k].name in clear}


def _only(bank: MotionBank, kept: set[int]) -> MotionBank:
    """The bank with some of its shapes."""
    columns, found = list(range(bank.nuisances)), []
    for shape in (bank.shapes[k] for k in sorted(kept)):
        first = len(columns)
        columns += shape.at
        found.append(Shape(shape.term, tuple(range(first, len(columns)))))
    evidence = [replace(e, rows=e.rows[:, columns]) for e in bank.evidence]
    return replace(bank, shapes=tuple(found), evidence=tuple(evidence))


def _indistinguishable(bank: MotionBank) -> set[str]:
    """Candidates that no motion of the bank tells from an earlier one."""
    # As the mass of a link that only turns about the vertical and the inertia of its rotor.
    gram = beyond(np.sum([e.gram for e in bank.evidence], axis=0), bank.nuisances)
    own, most = np.diag(gram), VISIBLE[1] ** 2 / np.maximum(np.diag(bank.beyond), 1e-12)
    left = np.empty((len(bank.shapes), len(bank.shapes)))
    for row, at in zip(left, (list(shape.at) for shape in bank.shapes), strict=True):
        free = np.diag(1e-9 * own[at] + 1e-300)
        rest = unexplained(own, gram[at], gram[np.ix_(at, at)], free)
        # squared length of the largest signature of every other shape beside this one
        sized = rest * np.minimum(most, 1e12)
        row[:] = [max((rest if s.term.law else sized)[list(s.at)]) for s in bank.shapes]
    alike, found = left < _INDISTINGUISHABLE_Z**2, set[str]()
    for number, name in enumerate(bank.names):
        one = bank.candidate == number
        for earlier in range(number):
            others = alike[bank.candidate == earlier][:, one]
            if bank.names[earlier] not in found and np.all(np.any(others, axis=0)):
                found.add(name)
    return found
