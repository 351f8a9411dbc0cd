"""Machines in worlds: errors of their models, motions, simulated runs, sensors and their noise."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import signal

from loose_env.typing import Array
from scripts.suites.gap.arms import GRAVITY, MACHINES, Machine, varied
from scripts.suites.gap.dynamics import NEUTRAL, RATIOS, Factors, Signals, System, exactly
from scripts.suites.gap.effects import (
    ACCELEROMETER,
    FREE,
    SERVO,
    TORQUE,
    Effect,
    apply_effect,
)

SAMPLE = 1e-3  # time between two samples where a log has no rate of its own [s]
WORLDS = ("exact", "servo", "torque", "free", "rough", "shaken")
"""Worlds, by the number's remainder."""
IDEAL = ("exact", "shaken")
"""Those in which a model is exact but for small errors of its scales."""
TOLERANCES = {
    "mass": 0.04, "inertia": 0.20, "armature": 0.20, "damping": 0.10, "kp": 0.04, "kv": 0.10,
    "x": 0.03, "y": 0.03, "z": 0.03, "zero": 1e-3, "constant": 0.04, "offset": 0.006,
}  # fmt: skip
"""Largest error of a model: shares, centres as shares of the link's length, zeros [rad, m], torques
as shares of the limit. A model errs by half of that, a standard deviation, and never by more."""
SHIFT = 0.5  # largest shift of the commands [samples], of either sign
FADE = 0.6  # time over which a motion grows from rest [s]
EFFORT = 0.55  # share of a drive's limit that the largest acceleration commanded may take


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """One run's commands."""

    commands: Array  # Positions commanded, of shape (T, n) [rad or m]
    release: int | None = None
    """Sample at which the drives go off and the recording starts; with drives if not given."""
    excited: int | None = None  # Joint that is shaken, counted from 0
    pose: Array | None = None  # Pose held, of shape (n,)
    family: str = ""  # A word for the motion


def _minimum_jerk(x: Any) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x * x))


def _multisine(rng: np.random.Generator, time: Array) -> Array:
    frequencies = np.exp(rng.uniform(np.log(0.1), np.log(min(4.0, 0.1 / time[1])), 9))
    phases = rng.uniform(-np.pi, np.pi, 9)
    out = np.sin(2 * np.pi * time[:, None] * frequencies + phases) @ frequencies**-0.8
    return np.asarray(out / np.abs(out).max())


def _reversals(rng: np.random.Generator, time: Array) -> Array:
    # slow ramps to and fro, with a small fast part on top in the second half
    period = float(np.exp(rng.uniform(np.log(1.5), np.log(6.0))))
    triangle = signal.sawtooth(2 * np.pi * (time / period + rng.random()), 0.5)
    window = np.hanning(round(rng.uniform(0.12, 0.4) / time[1]) + 3)
    smooth = np.convolve(np.pad(triangle, len(window), mode="edge"), window / window.sum())
    smooth = smooth[len(window) + len(window) // 2 :][: len(time)]
    quick = np.sin(2 * np.pi * rng.uniform(1.0, 3.0) * time) * (time > time[-1] / 2)
    return np.asarray(0.8 * smooth + 0.2 * quick * _minimum_jerk(2 * time - time[-1]))


def _steps(rng: np.random.Generator, time: Array) -> Array:
    """Moves between random targets with minimum jerk, with holds between them."""
    out, now, here = np.zeros(len(time)), 0.0, 0.0
    at = rng.uniform(0.0, 0.8)
    while now < time[-1]:
        target = rng.uniform(-1.0, 1.0)
        if abs(target - here) < 0.3:
            target = here - np.sign(here + 1e-9) * rng.uniform(0.4, 1.0)
        lasting = float(np.exp(rng.uniform(np.log(0.2), np.log(1.2))))
        lasting *= 0.5 + abs(target - here) / 2
        out += (target - here) * _minimum_jerk((time - at) / lasting)
        here, now = target, at + lasting
        at = now + rng.uniform(0.0, 0.8)
    return out


def _chirp(rng: np.random.Generator, time: Array) -> Array:
    low, high = rng.uniform(0.15, 0.4), min(rng.uniform(6.0, 12.0), 0.1 / time[1])
    if rng.random() < 0.5:
        low, high = high, low
    sweep = np.log(high / low) / time[-1]
    phase = 2 * np.pi * low * (np.exp(sweep * time) - 1) / sweep
    frequency = low * np.exp(sweep * time)
    # an even sweep of accelerations would hardly move; one of positions would hit the limits
    out = np.sin(phase + rng.uniform(-np.pi, np.pi)) / (1 + (frequency / 0.8) ** 1.5)
    out += 0.35 * np.sin(2 * np.pi * rng.uniform(0.1, 0.25) * time + rng.uniform(0, 6))
    return np.asarray(out)


FAMILIES = {
    "multisine": _multisine, "reversals": _reversals, "steps": _steps, "chirp": _chirp,
}  # fmt: skip
"""Families of motion, one a run."""


def rich_motion(
    rng: np.random.Generator, machine: Machine, *, family: str, seconds: float, sample: float
) -> Motion:
    """Commands that move all joints at once, growing from rest."""
    n, time = machine.joints, np.asarray(np.arange(round(seconds / sample)) * sample)
    shape = np.stack([FAMILIES[family](rng, time) for _ in range(n)], axis=1)
    shape = (shape - shape[0]) * _minimum_jerk(time / FADE)[:, None]
    shape /= np.maximum(np.abs(shape).max(axis=0), 1e-9)
    start = machine.home + machine.reach * rng.uniform(-0.2, 0.2, n)
    sizes = machine.reach * rng.uniform(0.55, 0.9, n)
    inertia = np.diag(System.build(machine, exactly(n)).at_rest(machine.home)[0])
    sharpest = np.abs(np.gradient(np.gradient(shape, sample, axis=0), sample, axis=0)).max(axis=0)
    sizes = np.minimum(sizes, machine.limit * EFFORT / inertia / np.maximum(sharpest, 1e-9))
    return Motion(commands=start + shape * sizes, family=family)


def shaken_motion(
    rng: np.random.Generator, machine: Machine, *, joint: int, seconds: float
) -> Motion:
    """A held pose with band-limited Gaussian noise on one joint's command."""
    samples, link = round(seconds / SAMPLE), machine.link(joint)
    pose = machine.home + machine.reach * rng.uniform(-0.8, 0.8, machine.joints)
    band = signal.butter(4, (4.0, rng.uniform(60.0, 120.0)), "bandpass", fs=1 / SAMPLE,
                         output="sos")  # fmt: skip
    noise = signal.sosfilt(band, rng.normal(size=samples + 1000))[1000:]
    level = float(np.exp(rng.uniform(np.log(0.06), np.log(0.2)))) * link.limit / link.kp
    commands = np.tile(pose, (samples, 1))
    swell = _minimum_jerk(np.arange(samples) * SAMPLE / 0.3)
    commands[:, joint] += level * noise / noise.std() * swell
    return Motion(commands=commands, excited=joint, pose=pose, family="shaken")


def free_motion(
    rng: np.random.Generator, machine: Machine, *, seconds: float, sample: float
) -> Motion:
    """An arm that hangs, is swung by its drives and let go while it moves."""
    swing, n = 1.5, machine.joints
    time = np.arange(round((swing + seconds) / sample)) * sample
    phases, rates = rng.uniform(-np.pi, np.pi, n), rng.uniform(0.5, 1.2, n)
    sizes = rng.uniform(0.3, 0.7, n)
    wave = np.sin(2 * np.pi * rates * time[:, None] + phases) - np.sin(phases)
    commands = machine.hanging + sizes * wave * _minimum_jerk(time / 1.0)[:, None]
    return Motion(commands=commands, release=round(swing / sample), family="free")


SLIDE_SCALE = 0.05
"""Metres of a slide that count like a radian of a hinge for the steps of its encoder."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Noise:
    """White noise of a recording's sensors, standard deviations."""

    step: Array  # Steps of the encoders, of shape (n,) [rad or m]
    position: Array  # Noise of the encoders before their steps, of shape (n,)
    velocity: Array  # Noise of the tachometers, of shape (n,) [rad/s or m/s]
    acceleration: float  # Noise of an axis of the accelerometer [m/s²]
    torque: Array  # Noise of the measured torques, of shape (n,) [N m or N]

    @classmethod
    def draw(cls, machine: Machine, rng: np.random.Generator, sample: float) -> Noise:
        """Encoders of 14 to 17 bits, accelerometers of 150 to 300 µg/√Hz."""
        scale = np.where(machine.slide, SLIDE_SCALE, 1.0)
        step = 2 * np.pi / 2.0 ** rng.integers(14, 18) * scale
        density = rng.uniform(150e-6, 300e-6) * GRAVITY
        return cls(
            step=step,
            position=step * rng.uniform(0.4, 0.8),
            velocity=rng.uniform(1e-3, 4e-3) * scale,
            acceleration=float(density * np.sqrt(0.5 / sample)),
            torque=rng.uniform(0.002, 0.006) * machine.limit,
        )

    @property
    def reading(self) -> Array:
        """Standard deviation of a position as read, noise and steps, of shape (n,)."""
        return np.sqrt(self.position**2 + self.step**2 / 12)

    def added(self, signals: Signals, rng: np.random.Generator) -> Signals:
        """Readings with noise and steps."""
        names = ("position", "velocity", "acceleration", "torque")
        noisy = {
            name: value + getattr(self, name) * rng.normal(size=value.shape)
            for name, value in signals._asdict().items()
            if name in names
        }
        noisy["position"] = self.step * np.round(noisy["position"] / self.step)
        return signals._replace(**noisy)


def _read(trace: Signals, system: System, *, inside: int, sample: float) -> Signals:
    """Readings without noise; a trace has so many steps in a sample."""

    def taken(name: str, values: Array) -> Array:
        # a sensor that is late reads what was there between the samples
        late = system.sensors["delay"].get(name, 0.0) / sample * inside
        if late:
            at, grid = np.arange(0, len(values), inside) - late, np.arange(len(values))
            values = np.stack([np.interp(at, grid, column) for column in values.T], axis=1)
        else:
            values = values[::inside]
        if name == ACCELEROMETER:
            values = values @ system.rotation.T
        gain, bias = system.sensors["gain"], system.sensors["bias"]
        return np.asarray(values * gain.get(name, 1.0) + bias.get(name, 0.0))

    def joints(word: str, values: Array) -> Array:
        columns = (values[:, [j]] for j in range(values.shape[1]))
        return np.hstack([taken(f"joint{j + 1}_{word}", x) for j, x in enumerate(columns)])

    found = Signals(
        position=joints("pos", trace.position),
        velocity=joints("vel", trace.velocity),
        acceleration=taken(ACCELEROMETER, trace.acceleration),
        torque=trace.torque[::inside] * system.torque_gain + system.torque_offset,
        joint_acceleration=trace.joint_acceleration[::inside],
    )
    return rounded(found, system)


def rounded(signals: Signals, system: System) -> Signals:
    """Readings of coarse encoders at whole steps."""
    position = signals.position.copy()
    for sensor, step in system.sensors["step"].items():
        column = position[:, int(sensor.removeprefix("joint").removesuffix("_pos")) - 1]
        column[:] = step * np.round(column / step)
    return signals._replace(position=position)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """A machine in a world: nominal parameters times factors, with effects, and its recorder."""

    machine: Machine
    factors: Factors
    effects: tuple[Effect, ...] = ()
    link_side: bool = False
    """Whether encoders are on the links' side of gears that are soft or have play."""
    servo: tuple[float, float, float] | None = None
    """Rate [Hz], delay in its samples (0 or 1) and share of a new velocity of sampled drives."""
    coupling: tuple[float, float, float] | None = None
    """Ratio, friction and rotor of the last motor, if it turns with the joint before too."""
    straight: bool = False
    """Whether the drives go in straight lines from command to command; they hold each if not."""
    world: str = IDEAL[0]
    form: str = SERVO  # Form of the recording
    sample: float = SAMPLE  # Time between two samples of the log [s]
    noise: Noise
    speeds: bool = True  # Whether velocities are recorded
    accelerometer: bool = False  # Whether the tool has one
    torques: bool = False  # Whether torques are recorded
    garbage: str = ""  # Column that says nothing
    ignored: tuple[str, ...] = ()
    """Places of which answers count neither for nor against a tool."""
    spoiled: tuple[int, ...] = ()  # Joints where no effect is put

    @property
    def ideal(self) -> bool:
        """Whether the model is exact but for small errors of its scales."""
        return self.world in IDEAL

    def assemble(self, run: int | None = None) -> System:
        """The arm and its sensors as they are in a run."""
        system, n = System.build(self.machine, self.factors), self.machine.joints
        if self.coupling is not None:
            ratio, friction, rotor = self.coupling
            system.cable[:] = (n - 1, n - 2, ratio, 0.0, 0.0, friction, rotor)
        for effect in self.effects:
            if run is None or not effect.runs or run in effect.runs:
                apply_effect(effect, system, self.machine)
        if self.link_side:
            soft = (system.proximal != system.joint_dofs) & ~system.slides[system.proximal]
            system.drives["link_side"] = np.where(soft, system.proximal, -1)
        return system

    def run(
        self, motion: Motion, *, step: float = 1e-4, settle: float = 1.2, number: int | None = None
    ) -> Signals:
        """Readings of one run without noise, integrated in steps of this length at most."""
        system, sample = self.assemble(number), self.sample
        inside = _steps_inside(system, self.machine, max(1, round(sample / step)), sample)
        servo = (0, 0.0, 1.0)
        if self.servo is not None and motion.release is None:
            rate, late, smoothing = self.servo
            servo = (max(1, round(inside / sample / rate)), late, smoothing)
        fine = bool(system.sensors["delay"])
        trace = system.simulate(
            motion.commands, sample=sample, inside=inside, settle=settle, release=motion.release,
            fine=fine, straight=self.straight or system.straight, servo=servo,
        )  # fmt: skip
        signals = _read(trace, system, inside=inside if fine else 1, sample=sample)
        if self.coupling is not None:  # the drives' own torques are logged
            signals.torque[:, -2] -= self.coupling[0] * signals.torque[:, -1]
        return Signals(*(values[motion.release or 0 :] for values in signals))


STOP_FORCE = 100.0  # force of a blow on the stops of a slide by which the steps are chosen [N]


def _steps_inside(system: System, machine: Machine, least: int, sample: float) -> int:
    """Steps in a sample that the stiffest law of an arm needs."""
    step, needed, joints = sample / least, 1.0, system.joint_dofs
    for dof, law in enumerate(system.laws):
        j = int(np.sum(joints <= dof)) - 1
        slide = system.slides[dof] and dof not in joints
        load = STOP_FORCE if slide else 0.6 * machine.limit[max(j, 0)]
        felt = system.felt_inertia(dof, machine.home)
        rate, stiffness = law["damping"] + law["extra"], law["stiffness"]
        if law["slack_force"] > 0:
            stiffness += law["slack_force"] / law["elastic"]
        if law["friction"] > 0:
            rate += law["friction"] * (1 + law["bump"]) / law["smooth_speed"]
        drive = system.drives[j]
        if dof in joints and drive["loaded"] > 0:
            slope = drive["loaded"] * (1 + drive["loaded_bump"]) / drive["loaded_smooth"]
            rate += 0.6 * machine.limit[j] * slope
        if law["hertz"] > 0:
            stiffness += 1.5 * law["hertz"] * (load / law["hertz"]) ** (1 / 3)
            rate += load * law["crossley"]
        needed = max(needed, rate / felt * step / 1.2, np.sqrt(stiffness / felt) * step / 0.6)
    return least * int(np.ceil(needed - 1e-9))


# ---------------------------------------------------------------------------------- draws


def _slight(rng: np.random.Generator, n: int) -> Factors:
    """Errors of 1 to 3 % and of random sign of all but centres, zeros and times."""
    off = {name: rng.uniform(0.01, 0.03, n) * rng.choice([-1, 1], n) for name in RATIOS}
    return exactly(n) | {name: 1 + each for name, each in off.items()}


def _errors(rng: np.random.Generator, machine: Machine, sample: float, shift: bool) -> Factors:
    """What a model of a real machine never has exactly."""

    def off(*names: str) -> Factors:
        draws = {name: np.clip(rng.normal(scale=0.5, size=n), -1, 1) for name in names}
        return {name: NEUTRAL[name] + each * TOLERANCES[name] for name, each in draws.items()}

    n, scale = machine.joints, np.where(machine.slide, SLIDE_SCALE, 1.0)
    found = off(*RATIOS[:4], "kp", "kv", "constant", "x", "y", "z", "offset")
    late = rng.uniform(-SHIFT, SHIFT) * sample if shift else 0.0
    return exactly(n) | found | {"shift": np.full(n, late), "zero": off("zero")["zero"] * scale}


def _servo(rng: np.random.Generator, log: float) -> tuple[float, float, float]:
    """A drive's own rate [Hz], so far above the log's that no delay of it counts."""
    rate = float(rng.choice([r for r in (1000.0, 2000.0, 4000.0, 8000.0) if r >= 4 * log]))
    late = float(rng.integers(0, 2)) if rate >= 8 * log else 0.0
    return rate, late, float(rng.uniform(0.5, 1.0))


def draw_setup(world: str, role: str, rng: np.random.Generator) -> Setup:
    """A machine in a world, with nothing missing yet."""
    small = {"many": 3, "two": 2}.get(role, 1)  # so many effects need that many joints
    names = [name for name, machine in MACHINES.items() if machine.joints >= small]
    chance = rng.random(6)
    form = {"torque": TORQUE, "free": FREE}.get(world, SERVO)
    trouble = ""
    if world == "rough":
        form = SERVO if chance[0] < 0.5 else TORQUE
        trouble = "garbage" if chance[1] < 0.4 else "wrist" if chance[1] < 0.7 else "slow"
    if world == "shaken":
        names = ["planar3", "spatial3", "scara4", "elbow4"]
    if trouble == "wrist":
        names = ["upright6", "redundant7", "elbow4"]
    if form == FREE:
        names = [name for name in names if MACHINES[name].hanging is not None]
        names += ["rig1"] * (2 if small == 1 else 0)
    machine = varied(MACHINES[str(rng.choice(names))], rng)
    n = machine.joints
    if world in IDEAL:
        return Setup(world=world, machine=machine, factors=_slight(rng, n), accelerometer=True,
                     noise=Noise.draw(machine, rng, SAMPLE))  # fmt: skip
    if form == FREE:  # one that is let swing has light gears or none
        machine = dataclasses.replace(
            machine, damping=0.05 * machine.damping, armature=0.2 * machine.armature,
            limit=0.12 * machine.limit,
        )  # fmt: skip
    rates = {SERVO: (100, 125, 200, 250, 500, 1000), TORQUE: (100, 200, 250, 500, 1000),
             FREE: (60, 100, 200, 500, 1000)}[form]  # fmt: skip
    rate = float(rng.choice((30, 50, 60, 100) if trouble == "slow" else rates))
    last, servo = machine.link(-1), form == SERVO
    setup = Setup(
        world=world, form=form, machine=machine, sample=1 / rate,
        factors=_errors(rng, machine, 1 / rate, shift=servo and bool(chance[2] < 0.6)),
        link_side=form != TORQUE and bool(chance[3] < 0.5),
        servo=_servo(rng, rate) if servo else None, noise=Noise.draw(machine, rng, 1 / rate),
        speeds=bool(chance[4] < 0.5), accelerometer=servo and bool(rng.random() < 0.3),
        torques=form == TORQUE or (servo and bool(rng.random() < 0.2)),
        straight=form == TORQUE or (servo and bool(rng.random() < 0.4)),
    )  # fmt: skip
    changes: dict[str, Any] = {}
    if trouble == "wrist":
        ratio = float(rng.choice([-1.0, 1.0]))
        changes = {
            "coupling": (ratio, 0.02 * last.limit, 0.3 * last.armature),
            "ignored": _places(n - 2) + _places(n - 1),
            "spoiled": (n - 2, n - 1),
        }
    elif trouble == "garbage":
        j = int(rng.integers(n))
        if servo and setup.speeds:
            name = f"joint{j + 1}_vel"
            changes = {"garbage": f"sensor.{name}", "ignored": (name,)}
        else:
            column = f"sensor.joint{j + 1}_pos" if servo else f"torque.joint{j + 1}"
            changes = {"garbage": column, "spoiled": (j,), "ignored": _places(j)}
    return dataclasses.replace(setup, **changes)


def _places(j: int) -> tuple[str, ...]:
    """Names of all that belongs to a joint."""
    words = ("joint{}", "motor{}", "link{}", "joint{}_pos", "joint{}_vel")
    return tuple(word.format(j + 1) for word in words)


def draw_motions(setup: Setup, rng: np.random.Generator) -> tuple[Motion, ...]:
    """The runs of a recording."""
    machine, sample = setup.machine, setup.sample
    if setup.form == FREE:
        seconds = rng.uniform(5.0, 10.0)
        return tuple(free_motion(rng, machine, seconds=seconds, sample=sample) for _ in range(4))
    if setup.world == "shaken":
        # the joint stays the same over runs of other poses, then the next one is shaken
        first = int(rng.integers(machine.joints))
        joints = ((first + i % 2) % machine.joints for i in range(4))
        return tuple(shaken_motion(rng, machine, joint=j, seconds=6.0) for j in joints)
    slow = setup.form == TORQUE or sample > 0.015
    seconds = rng.uniform(10.0, 16.0) if slow else rng.uniform(5.0, 9.0)
    families = [list(FAMILIES)[i] for i in rng.permutation(len(FAMILIES))]
    return tuple(
        rich_motion(rng, machine, family=family, seconds=seconds, sample=sample)
        for family in families
    )
