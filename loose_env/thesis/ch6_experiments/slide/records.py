"""Records of a slide shaken through a stinger, and of a resolver behind a gear with play.

The slide of Experiments Two and Three (`loose_env.thesis.rigs.slide`) and VERA on the shaker
(`loose_env.thesis.rigs.shaken_vera`), measured on the simulated rig. The rig's sensors are ideal
here; the pair of accelerometers, the protractor and the tape are put on its readings, so that
several pairs can be tried on one and the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np

from loose_env.arms import COIL, Arm, Holding, Mismatch
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.thesis.rigs.shaken_vera import shaken_vera
from loose_env.thesis.rigs.slide import BENCH, SLIDE, slide_rig
from loose_env.typing import Array

FORCE_RMS, FORCE_BAND = 6.0, (5.0, 2000.0)
"""Force of the shaker [N] and its band [Hz]; estimates. The suspension of its coil takes the
part below 40 Hz away."""
MACHINE_MASS, MACHINE_RMS, MACHINE_BAND = 5.0, 15.0, (8.0, 60.0)
"""Another machine on the bench: its moving mass [kg], force [N] and band [Hz]; estimates."""
FULL_SCALE = 50.0
"""Full scale of a tape channel [m/s²]; an estimate."""
TAPE_RATIO_DB = 46.0
"""Full scale over noise of an FM tape channel [dB]; an estimate."""
TAPE_OFFSET = 0.005
"""Deviation of a channel's offset over its full scale [1]; an estimate."""
PAIR = replace(Mismatch().scaled(0.0), gain=0.005, cross_axis=0.01)
"""Deviations of gain and cross-axis sensitivity of the accelerometers; estimates."""
PROTRACTOR = np.radians(0.15)
"""Deviation of the angle read [rad]; an estimate."""
BENCH_GAIN = 0.03
"""Deviation of the gain of the bench's sensor, which is of another kind [1]; an estimate."""
BENCH_SCALE = 0.1
"""Full scale of the bench's tape channel over that of the others; an estimate."""
RATE, DURATION = 10_000.0, 2.0

RESOLVER_UNIT = 2 * np.pi / 2**16
"""One unit of a resolver of 16 bits [rad]."""
RESOLVER_RATE = 1000.0
"""Readings of the resolver through the computer's digital port [Hz]; an estimate."""
GEAR_PLAY = 3 * RESOLVER_UNIT
"""Play between link and resolver [rad]: one arc-minute; an estimate."""
LINK_BAND = (20.0, 150.0)
"""Band of the shaker that drives link 1 [Hz]: readings at `RESOLVER_RATE` can follow it, so that
what spoils its derivative is the resolver and its gear. An estimate."""
LINK_FORCE_RMS = 48.0
"""Its force [N], for a resolver that moves by the few units printed (6.3.2)."""
VERA_POSE = (0.0, np.pi / 2)
"""Joints of VERA [rad]; the second is pinned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseRecord:
    """The slide while the bench is shaken."""

    slide: Array
    """Measured along the rails [m/s²] (N,)."""
    base: Array
    """Bench, measured along the rails [m/s²] (N,)."""
    relative: Array
    """True motion of the slide relative to the bench [m/s²] (N,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SlideRecords:
    """One record for each angle of the cube."""

    rate: float
    """Sampling rate [Hz]."""
    alpha: Array
    """Angle of the cube as read from the protractor [rad] (A,)."""
    x: Array
    """Accelerometer at alpha from the rails, as measured [m/s²] (A, N)."""
    y: Array
    """Accelerometer perpendicular to it [m/s²] (A, N)."""
    shaker: Array
    """Shaker's table, as measured [m/s²] (A, N)."""
    velocity: Array
    """True velocity of the slide along the rails, relative to the bench [m/s] (A, N)."""
    shaken_by: dict[str, BaseRecord]
    """Records about the base's motion, by what shakes the bench."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResolverRecords:
    """Link 1 driven from outside, and its resolver readings."""

    rate: float
    """Sampling rate [Hz]."""
    angle: Array
    """True angle of the link [rad] (N,)."""
    velocity: Array
    """True velocity of the link [rad/s] (N,)."""
    resolver: Array
    """Reading behind the gear [units of `RESOLVER_UNIT`] (N,)."""


def slide_records(seed: int, *, pair: int = 0) -> SlideRecords:
    """Shake the slide with the cube at 0 to 90 degrees; then once with the bench shaken too.

    ``pair``: which pair of accelerometers, with its protractor and tape: the motion is the same for
    every pair.
    """
    alpha, runs, with_machine = _motions(seed)
    rng = np.random.default_rng([seed, 91, pair])
    noise = FULL_SCALE * 10 ** (-TAPE_RATIO_DB / 20)
    sensor = PAIR.draw(slide_rig(), rng).sensor
    # The protractor's error turns the cube, and with it both accelerometers.
    turned = PROTRACTOR * rng.standard_normal(len(alpha))
    c, s = np.cos(turned)[:, None], np.sin(turned)[:, None]
    along, across = np.stack([run.tool for run in runs], axis=1)
    cube = np.array([c * along - s * across, s * along + c * across])
    measured = np.einsum("ij,jkn->ikn", sensor[:2, :2], cube)
    measured += noise * rng.standard_normal(measured.shape)
    measured += TAPE_OFFSET * FULL_SCALE * rng.standard_normal((2, len(alpha), 1))
    gain = 1 + BENCH_GAIN * rng.standard_normal()
    shaken_by = {}
    for name, run in (
        ("the shaker's own reaction", runs[0]),
        ("another machine too", with_machine),
    ):
        slide, base = run.probes[SLIDE][0], run.probes[BENCH][0]
        shaken_by[name] = BaseRecord(
            slide=slide + noise * rng.standard_normal(slide.shape),
            base=gain * base + BENCH_SCALE * noise * rng.standard_normal(base.shape),
            relative=slide - base,
        )
    shaker = np.array([run.probes[COIL][0] for run in runs])
    return SlideRecords(
        rate=RATE,
        alpha=alpha,
        x=measured[0],
        y=measured[1],
        shaker=shaker + noise * rng.standard_normal(shaker.shape),
        velocity=np.array([_velocity(run) for run in runs]),
        shaken_by=shaken_by,
    )


def resolver_records(seed: int) -> ResolverRecords:
    """Drive link 1 of VERA by the shaker and read its resolver behind a gear with play."""
    shake = Excitation(
        torque_rms=(0.0, 0.0), duration=DURATION, band=LINK_BAND, shaker_rms=LINK_FORCE_RMS
    )
    run = _measure(shaken_vera(), np.array(VERA_POSE), shake, [seed, 95])
    every = round(RATE / RESOLVER_RATE)
    angle = run.encoder[0, 1:-1]
    rotor = play(angle, GEAR_PLAY)
    return ResolverRecords(
        rate=RESOLVER_RATE,
        angle=angle[::every],
        velocity=_velocity(run)[::every],
        resolver=np.floor(rotor[::every] / RESOLVER_UNIT),
    )


def play(driving: Array, width: float) -> Array:
    """Follow a motion through play: the driven side stays until it is pushed.

    ``driving`` (N,): position of the driving side [rad], sampled finely. ``width``: play between
    its stops [rad]. Returns (N,): position of the driven side, in the middle of the play at first.

    Examples
    --------
    >>> play(np.array([0.0, 3.0, 1.0, -1.0]), 2.0).tolist()
    [0.0, 2.0, 2.0, 0.0]
    """
    driven = np.array(driving, dtype=float)
    for k in range(1, len(driven)):
        driven[k] = min(max(driven[k - 1], driving[k] - width / 2), driving[k] + width / 2)
    return driven


@lru_cache(maxsize=1)
def _motions(seed: int) -> tuple[Array, tuple[Measurement, ...], Measurement]:
    """Angles of the cube, the motion at each, and one with another machine on the bench."""
    alpha = np.radians(np.arange(0.0, 91.0, 5.0))
    shake = Excitation(torque_rms=(0.0,), duration=DURATION, band=FORCE_BAND, shaker_rms=FORCE_RMS)
    runs = tuple(
        # The cube's accelerometers turn against its angle: x lies at -alpha in the bench's frame.
        _measure(
            slide_rig(cube_angle=-angle, stinger="threaded_rod"),
            np.zeros(1),
            shake,
            [seed, 100 + k],
        )
        for k, angle in enumerate(alpha)
    )
    arm = _beside_a_machine(slide_rig(stinger="threaded_rod"))
    return alpha, runs, _with_machine(arm, seed)


def _with_machine(arm: Arm, seed: int) -> Measurement:
    low, high = MACHINE_BAND
    shake = Excitation(
        torque_rms=(MACHINE_RMS, 0.0),
        duration=DURATION,
        band=FORCE_BAND,
        shaping=(lambda f: ((f >= low) & (f <= high)).astype(float), None),
        shaker_rms=FORCE_RMS,
    )
    return _measure(arm, np.zeros(2), shake, [seed, 90])


def _beside_a_machine(rig: Arm) -> Arm:
    """Put a machine on the bench of the slide rig: a mass that its drive shakes."""
    spec = rig.spec.copy()
    machine = spec.body("bench").add_body(name="machine", pos=[-0.3, 0, 0.1])
    # In two halves, as every link of an arm: a seat, shut here, lies between them.
    for body in (machine, machine.add_body(name="machine_top")):
        body.mass, body.ipos = MACHINE_MASS / 2, [0, 0, 0]
        body.inertia, body.explicitinertial = [0.1] * 3, True
    machine.add_joint(name="machine", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    omega = 2 * np.pi * 5.0  # on its mounts, below its band

    def beside(own: Holding, stiffness: float, damping: float) -> Holding:
        return Holding(stiffness=(stiffness, *own.stiffness), damping=(damping, *own.damping))

    return replace(
        rig,
        spec=spec,
        joints=("machine", *rig.joints),
        seat_bodies=("machine_top", *rig.seat_bodies),
        torque_limits=(10 * MACHINE_RMS, *rig.torque_limits),
        joint_ranges=(None, *rig.joint_ranges),
        brake=beside(rig.brake, 1e7, 1e3),
        servo=beside(rig.servo, 2e4, 1e2),
        centring=beside(rig.centring, MACHINE_MASS * omega**2, MACHINE_MASS * omega),
        shaker=replace(rig.shaker, joint=2) if rig.shaker else None,
    )


def _measure(arm: Arm, pose: Array, shake: Excitation, key: list[int]) -> Measurement:
    """Measure a healthy arm by sensors that add nothing but their rate and band."""
    sensors = SensorSuite(
        rate=RATE,
        accelerometer=Accelerometer(noise_density=0.0, bandwidth=0.45 * RATE, resolution=0.0),
        encoder=Encoder(resolution=0.0, noise=0.0, linear_resolution=0.0, linear_noise=0.0),
    )
    rig = SimulatedRig(arm, sensors=sensors, threads=1)
    run = rig.measure(pose, shake, rng=np.random.default_rng(key))
    if run.failure is not None:
        raise InvalidData(f"the record of {arm.name!r} is worthless: {run.failure}")
    return run


def _velocity(run: Measurement) -> Array:
    """Velocity of the shaken joint, by central differences of its exact position (N,)."""
    position = run.encoder[0]
    return np.asarray((position[2:] - position[:-2]) * (run.rate / 2))
