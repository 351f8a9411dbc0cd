"""What the arms are asked to do: rich motions in families, held arms shaken, arms let go."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import signal

from loose_env.typing import Array
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.build import Factors, build
from scripts.suites.gap.simulator.chain import mass_matrix
from scripts.suites.gap.simulator.simulate import SAMPLE

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


def _multisine(rng: np.random.Generator, time: Array, joints: int) -> Array:
    out = np.zeros((len(time), joints))
    for j in range(joints):
        frequencies = np.exp(rng.uniform(np.log(0.1), np.log(4.0), 9))
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
        window = np.hanning(round(rng.uniform(0.12, 0.4) / SAMPLE))
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
        low, high = rng.uniform(0.15, 0.4), rng.uniform(6.0, 12.0)
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
    rng: np.random.Generator, figures: Figures, *, family: str, seconds: float
) -> Motion:
    """Commands that move all joints at once, growing from rest.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    figures : Figures
        The arm: its ranges of motion and the strength of its drives.
    family : str
        One of `FAMILIES`.
    seconds : float
        Length [s].
    """
    time = np.arange(round(seconds / SAMPLE)) * SAMPLE
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
    sharpest = np.abs(np.gradient(np.gradient(shape, SAMPLE, axis=0), SAMPLE, axis=0)).max(axis=0)
    sizes = np.minimum(sizes, strength / inertia / np.maximum(sharpest, 1e-9))
    return Motion(commands=start + shape * sizes, family=family)


def shaken_motion(
    rng: np.random.Generator, figures: Figures, *, joint: int, seconds: float
) -> Motion:
    """A held pose with band-limited Gaussian noise on one joint's command.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    figures : Figures
        The arm.
    joint : int
        Joint that is shaken.
    seconds : float
        Length [s].
    """
    samples = round(seconds / SAMPLE)
    pose = figures.home + figures.reach * rng.uniform(-0.8, 0.8, figures.joints)
    low, high = 4.0, rng.uniform(60.0, 120.0)
    band = signal.butter(4, (low, high), "bandpass", fs=1 / SAMPLE, output="sos")
    noise = signal.sosfilt(band, rng.normal(size=samples + 1000))[1000:]
    link = figures.links[joint]
    level = float(np.exp(rng.uniform(np.log(0.06), np.log(0.2)))) * link.limit / link.kp
    time = np.arange(samples) * SAMPLE
    commands = np.tile(pose, (samples, 1))
    commands[:, joint] += level * noise / noise.std() * _minimum_jerk(time / 0.3)  # type: ignore[arg-type]
    return Motion(commands=commands, excited=joint, pose=pose, family="shaken")


def free_motion(rng: np.random.Generator, figures: Figures, *, seconds: float) -> Motion:
    """An arm that hangs, is swung by its drives and let go while it moves.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    figures : Figures
        An arm that can hang.
    seconds : float
        Length after it is let go [s].
    """
    assert figures.hanging is not None, f"{figures.name} cannot hang"
    swing = 1.5
    time = np.arange(round((swing + seconds) / SAMPLE)) * SAMPLE
    phases = rng.uniform(-np.pi, np.pi, figures.joints)
    rates = rng.uniform(0.5, 1.2, figures.joints)
    sizes = rng.uniform(0.3, 0.7, figures.joints)
    wave = np.sin(2 * np.pi * rates * time[:, None] + phases) - np.sin(phases)
    commands = np.array(figures.hanging) + sizes * wave * _minimum_jerk(time / 1.0)[:, None]  # type: ignore[arg-type]
    return Motion(commands=commands, release=round(swing / SAMPLE), family="free")


def motions(
    rng: np.random.Generator, figures: Figures, *, form: str, runs: int, seconds: float
) -> list[Motion]:
    """The runs of one recording.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    figures : Figures
        The arm.
    form : str
        One of `effects.FORMS`, or mixed.
    runs : int
        Number of runs.
    seconds : float
        Length of each [s].
    """
    if form == "free":
        return [free_motion(rng, figures, seconds=seconds) for _ in range(runs)]
    if form == "random":
        # the joint stays the same over runs of other poses, then the next one is shaken
        first = int(rng.integers(figures.joints))
        return [
            shaken_motion(rng, figures, joint=(first + i % 2) % figures.joints, seconds=seconds)
            for i in range(runs)
        ]
    order = rng.permutation(len(FAMILIES))
    rich = [
        rich_motion(rng, figures, family=FAMILIES[order[i % len(order)]], seconds=seconds)
        for i in range(runs)
    ]
    # torques sampled right after the step of a held command would not be those of the motion
    straight = {"inverse": (True,), "mixed": (False, True)}.get(form, (False,))
    return [
        dataclasses.replace(motion, straight=straight[i % len(straight)])
        for i, motion in enumerate(rich)
    ]
