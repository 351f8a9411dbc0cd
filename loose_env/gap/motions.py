"""Motions: excitations of joints about a pose; libraries of them that fit an arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal

import mujoco
import numpy as np
from annotated_types import Gt

from loose_env.errors import InvalidSetting
from loose_env.gap.servo_arm import MotionLimits, PlannedMotion, ServoArm
from loose_env.io import Checked, NonNegativeCount, Positive, Rule
from loose_env.typing import Array, IndexArray

MotionKind = Literal[
    "slow_triangle", "constant_speed", "chirp", "multisine", "steps", "holds", "random"
]
"""Kinds of excitation."""
Library = Literal["battery", "brief", "whole"]
"""Libraries of motions."""
_RAMP = 0.25  # fade of an excitation at either end [s]
_STEP_S = 0.04  # time that a step takes [s]: what a servo's controller lets through
_LOWEST = 0.5  # lowest frequency of a chirp and of a multisine [Hz]
_PHASES = 2.399963
"""Phase between joints that move together [rad], the golden angle: no two stay in step."""
_SHRINK = 0.7  # factor on amplitude and speed of a motion that does not fit
_POSES = 400  # random poses among which those of small and of large load are chosen
_ABOVE_LOWEST = Rule(f"above {_LOWEST:g} Hz, the lowest frequency", (Gt(_LOWEST),))


@dataclass(frozen=True, kw_only=True)
class Motion(Checked):
    """One motion: an excitation of some joints about a centre pose.

    It begins and ends at rest in the arm's home pose, so that motions can follow one another.

    Examples
    --------
    >>> Motion(kind="slow_triangle", joints=(1,), amplitude=0.2, speed=0.1).description
    'slow triangle of joint 2, 0.20 rad at 0.10 rad/s'
    """

    kind: MotionKind
    """Excitation."""
    joints: tuple[NonNegativeCount, ...]
    """Indices of the joints that are excited, among the arm's driven ones."""
    amplitude: Positive
    """Largest deviation from the centre pose [rad; slides: 0.2 m]."""
    speed: Positive
    """Speed of the excitation [rad/s; slides: 0.2 m/s]; fades add to it, up to the arm's limit."""
    seconds: Positive = 4.0
    """Length of the excitation [s], without the ways from home and back."""
    highest: Annotated[float, _ABOVE_LOWEST] = 8.0
    """Highest frequency of chirps, multisines and random excitation [Hz]."""
    centre: tuple[float, ...] | None = None
    """Pose about which it moves [rad, m] (J,); None for home. It sets the load by gravity."""
    pause: Positive = 0.3
    """Rest at home, and in the centre pose, before and after [s]."""
    seed: int = 0
    """Seed of a random excitation and of poses that are held."""

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        if not self.joints or len(set(self.joints)) != len(self.joints):
            raise InvalidSetting(f"joints are distinct indices from 0, got {self.joints!r}")

    @property
    def description(self) -> str:
        """Kind, joints and size of the motion."""
        # one name more: whether these are all joints is not known
        return self.described([f"joint {k + 1}" for k in range(max(self.joints) + 2)])

    def described(self, names: Sequence[str]) -> str:
        """Kind, joints by their names, and size of the motion."""
        every = len(self.joints) == len(names) > 1
        which = "all joints" if every else ", ".join(names[j] for j in self.joints)
        size = f"{self.amplitude:.2f} rad at {self.speed:.2f} rad/s"
        pose = ", ".join(f"{value:.2f}" for value in self.centre or ())
        where = f" about ({pose})" if pose else ""
        return f"{self.kind.replace('_', ' ')} of {which}, {size}{where}"

    def commands(self, limits: MotionLimits) -> Array:
        """Desired positions of an arm's driven joints at its samples (n, J) [rad, m].

        Within the ranges of the joints and the speed limits; torque and collisions are
        `check_motion`'s.

        Raises
        ------
        InvalidSetting
            If the joints or the centre pose are not those of the arm, or the motion leaves a
            joint's range.
        """
        count, rate, unit = len(limits.joints), limits.rate, limits.unit
        if max(self.joints) >= count:
            raise InvalidSetting(f"the arm drives {count} joints, got {self.joints!r}")
        if self.centre is not None and len(self.centre) != count:
            raise InvalidSetting(f"centre has a position for each of {count} joints")
        centre = limits.home if self.centre is None else np.array(self.centre, dtype=float)
        speed = np.minimum(self.speed * unit, limits.speed)
        excited = np.tile(centre, (max(round(self.seconds * rate), 2), 1))
        time = np.arange(len(excited)) / rate
        for number, joint in enumerate(self.joints):
            shape = _SHAPES[self.kind](self, time, number, float(speed[joint] / unit[joint]))
            off = unit[joint] * shape
            fastest = float(np.max(np.abs(np.diff(off)))) * rate
            excited[:, joint] += off * min(1.0, limits.speed[joint] / max(fastest, 1e-12))
        rest, held = (np.tile(x, (round(self.pause * rate), 1)) for x in (limits.home, centre))
        there = [rest]
        if self.centre is not None:
            there += [_way(limits.home, centre, limits.speed, rate), held]
        found = np.concatenate([*there, excited, *(own[::-1] for own in reversed(there))])
        low, high = found.min(axis=0), found.max(axis=0)
        for k in np.flatnonzero((low < limits.low) | (high > limits.high)):
            raise InvalidSetting(
                f"{self.description} takes {limits.joints[k]} to {low[k]:.2f} and {high[k]:.2f}; "
                f"its range is {limits.low[k]:.2f} to {limits.high[k]:.2f}"
            )
        return found


def _smooth(share: Array) -> Array:
    """Way of least jerk from 0 to 1 for shares of its time (n,), clipped to it."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


def _way(start: Array, end: Array, speeds: Array, rate: float) -> Array:
    """Way of least jerk between two poses, at half the speed limits (n, J)."""
    seconds = float(np.max(1.875 * np.abs(end - start) / (0.5 * speeds)))
    count = max(round(seconds * rate), 2)
    share = _smooth(np.arange(count) / (count - 1))
    return np.asarray(start + share[:, None] * (end - start))


def _faded(motion: Motion, time: Array) -> Array:
    """Window that fades in and out (n,)."""
    ramp = min(_RAMP, motion.seconds / 4)
    return _smooth(time / ramp) * _smooth((time[-1] - time) / ramp)


def _triangle(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Reversals at one speed, with corners rounded over a twentieth of a period (n,)."""
    turns = max(round((motion.seconds - 2 * _RAMP) * speed / (4 * motion.amplitude)), 1)
    phase, period = time / motion.seconds * turns, motion.seconds / turns
    height = min(motion.amplitude, speed * period / 4)
    raw = np.abs((phase + 0.25 + 0.13 * number) % 1.0 - 0.5) * 4 - 1
    width = max(round(0.04 * period * (len(time) / motion.seconds)), 1)
    rounded = np.convolve(np.pad(raw, width, mode="wrap"), np.ones(width) / width, "same")
    return np.asarray(-height * rounded[width:-width] * _faded(motion, time))


def _constant_speed(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """There and back at a quarter, half and all of the speed, rests in between (n,)."""
    slower = np.array([1.0, 2.0, 4.0])
    lengths = motion.seconds * slower / slower.sum()
    reach = min(motion.amplitude, 0.85 * speed * motion.seconds / slower.sum() / 4)
    # out, across and back: four ways of one speed with soft ends
    knots, heights = [0.0, 0.22, 0.28, 0.72, 0.78, 1.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0]
    at = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])[:, None] + np.outer(lengths, knots)
    found = reach * np.interp(time, at.ravel(), 3 * heights)
    width = max(round(0.06 * len(time) / motion.seconds), 1)
    kernel = np.hanning(width + 2)[1:-1]
    return np.asarray(np.convolve(found, kernel / kernel.sum(), "same") * _faded(motion, time))


def _chirp(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Logarithmic sweep of frequency at the largest amplitude that the speed allows (n,)."""
    ratio = motion.highest / _LOWEST
    share = time / motion.seconds
    frequency = _LOWEST * ratio**share
    phase = 2 * np.pi * _LOWEST * motion.seconds / np.log(ratio) * (ratio**share - 1)
    height = np.minimum(motion.amplitude, speed / (2 * np.pi * frequency))
    return np.asarray(height * np.sin(phase + number * _PHASES) * _faded(motion, time))


def _multisine(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Sines of ten frequencies with Schroeder's phases (n,)."""
    frequencies = np.geomspace(_LOWEST, motion.highest, 10)
    k = np.arange(10)
    phases = -np.pi * k * (k + 1) / 10 + number * _PHASES * (k + 1)
    waves = np.sin(2 * np.pi * frequencies * time[:, None] + phases) / frequencies**0.7
    return _fitted(motion, waves.sum(axis=1) * _faded(motion, time), time, speed)


def _random(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Gaussian noise of a band (n,)."""
    rng = np.random.default_rng([motion.seed, number])
    rate = len(time) / motion.seconds
    frequency = np.fft.rfftfreq(len(time), 1 / rate)
    spectrum = np.fft.rfft(rng.normal(size=len(time)))
    spectrum[(frequency < 0.2) | (frequency > motion.highest)] = 0.0
    spectrum[1:] /= np.maximum(frequency[1:], _LOWEST) ** 0.5
    return _fitted(motion, np.fft.irfft(spectrum, len(time)) * _faded(motion, time), time, speed)


def _fitted(motion: Motion, wave: Array, time: Array, speed: float) -> Array:
    """Scale a wave to the amplitude, or to the speed where that is less (n,)."""
    fastest = float(np.max(np.abs(np.gradient(wave, time))))
    scale = min(motion.amplitude / max(float(np.max(np.abs(wave))), 1e-12), speed / fastest)
    return np.asarray(scale * wave)


def _steps(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Steps to and fro, of two sizes, a rest after each (n,)."""
    count = max(round(motion.seconds / 0.5), 2)
    heights = (-1) ** number * motion.amplitude * np.resize([1.0, -1.0, 0.4, -0.4, 0.0], count)
    heights[-1] = 0.0
    way = max(_STEP_S, 1.875 * (motion.amplitude * 2) / speed)
    return _levels(motion, time, heights, np.full(count, way), late=0.02 * number)


def _holds(motion: Motion, time: Array, number: int, speed: float) -> Array:
    """Poses held one after the other, ways of least jerk between them (n,)."""
    count = max(round(motion.seconds / 1.0), 2)
    rng = np.random.default_rng([motion.seed, number, 7])
    levels = rng.permutation(np.linspace(-1.0, 1.0, count - 1))
    heights = np.append(motion.amplitude * levels, 0.0)
    ways = 1.875 * np.abs(np.diff(heights, prepend=0.0)) / speed
    return _levels(motion, time, heights, np.clip(ways, 0.1, motion.seconds / count))


def _levels(motion: Motion, time: Array, heights: Array, ways: Array, late: float = 0.0) -> Array:
    """Levels one after the other, ways of some times between them (n,)."""
    begins = np.arange(len(heights)) * motion.seconds / len(heights) + late
    jumps = zip(np.diff(heights, prepend=0.0), begins, ways, strict=True)
    return np.asarray(sum(jump * _smooth((time - begin) / way) for jump, begin, way in jumps))


_SHAPES: dict[str, Callable[[Motion, Array, int, float], Array]] = {
    "slow_triangle": _triangle,
    "constant_speed": _constant_speed,
    "chirp": _chirp,
    "multisine": _multisine,
    "steps": _steps,
    "holds": _holds,
    "random": _random,
}


def check_motion(motion: Motion, arm: ServoArm) -> tuple[PlannedMotion, str]:
    """Simulate a motion with the nominal model, contacts included; say why it does not fit.

    Raises
    ------
    InvalidSetting
        If its commands leave the range of a joint.

    Examples
    --------
    >>> from loose_env.arms import SERVO_ARM
    >>> from loose_env.gap.servo_arm import read_servo_arm
    >>> arm = read_servo_arm(SERVO_ARM)
    >>> check_motion(Motion(kind="slow_triangle", joints=(1,), amplitude=0.2, speed=0.2), arm)[1]
    ''
    """
    planned = arm.play(motion.commands(arm.limits))
    return planned, arm.limits.refusal(planned)


def fitting(
    wanted: Iterable[Motion],
    checked: Callable[[Motion], tuple[PlannedMotion | None, str]],
    tries: int = 8,
) -> tuple[list[tuple[Motion, PlannedMotion]], list[tuple[Motion, str]]]:
    """Motions against which a check has nothing, reduced until it has; reasons of the others."""
    found, refused = list[tuple[Motion, PlannedMotion]](), list[tuple[Motion, str]]()
    for asked in dict.fromkeys(wanted):
        motion, planned, reason = asked, None, ""
        for left in reversed(range(tries)):
            try:
                planned, reason = checked(motion)
            except InvalidSetting as error:
                reason = str(error)
            if not (reason and left):
                break
            too_far = any(words in reason for words in ("touch", "its range", "would move"))
            slower = motion.speed if too_far else _SHRINK * motion.speed
            motion = replace(motion, amplitude=_SHRINK * motion.amplitude, speed=slower)
        if planned is None or reason:
            refused.append((asked, reason))
        else:
            found.append((motion, planned))
    return found, refused


def loaded_poses(
    model: mujoco.MjModel, rest: Array, driven: IndexArray, limits: MotionLimits, torque: Array
) -> tuple[Array, Array]:
    """Poses (J,) without contact of small and of large gravity load over torques of the joints."""
    rng, home, low, high = np.random.default_rng(0), limits.home, limits.low, limits.high
    half = np.minimum(0.35 * (high - low), 1.2 * limits.unit)
    data = mujoco.MjData(model)
    found, loads = [], []
    for _ in range(_POSES):
        pose = np.clip(home + rng.uniform(-1, 1, len(half)) * half, low + 0.2, high - 0.2)
        pose = np.where(high - low > 0.8, pose, (low + high) / 2)
        data.qpos[:] = rest
        data.qpos[driven] = pose
        mujoco.mj_forward(model, data)
        if data.ncon == 0:
            found.append(pose)
            loads.append(float(np.sum((data.qfrc_bias[driven] / torque) ** 2)))
    return (found[np.argmin(loads)], found[np.argmax(loads)]) if found else (home, home)


def motion_library(arm: ServoArm, which: Library = "whole") -> tuple[Motion, ...]:
    """Motions that fit the limits of an arm, reduced where need be.

    Parameters
    ----------
    arm : ServoArm
        The arm.
    which : str
        "battery", which an experienced engineer runs: slow triangle, multisine and steps of all
        joints; "brief" for that and brief excitations of each kind; "whole" for about 40 motions.

    Raises
    ------
    InvalidSetting
        If none fits.
    """
    every = tuple(range(len(arm.joints)))
    wanted = _battery(every)
    if which == "whole":
        rest, limits = arm.rest[0], arm.limits
        wanted = long_motions(*loaded_poses(arm.model, rest, arm.driven, limits, arm.torque_limits))
    if which != "battery":
        wanted += _brief_motions(every)
    found, _ = fitting(wanted, partial(check_motion, arm=arm))
    if not found:
        raise InvalidSetting(
            "no motion fits the arm: its home pose touches something or takes its torque limits"
        )
    return tuple(dict.fromkeys(motion for motion, _ in found))


def long_motions(small: Array, large: Array) -> list[Motion]:
    """Motions of an arm, not yet reduced to its limits, about poses of small and large load."""
    every, poses = tuple(range(len(small))), [tuple(map(float, pose)) for pose in (small, large)]
    steps = partial(Motion, kind="steps", amplitude=0.06, speed=1.5, seconds=2.5)
    chirp = partial(Motion, kind="chirp", amplitude=0.2, speed=0.8, highest=20.0)
    slow = partial(Motion, kind="slow_triangle", amplitude=0.25, speed=0.25)
    both = partial(Motion, joints=every)
    wanted = []
    for j in every:
        wanted += [slow(joints=(j,), centre=pose) for pose in poses]
        wanted += [
            Motion(kind="constant_speed", joints=(j,), amplitude=0.8, speed=1.6, seconds=5.0),
            chirp(joints=(j,)),
            steps(joints=(j,)),
        ]
    for pose in poses:
        wanted += [
            both(kind="holds", amplitude=0.5, speed=1.2, centre=pose),
            both(kind="multisine", amplitude=0.4, speed=1.2, centre=pose),
            steps(joints=every, centre=pose),
        ]
    return [
        *wanted,
        *_battery(every),
        both(kind="holds", amplitude=0.7, speed=1.2, seconds=8.0, seed=1),
        chirp(joints=every),
        both(kind="random", amplitude=0.5, speed=1.8, seed=9),
        both(kind="random", amplitude=0.5, speed=1.8, seed=3, seconds=1.5),
    ]


def _brief_motions(every: tuple[int, ...]) -> list[Motion]:
    """Excitations of 0.5 to 3 s about home: a second motion need not cost the way to a pose."""
    # a servo settles in a tenth of a second
    brief = partial(Motion, joints=every, pause=0.1)
    noise = partial(brief, kind="random", speed=1.8)
    return [
        noise(amplitude=0.5, seconds=0.5, seed=3),
        noise(amplitude=0.5, seconds=1.0, seed=3),
        noise(amplitude=0.5, seconds=1.0, seed=9),
        noise(amplitude=0.6, seconds=1.5, seed=9, highest=2.5),
        noise(amplitude=0.6, seconds=2.5, seed=5, highest=2.0),
        brief(kind="multisine", amplitude=0.4, speed=1.8, seconds=1.5),
        brief(kind="chirp", amplitude=0.3, speed=1.2, seconds=1.5, highest=20.0),
        brief(kind="steps", amplitude=0.06, speed=1.5, seconds=1.0),
        brief(kind="holds", amplitude=0.5, speed=1.8, seconds=2.0, seed=1),
        brief(kind="holds", amplitude=0.7, speed=1.8, seconds=3.0, seed=2),
        brief(kind="slow_triangle", amplitude=0.1, speed=0.3, seconds=1.5),
        brief(kind="constant_speed", amplitude=0.5, speed=1.2, seconds=2.0),
    ]


def _battery(every: tuple[int, ...]) -> list[Motion]:
    both = partial(Motion, joints=every)
    return [
        both(kind="slow_triangle", amplitude=0.3, speed=0.3, seconds=8.0),
        both(kind="multisine", amplitude=0.4, speed=1.2, seconds=8.0),
        both(kind="steps", amplitude=0.06, speed=1.5, seconds=5.0),
    ]
