"""Cases of the gap suite by number: worlds, effects that can be seen, recordings, sealed truth.

A number below `FIRST_JUDGED` is for development. Those from there on are drawn from a phrase, so
that nobody has seen their cases before the phrase is chosen.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from scipy import signal
from scipy.optimize import lsq_linear

from loose_env.errors import InvalidSetting
from loose_env.io import write_text
from loose_env.recording import Run, write_recording
from loose_env.typing import Array
from scripts.suites.blind import drawn_from
from scripts.suites.gap.arms import ARMS, MACHINES, Figures, model_xml, varied
from scripts.suites.gap.dynamics import DAMPING, Factors, Signals, build, forward, mass_and_bias
from scripts.suites.gap.effects import (
    ACCELEROMETER,
    CATALOGUE,
    FREE,
    KINDS,
    OUTSIDE,
    SERVO,
    TORQUE,
    Effect,
    Place,
    Spot,
    drawn,
)
from scripts.suites.gap.machine import (
    FAMILIES,
    Motion,
    Noise,
    TrueArm,
    add_noise,
    free_motion,
    rich_motion,
    rounded,
    shaken_motion,
)

SEED = 53_001
"""Seed of the development numbers."""
FORMAT = "gap-truth/2"
"""Format of a file of truth."""
WORLDS = ("exact", "servo", "torque", "free", "rough", "shaken")
"""Worlds, by the number's remainder."""
ROLES = ("none", "one", "two", "many", "outside")
"""What is missing: nothing, one effect, two, four to six, or one that the catalogue lacks."""
_TURN = ("one", "two", "none", "one", "many", "one", "outside", "two", "none", "one")
"""Roles of sixty successive numbers, ten for each world."""
TOLERANCES = {
    "mass": 0.04, "inertia": 0.20, "armature": 0.20, "damping": 0.10, "kp": 0.04, "kv": 0.10,
    "x": 0.03, "y": 0.03, "z": 0.03, "zero": 1e-3, "constant": 0.04, "offset": 0.006,
}  # fmt: skip
"""Largest error of a model: shares, centres as shares of the link's length, zeros [rad, m], torques
as shares of the limit. A model errs by half of that, a standard deviation, and never by more."""
SHIFT = 0.5
"""Largest shift of the commands [samples], of either sign."""
VISIBLE = 5.0
"""Standard deviations of its own scatter by which what an effect changes, and no model within
tolerances explains, exceeds the noise."""
EQUAL = 2.0
"""The same of what is left of it with another effect in its place, below which both are right."""
TRIES = 60
"""Draws until effects can be seen."""
FRICTIONS = ("coulomb_friction", "viscous_friction", "load_friction", "asymmetric_friction")
"""What most joints lack."""
ALIKE = (
    ("payload", "link_mass", "link_com", "gravity_compensation", "joint_spring", "base_tilt",
     "encoder_offset", "torque_offset", "asymmetric_friction", "gear_eccentricity",
     "torque_ripple"),  # what a joint carries, and where it is
    ("payload", "link_mass", "rotor_inertia", "actuator_gain", "torque_constant",
     "viscous_friction", "load_friction", "link_com", "gravity_compensation"),  # its scales
    ("command_delay", "actuator_lag", "sensor_delay", "joint_compliance", "link_flexibility",
     "base_compliance", "command_interpolation"),  # what comes late
    ("coulomb_friction", "viscous_friction", "stribeck_friction", "asymmetric_friction",
     "load_friction", "quadratic_drag", "friction_behind_slack", "backlash", "dead_zone"),
    ("torque_limit", "voltage_limit", "speed_limit"),
    ("sensor_misalignment", "sensor_gain", "sensor_bias", "base_tilt"),
)  # fmt: skip
"""Kinds that data may not separate; whether they do is computed for each case."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """A machine in a world: everything but its motions and what it lacks."""

    world: str
    form: str
    """Form of the recording."""
    arm: TrueArm
    sample: float
    """Time between two samples of the log [s]."""
    noise: Noise
    speeds: bool = True
    """Whether velocities are recorded."""
    accelerometer: bool = False
    """Whether the tool has one."""
    torques: bool = False
    """Whether torques are recorded."""
    straight: bool = False
    """Whether the drives go in straight lines from command to command."""
    garbage: str = ""
    """Column that says nothing."""
    ignored: tuple[str, ...] = ()
    """Places of which answers count neither for nor against a tool."""
    spoiled: tuple[int, ...] = ()
    """Joints where no effect is put."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn: everything that its recording is made of."""

    number: int
    name: str
    """Name of the recording; it tells nothing."""
    role: str
    """One of `ROLES`."""
    setup: Setup
    effects: tuple[Effect, ...]
    motions: tuple[Motion, ...]
    scores: tuple[float, ...]
    """How visible each effect is, in units of which `VISIBLE` is asked."""
    accepted: tuple[tuple[tuple[tuple[str, str], ...], ...], ...]
    """For each effect the sets of names that count as right."""
    seed: tuple[int, ...]

    @property
    def arm(self) -> TrueArm:
        """The true arm."""
        return dataclasses.replace(self.setup.arm, effects=self.effects)


def seed_of(number: int, phrase: str = "") -> tuple[int, ...]:
    """Seed of a case; judged ones need a phrase."""
    return (drawn_from(number, phrase, SEED), number)


def name_of(number: int, phrase: str = "") -> str:
    """Name of a case's recording."""
    seed = seed_of(number, phrase)
    return f"case-{hashlib.sha256(repr((seed, 'name')).encode()).hexdigest()[:8]}"


def world_of(number: int) -> str:
    """World of a case by its number."""
    return WORLDS[number % len(WORLDS)]


def role_of(number: int) -> str:
    """Role of a case by its number."""
    return _TURN[number // len(WORLDS) % len(_TURN)]


# ----------------------------------------------------------------------------------- worlds


def _errors(rng: np.random.Generator, figures: Figures, sample: float, shift: bool) -> Factors:
    """What a model of a real machine never has exactly."""
    n = figures.joints

    def off(name: str) -> Array:
        return np.clip(rng.normal(scale=0.5, size=n), -1, 1) * TOLERANCES[name]

    ratios = {name: 1 + off(name) for name in ("mass", "inertia", "armature", "damping")}
    gains = {name: 1 + off(name) for name in ("kp", "kv", "constant")}
    scale = [0.05 if link.kind == "slide" else 1.0 for link in figures.links]
    others = {name: off(name) for name in ("x", "y", "z", "offset")}
    late = rng.uniform(-SHIFT, SHIFT) * sample if shift else 0.0
    return Factors(
        **ratios, **gains, **others, zero=off("zero") * scale, shift=np.full(n, late)
    )  # fmt: skip


def _servo(rng: np.random.Generator, log: float) -> tuple[float, float, float]:
    """A drive's own rate [Hz], so far above the log's that no delay of it counts."""
    rate = float(rng.choice([r for r in (1000.0, 2000.0, 4000.0, 8000.0) if r >= 4 * log]))
    late = float(rng.integers(0, 2)) if rate >= 8 * log else 0.0
    return rate, late, float(rng.uniform(0.5, 1.0))


def _machine(rng: np.random.Generator, names: Sequence[str]) -> Figures:
    return varied(MACHINES[str(rng.choice(names))](), rng)


def draw_setup(world: str, role: str, rng: np.random.Generator) -> Setup:
    """A machine in a world, with nothing missing yet."""
    small = {"many": 3, "two": 2}.get(role, 1)  # so many effects need that many joints
    names = [name for name, make in MACHINES.items() if make().joints >= small]
    chance = rng.random(6)
    if world in ("exact", "shaken"):
        figures = _machine(rng, list(ARMS) if world == "shaken" else names)
        factors = Factors.draw(figures.joints, rng)
        arm = TrueArm(figures=figures, factors=factors)
        return Setup(world=world, form=SERVO, arm=arm, sample=1e-3, accelerometer=True,
                     noise=Noise.draw(figures, rng))  # fmt: skip
    form = {"servo": SERVO, "torque": TORQUE, "free": FREE}.get(world)
    trouble = ""
    if form is None:
        form = SERVO if chance[0] < 0.5 else TORQUE
        trouble = "garbage" if chance[1] < 0.4 else "wrist" if chance[1] < 0.7 else "slow"
    if trouble == "wrist":
        names = ["upright6", "redundant7", "elbow4"]
    if form == FREE:
        hanging = [n for n in names if MACHINES[n]().hanging is not None]
        names = hanging + ["rig1"] * (2 if small == 1 else 0)
    figures = _machine(rng, names)
    if form == FREE:  # one that is let swing has light gears or none
        links = [
            dataclasses.replace(
                link, damping=0.05 * link.damping, armature=0.2 * link.armature,
                limit=0.12 * link.limit,
            )
            for link in figures.links
        ]  # fmt: skip
        figures = dataclasses.replace(figures, links=tuple(links))
    rates = {SERVO: (100, 125, 200, 250, 500, 1000), TORQUE: (100, 200, 250, 500, 1000),
             FREE: (60, 100, 200, 500, 1000)}[form]  # fmt: skip
    rate = float(rng.choice((30, 50, 60, 100) if trouble == "slow" else rates))
    arm = TrueArm(
        figures=figures,
        factors=_errors(rng, figures, 1 / rate, shift=form == SERVO and bool(chance[2] < 0.6)),
        link_side=form != TORQUE and bool(chance[3] < 0.5),
        servo=_servo(rng, rate) if form == SERVO else None,
    )
    setup = Setup(
        world=world, form=form, arm=arm, sample=1 / rate, noise=Noise.draw(figures, rng, 1 / rate),
        speeds=bool(chance[4] < 0.5), accelerometer=form == SERVO and bool(rng.random() < 0.3),
        torques=form == TORQUE or (form == SERVO and bool(rng.random() < 0.2)),
        straight=form == TORQUE or (form == SERVO and bool(rng.random() < 0.4)),
    )  # fmt: skip
    n = figures.joints
    if trouble == "wrist":
        last = figures.links[-1]
        ratio = float(rng.choice([-1.0, 1.0]))
        arm = dataclasses.replace(arm, coupling=(ratio, 0.02 * last.limit, 0.3 * last.armature))
        setup = dataclasses.replace(setup, arm=arm, spoiled=(n - 2, n - 1),
                                    ignored=_places(n - 2) + _places(n - 1))  # fmt: skip
    if trouble == "garbage":
        j = int(rng.integers(n))
        if setup.form == TORQUE or not setup.speeds:
            column = f"torque.joint{j + 1}" if setup.form == TORQUE else f"sensor.joint{j + 1}_pos"
            setup = dataclasses.replace(setup, garbage=column, spoiled=(j,), ignored=_places(j))
        else:
            name = f"joint{j + 1}_vel"
            setup = dataclasses.replace(setup, garbage=f"sensor.{name}", ignored=(name,))
    return setup


def _places(j: int) -> tuple[str, ...]:
    """Names of all that belongs to a joint."""
    words = ("joint{}", "motor{}", "link{}", "joint{}_pos", "joint{}_vel")
    return tuple(word.format(j + 1) for word in words)


def draw_motions(setup: Setup, rng: np.random.Generator) -> tuple[Motion, ...]:
    """The runs of a recording."""
    figures, sample = setup.arm.figures, setup.sample
    if setup.form == FREE:
        seconds = rng.uniform(5.0, 10.0)
        return tuple(free_motion(rng, figures, seconds=seconds, sample=sample) for _ in range(4))
    if setup.world == "shaken":
        # the joint stays the same over runs of other poses, then the next one is shaken
        first = int(rng.integers(figures.joints))
        return tuple(
            shaken_motion(rng, figures, joint=(first + i % 2) % figures.joints, seconds=6.0)
            for i in range(4)
        )
    slow = setup.sample > 0.015
    seconds = rng.uniform(10.0, 16.0) if setup.form == TORQUE or slow else rng.uniform(5.0, 9.0)
    order = rng.permutation(len(FAMILIES))
    return tuple(
        dataclasses.replace(
            rich_motion(rng, figures, family=FAMILIES[i], seconds=seconds, sample=sample),
            straight=setup.straight,
        )
        for i in order
    )


# ------------------------------------------------------------------------------- visibility

BAND = 20.0
"""Band in which torques are compared [Hz]."""
STEP = {"zero": 1e-4, "offset": 1e-3}
"""Step of a tolerance for a difference quotient, where it is not 0.002."""
FINE = 2e-4
"""Integration step of recordings [s], at most; the servos and gears here are ten times slower."""
COARSE = 1e-3
"""Integration step while effects are drawn [s]; recordings take a finer one."""
SMOOTH = 8e-3
"""Speed over which friction turns over then, at least [rad/s]."""
SEEN = 4.0
"""Length of the run by which effects are drawn [s]."""
THIN = 4
"""Of trajectories one sample in this many is looked at and counted for all: what effects do
changes little in between."""


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


class Visibility:
    """What effects change on one run of one machine, beyond noise and tolerances."""

    def __init__(self, setup: Setup, motion: Motion, rng: np.random.Generator) -> None:
        self.setup = setup
        most = round(SEEN / motion.sample) + (motion.release or 0)
        self.motion = dataclasses.replace(motion, commands=motion.commands[:most])
        self.balance = setup.form != SERVO
        self._base = self.features(())
        if self.balance:
            self._scale = self._torque_noise(rng)
            self._base = self._base / self._scale
        self._base = self._base.ravel()
        self.count = self._base.size * (1 if self.balance else THIN)
        columns, lows, highs = self._tolerances()
        lengths = np.linalg.norm(columns, axis=0)
        acts = lengths > 1e-9
        self._columns = columns[:, acts] / lengths[acts]
        self._low, self._high = lows[acts] * lengths[acts], highs[acts] * lengths[acts]

    def _signals(self, arm: TrueArm) -> Signals:
        # friction that turns over less abruptly needs fewer steps and shows the same
        rubbing = tuple(
            dataclasses.replace(e, parameters={**e.parameters, "smooth_speed": SMOOTH})
            if e.parameters.get("smooth_speed", SMOOTH) < SMOOTH
            else e
            for e in arm.effects
        )
        arm = dataclasses.replace(arm, effects=rubbing)
        return arm.run(self.motion, step=COARSE, settle=0.8)

    def features(self, effects: tuple[Effect, ...], factors: Factors | None = None) -> Array:
        """Signals in noise standard deviations, or torques that are missing along the motion."""
        arm = dataclasses.replace(self.setup.arm, effects=effects)
        if self.balance:
            return self._missing(self._signals(arm), factors or arm.factors)
        if factors is not None:
            arm = dataclasses.replace(arm, factors=factors)
        found, noise = self._signals(arm), self.setup.noise
        parts = [found.position / noise.reading]
        parts += [found.velocity / noise.velocity] * self.setup.speeds
        parts += [found.acceleration / noise.acceleration] * self.setup.accelerometer
        kept = [k for k in range(self.setup.arm.figures.joints) if k not in self.setup.spoiled]
        parts[0] = parts[0][:, kept]
        return np.asarray(np.sqrt(THIN) * np.hstack(parts)[::THIN])

    def _missing(self, found: Signals, factors: Factors, smooth: bool = False) -> Array:
        """Torque logged (none, swinging freely) less what the machine needs for the motion."""
        sample, arm = self.motion.sample, self.setup.arm
        system = build(arm.figures, factors)
        q, v, a = found.position - system.drives[:, 7], found.velocity, found.joint_acceleration
        band = min(BAND, 0.2 / sample)
        low = signal.butter(4, band, fs=1 / sample, output="sos")
        if smooth:
            q = signal.sosfiltfilt(low, q, axis=0)
            v = np.gradient(q, sample, axis=0)
            a = np.gradient(v, sample, axis=0)
        arrays = (np.ascontiguousarray(x, dtype=float) for x in (q, v, a))
        needed = _needed(system.bodies, system.laws[:, DAMPING].copy(), system.gravity, *arrays)
        torque = np.zeros_like(q)
        if self.setup.form == TORQUE:
            limits = np.array([link.limit for link in arm.figures.links])
            torque = (found.torque - factors.offset * limits) / factors.constant
        rest = signal.sosfiltfilt(low, torque - needed, axis=0)
        thin = max(1, round(0.5 / band / sample))
        return np.delete(rest[2 * thin : -2 * thin : thin], self.setup.spoiled, axis=1)

    def _torque_noise(self, rng: np.random.Generator) -> Array:
        arm = self.setup.arm
        clean = self._signals(arm)
        noisy = add_noise(clean, self.setup.noise, rng)
        moved = [self._missing(each, arm.factors, smooth=True) for each in (noisy, clean)]
        return np.asarray((moved[0] - moved[1]).std(axis=0))

    def _tolerances(self) -> tuple[Array, Array, Array]:
        """Changes of the features by every figure of the model, and how far each may go."""
        arm = self.setup.arm
        n, names = arm.figures.joints, list(TOLERANCES)
        if self.balance:
            names = [name for name in names if name not in ("kp", "kv")]
        if self.setup.form != TORQUE:
            names = [name for name in names if name not in ("constant", "offset")]
        motion = self._signals(arm) if self.balance else None
        columns, lows, highs = [], [], []
        for name in names:
            for j in range(n):
                step = STEP.get(name, 2e-3)
                moved = arm.factors.changed(name, j, step)
                columns.append((self._moved(motion, moved) - self._base) / step)
                neutral = 0.0 if name in ("x", "y", "z", "zero", "offset") else 1.0
                off = float(np.broadcast_to(getattr(arm.factors, name), n)[j]) - neutral
                # a figure of the model less that of the arm; forces along a motion change in sign
                middle = off if self.balance else -off
                lows.append(min(middle - TOLERANCES[name], 0.0))
                highs.append(max(middle + TOLERANCES[name], 0.0))
        if self.setup.form == SERVO:
            step = 0.02 * self.setup.sample
            late = np.broadcast_to(arm.factors.shift, n)
            moved = dataclasses.replace(arm.factors, shift=late + step)
            columns.append((self._moved(motion, moved) - self._base) / step)
            lows.append(-2 * SHIFT * self.setup.sample)
            highs.append(2 * SHIFT * self.setup.sample)
        return np.stack(columns, axis=1), np.array(lows), np.array(highs)

    def _moved(self, motion: Signals | None, factors: Factors) -> Array:
        if motion is None:
            return self.features((), factors).ravel()
        return np.asarray((self._missing(motion, factors) / self._scale).ravel())

    def change(self, effects: tuple[Effect, ...]) -> Array:
        """What effects change, in standard deviations, of shape (features,)."""
        found = self.features(effects)
        if self.balance:
            found = found / self._scale
        return np.asarray(found.ravel() - self._base)

    def score(self, change: Array, others: Sequence[Array] = ()) -> float:
        """What no tolerance and no multiple of other changes explains, in its own scatter."""
        if not np.all(np.isfinite(change)):
            return 0.0
        free = [c / max(float(np.linalg.norm(c)), 1e-9) for c in others]
        columns = np.column_stack([self._columns, *free])
        bound = np.full(len(free), np.inf)
        q, r = np.linalg.qr(columns)
        inside = q.T @ change
        low, high = np.concatenate((self._low, -bound)), np.concatenate((self._high, bound))
        rest = max(float(change @ change - inside @ inside), 0.0)
        excess = rest + 2 * float(lsq_linear(r, inside, bounds=(low, high), method="bvls").cost)
        return float(excess / np.sqrt(2 * self.count + 4 * excess))


# ----------------------------------------------------------------------------- what is missing


def _wanted(role: str, setup: Setup, rng: np.random.Generator) -> list[str]:
    """Kinds for a role that this recording can show."""
    can = [name for name in CATALOGUE if setup.form in KINDS[name].forms]
    if not setup.accelerometer:
        can = [name for name in can if name != "sensor_misalignment"]
    if setup.world not in ("exact", "shaken"):
        # a slow log has nothing of impacts, and a link cannot be cut whose inertia is far off
        can = [name for name in can if name not in ("structural_looseness", "link_flexibility")]
    if setup.form == FREE:
        can = [name for name in can if name not in ("friction_behind_slack",)]
    if setup.straight or setup.sample < 4e-3:
        can = [name for name in can if name != "command_interpolation"]
    if role == "one":
        return [str(rng.choice(can))]
    if role == "two":
        return [str(name) for name in rng.choice(can, 4, replace=False)]
    if role == "many":
        count = int(rng.integers(4, 7))
        rubbing = [name for name in FRICTIONS if name in can]
        others = [name for name in can if name not in FRICTIONS]
        first = int(rng.integers(2, count))
        rest = [str(name) for name in rng.choice(others, 5, replace=False)]
        return [str(rng.choice(rubbing)) for _ in range(first)] + rest
    return [str(rng.choice([name for name in OUTSIDE if setup.form in KINDS[name].forms]))]


def _recorded(place: Place, setup: Setup) -> bool:
    """Whether what happens at a place can be seen and judged."""
    if place.name.endswith("_vel"):
        return setup.speeds and f"sensor.{place.name}" != setup.garbage
    if place.name == ACCELEROMETER:
        return setup.accelerometer
    return place.index not in setup.spoiled


def _placed(
    name: str, found: Sequence[Effect], setup: Setup, rng: np.random.Generator
) -> Effect | None:
    """An effect at a place that is free for it, if there is one."""
    figures = setup.arm.figures
    places = [p for p in KINDS[name].places(figures) if _recorded(p, setup)]
    for each in found:
        # viscous and dry friction at a joint are usual; else two could be one behind another
        both = {each.kind, name}
        if not (both <= set(FRICTIONS) and len(both) == 2 and "viscous_friction" in both):
            places = [p for p in places if p.index != each.place.index]
        if each.kind == name and -1 in (each.place.index, *(p.index for p in places)):
            places = []
    return (
        drawn(name, Spot(figures, places[int(rng.integers(len(places)))], rng)) if places else None
    )


def draw_effects(
    role: str, setup: Setup, visibility: Visibility, rng: np.random.Generator
) -> tuple[tuple[Effect, ...], tuple[float, ...]] | None:
    """Effects that can be seen beside each other, and how well; None where they cannot."""
    least, most = {"two": (2, 2), "many": (4, int(rng.integers(4, 7)))}.get(role, (1, 1))
    effects: tuple[Effect, ...] = ()
    for name in _wanted(role, setup, rng):
        before = visibility.change(effects)
        for _ in range(4):
            more = _placed(name, effects, setup, rng)
            if more is None or len(effects) == most:
                break
            both = (*effects, more)
            seen = visibility.score(visibility.change(both) - before) >= VISIBLE
            if seen and (setup.form != SERVO or _sane(both, visibility)):
                effects = both
                break
    if role == "outside" and effects:
        rivals = _rivals(effects[0], visibility)
        score = visibility.score(visibility.change(effects), rivals)
        return (effects, (score,)) if score >= VISIBLE else None
    scores = _scores(effects, visibility)
    while effects and min(scores) < VISIBLE:
        effects = _without(effects, int(np.argmin(scores)))
        scores = _scores(effects, visibility)
    if len(effects) < least:
        return None
    if role == "one" and effects[0].kind == "payload" and rng.random() < 0.3:
        effects = (dataclasses.replace(effects[0], runs=(1, 3)),)
    return effects, tuple(scores)


WILD = 0.4
"""Share of a joint's half range by which a machine that still works is off, at most."""


def _sane(effects: tuple[Effect, ...], visibility: Visibility) -> bool:
    """Whether the machine still goes where it is told."""
    arm, motion = visibility.setup.arm, visibility.motion
    moved = dataclasses.replace(arm, effects=effects).run(motion, step=COARSE, settle=0.8).position
    return bool((np.abs(moved - motion.commands).max(axis=0) < WILD * arm.figures.reach).all())


def _without(effects: Sequence[Effect], left_out: int) -> tuple[Effect, ...]:
    return tuple(e for i, e in enumerate(effects) if i != left_out)


RIVALS = {
    "warming_friction": ("coulomb_friction", "viscous_friction", "load_friction"),
    "cable_coupling": ("joint_spring", "encoder_offset"),
    "voltage_sag": ("actuator_gain",),
    "tight_spots": ("coulomb_friction", "asymmetric_friction", "torque_ripple"),
}
"""What of the catalogue may explain most of an effect that it lacks."""


def _rivals(effect: Effect, visibility: Visibility) -> list[Array]:
    """Changes with kinds of the catalogue that could stand for one from outside."""
    setup, found = visibility.setup, []
    joints = (effect.place.index, effect.parameters.get("other", effect.place.index))
    for kind in RIVALS.get(effect.kind, ()):
        for place in KINDS[kind].places(setup.arm.figures):
            if setup.form in KINDS[kind].forms and (place.index in joints or joints[0] < 0):
                for k in range(2):
                    shape = drawn(
                        kind, Spot(setup.arm.figures, place, np.random.default_rng(k)), 0.5
                    )
                    found.append(visibility.change((shape,)))
    return found


def _scores(effects: tuple[Effect, ...], visibility: Visibility) -> list[float]:
    """How visible each is beside the others, any size of which is possible."""
    seen = tuple(dataclasses.replace(e, runs=()) for e in effects)
    whole = visibility.change(seen)
    changes = [whole - visibility.change(_without(seen, i)) for i in range(len(seen))]
    return [
        visibility.score(change, _without(changes, i))  # type: ignore[arg-type]
        for i, change in enumerate(changes)
    ]


def accepted_of(
    effects: tuple[Effect, ...], setup: Setup, visibility: Visibility
) -> tuple[tuple[tuple[tuple[str, str], ...], ...], ...]:
    """For each effect the sets of kinds and places that are as right as its own."""
    figures = setup.arm.figures
    n = figures.joints
    found = []
    for i, effect in enumerate(effects):
        where, j = effect.place.name, effect.place.index
        sets: list[tuple[tuple[str, str], ...]] = [((effect.kind, where),)]
        if where == "all":
            sets.append(tuple((effect.kind, f"motor{k + 1}") for k in range(n)))
        if effect.kind == "asymmetric_friction":
            sets.append((("coulomb_friction", where), ("torque_offset", where)))
        if effect.kind == "torque_constant" and setup.form == TORQUE:
            # without commands a drive that gives more than it reads is the same
            sets.append((("actuator_gain", f"motor{j + 1}"),))
        if effect.kind in ("payload", "link_mass", "link_com") and j == n - 1:
            tip = f"link{n}"
            alike = (("payload", "tool"), ("link_mass", tip), ("link_com", tip))
            sets += [(name,) for name in alike if name != (effect.kind, where)]
        seen = tuple(dataclasses.replace(e, runs=()) for e in effects)
        others = _without(seen, i)
        change = visibility.change(seen) - visibility.change(others)
        for kind in _kinds_alike(effect.kind, setup):
            for place in KINDS[kind].places(figures):
                near = place.index in (j, -1) or where in ("all", "base", ACCELEROMETER)
                name = ((kind, place.name),)
                if not near or not _recorded(place, setup) or name in sets:
                    continue
                if _alike(kind, place, change, others, visibility):
                    sets.append(name)
        found.append(tuple(sets))
    return tuple(found)


def _kinds_alike(kind: str, setup: Setup) -> list[str]:
    """Kinds that could stand for another in this form of recording."""
    alike = dict.fromkeys(name for group in ALIKE if kind in group for name in group)
    if setup.world not in ("exact", "shaken"):
        alike.pop("link_flexibility", None)
    return [name for name in alike if name != kind and setup.form in KINDS[name].forms]


def _alike(
    kind: str, place: Place, change: Array, others: tuple[Effect, ...], visibility: Visibility
) -> bool:
    """Whether an effect of another kind explains a change, tolerances beside it."""
    figures = visibility.setup.arm.figures
    base = visibility.change(others)
    shapes = []
    for k in range(3):  # of several shapes, for one may point elsewhere
        effect = drawn(kind, Spot(figures, place, np.random.default_rng(k)), 0.5)
        shapes.append(visibility.change((*others, effect)) - base)
        if len(effect.parameters) == 1:
            break
    if not all(np.all(np.isfinite(shape)) for shape in shapes):
        return False
    return visibility.score(change, shapes) < EQUAL


def draw_case(number: int, phrase: str = "") -> Case:
    """Draw a case by its number."""
    seed = seed_of(number, phrase)
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    world, role = world_of(number), role_of(number)
    for _ in range(TRIES):
        setup = draw_setup(world, role, rng)
        motions = draw_motions(setup, rng)
        effects: tuple[Effect, ...] = ()
        scores: tuple[float, ...] = ()
        accepted: tuple[Any, ...] = ()
        if role != "none":
            visibility = Visibility(setup, motions[-1], rng)
            tried = (draw_effects(role, setup, visibility, rng) for _ in range(6))
            drawn_now = next((each for each in tried if each is not None), None)
            if drawn_now is None:
                continue
            effects, scores = drawn_now
            if role != "outside":
                accepted = accepted_of(effects, setup, visibility)
        return Case(
            number=number, name=name_of(number, phrase), role=role, setup=setup, effects=effects,
            motions=motions, scores=scores, accepted=accepted, seed=seed,
        )  # fmt: skip
    raise RuntimeError(f"case {number}: no effects that can be seen in {TRIES} draws")


# ------------------------------------------------------------------------ recording and truth


def runs_of(case: Case) -> list[Run]:
    """Readings of a case with noise."""
    return [_run_of(case, i, motion) for i, motion in enumerate(case.motions)]


def _run_of(case: Case, number: int, motion: Motion) -> Run:
    setup, arm = case.setup, case.arm
    rng = np.random.default_rng(np.random.SeedSequence([*case.seed, 2, number]))
    readings = arm.assemble(number)[1]
    true = arm.run(motion, step=FINE, number=number)
    found = rounded(add_noise(true, setup.noise, rng), readings)
    joints = range(arm.figures.joints)
    sensors: dict[str, Any] = {}
    for j in joints:
        sensors[f"joint{j + 1}_pos"] = found.position[:, j]
        if setup.speeds:
            sensors[f"joint{j + 1}_vel"] = found.velocity[:, j]
    if setup.accelerometer:
        sensors[ACCELEROMETER] = found.acceleration
    torques = {f"joint{j + 1}": found.torque[:, j] for j in joints} if setup.torques else {}
    controls = {}
    if setup.form == SERVO:
        controls = {f"motor{j + 1}": motion.commands[:, j] for j in joints}
    if setup.garbage:
        part, _, name = setup.garbage.partition(".")
        columns = torques if part == "torque" else sensors
        columns[name] = _garbage(columns[name], rng)
    extra: dict[str, Any] = {}
    if motion.excited is not None and motion.pose is not None:
        extra["excited"] = (f"joint{motion.excited + 1}",)
        extra["pose"] = {f"joint{j + 1}": float(motion.pose[j]) for j in joints}
    time = np.arange(len(found.position), dtype=float) * motion.sample
    return Run(name=f"run-{number + 1:02d}", time=time, controls=controls, sensors=sensors,
               torques=torques, **extra)  # fmt: skip


def _garbage(values: Array, rng: np.random.Generator) -> Array:
    """A wire that hangs loose: a constant, a drift or noise."""
    size = float(np.std(values)) + 1e-6
    kind = int(rng.integers(3))
    if kind == 0:
        return np.full_like(values, rng.normal() * size)
    if kind == 1:
        drift = np.cumsum(rng.normal(size=len(values)))
        return np.asarray(drift * size / np.sqrt(len(values)))
    return np.asarray(rng.normal(size=len(values)) * 3 * size)


_ALONG: dict[str, dict[str, str]] = {
    "viscous_friction": {"damping": "damping"}, "rotor_inertia": {"inertia": "armature"},
    "link_mass": {"mass": "mass"}, "actuator_gain": {"gain": "kp"},
    "torque_constant": {"factor": "constant"}, "torque_offset": {"torque": "offset"},
    "link_com": {"x": "x", "y": "y", "z": "z"}, "encoder_offset": {"offset": "zero"},
    "command_delay": {"delay": "shift"},
}  # fmt: skip
"""Parameters that add to an error of the model, from which no data tell them apart."""


def _true_values(effect: Effect, setup: Setup) -> dict[str, float]:
    """Parameters that a result has too, with the error of the model that they add to."""
    j, factors = effect.place.index, setup.arm.factors
    link = setup.arm.figures.links[j]
    scale = {"offset": link.limit, **dict.fromkeys("xyz", link.length)}
    values = {}
    for name in KINDS[effect.kind].units:
        if name not in effect.parameters:
            continue
        value, error = float(effect.parameters[name]), _ALONG.get(effect.kind, {}).get(name)
        if error is not None:
            off = np.broadcast_to(getattr(factors, error), setup.arm.figures.joints)
            own = float(off[max(j, 0)])
            if name in ("gain", "factor"):
                value *= own
            elif error in ("damping", "armature", "mass"):
                value += (own - 1) * getattr(link, error)
            else:
                value += own * scale.get(error, 1.0)
        values[name] = value
    return values


def truth_of(case: Case) -> dict[str, Any]:
    """What is true of a case, as it is sealed."""
    setup, figures = case.setup, case.setup.arm.figures
    effects = []
    for i, effect in enumerate(case.effects):
        slide = effect.place.index >= 0 and figures.links[effect.place.index].kind == "slide"
        torque, way = ("N", "m") if slide else ("N·m", "rad")
        units = KINDS[effect.kind].units
        values = {
            name: {"value": value, "unit": units[name].replace("T", torque).replace("A", way)}
            for name, value in _true_values(effect, setup).items()
        }
        effects.append(
            {
                "kind": effect.kind, "where": effect.place.name, "index": effect.place.index,
                "values": values,
                "parameters": dict(effect.parameters), "visible": round(case.scores[i], 1),
                "accept": case.accepted[i] if case.accepted else (), "runs": list(effect.runs),
            }
        )  # fmt: skip
    neutral = [["command_interpolation", "*"]] if setup.straight and setup.form == SERVO else []
    factors = {
        f.name: np.broadcast_to(getattr(setup.arm.factors, f.name), figures.joints).tolist()
        for f in dataclasses.fields(Factors)
    }
    return {
        "format": FORMAT, "case": case.name, "number": case.number, "role": case.role,
        "world": setup.world, "form": setup.form, "machine": figures.name, "joints": figures.joints,
        "rate": 1 / setup.sample, "families": [motion.family for motion in case.motions],
        "link_side": setup.arm.link_side, "servo": setup.arm.servo,
        "straight": setup.straight, "coupled_wrist": setup.arm.coupling, "garbage": setup.garbage,
        "ignored": list(setup.ignored), "neutral": neutral, "effects": effects,
        "tolerances": TOLERANCES,
        "factors": factors,
        "noise": {
            "position": setup.noise.reading.tolist(), "velocity": setup.noise.velocity.tolist(),
            "acceleration": setup.noise.acceleration, "torque": setup.noise.torque.tolist(),
        },
    }  # fmt: skip


def write_case(case: Case, *, recordings: Path, truth: Path) -> Path:
    """Write a case's recording and its truth, the truth last; return the recording's folder."""
    if recordings.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise InvalidSetting(f"truth {truth} lies inside the recordings; keep it apart")
    setup, folder = case.setup, recordings / case.name
    model = model_xml(
        setup.arm.figures,
        drives="" if setup.form == FREE else "position",
        speeds=setup.speeds,
        accelerometer=setup.accelerometer,
        plain=setup.world not in ("exact", "shaken"),
    )
    write_recording(folder, model_xml=model, runs=runs_of(case), overwrite=True)
    write_text(truth / f"{case.name}.json", json.dumps(truth_of(case), indent=1) + "\n")
    return folder


def made(number: int, phrase: str, folder: Path) -> str:
    """Write a case into `recordings` and `truth` of a folder, unless it is there; its name."""
    name, parts = name_of(number, phrase), (folder / "recordings", folder / "truth")
    if not is_written(name, recordings=parts[0], truth=parts[1]):
        write_case(draw_case(number, phrase), recordings=parts[0], truth=parts[1])
    return name


def is_written(name: str, *, recordings: Path, truth: Path) -> bool:
    """Whether a case is there already, whole."""
    written = recordings / name / "recording.json"
    return (truth / f"{name}.json").is_file() and written.is_file()
