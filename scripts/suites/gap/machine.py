"""Motions of a true arm, its simulated runs, and its sensors' readings and noise."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import signal

from loose_env.typing import Array
from scripts.suites.gap.arms import GRAVITY, Figures
from scripts.suites.gap.dynamics import (
    BUMP,
    CROSSLEY,
    DAMPING,
    ELASTIC,
    EXTRA,
    FRICTION,
    HERTZ,
    LINK_SIDE,
    LOADED,
    LOADED_BUMP,
    LOADED_SMOOTH,
    SAMPLE,
    SLACK_FORCE,
    SMOOTH_SPEED,
    STIFFNESS,
    Factors,
    Signals,
    System,
    build,
    felt_inertia,
    mass_matrix,
    simulate,
)
from scripts.suites.gap.effects import ACCELEROMETER, Effect, Readings, apply_effect

FADE = 0.6
"""Time over which a motion grows from rest [s]."""
EFFORT = 0.55
"""Share of a drive's limit that the largest acceleration commanded may take."""
FAMILIES = ("multisine", "reversals", "steps", "chirp")
"""Families of motion, one a run."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """One run's commands."""

    commands: Array
    """Positions commanded, of shape (T, n) [rad or m]."""
    release: int | None = None
    """Sample at which the drives go off and the recording starts; with drives if not given."""
    excited: int | None = None
    """Joint that is shaken, counted from 0."""
    pose: Array | None = None
    """Pose held, of shape (n,)."""
    straight: bool = False
    """Whether the drives go in straight lines from command to command; they hold each if not."""
    family: str = ""
    """A word for the motion."""
    sample: float = SAMPLE
    """Time between two commands [s]."""


def _multisine(rng: np.random.Generator, time: Array, joints: int) -> Array:
    out = np.zeros((len(time), joints))
    for j in range(joints):
        frequencies = np.exp(rng.uniform(np.log(0.1), np.log(min(4.0, 0.1 / time[1])), 9))
        sizes = frequencies**-0.8
        phases = rng.uniform(-np.pi, np.pi, 9)
        out[:, j] = np.sin(2 * np.pi * time[:, None] * frequencies + phases) @ sizes
        out[:, j] /= np.abs(out[:, j]).max()
    return out


def _minimum_jerk(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x * x)


def _walk(rng: np.random.Generator, time: Array, times: tuple[float, float], hold: float) -> Array:
    """Moves between random targets with minimum jerk, with holds between them."""
    out = np.zeros(len(time))
    now, at = 0.0, rng.uniform(0.0, hold)
    here = 0.0
    while now < time[-1]:
        target = rng.uniform(-1.0, 1.0)
        if abs(target - here) < 0.3:
            target = here - np.sign(here + 1e-9) * rng.uniform(0.4, 1.0)
        lasting = float(np.exp(rng.uniform(*np.log(times)))) * (0.5 + abs(target - here) / 2)
        out += (target - here) * _minimum_jerk((time - at) / lasting)
        here, now = target, at + lasting
        at = now + rng.uniform(0.0, hold)
    return out


def _reversals(rng: np.random.Generator, time: Array, joints: int) -> Array:
    # slow ramps to and fro, with a small fast part on top in the second half
    out = np.zeros((len(time), joints))
    for j in range(joints):
        period = float(np.exp(rng.uniform(np.log(1.5), np.log(6.0))))
        triangle = signal.sawtooth(2 * np.pi * (time / period + rng.random()), 0.5)
        window = np.hanning(round(rng.uniform(0.12, 0.4) / time[1]) + 3)
        smooth = np.convolve(np.pad(triangle, len(window), mode="edge"), window / window.sum())
        smooth = smooth[len(window) + len(window) // 2 :][: len(time)]
        quick = np.sin(2 * np.pi * rng.uniform(1.0, 3.0) * time) * (time > time[-1] / 2)
        out[:, j] = 0.8 * smooth + 0.2 * quick * _minimum_jerk(2 * time - time[-1])
    return out


def _steps(rng: np.random.Generator, time: Array, joints: int) -> Array:
    return np.stack([_walk(rng, time, (0.2, 1.2), 0.8) for _ in range(joints)], axis=1)


def _chirp(rng: np.random.Generator, time: Array, joints: int) -> Array:
    out = np.zeros((len(time), joints))
    for j in range(joints):
        low, high = rng.uniform(0.15, 0.4), min(rng.uniform(6.0, 12.0), 0.1 / time[1])
        if rng.random() < 0.5:
            low, high = high, low
        sweep = np.log(high / low) / time[-1]
        phase = 2 * np.pi * low * (np.exp(sweep * time) - 1) / sweep
        frequency = low * np.exp(sweep * time)
        # an even sweep of accelerations would hardly move; one of positions would hit the limits
        out[:, j] = np.sin(phase + rng.uniform(-np.pi, np.pi)) / (1 + (frequency / 0.8) ** 1.5)
        out[:, j] += 0.35 * np.sin(2 * np.pi * rng.uniform(0.1, 0.25) * time + rng.uniform(0, 6))
    return out


def rich_motion(
    rng: np.random.Generator, figures: Figures, *, family: str, seconds: float, sample: float
) -> Motion:
    """Commands that move all joints at once, growing from rest."""
    time = np.arange(round(seconds / sample)) * sample
    make = {
        "multisine": _multisine, "reversals": _reversals, "steps": _steps, "chirp": _chirp,
    }[family]  # fmt: skip
    shape = make(rng, time, figures.joints)  # type: ignore[arg-type]
    shape = (shape - shape[0]) * _minimum_jerk(time / FADE)[:, None]  # type: ignore[arg-type]
    shape /= np.maximum(np.abs(shape).max(axis=0), 1e-9)
    start = figures.home + figures.reach * rng.uniform(-0.2, 0.2, figures.joints)
    sizes = figures.reach * rng.uniform(0.55, 0.9, figures.joints)
    system = build(figures, Factors.ones(figures.joints))
    strength = [link.limit for link in figures.links] * np.array(EFFORT)
    inertia = np.diag(mass_matrix(system, figures.home))
    sharpest = np.abs(np.gradient(np.gradient(shape, sample, axis=0), sample, axis=0)).max(axis=0)
    sizes = np.minimum(sizes, strength / inertia / np.maximum(sharpest, 1e-9))
    return Motion(commands=start + shape * sizes, family=family, sample=sample)


def shaken_motion(
    rng: np.random.Generator, figures: Figures, *, joint: int, seconds: float
) -> Motion:
    """A held pose with band-limited Gaussian noise on one joint's command."""
    samples = round(seconds / SAMPLE)
    pose = figures.home + figures.reach * rng.uniform(-0.8, 0.8, figures.joints)
    band = signal.butter(4, (4.0, rng.uniform(60.0, 120.0)), "bandpass", fs=1 / SAMPLE,
                         output="sos")  # fmt: skip
    noise = signal.sosfilt(band, rng.normal(size=samples + 1000))[1000:]
    link = figures.links[joint]
    level = float(np.exp(rng.uniform(np.log(0.06), np.log(0.2)))) * link.limit / link.kp
    commands = np.tile(pose, (samples, 1))
    swell = _minimum_jerk(np.arange(samples) * SAMPLE / 0.3)  # type: ignore[arg-type]
    commands[:, joint] += level * noise / noise.std() * swell
    return Motion(commands=commands, excited=joint, pose=pose, family="shaken")


def free_motion(
    rng: np.random.Generator, figures: Figures, *, seconds: float, sample: float
) -> Motion:
    """An arm that hangs, is swung by its drives and let go while it moves."""
    assert figures.hanging is not None, f"{figures.name} cannot hang"
    swing = 1.5
    time = np.arange(round((swing + seconds) / sample)) * sample
    phases = rng.uniform(-np.pi, np.pi, figures.joints)
    rates = rng.uniform(0.5, 1.2, figures.joints)
    sizes = rng.uniform(0.3, 0.7, figures.joints)
    wave = np.sin(2 * np.pi * rates * time[:, None] + phases) - np.sin(phases)
    commands = np.array(figures.hanging) + sizes * wave * _minimum_jerk(time / 1.0)[:, None]  # type: ignore[arg-type]
    return Motion(commands=commands, release=round(swing / sample), family="free", sample=sample)


SLIDE_SCALE = 0.05
"""Metres of a slide that count like a radian of a hinge for the steps of its encoder."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Noise:
    """Noise of a recording's sensors; it is white."""

    step: Array
    """Steps of the encoders, of shape (n,) [rad or m]."""
    position: Array
    """Noise of the encoders before their steps, of shape (n,), standard deviation."""
    velocity: Array
    """Noise of the tachometers, of shape (n,) [rad/s or m/s]."""
    acceleration: float
    """Noise of the accelerometer, standard deviation of an axis [m/s²]."""
    torque: Array
    """Noise of the measured torques, of shape (n,) [N m or N]."""

    @classmethod
    def draw(cls, figures: Figures, rng: np.random.Generator, sample: float = SAMPLE) -> Noise:
        """Encoders of 14 to 17 bits, accelerometers of 150 to 300 µg/√Hz."""
        scale = np.array([SLIDE_SCALE if x.kind == "slide" else 1.0 for x in figures.links])
        step = 2 * np.pi / 2.0 ** rng.integers(14, 18) * scale
        density = rng.uniform(150e-6, 300e-6) * GRAVITY
        limits = np.array([link.limit for link in figures.links])
        return cls(
            step=step,
            position=step * rng.uniform(0.4, 0.8),
            velocity=rng.uniform(1e-3, 4e-3) * scale,
            acceleration=float(density * np.sqrt(0.5 / sample)),
            torque=rng.uniform(0.002, 0.006) * limits,
        )

    @property
    def reading(self) -> Array:
        """Standard deviation of a position as read, noise and steps, of shape (n,)."""
        return np.sqrt(self.position**2 + self.step**2 / 12)


def read(trace: Signals, readings: Readings, *, inside: int, sample: float) -> Signals:
    """Readings without noise; a trace has so many steps in a sample."""

    def taken(name: str, values: Array) -> Array:
        # a sensor that is late reads what was there between the samples
        late = readings.delay.get(name, 0.0) / sample * inside
        at = np.arange(0, len(values), inside) - late
        if late:
            grid = np.arange(len(values))
            values = np.stack([np.interp(at, grid, column) for column in values.T], axis=1)
        else:
            values = values[::inside]
        if name == ACCELEROMETER:
            values = values @ readings.rotation.T
        return values * readings.gain.get(name, 1.0) + readings.bias.get(name, 0.0)

    joints = range(trace.position.shape[1])
    torque = trace.torque[::inside].copy()
    for j in joints:
        torque[:, j] *= readings.torque.get(j, 1.0)
        torque[:, j] += readings.offset.get(j, 0.0)
    found = Signals(
        position=np.hstack([taken(f"joint{j + 1}_pos", trace.position[:, [j]]) for j in joints]),
        velocity=np.hstack([taken(f"joint{j + 1}_vel", trace.velocity[:, [j]]) for j in joints]),
        acceleration=taken(ACCELEROMETER, trace.acceleration),
        torque=torque,
        joint_acceleration=trace.joint_acceleration[::inside],
    )
    return rounded(found, readings)


def rounded(signals: Signals, readings: Readings) -> Signals:
    """Readings of coarse encoders at whole steps."""
    position = signals.position.copy()
    for sensor, step in readings.step.items():
        column = position[:, int(sensor.removeprefix("joint").removesuffix("_pos")) - 1]
        column[:] = step * np.round(column / step)
    return dataclasses.replace(signals, position=position)


def add_noise(signals: Signals, noise: Noise, rng: np.random.Generator) -> Signals:
    """Readings with noise and steps."""
    draw = rng.normal
    position = signals.position + noise.position * draw(size=signals.position.shape)
    return dataclasses.replace(
        signals,
        position=noise.step * np.round(position / noise.step),
        velocity=signals.velocity + noise.velocity * draw(size=signals.velocity.shape),
        acceleration=signals.acceleration
        + noise.acceleration * draw(size=signals.acceleration.shape),
        torque=signals.torque + noise.torque * draw(size=signals.torque.shape),
    )


STOP_FORCE = 100.0
"""Force of a blow on the stops of a slide by which the steps are chosen [N]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrueArm:
    """An arm as it is: nominal figures times factors, with effects."""

    figures: Figures
    factors: Factors
    effects: tuple[Effect, ...] = ()
    link_side: bool = False
    """Whether encoders are on the links' side of gears that are soft or have play."""
    servo: tuple[float, float, float] | None = None
    """Rate [Hz], delay in its samples and share of a new velocity of drives that are sampled."""
    coupling: tuple[float, float, float] | None = None
    """Ratio, friction and rotor of the last motor, if it turns with the joint before too."""

    def assemble(self, run: int | None = None) -> tuple[System, Readings]:
        """The arrays to integrate and what is wrong with the sensors, in a run."""
        system, readings = build(self.figures, self.factors), Readings()
        limits = np.array([link.limit for link in self.figures.links])
        n = self.figures.joints
        readings.torque = dict(enumerate(np.broadcast_to(self.factors.constant, n).tolist()))
        readings.offset = dict(
            enumerate((np.broadcast_to(self.factors.offset, n) * limits).tolist())
        )
        if self.coupling is not None:
            ratio, friction, rotor = self.coupling
            system.cable[:] = (n - 1, n - 2, ratio, 0.0, 0.0, friction, rotor)
        for effect in self.effects:
            if run is None or not effect.runs or run in effect.runs:
                apply_effect(effect, system, readings, self.figures)
        if self.link_side:
            for j in range(n):
                bodies = (system.proximal[j], int(system.drives[j, 0]))
                soft = bodies[0] != bodies[1] and system.bodies[bodies[0], 0] < 0.5
                system.drives[j, LINK_SIDE] = bodies[0] if soft else -1.0
        return system, readings

    def run(
        self,
        motion: Motion,
        *,
        step: float = 1e-4,
        settle: float = 1.2,
        number: int | None = None,
    ) -> Signals:
        """Readings of one run without noise, integrated in steps of this length at most."""
        system, readings = self.assemble(number)
        sample = motion.sample
        inside = steps_inside(system, self.figures, max(1, round(sample / step)), sample)
        servo = (0, 0, 1.0, 0.0)
        if self.servo is not None:
            rate, late, smoothing = self.servo
            every = max(1, round(inside / sample / rate))
            servo = (every, round(late), smoothing, 0.0)
        fine = bool(readings.delay)
        trace = simulate(
            system,
            motion.commands,
            inside=inside,
            release=motion.release,
            settle=settle,
            fine=fine,
            straight=motion.straight or readings.straight,
            servo=(0, 0, 1.0, 0.0) if motion.release is not None else servo,
            sample=sample,
        )
        signals = read(trace, readings, inside=inside if fine else 1, sample=sample)
        if self.coupling is not None:  # the drives' own torques are logged
            torque = signals.torque.copy()
            torque[:, -2] -= self.coupling[0] * torque[:, -1]
            signals = dataclasses.replace(signals, torque=torque)
        start = motion.release or 0
        return Signals(**{name: values[start:] for name, values in vars(signals).items()})


def steps_inside(system: System, figures: Figures, least: int, sample: float = SAMPLE) -> int:
    """Steps in a sample that the stiffest law of an arm needs."""
    step = sample / least
    needed = 1.0
    limits = np.array([link.limit for link in figures.links])
    for dof, law in enumerate(system.laws):
        joint = int(np.sum(system.joint_dofs <= dof)) - 1
        slide = system.bodies[dof, 0] > 0.5 and dof not in system.joint_dofs
        load = STOP_FORCE if slide else 0.6 * limits[max(joint, 0)]
        felt = felt_inertia(system, dof, figures.home)
        rate = law[DAMPING] + law[EXTRA]
        stiffness = law[STIFFNESS]
        if law[SLACK_FORCE] > 0:
            stiffness += law[SLACK_FORCE] / law[ELASTIC]
        if law[FRICTION] > 0:
            rate += law[FRICTION] * (1 + law[BUMP]) / law[SMOOTH_SPEED]
        if dof in system.joint_dofs:
            drive = system.drives[joint]
            if drive[LOADED] > 0:
                slope = drive[LOADED] * (1 + drive[LOADED_BUMP]) / drive[LOADED_SMOOTH]
                rate += 0.6 * limits[joint] * slope
        if law[HERTZ] > 0:
            stiffness += 1.5 * law[HERTZ] * (load / law[HERTZ]) ** (1 / 3)
            rate += load * law[CROSSLEY]
        needed = max(needed, rate / felt * step / 1.2, np.sqrt(stiffness / felt) * step / 0.6)
    return least * int(np.ceil(needed - 1e-9))
