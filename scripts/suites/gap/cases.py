"""Cases of the gap suite by number: worlds, effects that can be seen, recordings, sealed truth.

A number below `FIRST_JUDGED` is for development. Those from there on are drawn from a phrase, so
that nobody has seen their cases before the phrase is chosen.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal
from scipy.optimize import lsq_linear

from loose_env.io import write_text
from loose_env.recording import Run, write_recording
from loose_env.typing import Array
from scripts.suites.blind import drawn_from
from scripts.suites.gap.arms import model_xml
from scripts.suites.gap.dynamics import NEUTRAL, RATIOS, Factors, Signals, System, needed
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
from scripts.suites.gap.worlds import (
    SHIFT,
    TOLERANCES,
    WORLDS,
    Motion,
    Setup,
    draw_motions,
    draw_setup,
    rounded,
)

SEED = 53_001  # seed of the development numbers
FORMAT = "gap-truth/2"  # format of a file of truth
_TURN = ("one", "two", "none", "one", "many", "one", "outside", "two", "none", "one")
"""What is missing in sixty successive numbers, ten for each world: nothing, one effect, two, four
to six, or one that the catalogue lacks."""
VISIBLE = 5.0
"""Standard deviations of its own scatter by which what an effect changes, and no model within
tolerances explains, exceeds the noise."""
EQUAL = 2.0
"""The same of what is left of it with another effect in its place, below which both are right."""
TRIES = 60  # draws until effects can be seen
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


Names = tuple[tuple[str, str], ...]  # kinds and places that together are a right answer


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn: everything that its recording is made of."""

    number: int
    phrase: str
    setup: Setup
    motions: tuple[Motion, ...]
    scores: tuple[float, ...]
    """How visible each effect is, in units of which `VISIBLE` is asked."""
    accepted: tuple[tuple[Names, ...], ...]
    """For each effect the sets of names that count as right."""


def seed_of(number: int, phrase: str = "") -> tuple[int, ...]:
    """Seed of a case; judged ones need a phrase."""
    return (drawn_from(number, phrase, SEED), number)


def name_of(number: int, phrase: str = "") -> str:
    """Name of a case's recording; it tells nothing."""
    seed = seed_of(number, phrase)
    return f"case-{hashlib.sha256(repr((seed, 'name')).encode()).hexdigest()[:8]}"


def world_of(number: int) -> str:
    """World of a case by its number."""
    return WORLDS[number % len(WORLDS)]


def role_of(number: int) -> str:
    """Role of a case by its number."""
    return _TURN[number // len(WORLDS) % len(_TURN)]


# ------------------------------------------------------------------------------- visibility

BAND = 20.0  # band in which torques are compared [Hz]
STEP = {"zero": 1e-4, "offset": 1e-3}
"""Step of a tolerance for a difference quotient, where it is not 0.002."""
FINE = 2e-4
"""Integration step of recordings [s], at most; the servos and gears here are ten times slower."""
COARSE = 1e-3  # integration step while effects are drawn [s]; recordings take a finer one
SMOOTH = 8e-3  # speed over which friction turns over then, at least [rad/s]
SEEN = 4.0  # length of the run by which effects are drawn [s]
THIN = 4
"""Of trajectories one sample in this many is looked at and counted for all: what effects do
changes little in between."""
Effects = tuple[Effect, ...]


class Visibility:
    """What effects change on one run of one machine, beyond noise and tolerances."""

    def __init__(self, setup: Setup, motion: Motion, rng: np.random.Generator) -> None:
        self.setup = setup
        most = round(SEEN / setup.sample) + (motion.release or 0)
        self.motion = dataclasses.replace(motion, commands=motion.commands[:most])
        self.balance = setup.form != SERVO
        self._scale = self._torque_noise(rng) if self.balance else np.ones(())
        self._base = self.features(())
        self.count = self._base.size * (1 if self.balance else THIN)
        columns, lows, highs = self._tolerances()
        lengths = np.linalg.norm(columns, axis=0)
        acts = lengths > 1e-9
        self._columns = columns[:, acts] / lengths[acts]
        self._low, self._high = lows[acts] * lengths[acts], highs[acts] * lengths[acts]

    def signals(self, effects: Effects = (), factors: Factors | None = None) -> Signals:
        """Readings without noise of the machine with effects, and with other factors."""
        factors = factors or self.setup.factors
        arm = dataclasses.replace(self.setup, effects=effects, factors=factors)
        return arm.run(self.motion, step=COARSE, settle=0.8)

    def features(self, effects: Effects, factors: Factors | None = None) -> Array:
        """Signals, or torques that are missing along the motion, in noise standard deviations."""
        # friction that turns over less abruptly needs fewer steps and shows the same
        rubbing = tuple(
            dataclasses.replace(e, parameters={**e.parameters, "smooth_speed": SMOOTH})
            if e.parameters.get("smooth_speed", SMOOTH) < SMOOTH
            else e
            for e in effects
        )
        setup, noise = self.setup, self.setup.noise
        if self.balance:
            return self._missing(self.signals(rubbing), self.setup.factors)
        found = self.signals(rubbing, factors)
        parts = [np.delete(found.position / noise.reading, setup.spoiled, axis=1)]
        parts += [found.velocity / noise.velocity] * setup.speeds
        parts += [found.acceleration / noise.acceleration] * setup.accelerometer
        return np.asarray(np.sqrt(THIN) * np.hstack(parts)[::THIN]).ravel()

    def _missing(self, found: Signals, factors: Factors) -> Array:
        return np.asarray((self._lacking(found, factors) / self._scale).ravel())

    def _lacking(self, found: Signals, factors: Factors, smooth: bool = False) -> Array:
        """Torque logged (none, swinging freely) less what the machine needs for the motion."""
        sample, machine = self.setup.sample, self.setup.machine
        system = System.build(machine, factors)
        q, v, a = found.position - factors["zero"], found.velocity, found.joint_acceleration
        band = min(BAND, 0.2 / sample)
        low = signal.butter(4, band, fs=1 / sample, output="sos")
        if smooth:
            q = signal.sosfiltfilt(low, q, axis=0)
            v = np.gradient(q, sample, axis=0)
            a = np.gradient(v, sample, axis=0)
        moved = (np.ascontiguousarray(x, dtype=float) for x in (q, v, a))
        torque = -needed(system.bodies, system.laws["damping"].copy(), system.gravity, *moved)
        if self.setup.form == TORQUE:
            torque += (found.torque - factors["offset"] * machine.limit) / factors["constant"]
        rest = signal.sosfiltfilt(low, torque, axis=0)
        thin = max(1, round(0.5 / band / sample))
        return np.delete(rest[2 * thin : -2 * thin : thin], self.setup.spoiled, axis=1)

    def _torque_noise(self, rng: np.random.Generator) -> Array:
        clean = self.signals()
        both = (self.setup.noise.added(clean, rng), clean)
        moved = [self._lacking(each, self.setup.factors, smooth=True) for each in both]
        return np.asarray((moved[0] - moved[1]).std(axis=0))

    def _tolerances(self) -> tuple[Array, Array, Array]:
        """Changes of the features by every parameter of the model, and how far each may go."""
        factors, n = self.setup.factors, self.setup.machine.joints
        absent = {"kp", "kv"} if self.balance else set()
        absent |= {"constant", "offset"} if self.setup.form != TORQUE else set()
        motion = self.signals()
        columns, lows, highs = [], [], []

        def add(name: str, joints: Any, step: float, low: float, high: float) -> None:
            moved = {**factors, name: factors[name].copy()}
            moved[name][joints] += step
            found = self._missing(motion, moved) if self.balance else self.features((), moved)
            columns.append((found - self._base) / step)
            lows.append(low)
            highs.append(high)

        for name, most in TOLERANCES.items():
            for j in range(n if name not in absent else 0):
                off = float(factors[name][j]) - NEUTRAL[name]
                # a parameter of the model less that of the arm; forces along a motion change sign
                middle = off if self.balance else -off
                step = STEP.get(name, 2e-3)
                add(name, j, step, min(middle - most, 0.0), max(middle + most, 0.0))
        if self.setup.form == SERVO:
            late = 2 * SHIFT * self.setup.sample
            add("shift", slice(None), 0.02 * self.setup.sample, -late, late)
        return np.stack(columns, axis=1), np.array(lows), np.array(highs)

    def change(self, effects: Effects) -> Array:
        """What effects change, in standard deviations, of shape (features,)."""
        return self.features(effects) - self._base

    def score(self, change: Array, others: Sequence[Array] = ()) -> float:
        """What no tolerance and no multiple of other changes explains, in its own scatter."""
        if not np.all(np.isfinite(change)):
            return 0.0
        free = [c / max(float(np.linalg.norm(c)), 1e-9) for c in others]
        bound = np.full(len(free), np.inf)
        q, r = np.linalg.qr(np.column_stack([self._columns, *free]))
        inside = q.T @ change
        low, high = np.concatenate((self._low, -bound)), np.concatenate((self._high, bound))
        rest = max(float(change @ change - inside @ inside), 0.0)
        excess = rest + 2 * float(lsq_linear(r, inside, bounds=(low, high), method="bvls").cost)
        return float(excess / np.sqrt(2 * self.count + 4 * excess))

    def scores(self, effects: Effects) -> list[float]:
        """How visible each effect is beside the others, any size of which is possible."""
        whole = self.change(effects)
        changes = [whole - self.change(_without(effects, i)) for i in range(len(effects))]
        return [self.score(each, _without(changes, i)) for i, each in enumerate(changes)]

    def examples(self, kind: str, place: Place, others: Effects) -> Iterator[tuple[Effect, Array]]:
        """Examples of a kind, and what they change with other effects beside them."""
        for k in range(3):
            effect = drawn(kind, Spot(self.setup.machine, place, np.random.default_rng(k)), 0.5)
            yield effect, self.change((*others, effect))


def _without(values: Any, left_out: int) -> Any:
    return tuple(each for i, each in enumerate(values) if i != left_out)


# ----------------------------------------------------------------------------- what is missing


def _wanted(role: str, setup: Setup, rng: np.random.Generator) -> list[str]:
    """Kinds for a role that this recording can show."""
    lacking = set() if setup.accelerometer else {"sensor_misalignment"}
    if not setup.ideal:
        # a slow log has nothing of impacts, and a link cannot be cut whose inertia is far off
        lacking |= {"structural_looseness", "link_flexibility"}
    if setup.form == FREE:
        lacking |= {"friction_behind_slack"}
    if setup.straight or setup.sample < 4e-3:
        lacking |= {"command_interpolation"}
    known = OUTSIDE if role == "outside" else CATALOGUE
    can = [name for name in known if KINDS[name].shown_by(setup.form) and name not in lacking]
    if role == "two":
        return [str(name) for name in rng.choice(can, 4, replace=False)]
    if role == "many":
        count = int(rng.integers(4, 7))
        rubbing = [name for name in FRICTIONS if name in can]
        others = [name for name in can if name not in FRICTIONS]
        first = int(rng.integers(2, count))
        rest = [str(name) for name in rng.choice(others, 5, replace=False)]
        return [str(rng.choice(rubbing)) for _ in range(first)] + rest
    return [str(rng.choice(can))]


def _seen(name: str, setup: Setup) -> list[Place]:
    """Places of a kind where it can be seen and judged."""

    def recorded(place: Place) -> bool:
        if place.name.endswith("_vel"):
            return setup.speeds and f"sensor.{place.name}" != setup.garbage
        if place.name == ACCELEROMETER:
            return setup.accelerometer
        return place.index not in setup.spoiled

    return [place for place in KINDS[name].places(setup.machine) if recorded(place)]


def _placed(name: str, found: Effects, setup: Setup, rng: np.random.Generator) -> Effect | None:
    """An effect at a place that is free for it, if there is one."""
    places = _seen(name, setup)
    for each in found:
        # viscous and dry friction at a joint are usual; else two could be one behind another
        both = {each.kind, name}
        if not (both <= set(FRICTIONS) and len(both) == 2 and "viscous_friction" in both):
            places = [p for p in places if p.index != each.place.index]
        if each.kind == name and -1 in (each.place.index, *(p.index for p in places)):
            places = []
    if not places:
        return None
    return drawn(name, Spot(setup.machine, places[int(rng.integers(len(places)))], rng))


def draw_effects(
    role: str, setup: Setup, visibility: Visibility, rng: np.random.Generator
) -> tuple[Effects, tuple[float, ...]] | None:
    """Effects that can be seen beside each other, and how well; None where they cannot."""
    least, most = {"two": (2, 2), "many": (4, int(rng.integers(4, 7)))}.get(role, (1, 1))
    effects: Effects = ()
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
    scores = visibility.scores(effects)
    while effects and min(scores) < VISIBLE:
        effects = _without(effects, int(np.argmin(scores)))
        scores = visibility.scores(effects)
    if len(effects) < least:
        return None
    if role == "one" and effects[0].kind == "payload" and rng.random() < 0.3:
        effects = (dataclasses.replace(effects[0], runs=(1, 3)),)
    return effects, tuple(scores)


WILD = 0.4  # share of a joint's half range by which a machine that still works is off, at most


def _sane(effects: Effects, visibility: Visibility) -> bool:
    """Whether the machine still goes where it is told."""
    off = np.abs(visibility.signals(effects).position - visibility.motion.commands).max(axis=0)
    return bool((off < WILD * visibility.setup.machine.reach).all())


RIVALS = {
    "warming_friction": ("coulomb_friction", "viscous_friction", "load_friction"),
    "cable_coupling": ("joint_spring", "encoder_offset"),
    "voltage_sag": ("actuator_gain",),
    "tight_spots": ("coulomb_friction", "asymmetric_friction", "torque_ripple"),
}
"""What of the catalogue may explain most of an effect that it lacks."""


def _rivals(effect: Effect, visibility: Visibility) -> list[Array]:
    """Changes with kinds of the catalogue that could stand for one from outside."""
    j, found = effect.place.index, []
    for name in RIVALS.get(effect.kind, ()):
        if KINDS[name].shown_by(visibility.setup.form):
            for place in KINDS[name].places(visibility.setup.machine):
                if j < 0 or place.index in (j, effect.parameters.get("other", j)):
                    examples = visibility.examples(name, place, ())
                    found += [change for _, change in islice(examples, 2)]
    return found


def accepted_of(
    effects: Effects, setup: Setup, visibility: Visibility
) -> tuple[tuple[Names, ...], ...]:
    """For each effect the sets of kinds and places that are as right as its own."""
    seen = tuple(dataclasses.replace(e, runs=()) for e in effects)
    whole, found = visibility.change(seen), []
    for i, effect in enumerate(seen):
        others = _without(seen, i)
        base = visibility.change(others)
        sets = _by_rule(effect, setup)
        for name, place in _near(effect, setup):
            if ((name, place.name),) not in sets:
                shapes = []
                for example, change in visibility.examples(name, place, others):
                    shapes.append(change - base)
                    if len(example.parameters) == 1:  # others may point elsewhere
                        break
                finite = all(np.all(np.isfinite(shape)) for shape in shapes)
                if finite and visibility.score(whole - base, shapes) < EQUAL:
                    sets.append(((name, place.name),))
        found.append(tuple(sets))
    return tuple(found)


def _by_rule(effect: Effect, setup: Setup) -> list[Names]:
    """Sets of names that stand for an effect whatever the motion."""
    kind, where, j, n = effect.kind, effect.place.name, effect.place.index, setup.machine.joints
    sets: list[Names] = [((kind, where),)]
    if where == "all":
        sets.append(tuple((kind, f"motor{k + 1}") for k in range(n)))
    if kind == "asymmetric_friction":
        sets.append((("coulomb_friction", where), ("torque_offset", where)))
    if kind == "torque_constant":
        # without commands a drive that gives more than it reads is the same
        sets.append((("actuator_gain", f"motor{j + 1}"),))
    if kind in ("payload", "link_mass", "link_com") and j == n - 1:
        tip = (("payload", "tool"), ("link_mass", f"link{n}"), ("link_com", f"link{n}"))
        sets += [(name,) for name in tip if name != (kind, where)]
    return sets


def _near(effect: Effect, setup: Setup) -> Iterator[tuple[str, Place]]:
    """Other kinds and places that could stand for an effect in this form of recording."""
    kind, where, j = effect.kind, effect.place.name, effect.place.index
    for name in dict.fromkeys(name for group in ALIKE if kind in group for name in group):
        cut = name == "link_flexibility" and not setup.ideal
        if name != kind and not cut and KINDS[name].shown_by(setup.form):
            for place in _seen(name, setup):
                if place.index in (j, -1) or where in ("all", "base", ACCELEROMETER):
                    yield name, place


def draw_case(number: int, phrase: str = "") -> Case:
    """Draw a case by its number."""
    rng = np.random.default_rng(np.random.SeedSequence(seed_of(number, phrase)))
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
            number=number, phrase=phrase, setup=dataclasses.replace(setup, effects=effects),
            motions=motions, scores=scores, accepted=accepted,
        )  # fmt: skip
    raise RuntimeError(f"case {number}: no effects that can be seen in {TRIES} draws")


# ------------------------------------------------------------------------ recording and truth


def runs_of(case: Case) -> list[Run]:
    """Readings of a case with noise."""
    return [_run_of(case, i, motion) for i, motion in enumerate(case.motions)]


def _run_of(case: Case, number: int, motion: Motion) -> Run:
    setup = case.setup
    rng = np.random.default_rng(
        np.random.SeedSequence([*seed_of(case.number, case.phrase), 2, number])
    )
    true = setup.run(motion, step=FINE, number=number)
    found = rounded(setup.noise.added(true, rng), setup.assemble(number))

    def columns(name: str, values: Array) -> dict[str, Array]:
        return {name.format(j + 1): column for j, column in enumerate(values.T)}

    sensors: dict[str, Array] = columns("joint{}_pos", found.position)
    sensors |= columns("joint{}_vel", found.velocity) if setup.speeds else {}
    sensors |= {ACCELEROMETER: found.acceleration} if setup.accelerometer else {}
    torques = columns("joint{}", found.torque) if setup.torques else {}
    if setup.garbage:
        part, _, name = setup.garbage.partition(".")
        own = torques if part == "torque" else sensors
        own[name] = _garbage(own[name], rng)
    extra: dict[str, Any] = {}
    if motion.excited is not None and motion.pose is not None:
        extra["excited"] = (f"joint{motion.excited + 1}",)
        extra["pose"] = {f"joint{j + 1}": float(q) for j, q in enumerate(motion.pose)}
    return Run(
        name=f"run-{number + 1:02d}",
        time=np.arange(len(found.position), dtype=float) * setup.sample,
        controls=columns("motor{}", motion.commands) if setup.form == SERVO else {},
        sensors=sensors, torques=torques, **extra,
    )  # fmt: skip


def _garbage(values: Array, rng: np.random.Generator) -> Array:
    """A wire that hangs loose: a constant, a drift or noise."""
    size, count = float(np.std(values)) + 1e-6, len(values)
    kind = int(rng.integers(3))
    if kind == 0:
        return np.full_like(values, rng.normal() * size)
    if kind == 1:
        return np.asarray(np.cumsum(rng.normal(size=count)) * size / np.sqrt(count))
    return np.asarray(rng.normal(size=count) * 3 * size)


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
    j, link = effect.place.index, setup.machine.link(effect.place.index)
    scale = {"offset": link.limit, **dict.fromkeys("xyz", link.length)}
    values = {}
    for name in KINDS[effect.kind].units:
        if name not in effect.parameters:
            continue
        value, error = float(effect.parameters[name]), _ALONG.get(effect.kind, {}).get(name)
        if error is not None:
            own = float(setup.factors[error][max(j, 0)])
            if name in ("gain", "factor"):
                value *= own
            elif error in RATIOS:
                value += (own - 1) * getattr(link, error)
            else:
                value += own * scale.get(error, 1.0)
        values[name] = value
    return values


def _effect_of(case: Case, i: int) -> dict[str, Any]:
    """What is true of an effect."""
    effect, units = case.setup.effects[i], KINDS[case.setup.effects[i].kind].units
    slide = effect.place.index >= 0 and case.setup.machine.slide[effect.place.index]
    torque, way = ("N", "m") if slide else ("N·m", "rad")
    return {
        "kind": effect.kind, "where": effect.place.name, "index": effect.place.index,
        "values": {
            name: {"value": value, "unit": units[name].replace("T", torque).replace("A", way)}
            for name, value in _true_values(effect, case.setup).items()
        },
        "parameters": dict(effect.parameters), "visible": round(case.scores[i], 1),
        "accept": case.accepted[i] if case.accepted else (), "runs": list(effect.runs),
    }  # fmt: skip


def truth_of(case: Case) -> dict[str, Any]:
    """What is true of a case, as it is sealed."""
    setup, noise = case.setup, case.setup.noise
    neutral = [["command_interpolation", "*"]] if setup.straight and setup.form == SERVO else []
    return {
        "format": FORMAT, "case": name_of(case.number, case.phrase), "number": case.number,
        "role": role_of(case.number),
        "world": setup.world, "form": setup.form, "machine": setup.machine.name,
        "joints": setup.machine.joints, "rate": 1 / setup.sample,
        "families": [motion.family for motion in case.motions],
        "link_side": setup.link_side, "servo": setup.servo, "straight": setup.straight,
        "coupled_wrist": setup.coupling, "garbage": setup.garbage, "ignored": list(setup.ignored),
        "neutral": neutral, "effects": [_effect_of(case, i) for i in range(len(setup.effects))],
        "tolerances": TOLERANCES,
        "factors": {name: values.tolist() for name, values in setup.factors.items()},
        "noise": {
            "position": noise.reading.tolist(), "velocity": noise.velocity.tolist(),
            "acceleration": noise.acceleration, "torque": noise.torque.tolist(),
        },
    }  # fmt: skip


def write_case(case: Case, folder: Path) -> None:
    """Write a case into `recordings` and `truth` of a folder, the truth last."""
    setup, name = case.setup, name_of(case.number, case.phrase)
    model = model_xml(
        setup.machine, servos=setup.form != FREE, speeds=setup.speeds,
        accelerometer=setup.accelerometer, plain=not setup.ideal,
    )  # fmt: skip
    write_recording(
        folder / "recordings" / name, model_xml=model, runs=runs_of(case), overwrite=True
    )
    sealed = json.dumps(truth_of(case), indent=1) + "\n"
    write_text(folder / "truth" / f"{name}.json", sealed)


def made(number: int, phrase: str, folder: Path) -> str:
    """Write a case into a folder unless it is there, whole; its name."""
    name = name_of(number, phrase)
    recording = folder / "recordings" / name / "recording.json"
    if not (recording.is_file() and (folder / "truth" / f"{name}.json").is_file()):
        write_case(draw_case(number, phrase), folder)
    return name
