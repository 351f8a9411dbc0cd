"""Cases of the gap suite by number, effects sized to be visible; recordings, sealed truth."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from scipy import signal
from scipy.optimize import lsq_linear

from loose_env.errors import InvalidSetting
from loose_env.recording import Run, write_recording
from loose_env.typing import Array
from scripts.suites.gap.arms import ARMS, MACHINES, Figures, model_xml
from scripts.suites.gap.dynamics import (
    DAMPING,
    FACTORS,
    SAMPLE,
    TOLERANCE,
    Factors,
    build,
    forward,
    mass_and_bias,
)
from scripts.suites.gap.effects import (
    ACCELEROMETER,
    CATALOGUE,
    FORWARD,
    FREE,
    INVERSE,
    KINDS,
    MIXED,
    OUTSIDE,
    RANDOM,
    Effect,
    Kind,
    Parameters,
    Place,
    log_uniform,
)
from scripts.suites.gap.machine import Motion, Noise, Signals, TrueArm, add_noise, motions, rounded


def numbers_of(words: Iterable[str]) -> list[int]:
    """Numbers of cases from words such as ``7`` and ``1000-1003``."""
    found: dict[int, None] = {}
    for word in words:
        ends = word.split("-")
        if len(ends) > 2 or not all(end.isdecimal() for end in ends):
            raise InvalidSetting(f"{word!r} is no case; give numbers as in 7 or 1000-1003")
        first, last = int(ends[0]), int(ends[-1])
        if not first <= last <= LAST:
            raise InvalidSetting(
                f"{word}: cases have numbers from 0 to {LAST}, the lower one first"
            )
        found.update(dict.fromkeys(range(first, last + 1)))
    return list(found)


def mixed(numbers: Sequence[int]) -> list[int]:
    """The same numbers in an order in which a run cut short has a little of every role."""
    roles: dict[str, list[int]] = {}
    for number in sorted(set(numbers)):
        roles.setdefault(role_of(number), []).append(number)
    return sorted(
        (number for own in roles.values() for number in own),
        key=lambda n: (roles[role_of(n)].index(n) / len(roles[role_of(n)]), n),
    )


SEED = 20_281
"""Seed of the published suite; a private one has another."""
GROSS = 30.0
"""Largest size over the size that is just visible."""
_SEVERAL = {"pair": 2, "triple": 3}
"""Number of effects by group."""
TRIES = 12
"""Places and shapes that are tried until an effect can be seen."""
NONE, SINGLE, PAIR, OUT, TRIPLE, MACHINE = 0, 1000, 2000, 3000, 4000, 5000
"""First numbers of the cases with nothing missing, one effect, two, one outside the catalogue,
three, and of whole machines."""
ROLES = ("none", "single", "pair", "outside", "triple", "machine")
"""Groups of cases, by thousands of their numbers."""
LAST = MACHINE + 999
"""Largest number of a case."""
SHORT, LONG = 3.0, 6.0
"""Lengths of runs [s]: with nothing missing, and else."""
RUNS = 4
"""Runs of a recording."""
HELD_OUT = -1
"""Run that the tool holds out of so many: the last one."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn: everything that its recording is made of."""

    number: int
    """Number in the suite."""
    form: str
    """Form of the recording."""
    arm: TrueArm
    """The true arm."""
    motions: tuple[Motion, ...]
    """The runs."""
    noise: Noise
    """Noise of the sensors."""
    sizes: tuple[dict[str, Any], ...] = ()
    """For each effect its size, the size that is just visible and their ratio."""
    seed: int = SEED
    """Seed of the suite that it belongs to."""

    @property
    def role(self) -> str:
        """One of `ROLES`."""
        return role_of(self.number)

    @property
    def name(self) -> str:
        """Name of the recording; it tells nothing."""
        return name_of(self.number, seed=self.seed)


def role_of(number: int) -> str:
    """Group of a case by its number."""
    return ROLES[number // 1000]


def name_of(number: int, *, seed: int = SEED) -> str:
    """Name of a case's recording: numbers in an order that tells nothing without the seed."""
    if seed != SEED:
        first, count, key = 0, LAST + 1, 1
    else:  # the published suite had names before it had cases of many effects
        first, count, key = (0, TRIPLE, 1) if number < TRIPLE else (TRIPLE, LAST + 1 - TRIPLE, 4)
    order = np.random.default_rng(np.random.SeedSequence([seed, key])).permutation(count)
    return f"case-{first + int(order[number - first]):04d}"


def quick_list() -> list[int]:
    """Numbers of a small suite of 20 cases."""
    return [
        *range(NONE, NONE + 6),
        *(SINGLE + i for i in (0, 1, 4, 6, 7, 8, 11, 15, 16, 20)),
        *range(PAIR, PAIR + 2),
        *range(OUT, OUT + 2),
    ]


def full_list(
    *, none: int = 100, singles: int = 3, pairs: int = 24, outside: int = 18
) -> list[int]:
    """Numbers of the whole suite."""
    return [
        *range(NONE, NONE + none),
        *range(SINGLE, SINGLE + singles * len(CATALOGUE)),
        *range(PAIR, PAIR + pairs),
        *range(OUT, OUT + outside),
    ]


def draw_few(number: int, rng: np.random.Generator, *, even_lengths: bool = False) -> Case:
    """Draw a case with at most three effects."""
    role, within = role_of(number), number % 1000
    if role == "none":
        wanted: list[str] = []
    elif role == "single":
        wanted = [CATALOGUE[within % len(CATALOGUE)]]
    elif role in _SEVERAL:
        wanted = _several(rng, _SEVERAL[role])
    else:
        wanted = [OUTSIDE[within % len(OUTSIDE)]]
    seconds = SHORT if role == "none" and not even_lengths else LONG
    while True:
        form = _draw_form(rng, wanted)
        if form is None:
            wanted = _several(rng, _SEVERAL[role])
            continue
        figures = _draw_arm(rng, form)
        arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
        runs = motions(rng, figures, form=form, runs=RUNS, seconds=seconds)
        noise = Noise.draw(figures, rng)
        placed = _draw_effects(rng, [KINDS[name] for name in wanted], arm, runs, noise, form)
        if placed is not None:
            break
        if role in _SEVERAL:
            wanted = _several(rng, _SEVERAL[role])
    effects, sizes = placed
    return Case(
        number=number,
        form=form,
        arm=dataclasses.replace(arm, effects=effects),
        motions=tuple(runs),
        noise=noise,
        sizes=sizes,
    )


def _several(rng: np.random.Generator, count: int) -> list[str]:
    """Kinds of the catalogue."""
    return [str(name) for name in rng.choice(CATALOGUE, count, replace=False)]


def _draw_form(rng: np.random.Generator, wanted: list[str]) -> str | None:
    allowed = [FORWARD, INVERSE, FREE, RANDOM]
    for name in wanted:
        allowed = [form for form in allowed if form in KINDS[name].forms]
    if not allowed:
        return None
    likely = {FORWARD: 0.7, INVERSE: 0.12, FREE: 0.08, RANDOM: 0.1}
    if "structural_looseness" in wanted or "backlash" in wanted:
        likely[RANDOM] = 0.5
    shares = np.array([likely[form] for form in allowed])
    return str(rng.choice(allowed, p=shares / shares.sum()))


def _draw_arm(rng: np.random.Generator, form: str) -> Figures:
    arms = [make() for make in ARMS.values()]
    if form == FREE:
        arms = [arm for arm in arms if arm.hanging is not None]
    return arms[int(rng.integers(len(arms)))]


def _draw_effects(
    rng: np.random.Generator,
    wanted: list[Kind],
    arm: TrueArm,
    runs: list[Motion],
    noise: Noise,
    form: str,
) -> tuple[tuple[Effect, ...], tuple[dict[str, Any], ...]] | None:
    """Effects at places where they can be seen, or None if none was found."""
    if not wanted:
        return (), ()
    visibility = Visibility(arm, runs[HELD_OUT], noise, form, seed=int(rng.integers(2**31)))
    effects: list[Effect] = []
    sizes = []
    taken: set[int] = set()
    for kind in wanted:
        found = None
        for _ in range(TRIES):
            place = _draw_place(rng, kind, arm.figures, taken)
            if place is None:
                return None
            found = drawn_effect(rng, visibility, kind, place, ratios=(1.0, GROSS))
            if found is not None:
                break
        if found is None or place is None:
            return None
        effects.append(found[0])
        sizes.append(found[1])
        taken.add(place.index)
    for effect in effects:
        for other in effects:
            # two that act alike cannot be told from one: they are no pair
            if effect is not other and visibility.beside(effect, other) < VISIBLE:
                return None
    return tuple(effects), tuple(sizes)


def _draw_place(
    rng: np.random.Generator, kind: Kind, figures: Figures, taken: set[int]
) -> Place | None:
    # two effects at one joint could be one spring behind another, which no data tell apart
    places = [place for place in kind.places(figures) if place.index not in taken]
    return places[int(rng.integers(len(places)))] if places else None


BAND = 20.0
"""Band in which torques are compared [Hz]."""
THINNED = round(0.5 / BAND / SAMPLE)
"""One sample in this many is independent of the others in the band."""


@njit(cache=True)
def _needed(bodies, damping, gravity, q, v, a):  # type: ignore[no-untyped-def]
    samples, n = q.shape
    out = np.zeros((samples, n))
    work = np.zeros((n, 40))
    mass, bias = np.zeros((n, n)), np.zeros(n)
    for i in range(samples):
        forward(bodies, q[i], v[i], gravity, work)
        mass_and_bias(bodies, work, mass, bias)
        for j in range(n):
            out[i, j] = bias[j] + damping[j] * v[i, j]
            for k in range(n):
                out[i, j] += mass[j, k] * a[i, k]
    return out


def _smooth(values: Array) -> Array:
    low = signal.butter(4, BAND, fs=1 / SAMPLE, output="sos")
    return signal.sosfiltfilt(low, values, axis=0)  # type: ignore[no-any-return]


def torque_residual(signals: Signals, figures: Figures, factors: Factors) -> Array:
    """Measured torque less the torque that the rigid arm needs, in a low band."""
    system = build(figures, factors)
    q, v = _smooth(signals.position), _smooth(signals.velocity)
    a = np.gradient(v, SAMPLE, axis=0)
    needed = _needed(system.bodies, system.laws[:, DAMPING].copy(), system.gravity, q, v, a)
    residual = _smooth(signals.torque) - needed
    edge = 2 * THINNED
    return residual[edge:-edge:THINNED]  # type: ignore[no-any-return]


VISIBLE = 3.0
"""Standard deviations of the excess at which an effect is just visible."""
STEP = 2e-3
"""Step of a factor for a difference quotient."""
INSIDE = 1
"""Integration steps in a sample while sizes are sought; recordings take more."""
SETTLE = 0.8
"""Time to settle while sizes are sought [s]."""
SEGMENT = 1024
"""Samples of a segment of a spectrum."""
PRECISION = 1.05
"""Ratio to which a size is found."""
THIN = 4
"""Of trajectories one sample in this many is looked at and counted for all: what effects do
changes little in between."""


class Visibility:
    """How visible effects are on one run of one arm."""

    def __init__(
        self,
        arm: TrueArm,
        motion: Motion,
        noise: Noise,
        form: str,
        *,
        seed: int = 0,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.arm, self.motion, self.noise, self.form = arm.without(), motion, noise, form
        self._rng = np.random.default_rng(seed)
        self._kept: dict[tuple[object, ...], Array] = {}
        signals = self._signals(self.arm)
        self._scale = self._noise_scale(signals)
        self._base = self._features(signals)
        self.count = self._base.size * (1 if form in (INVERSE, RANDOM) else THIN)
        self.columns = columns = self._sensitivities()
        # a figure that does nothing (an inertia about an axis that never turns) is left out
        lengths = np.linalg.norm(columns, axis=0)
        self._acts, self._lengths = lengths > 0, lengths[lengths > 0]
        # of the true figures: a figure of the model less that of the arm, changed in sign
        off = (self.arm.factors.flat() - 1.0)[self._acts]
        self._low = (off - tolerance) * self._lengths
        self._high = (off + tolerance) * self._lengths
        self._q, self._r = np.linalg.qr(columns[:, self._acts] / self._lengths)

    def _signals(self, arm: TrueArm) -> Signals:
        return arm.run(self.motion, inside=INSIDE, settle=SETTLE)

    def _noise_scale(self, signals: Signals) -> Array:
        """Standard deviations of the features, or one where they are normalised already."""
        noisy = add_noise(signals, self.noise, self._rng)
        if self.form == INVERSE:
            arm = self.arm
            moved = torque_residual(noisy, arm.figures, arm.factors) - torque_residual(
                signals, arm.figures, arm.factors
            )
            return np.asarray(moved.std(axis=0))
        if self.form == RANDOM:
            transfer, coherence, segments = self._transfer(noisy)
            spread = np.abs(transfer) ** 2 * (1 - coherence) / (2 * segments * coherence)
            return np.sqrt(np.maximum(spread, 1e-30))
        return np.ones(1)

    def _transfer(self, signals: Signals) -> tuple[Array, Array, float]:
        """Transfer from the command to every reading, its coherence, number of segments."""
        x = self.motion.commands[:, self.motion.excited]
        y = signals.normalised(self.noise).T
        spectrum = signal.welch(x, 1 / SAMPLE, nperseg=SEGMENT)[1]
        frequencies, cross = signal.csd(x[None], y, 1 / SAMPLE, nperseg=SEGMENT)
        power = signal.welch(y, 1 / SAMPLE, nperseg=SEGMENT)[1]
        band = (frequencies > 5.0) & (spectrum > 0.05 * spectrum.max())
        coherence = np.abs(cross) ** 2 / (spectrum * np.maximum(power, 1e-30))
        segments = 2 * len(x) / SEGMENT * 0.75
        return (cross / spectrum)[:, band], np.clip(coherence[:, band], 1e-6, 1 - 1e-9), segments

    def _features(self, signals: Signals, factors: Factors | None = None) -> Array:
        if self.form == INVERSE:
            arm = self.arm
            residual = torque_residual(signals, arm.figures, factors or arm.factors)
            return (residual / self._scale).ravel()
        if self.form == RANDOM:
            transfer = self._transfer(signals)[0] / self._scale
            return np.concatenate((transfer.real.ravel(), transfer.imag.ravel()))
        return np.sqrt(THIN) * signals.normalised(self.noise)[::THIN].ravel()  # type: ignore[no-any-return]

    def _sensitivities(self) -> Array:
        """Change of the features with every factor, of shape (features, 6 n)."""
        columns = []
        base = self._signals(self.arm) if self.form == INVERSE else None
        for name in FACTORS:
            for joint in range(self.arm.figures.joints):
                moved = self.arm.factors.changed(name, joint, STEP)
                if base is not None:
                    features = self._features(base, moved)
                else:
                    arm = dataclasses.replace(self.arm, factors=moved)
                    features = self._features(self._signals(arm))
                columns.append((features - self._base) / STEP)
        return np.stack(columns, axis=1)

    def difference(self, effects: tuple[Effect, ...]) -> Array:
        """Difference that effects make, in standard deviations, of shape (features,)."""
        arm = dataclasses.replace(self.arm, effects=effects)
        return self._features(self._signals(arm)) - self._base

    def excess(self, difference: Array, rivals: Array | None = None) -> float:
        """What of a difference no nuisance explains, squared and summed."""
        if not np.all(np.isfinite(difference)):
            return float("inf")
        q, r, low, high = self._q, self._r, self._low, self._high
        if rivals is not None:
            inside = q.T @ rivals
            new, corner = np.linalg.qr(rivals - q @ inside)  # what the nuisances leave of them
            q = np.hstack((q, new))
            zero = np.zeros((corner.shape[0], r.shape[1]))
            r = np.block([[r, inside], [zero, corner]])
            free = np.full(rivals.shape[1], np.inf)
            low, high = np.concatenate((low, -free)), np.concatenate((high, free))
        inside = q.T @ difference
        rest = float(difference @ difference - inside @ inside)
        found = lsq_linear(r, -inside, bounds=(low, high), method="bvls")
        return max(rest, 0.0) + 2 * float(found.cost)

    def explained(self, difference: Array) -> Array:
        """Changes of the nuisance factors that undo most of a difference, of shape (6 n,)."""
        found = lsq_linear(
            self._r, -self._q.T @ difference, bounds=(self._low, self._high), method="bvls"
        )
        changes = np.zeros(len(self._acts))
        changes[self._acts] = found.x / self._lengths
        return changes

    def score(self, excess: float) -> float:
        """An excess in its own standard deviations."""
        if not np.isfinite(excess):
            return float("inf")
        return excess / np.sqrt(2 * self.count + 4 * excess)  # type: ignore[no-any-return]

    def of(self, kind: Kind, place: Place, drawn: Parameters, size: float) -> float:
        """Score of an effect of a given size, beyond what its rivals explain."""
        figures = self.arm.figures
        effect = Effect(
            kind=kind.name, place=place, parameters=kind.size(size, drawn, figures, place)
        )
        return self.score(self.excess(self.difference((effect,)), self._rivals(kind, place, drawn)))

    def beside(self, effect: Effect, other: Effect) -> float:
        """Score of an effect beyond what a change of another one explains."""
        columns = self._columns_of(KINDS[other.kind], other.place)
        return self.score(self.excess(self.difference((effect,)), np.stack(columns, axis=1)))

    def _rivals(self, kind: Kind, place: Place, drawn: Parameters) -> Array | None:
        """Changes with the kinds that could stand for another, of shape (features, r)."""
        if not kind.rivals:
            return None
        key = (kind.name, place.index, drawn.get("other"))
        if key not in self._kept:
            columns = []
            for name in kind.rivals:
                rival = KINDS[name]
                for at in rival.places(self.arm.figures):
                    if place.index in (-1, at.index) or drawn.get("other") == at.index:
                        columns += self._columns_of(rival, at)
            # none of them may be there: a wheel about the vertical has no zero that matters
            self._kept[key] = np.stack(columns, axis=1) if columns else np.empty((0, 0))
        return self._kept[key] if self._kept[key].size else None

    def _columns_of(self, kind: Kind, place: Place) -> list[Array]:
        """Changes of the readings with the free numbers of a kind, each of shape (features,)."""
        figures = self.arm.figures
        rng = np.random.default_rng(1)
        low, high = kind.bounds(figures, place)
        # a fraction of its range: small enough to be nearly linear, large enough to be exact
        size = float(np.sqrt(low * high))
        drawn = {**kind.draw(rng, figures, place), "sign": 1.0}
        shapes = [drawn]
        if "direction" in drawn:
            shapes = [{**drawn, "direction": axis.tolist()} for axis in np.eye(3)]
        elif "reference" in drawn:
            shapes.append({**drawn, "reference": drawn["reference"] + figures.reach[place.index]})
        columns = []
        for shape in shapes:
            parameters = kind.size(size, shape, figures, place)
            effect = Effect(kind=kind.name, place=place, parameters=parameters)
            columns.append(self.difference((effect,)))
        moves = [column for column in columns if np.linalg.norm(column) > 1e-9]
        return moves or columns[:1]


def visible_size(
    visibility: Visibility, kind: Kind, place: Place, drawn: Parameters
) -> float | None:
    """Size at which an effect is just visible on a run, or None if it cannot be."""
    low, high = kind.bounds(visibility.arm.figures, place)
    score = visibility.of(kind, place, drawn, high)
    if score < VISIBLE:
        return None
    guess = np.sqrt(low * high)
    while high / low > PRECISION:
        score = visibility.of(kind, place, drawn, guess)
        if score < VISIBLE:
            low = guess
        else:
            high = guess
        # most effects show by the square of their size: guess by that, inside the bracket
        step = np.sqrt(VISIBLE / score) if 0 < score < np.inf else 0.0
        guess = guess * step * (PRECISION**0.4 if score < VISIBLE else PRECISION**-0.4)
        if not low * PRECISION**0.2 < guess < high / PRECISION**0.2:
            guess = np.sqrt(low * high)
    return float(high)


def drawn_effect(
    rng: np.random.Generator,
    visibility: Visibility,
    kind: Kind,
    place: Place,
    *,
    ratios: tuple[float, float],
) -> tuple[Effect, dict[str, Any]] | None:
    """Draw an effect at a place, with its size; None if it cannot be seen there."""
    figures = visibility.arm.figures
    drawn = kind.draw(rng, figures, place)
    visible = visible_size(visibility, kind, place, drawn)
    factor = log_uniform(rng, *ratios)
    if visible is None:
        return None
    least, largest = kind.bounds(figures, place)
    size = min(visible * factor, largest)
    parameters = kind.size(size, drawn, figures, place)
    return Effect(kind=kind.name, place=place, parameters=parameters), {
        "size": size,
        "visible": visible,
        "ratio": size / visible,
        # seen at every size that is real: the smallest of those stands for just visible
        "least_real": visible <= least * PRECISION,
    }


LEAST_ERROR, MACHINE_TOLERANCE = 0.03, 0.10
"""Smallest and largest relative error of nominal masses, inertias, dampings, gains and rotors."""
FEWEST, MOST = 5, 15
"""Effects at once."""
SMALLEST, LARGEST = 3.0, 30.0
"""Sizes over the size that is just visible without the other effects."""
FRICTION = 0.8
"""Probability of each joint to have a friction that the model lacks."""
FRICTIONS = ("viscous_friction", "coulomb_friction")
PARTS = (
    ("payload", 0.7), ("command_delay", 0.5), ("joint_compliance", 0.5), ("encoder_offset", 0.5),
    ("base_tilt", 0.3), ("actuator_gain", 0.4), ("joint_spring", 0.2), ("torque_ripple", 0.2),
)  # fmt: skip
"""Other effects, and their probabilities."""


def draw_machine(number: int, rng: np.random.Generator) -> Case:
    """Draw a whole machine."""
    form = str(rng.choice([FORWARD, INVERSE, MIXED], p=[0.5, 0.3, 0.2]))
    makers = list(MACHINES.values())
    figures = makers[int(rng.integers(len(makers)))]()
    factors = Factors.draw(figures.joints, rng, least=LEAST_ERROR, most=MACHINE_TOLERANCE)
    arm = TrueArm(figures=figures, factors=factors)
    many = form == MIXED
    runs = motions(
        rng, figures, form=form, runs=2 * RUNS if many else RUNS, seconds=SHORT if many else LONG
    )
    noise = Noise.draw(figures, rng)
    shown = INVERSE if form == INVERSE else FORWARD
    seen = next(run for run in reversed(runs) if run.straight == (shown == INVERSE))
    visibility = Visibility(
        arm, seen, noise, shown, seed=int(rng.integers(2**31)), tolerance=MACHINE_TOLERANCE
    )
    effects: list[Effect] = []
    sizes: list[dict[str, Any]] = []
    while len(effects) < FEWEST:
        effects, sizes = [], []
        for name, index in _wanted(rng, figures.joints, shown)[:MOST]:
            kind = KINDS[name]
            places = [p for p in kind.places(figures) if index in (None, p.index)]
            if not places:
                continue
            place = places[int(rng.integers(len(places)))]
            found = drawn_effect(rng, visibility, kind, place, ratios=(SMALLEST, LARGEST))
            if found is None or found[1]["ratio"] < SMALLEST:
                continue  # no real size of it is clearly visible
            effects.append(found[0])
            sizes.append(found[1])
    return Case(
        number=number,
        form=form,
        arm=dataclasses.replace(arm, effects=tuple(effects)),
        motions=tuple(runs),
        noise=noise,
        sizes=tuple(sizes),
    )


def _wanted(rng: np.random.Generator, joints: int, form: str) -> list[tuple[str, int | None]]:
    """Kinds, with the joint where it is drawn beforehand, in an order that tells nothing."""
    found: list[tuple[str, int | None]] = [
        (str(rng.choice(FRICTIONS)), joint) for joint in range(joints) if rng.random() < FRICTION
    ]
    for name, likely in PARTS:
        if rng.random() < likely and form in KINDS[name].forms:
            found.append((name, None))
    return [found[k] for k in rng.permutation(len(found))]


def draw_case(number: int, *, seed: int = SEED) -> Case:
    """Draw a case by its number."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0, number]))
    if role_of(number) == "machine":
        case = draw_machine(number, rng)
    else:
        case = draw_few(number, rng, even_lengths=seed != SEED)
    return dataclasses.replace(case, seed=seed)


def tolerance_of(number: int) -> float:
    """Largest relative error of the nominal figures of a case, which the tool is told."""
    return MACHINE_TOLERANCE if role_of(number) == "machine" else TOLERANCE


FORMAT = "gap-truth/1"
"""Format of a file of truth."""


def runs_of(case: Case) -> list[Run]:
    """Readings of a case with noise."""
    runs = []
    readings = case.arm.assemble()[1]
    for i, motion in enumerate(case.motions):
        rng = np.random.default_rng(np.random.SeedSequence([case.seed, 2, case.number, i]))
        signals = rounded(add_noise(case.arm.run(motion), case.noise, rng), readings)
        runs.append(_run(case, motion, signals, f"run-{i + 1:02d}"))
    return runs


def _run(case: Case, motion: Motion, signals: Signals, name: str) -> Run:
    joints, form = range(case.arm.figures.joints), case.form
    if form == MIXED:
        form = INVERSE if motion.straight else FORWARD
    sensors: dict[str, Any] = {}
    for j in joints:
        sensors[f"joint{j + 1}_pos"] = signals.position[:, j]
        sensors[f"joint{j + 1}_vel"] = signals.velocity[:, j]
    if form != INVERSE:
        sensors[ACCELEROMETER] = signals.acceleration
    controls, torques = {}, {}
    if form == INVERSE:
        torques = {f"joint{j + 1}": signals.torque[:, j] for j in joints}
    elif form != FREE:
        controls = {f"motor{j + 1}": motion.commands[:, j] for j in joints}
    extra: dict[str, Any] = {}
    if form == RANDOM:
        assert motion.excited is not None and motion.pose is not None
        extra["excited"] = (f"joint{motion.excited + 1}",)
        extra["pose"] = {f"joint{j + 1}": float(motion.pose[j]) for j in joints}
    return Run(
        name=name,
        time=np.arange(len(signals.position)) * SAMPLE,  # type: ignore[arg-type]
        controls=controls,
        sensors=sensors,
        torques=torques,
        **extra,
    )


def truth_of(case: Case) -> dict[str, Any]:
    """What is true of a case, as it is sealed."""
    return {
        "format": FORMAT,
        "case": case.name,
        "number": case.number,
        "role": case.role,
        "form": case.form,
        "arm": case.arm.figures.name,
        "families": [motion.family for motion in case.motions],
        "effects": [
            {
                "kind": effect.kind,
                "where": effect.place.name,
                "index": effect.place.index,
                "parameters": dict(effect.parameters),
                "size": size,
            }
            for effect, size in zip(case.arm.effects, case.sizes, strict=True)
        ],
        "factors": {name: getattr(case.arm.factors, name).tolist() for name in FACTORS},
        "noise": {
            "position": case.noise.reading.tolist(),
            "velocity": case.noise.velocity.tolist(),
            "acceleration": case.noise.acceleration,
            "torque": case.noise.torque.tolist(),
        },
    }


def write_runs(folder: Path, case: Case, runs: list[Run]) -> Path:
    """Write runs of a case with its nominal model as a recording; return its folder."""
    write_recording(
        folder,
        model_xml=model_xml(case.arm.figures, drives="" if case.form == FREE else "position"),
        runs=runs,
        overwrite=True,
    )
    return folder


def write_case(case: Case, *, recordings: Path, truth: Path) -> Path:
    """Write a case's recording and its truth, the truth last."""
    if recordings.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise ValueError(f"truth {truth} lies inside the recordings {recordings}; keep it apart")
    folder = write_runs(recordings / case.name, case, runs_of(case))
    truth.mkdir(parents=True, exist_ok=True)
    path = truth / f"{case.name}.json"
    beside = path.with_suffix(f".{os.getpid()}.part")
    beside.write_text(json.dumps(truth_of(case), indent=1) + "\n", encoding="utf-8")
    beside.rename(path)
    return folder


def is_written(name: str, *, recordings: Path, truth: Path) -> bool:
    """Whether a case is there already, whole."""
    path = truth / f"{name}.json"
    return path.is_file() and (recordings / name / "recording.json").is_file()
