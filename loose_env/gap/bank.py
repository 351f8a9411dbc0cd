"""Evidence of an arm's motions before they are made: columns of all effects along each of them.

The nominal model plays each motion once. Along it, columns of the force balance are made as for a
recording (`loose_env.gap.core`), once for the commands and once for the measured torques, and
whitened by the noise of the sensors. Readings of a machine along the same motion give the residual
that these columns explain.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import log
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.core.balance import Balance, Forces, scaled
from loose_env.gap.core.catalogue import Term, shapes, terms_of
from loose_env.gap.core.evidence import weight_of
from loose_env.gap.core.find import Say, silent
from loose_env.gap.core.motion import Motion as Measured
from loose_env.gap.core.motion import RunMotion, low_passed, rates
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.motions import Motion, battery, check_motion
from loose_env.gap.servo_arm import RATE, ServoArm
from loose_env.typing import Array, IndexArray

EXCLUDED = (
    "structural_looseness",
    "backlash",
    "sensor_quantisation",
    "torque_constant",
    "torque_limit",
    "voltage_limit",
    "gear_eccentricity",
)
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
_STEP = 1e-3  # relative step of derivatives by nominal parameters
VISIBLE = (12.0, 160.0)
"""Visibility that a candidate must reach, and the largest that is considered [noise sd]."""
_INDISTINGUISHABLE_Z = 2.0
"""Length of a signature beside that of another candidate below which both are one [noise sd]."""
Form = Literal["commands", "torques", "sampled"]
"""What a balance compares the needed forces with: those of the nominal drives for the commands,
measured torques, or those of the nominal drives for commands as they act at the samples."""
_FORMAT = "gap evidence 2"  # version of what is stored; a change of the computation changes it
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "loose_env" / "gap"
"""Folder of stored evidence."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a candidate, with its columns in the bank."""

    term: Term
    """Effect, axes and columns along the battery."""
    at: tuple[int, ...]
    """Its columns in the bank."""

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
    window: Array  # Taper and weight of the samples by form (2, T, J)
    scale: Array  # One over the noise by form (2, F, J)
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
        """Series by form (2, ..., T, J) as rows (..., R)."""
        parts = []
        for own, taper, gain in zip(series, self.window, self.scale, strict=True):
            spectrum = np.fft.rfft(own * taper, axis=-2)[..., : len(gain), :] * gain
            parts += [spectrum.real, spectrum.imag]
        whole = np.concatenate(parts, axis=-2)
        return np.asarray(whole.reshape(*whole.shape[:-2], -1))

    def residual(self, measured: Along) -> Array:
        """Residual of a measured motion in the rows of the columns (R,)."""
        return self.whitened(measured.residuals() - self.nominal)


@dataclass(frozen=True, eq=False)
class MotionBank:
    """Candidates of an arm, a library of motions, and the evidence of each."""

    arm: ServoArm
    library: tuple[Motion, ...]
    shapes: tuple[Shape, ...]
    evidence: tuple[MotionEvidence, ...]
    """By motion."""
    reference: tuple[int, ...]
    """Motions on which effects are sized."""

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
        return len(self.arm.nominal.entries)

    @cached_property
    def _coefficients(self) -> Array:
        """Precision, centre, low and high of each coefficient, and of none (4, V + 1)."""
        columns = [column for shape in self.shapes for column in shape.term.columns]
        known = [(c.spread**-2, c.centre, c.low, c.high) for c in columns]
        none = (1.0, 0.0, -np.inf, np.inf)
        return np.array([none] * self.nuisances + known + [none]).T

    @property
    def precision(self) -> Array:
        """Prior precisions of all coefficients (V,)."""
        return np.asarray(self._coefficients[0, :-1])

    @property
    def centre(self) -> Array:
        """Prior means of all coefficients (V,)."""
        return np.asarray(self._coefficients[1, :-1])

    @cached_property
    def padded(self) -> IndexArray:
        """Columns of every shape, those of narrower ones filled up by none (H, Q)."""
        width = max(len(shape.at) for shape in self.shapes)
        none = self._coefficients.shape[1] - 1
        return np.array([[*s.at, *[none] * (width - len(s.at))] for s in self.shapes])

    @cached_property
    def priors(self) -> Array:
        """Precision, centre, low and high of the coefficients of every shape (4, H, Q)."""
        return np.asarray(self._coefficients[:, self.padded])

    @cached_property
    def beyond(self) -> Array:
        """Products on the motions of reference that no nominal parameter explains (V, V)."""
        grams = [self.evidence[k].gram for k in self.reference]
        return beyond(np.sum(grams, axis=0), self.nuisances)

    def visibility(self, shape: Shape, coefficients: Array) -> float:
        """Length of the signature on the motions of reference [noise standard deviations]."""
        own = self.beyond[np.ix_(shape.at, shape.at)]
        return float(np.sqrt(max(float(coefficients @ own @ coefficients), 0.0)))

    @cached_property
    def seconds(self) -> Array:
        """Machine time of each motion [s] (M,)."""
        return np.array([found.seconds for found in self.evidence])

    @cached_property
    def wear(self) -> Array:
        """Integral of the squared torque shares of each motion [s] (M,)."""
        return np.array([found.wear for found in self.evidence])

    def index_of(self, motion: Motion) -> int:
        """Index of a motion in the library; InvalidData if it is not in it."""
        if motion not in self.library:
            raise InvalidData(f"{motion.description} is not in the library of this bank")
        return self.library.index(motion)

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

    on = battery(arm) if reference is None else tuple(reference)
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
    bank = _only(bank, {k for k, shape in enumerate(shaped) if _seen(bank, shape)})
    if not bank.shapes:
        raise InvalidData("no candidate effect can be seen on the battery of this arm")
    twins = _indistinguishable(bank)
    return _only(bank, {k for k, c in enumerate(bank.candidate) if bank.names[c] not in twins})


def _played(arm: ServoArm, commands: Array, readings: Array) -> dict[Form, Measured]:
    """Motion of one run by its readings, in the band of all motions, as each balance sees it."""
    step, joints, own = 1.0 / RATE, len(arm.joints), arm.driven
    thin = max(1, int(RATE / (6 * _BAND_HZ)))
    filtered = np.zeros((len(readings), arm.machine.model.nv))
    filtered[:] = arm.rest_position
    filtered[:, own] = low_passed(readings[:, :joints], _BAND_HZ, step)
    torques = np.full_like(filtered, np.nan)
    torques[:, own] = low_passed(readings[:, joints:], _BAND_HZ, step)
    states = [filtered, rates(filtered, step), rates(filtered, step, 2)]
    position, speed, acceleration = (np.ascontiguousarray(x[::thin]) for x in states)
    held, every = arm.held(commands), arm.parts
    given = low_passed(held, _BAND_HZ, step / every)[:: thin * every]
    seen = low_passed(held[::every], _BAND_HZ, step)[::thin]
    run = RunMotion(
        name="motion", form="forward", step=step * thin, position=position, speed=speed,
        acceleration=acceleration, derived=speed, readings=np.zeros((len(position), 0)),
        commands=given, sampled=seen, straight=given, torques=torques[::thin],
        limited=np.zeros_like(position), log_step=step, begin=0.0,
    )  # fmt: skip
    noise = np.full((3, arm.machine.model.nv), np.inf)
    noise[0] = arm.noise[0] / np.sqrt(thin)
    noise[0, own] = arm.noise[:joints] / np.sqrt(thin)
    measured = Measured(
        runs=(run,), band=_BAND_HZ, noise=noise, sensors=(), sensor_noise=np.zeros(0)
    )
    read = noise.copy()
    read[2, own] = arm.noise[joints:] / np.sqrt(thin)
    return {
        "commands": measured,
        "torques": replace(measured, runs=(replace(run, form="inverse"),), noise=read),
        "sampled": replace(measured, runs=(replace(run, commands=seen),)),
    }


def _shapes_of(arm: ServoArm, motions: Sequence[Motion], kinds: Sequence[str]) -> list[Shape]:
    """Shapes of all candidates, with the priors that they have along some motions."""
    runs = [
        _played(arm, commands, arm.simulate(Hypothesis(), commands))["commands"]
        for commands in (motion.commands(arm) for motion in motions)
    ]
    measured = replace(runs[0], runs=tuple(run for each in runs for run in each.runs))
    balance = Balance(scaled(Balance(arm.machine, measured)), measured)
    balance.residual[:] = 0.0
    wanted = kinds or [kind for kind in CATALOGUE if kind not in EXCLUDED]
    found: list[Shape] = []
    at = len(arm.nominal.entries)
    driven = {arm.model.actuator(int(k)).name for k in arm.actuators}
    for effect in candidates(balance.machine, wanted):
        first = type(effect).variants_at(balance.machine, effect.where)[0]
        if effect.variant != first and effect.kind not in _AXES:
            continue
        if effect.part == "actuator" and effect.where not in ("all", *driven):
            continue
        for axes, law in _axes_of(balance, effect):
            for term in terms_of(balance, effect, axes, law, _CONTACTS):
                width = len(term.columns)
                found.append(Shape(term, tuple(range(at, at + width))))
                at += width
    return found


def _axes_of(
    balance: Balance, effect: Effect
) -> Iterator[tuple[tuple[tuple[float, ...], ...], bool]]:
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
    """Columns and residuals along a motion whose readings (n, 2 J) are positions and torques."""

    def __init__(self, arm: ServoArm, motion: Motion, readings: Array) -> None:
        self.arm, self.commands = arm, motion.commands(arm)
        self.motions = _played(arm, self.commands, readings)
        self.balance = Balance(arm.machine, self.motions["commands"])
        released, sampled = copy(self.balance), copy(self.balance)
        released.motion, sampled.motion = self.motions["torques"], self.motions["sampled"]
        released.released = np.ones_like(self.balance.released)
        released.given = np.zeros_like(self.balance.given)
        sampled.commands = sampled.motion.stacked("commands")
        sampled.given = sampled.given_by(sampled.commands)
        self.balances: dict[Form, Balance] = {
            "commands": self.balance, "torques": released, "sampled": sampled,
        }  # fmt: skip

    def residuals(self) -> Array:
        """Missing forces by commands and by torques (2, T, J)."""
        balance = self.balance
        measured = self.motions["torques"].stacked("torques")
        by_torque = balance.residual + measured - balance.given
        return np.stack([balance.residual, by_torque])[:, :, self.arm.driven]

    def tolerances(self, sizes: Array) -> Array:
        """Change by nominal parameters that are off by some standard deviations (2, T, J)."""
        nominal = self.arm.nominal
        changes: dict[Form, Array] = {}
        for form, balance in self.balances.items():
            spec = balance.machine.fresh()
            nominal.edit(spec, 1 + _STEP * sizes * nominal.deviation)
            changes[form] = balance.edited(spec).smooth / _STEP
        return self._by_form(changes)

    def columns(self, terms: Iterable[Term]) -> Iterator[Array]:
        """Change by every column of some terms (2, T, J)."""
        known: dict[tuple[float, ...], dict[Form, Forces]] = {}
        before: Effect | None = None
        for term in terms:
            known, before = known if term.effect is before else {}, term.effect
            moves_otherwise = term.effect.part == "sensor" or term.effect.adds_motion
            forms: tuple[Form, ...] = ("commands", "torques") if moves_otherwise else ("commands",)
            forms = (*forms, "sampled") if term.effect.drives else forms
            for values in term.axes:
                if values not in known:
                    own = np.array(values)
                    known[values] = {f: self.balances[f].forces(term.effect, own) for f in forms}
                    if term.effect.overrides("command"):
                        known[values]["sampled"] = self._stepped(term.effect, own)
                changes: dict[Form, Array] = {}
                for form, forces in known[values].items():
                    change = forces.smooth
                    if term.contact:
                        change = change + forces.dry * self.balance.directions[term.contact]
                    changes[form] = np.nan_to_num(change)
                if "torques" not in changes:  # drives do not change what the motion takes
                    nothing = np.zeros_like(changes["commands"])
                    changes["torques"] = nothing if term.effect.drives else changes["commands"]
                yield self._by_form(changes)

    def _stepped(self, effect: Effect, values: Array) -> Forces:
        """Change at the samples by an effect on the commands, which act in steps."""
        every, sampled = self.arm.parts, self.balances["sampled"]
        thin = round(sampled.motion.step * RATE)
        held = self.arm.held(self.commands)
        time = np.arange(len(held)) / (every * RATE)
        acting = effect.command(time, held, values)[::every]
        acting = low_passed(acting, _BAND_HZ, 1.0 / RATE)[::thin]
        smooth = sampled.given - sampled.given_by(acting)
        nothing = np.zeros_like(smooth)
        return Forces(smooth=smooth, dry=nothing, readings=nothing[:, :0], operator=nothing)

    def _by_form(self, changes: dict[Form, Array]) -> Array:
        """Change by commands, and by torques, which are read while one command acts."""
        commands = changes["commands"]
        stepped = commands - changes.get("sampled", commands)
        return np.stack([commands, changes["torques"] + stepped])[:, :, self.arm.driven]


def _evidence(
    key: str, motion: Motion, arm: ServoArm, shaped: Sequence[Shape], say: Say, words: str
) -> MotionEvidence:
    """Play a motion with the nominal model, and whiten the columns of all shapes along it."""
    say(f"columns of {len(shaped)} shapes along {words}: {motion.description}")
    planned, _ = check_motion(motion, arm)
    along = Along(arm, motion, arm.simulate(Hypothesis(), motion.commands(arm)))
    nominal, whitening = along.residuals(), []
    for balance in (along.balance, Balance(arm.machine, along.motions["torques"])):
        balance.residual[:] = 0.0  # what the nominal model leaves is no knock
        parts = zip(*(_whitening(balance, int(j)) for j in arm.driven), strict=True)
        whitening.append([np.stack(part, axis=1) for part in parts])
    window, scale = (np.stack(each) for each in zip(*whitening, strict=True))
    own, terms = np.eye(len(arm.nominal.entries)), (shape.term for shape in shaped)
    series = np.stack([*map(along.tolerances, own), *along.columns(terms)], axis=1)
    found = MotionEvidence(
        np.empty((0, 0), np.float32), nominal, window, scale,
        len(planned.desired) / RATE,
        float(np.sum((planned.torque / arm.torque_limits) ** 2)) / RATE,
    )  # fmt: skip
    return replace(found, rows=found.whitened(series).T.astype(np.float32))


def _whitening(balance: Balance, joint: int) -> tuple[Array, Array]:
    """Window of a joint's samples (T,), and one over the noise at the frequencies kept (F,)."""
    count = len(balance.position)
    ramp = np.minimum(np.arange(count) + 0.5, count - 0.5 - np.arange(count)) / (0.05 * count)
    window = np.sin(0.5 * np.pi * np.clip(ramp, 0.0, 1.0)) ** 2 * weight_of(balance, joint)
    frequency = np.asarray(np.fft.rfftfreq(count, balance.motion.step), float)
    frequency = frequency[frequency <= _BAND_HZ]
    scale = 1 / np.sqrt((window**2).sum() / 2 + 1e-12) / balance.noise(joint, frequency)
    scale[0] /= np.sqrt(2)
    return window, scale


def _seen(bank: MotionBank, shape: Shape) -> bool:
    """Whether a shape is visible within its bounds on the motions of reference."""
    if shape.term.law:
        return VISIBLE[0] / 4 < bank.visibility(shape, shape.centre) < 4 * VISIBLE[1]
    return any(
        bank.visibility(shape, np.eye(len(shape.at))[k] * min(abs(bound), 1e9)) > VISIBLE[0]
        for k, column in enumerate(shape.term.columns)
        for bound in (column.low, column.high)
    )


def _only(bank: MotionBank, kept: set[int]) -> MotionBank:
    """The bank with some of its shapes; a candidate that is never clearly visible goes whole."""

    def clear(shape: Shape) -> bool:
        return not shape.term.law or bank.visibility(shape, shape.centre) > VISIBLE[0]

    names = {bank.shapes[k].name for k in kept if clear(bank.shapes[k])}
    columns, found = list(range(bank.nuisances)), []
    for k in sorted(kept):
        shape = bank.shapes[k]
        if shape.name in names:
            first = len(columns)
            columns += shape.at
            found.append(Shape(shape.term, tuple(range(first, len(columns)))))
    evidence = [replace(e, rows=e.rows[:, columns]) for e in bank.evidence]
    return replace(bank, shapes=tuple(found), evidence=tuple(evidence))


def _indistinguishable(bank: MotionBank) -> set[str]:
    """Candidates that no motion of the bank tells from an earlier one.

    As the mass of a link that only turns about the vertical and the inertia of its rotor.
    """
    gram = beyond(np.sum([e.gram for e in bank.evidence], axis=0), bank.nuisances)
    of = {name: [s for s in bank.shapes if s.name == name] for name in bank.names}
    found: set[str] = set()

    def left(shape: Shape, other: Shape) -> float:
        """Squared length of a shape's largest signature beside another one."""
        at, beside = list(shape.at), list(other.at)
        own = gram[np.ix_(at, at)]
        across = gram[np.ix_(at, beside)]
        rest = own - across @ np.linalg.pinv(gram[np.ix_(beside, beside)]) @ across.T
        sizes = [1.0] if shape.term.law else VISIBLE[1] ** 2 / np.maximum(
            np.diag(bank.beyond)[at], 1e-12
        )  # fmt: skip
        return float(np.max(np.diag(rest) * np.minimum(sizes, 1e12)))

    for number, name in enumerate(bank.names):
        for earlier in bank.names[:number]:
            if earlier not in found and all(
                any(left(one, other) < _INDISTINGUISHABLE_Z**2 for other in of[earlier])
                for one in of[name]
            ):
                found.add(name)
    return found
