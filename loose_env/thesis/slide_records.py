"""Records of a slide shaken through a stinger, and of a resolver behind a gear with play.

The slide of Experiments Two and Three: a shaker's table drives it along its rails on a bench
that moves too. An accelerometer cube on it is turned by a known angle from the rails.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from loose_env.errors import InvalidData

__all__ = [
    "RESOLVER_UNIT",
    "BaseRecord",
    "ResolverRecords",
    "SlideRecords",
    "resolver_records",
    "slide_records",
]

Array = NDArray[np.float64]

SLIDE_MASS = 0.50
"""Slide with cube and accelerometers [kg] (6.3.2)."""
TABLE_MASS = 8.0
"""Moving part of the shaker [kg]; an estimate."""
STINGER_MASS = 0.0171
"""Steel rod of 0.0199 in² and 0.17 m [kg] (6.3.2)."""
STINGER_MODE_HZ = 710.0
"""Mode of the slide on its stinger, as measured (6.3.2)."""
BENCH_MASS = 150.0
"""Bench and what stands on it [kg]; an estimate."""
BENCH_MODES_HZ = (24.0, 50.5, 101.0)
"""Modes along the rails, across them and of turning [Hz]; the last two as seen (6.3.1)."""
BENCH_JOINTS = ("bench_along", "bench_across", "bench_turn")
BENCH_DAMPING = 0.01
"""Damping ratio of those modes; an estimate."""
BENCH_CANT = np.radians(15.0)
"""Angle of the bench's principal axes to the rails [rad]; an estimate."""
FORCE_RMS = 40.0
"""Force of the shaker [N]; an estimate."""
FORCE_BAND = (40.0, 2000.0)
"""Corners of the force: weak below the first (6.3.1), the amplifier's limit above [Hz]."""
FULL_SCALE = 50.0
"""Full scale of a tape channel [m/s²]; an estimate."""
TAPE_RATIO_DB = 46.0
"""Full scale over noise of an FM tape channel [dB]; an estimate."""
TAPE_OFFSET = 0.005
"""Deviation of a channel's offset over its full scale [1]; an estimate."""
GAIN_ERROR, CROSS_AXIS, PROTRACTOR = 0.005, 0.01, np.radians(0.15)
"""Deviations of gain and cross-axis sensitivity [1], and of the angle read [rad]; estimates."""
RATE, DURATION, STEP, SETTLING = 10_000.0, 2.0, 5e-5, 0.3

RESOLVER_UNIT = 2 * np.pi / 2**16
"""One unit of a resolver of 16 bits [rad]."""
RESOLVER_RATE = 1000.0
"""Readings of the resolver through the computer's digital port [Hz]; an estimate."""
GEAR_PLAY = 3 * RESOLVER_UNIT
"""Play between link and resolver [rad]: one arc-minute; an estimate."""
LINK_INERTIA, LINK_TORQUE_RMS, LINK_BAND = 1.0, 22.0, (40.0, 150.0)
"""Link 1 about its joint [kg·m²], torque by the shaker [N·m], its band [Hz]; estimates."""


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
    """True velocity of the slide along the rails [m/s] (A, N)."""
    shaken_by: dict[str, BaseRecord]
    """Records about the base's motion, by what shakes the bench."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResolverRecords:
    """Link 1 driven from outside, and what its resolver says."""

    rate: float
    """Sampling rate [Hz]."""
    angle: Array
    """True angle of the link [rad] (N,)."""
    velocity: Array
    """True velocity of the link [rad/s] (N,)."""
    resolver: Array
    """Reading behind the gear [units of `RESOLVER_UNIT`] (N,)."""


def slide_records(seed: int) -> SlideRecords:
    """Shake the slide with the cube at 0 to 90 degrees; then once with the bench shaken too.

    Examples
    --------
    >>> slide_records.__name__
    'slide_records'
    """
    alpha = np.radians(np.arange(0.0, 91.0, 5.0))
    model = _bench()
    runs, steps = len(alpha) + 1, round((SETTLING + DURATION) / STEP)
    control = np.zeros((runs, steps, 2))
    for k in range(runs):
        rng = np.random.default_rng([seed, 100 + k])
        control[k, :, 0] = _coloured(rng, steps, FORCE_BAND, FORCE_RMS, order=2)
    # Another machine on the same floor shakes the bench in the last run.
    rng = np.random.default_rng([seed, 90])
    control[-1, :, 1] = _coloured(rng, steps, (8.0, 60.0), 150.0, order=2)
    recorded = _simulate(model, control)
    every = round(1 / (RATE * STEP))
    start = round(SETTLING / STEP)
    tail = recorded[:, start:].reshape(runs, -1, every, recorded.shape[2]).mean(axis=2)
    along, across, shaker, base = tail[..., 0], tail[..., 1], tail[..., 3], tail[..., 6]
    velocity = tail[..., 9]

    rng = np.random.default_rng([seed, 91])
    noise = FULL_SCALE * 10 ** (-TAPE_RATIO_DB / 20)
    sensors = np.eye(2) + np.array([[GAIN_ERROR, CROSS_AXIS], [CROSS_AXIS, GAIN_ERROR]]) * (
        rng.standard_normal((2, 2))
    )
    turned = alpha + PROTRACTOR * rng.standard_normal(len(alpha))
    c, s = np.cos(turned)[:, None], np.sin(turned)[:, None]
    cube = np.array([c * along[:-1] - s * across[:-1], s * along[:-1] + c * across[:-1]])
    measured = np.einsum("ij,jkn->ikn", sensors, cube)
    measured += noise * rng.standard_normal(measured.shape)
    measured += TAPE_OFFSET * FULL_SCALE * rng.standard_normal((2, len(alpha), 1))
    base_gain = 1 + 0.03 * rng.standard_normal()  # another kind of sensor on the bench
    shaken_by = {
        name: BaseRecord(
            slide=along[k] + noise * rng.standard_normal(along.shape[1]),
            base=base_gain * base[k] + 0.1 * noise * rng.standard_normal(along.shape[1]),
            relative=along[k] - base[k],
        )
        for name, k in (("the shaker's own reaction", 0), ("another machine too", runs - 1))
    }
    return SlideRecords(
        rate=RATE,
        alpha=alpha,
        x=measured[0],
        y=measured[1],
        shaker=shaker[:-1],
        velocity=velocity[:-1],
        shaken_by=shaken_by,
    )


def resolver_records(seed: int) -> ResolverRecords:
    """Drive link 1 from outside and read its resolver behind a gear with play."""
    spec = _spec(STEP)
    link = _point(spec.worldbody, "link", 1.0, LINK_INERTIA)
    link.add_joint(
        name="link",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        stiffness=[LINK_INERTIA * (2 * np.pi * 3.0) ** 2, 0, 0],
        damping=[2 * 0.7 * LINK_INERTIA * 2 * np.pi * 3.0, 0, 0],
    )
    rotor = _point(spec.worldbody, "rotor", 0.1, 2e-4)
    rotor.add_joint(
        name="rotor",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        frictionloss=0.05,
        # Friction that truly sticks.
        solref_friction=[2 * STEP, 1.0],
        solimp_friction=[0.9999, 0.9999, 0.001, 0.5, 2],
    )
    mesh = spec.add_tendon(
        name="mesh",
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[-GEAR_PLAY / 2, GEAR_PLAY / 2],
        solref_limit=[4 * STEP, 1.0],
    )
    mesh.wrap_joint("link", 1.0)
    mesh.wrap_joint("rotor", -1.0)
    spec.add_actuator(name="drive", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="link")
    for name in ("link", "rotor"):
        _joint_sensor(spec, name, mujoco.mjtSensor.mjSENS_JOINTPOS)
    _joint_sensor(spec, "link", mujoco.mjtSensor.mjSENS_JOINTVEL)
    rng = np.random.default_rng([seed, 95])
    steps = round((SETTLING + DURATION) / STEP)
    torque = _coloured(rng, steps, LINK_BAND, LINK_TORQUE_RMS, order=3)
    recorded = _simulate(spec.compile(), torque[None, :, None])[0]
    every = round(1 / (RESOLVER_RATE * STEP))
    angle, rotor_angle, velocity = recorded[round(SETTLING / STEP) :: every].T
    return ResolverRecords(
        rate=RESOLVER_RATE,
        angle=angle,
        velocity=velocity,
        resolver=np.floor(rotor_angle / RESOLVER_UNIT),
    )


def _spec(step: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = step
    spec.option.gravity = [0, 0, 0]
    # MuJoCo 4.0.0 has a fault in its sparse Cholesky factorisation.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return spec


def _bench() -> mujoco.MjModel:
    """Bench on its mounts, and on it the shaker's table, the stinger and the slide."""
    spec = _spec(STEP)
    slide_joint, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    turning = BENCH_MASS * 0.25  # 0.5 m radius of gyration
    bench = _point(spec.worldbody, "bench", BENCH_MASS, turning)
    c, s = np.cos(BENCH_CANT), np.sin(BENCH_CANT)
    mounts = zip(
        BENCH_JOINTS,
        (slide_joint, slide_joint, hinge),
        ([c, s, 0], [-s, c, 0], [0, 0, 1]),
        strict=True,
    )
    for name, kind, axis in mounts:
        bench.add_joint(name=name, type=kind, axis=axis)
    # The rails lie beside the bench's centre of mass, so the shaker turns the bench too.
    moving = SLIDE_MASS + STINGER_MASS / 3
    for name, x, mass in (("table", -0.25, TABLE_MASS), ("slide", 0.10, moving)):
        body = _point(bench, name, mass, 1e-3, at=(x, 0.12, 0.0))
        body.add_joint(name=name, type=slide_joint, axis=[1, 0, 0], damping=[5.0, 0, 0])
        if name == "table":
            body.first_joint().stiffness = [TABLE_MASS * (2 * np.pi * 10.0) ** 2, 0, 0]
        body.add_site(name=name)
    bench.add_site(name="bench")
    reduced = TABLE_MASS * moving / (TABLE_MASS + moving)
    omega = 2 * np.pi * STINGER_MODE_HZ
    stinger = spec.add_tendon(
        name="stinger",
        stiffness=[reduced * omega**2, 0, 0],
        damping=[2 * 0.02 * reduced * omega, 0, 0],
    )
    stinger.wrap_joint("slide", 1.0)
    stinger.wrap_joint("table", -1.0)
    for joint in ("table", "bench_along"):
        spec.add_actuator(name=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint)
    for name in ("slide", "table", "bench"):
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=name,
        )
    _joint_sensor(spec, "slide", mujoco.mjtSensor.mjSENS_JOINTVEL)
    model = spec.compile()
    # Mounts that give the loaded bench its modes.
    data, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    for name, mode in zip(BENCH_JOINTS, BENCH_MODES_HZ, strict=True):
        joint, omega = model.joint(name), 2 * np.pi * mode
        dof = joint.dofadr[0]
        model.jnt_stiffness[joint.id] = inertia[dof, dof] * omega**2
        model.dof_damping[dof] = 2 * BENCH_DAMPING * inertia[dof, dof] * omega
    return model


def _point(
    parent: mujoco.MjsBody,
    name: str,
    mass: float,
    inertia: float,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> mujoco.MjsBody:
    return parent.add_body(
        name=name,
        pos=list(at),
        mass=mass,
        ipos=[0, 0, 0],
        inertia=[inertia, inertia, inertia],
        explicitinertial=True,
    )


def _joint_sensor(spec: mujoco.MjSpec, joint: str, kind: mujoco.mjtSensor) -> None:
    spec.add_sensor(
        name=f"{joint}_{int(kind)}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint
    )


def _coloured(
    rng: np.random.Generator, steps: int, band: tuple[float, float], rms: float, *, order: int
) -> Array:
    """Gaussian noise within a band, falling off on either side [rms's unit] (steps,)."""
    shape = butter(order, band, "bandpass", fs=1 / STEP, output="sos")
    signal = np.asarray(sosfilt(shape, rng.standard_normal(steps)))
    return np.asarray(signal * (rms / signal.std()))


def _simulate(model: mujoco.MjModel, control: Array) -> Array:
    """Run the simulations from rest; sensors at every step (runs, steps, channels)."""
    batch = Batch(model, len(control), 1)
    recorded = batch.rollout(control.shape[1], control, record=("sensordata",))["sensordata"]
    if not np.isfinite(recorded).all() or batch.warning[:, :, 1].any():
        raise InvalidData("the simulated slide diverged; use a shorter step")
    return np.asarray(recorded)
