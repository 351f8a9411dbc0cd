"""The boom of the cylindrical arm in bearing blocks with play.

The boom runs through four roller bearing blocks. With its weight behind their middle one
diagonal pair of blocks carries it, ahead of it the other pair. As it strokes through the point
between, it pitches from one pair to the other by the play: the boom's seat is a hinge with a
gap, its stops are the pairs of blocks, and gravity turns it over.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.signal import lfilter

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.thesis.rigs.cylindrical import GUIDE, cylindrical
from loose_env.typing import Array

SEAT_HINGE = "boom_pitch"
"""Joint about which the boom pitches in its blocks."""
AXES = ("joint1", "joint2", "joint3")
"""Joints of swing, lift and reach."""
_SOFT = 1e-4  # MuJoCo's smallest constraint impedance


@dataclass(frozen=True, kw_only=True)
class Guideway:
    """Guide, servos, sensors and trigger; estimates but for the potentiometer's noise."""

    play: float = 0.30e-3
    """Vertical travel of the boom within a bearing block [m]; 0 for a preloaded guide."""
    spacing: float = 0.50
    """Distance between front and rear blocks [m]."""
    block_stiffness: float = 4e7
    """Stiffness of one block [N/m]."""
    block_damping_ratio: float = 0.08
    """Damping of the boom's pitching on its blocks [1]."""
    servo_mode_hz: tuple[float, float, float] = (2.5, 6.0, 6.0)
    """Modes of the position servos of swing, lift and reach, all critically damped [Hz]."""
    potentiometer_noise: float = 25e-3
    """Noise of the reach potentiometer, peak to peak, taken as six deviations [V] (6.2.1)."""
    potentiometer_scale: float = 10.0 / 1.05
    """Volt per metre of reach."""
    feedback_bandwidth: float = 4.0
    """Two-pole low-pass of the potentiometer's signal in the servo [Hz]."""
    accelerometer_noise: float = 0.02
    """Noise of the accelerometer channel, rms [m/s²]."""
    trigger_jitter: float = 0.5e-3
    """Standard deviation of the controller's trigger [s]."""
    speed: float = 0.5
    """Speed of the stroke [m/s]."""
    ramp: float = 0.08
    """Time to reach it, and to stop [s]."""
    lead: float = 0.10
    """Time before the stroke starts [s]."""
    trigger: float = 0.12
    """Start of the record, after the start of the stroke [s]."""
    record: float = 1.40
    """Length of a record [s]."""
    rate: float = 1000.0
    """Sampling rate [Hz]."""
    timestep: float = 5e-4
    """Simulation step [s]."""

    @property
    def every(self) -> int:
        """Steps from sample to sample."""
        return max(1, round(1 / (self.rate * self.timestep)))

    @property
    def gap(self) -> float:
        """Angle by which the boom pitches from one pair of blocks to the other [rad]."""
        return 2 * self.play / self.spacing

    @property
    def pitch_stiffness(self) -> float:
        """Stiffness of the boom's pitching on a pair of blocks [N·m/rad]."""
        return self.block_stiffness * self.spacing**2 / 2


@dataclass(frozen=True, kw_only=True)
class StrokePose:
    """One of the poses: where the stroke runs while the other axes stand still."""

    name: str
    """Letter of the pose."""
    swing: float
    """Swing [rad]."""
    lift: float
    """Height of the carriage above its lowest place [m]."""
    start: float
    """Reach at the start of the stroke [m]."""
    end: float
    """Reach at its end [m]."""


POSES: dict[str, StrokePose] = {
    "A": StrokePose(name="A", swing=0.0, lift=0.05, start=0.50, end=1.00),
    "B": StrokePose(name="B", swing=0.0, lift=0.05, start=0.05, end=0.55),
    "C": StrokePose(name="C", swing=0.0, lift=0.70, start=0.50, end=1.00),
    "D": StrokePose(name="D", swing=0.0, lift=0.70, start=0.05, end=0.55),
    "E": StrokePose(name="E", swing=np.pi / 2, lift=0.70, start=0.50, end=1.00),
}
"""Out and low, in and low, out and high, in and high, and C swung by 90°; figures estimated."""


def shift_end(pose: StrokePose, by: float) -> StrokePose:
    """Return the pose with the end of its stroke moved [m].

    Examples
    --------
    >>> round(shift_end(POSES["A"], 0.002).end, 4)
    1.002
    """
    return StrokePose(
        name=pose.name, swing=pose.swing, lift=pose.lift, start=pose.start, end=pose.end + by
    )


def transfer_point() -> float:
    """Reach at which the weight of boom and wrist lies over the middle of the guide [m].

    Examples
    --------
    >>> 0.1 < transfer_point() < 0.5
    True
    """
    arm = cylindrical()
    data = mujoco.MjData(arm.model)
    mujoco.mj_forward(arm.model, data)
    boom = arm.model.body("flange3").id
    return float(data.body(GUIDE).xpos[0] - data.subtree_com[boom][0])


def guideway_model(pose: StrokePose, settings: Guideway) -> mujoco.MjModel:
    """Compile the arm with a locked wrist, servos on the major axes and the boom's seat."""
    spec = cylindrical().spec.copy()
    for number in (4, 5, 6):
        spec.delete(spec.joint(f"joint{number}"))
    blocks = spec.body(GUIDE)
    blocks.add_joint(name=SEAT_HINGE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
    stops = {"low": (0.0, 2.0), "high": (-2.0, 0.0)}
    for name, limits in stops.items():
        stop = spec.add_tendon(
            name=name,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=list(limits),
            solimp_limit=[_SOFT, _SOFT, 0.001, 0.5, 2],
        )
        stop.wrap_joint(SEAT_HINGE, 1.0)
    for joint in AXES:
        spec.add_actuator(name=f"servo_{joint}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint)
    sensor = mujoco.mjtSensor
    spec.add_sensor(
        name="acceleration",
        type=sensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="wrist_base",
    )
    for name in ("joint3", SEAT_HINGE):
        spec.add_sensor(
            name=f"place_{name}",
            type=sensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    spec.option.timestep = settings.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # MuJoCo 4.0.0 has a fault in its sparse Cholesky factorisation.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    _seat(model, settings)
    _servos(model, pose, settings)
    return model


def _inertia(model: mujoco.MjModel, pose: StrokePose) -> Array:
    """Inertia matrix in the middle of the stroke (nv, nv)."""
    data = mujoco.MjData(model)
    middle = (pose.swing, pose.lift, (pose.start + pose.end) / 2)
    for joint, value in zip(AXES, middle, strict=True):
        data.joint(joint).qpos[0] = value
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def _seat(model: mujoco.MjModel, settings: Guideway) -> None:
    """Set the boom's stops, or with no play the spring that takes their place."""
    hinge = model.joint(SEAT_HINGE)
    dof = hinge.dofadr[0]
    stiffness = settings.pitch_stiffness
    inertia = _inertia(model, POSES["B"])[dof, dof]
    damping = 2 * settings.block_damping_ratio * np.sqrt(stiffness * inertia)
    low, high = model.tendon("low").id, model.tendon("high").id
    if settings.play == 0:
        model.tendon_limited[[low, high]] = 0
        model.jnt_stiffness[hinge.id] = stiffness
        model.dof_damping[dof] = damping
        return
    model.tendon_range[low] = (-settings.gap / 2, 2.0)
    model.tendon_range[high] = (-2.0, settings.gap / 2)
    for stop in (low, high):
        weight = (1 - _SOFT) * model.tendon_invweight0[stop]
        model.tendon_solref_lim[stop] = (-stiffness * weight, -damping * weight)


def _servos(model: mujoco.MjModel, pose: StrokePose, settings: Guideway) -> None:
    """Give the major axes position servos for the inertia in the middle of the stroke."""
    inertia = _inertia(model, pose)
    for joint, mode in zip(AXES, settings.servo_mode_hz, strict=True):
        drive, dof = model.actuator(f"servo_{joint}").id, model.joint(joint).dofadr[0]
        mass, omega = inertia[dof, dof], 2 * np.pi * mode
        model.actuator_gainprm[drive, 0] = mass * omega**2
        model.actuator_biastype[drive] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_biasprm[drive, :3] = (0.0, -mass * omega**2, -2 * mass * omega)


@dataclass(frozen=True, kw_only=True, eq=False)
class Strokes:
    """Records of repeated strokes in one pose."""

    time: Array
    """Time since the nominal trigger [s] (N,)."""
    acceleration: Array
    """At the base of the wrist, along the boom, as measured [m/s²] (strokes, N)."""
    potentiometer: Array
    """Reach by the potentiometer, as measured [V] (strokes, N)."""
    reach: Array = field(repr=False)
    """True reach [m] (strokes, N)."""
    pitch: Array = field(repr=False)
    """True pitch of the boom on its blocks [rad] (strokes, N)."""


def stroke_many(
    pose: StrokePose, count: int, settings: Guideway, rng: np.random.Generator
) -> Strokes:
    """Stroke the horizontal axis again and again, under point-to-point control.

    Every stroke is simulated. From stroke to stroke the potentiometer's noise, which also
    goes through the servo, the accelerometer's noise and the trigger's jitter differ.

    Examples
    --------
    >>> from loose_env.thesis.ch6_experiments.arm.guideway import POSES
    >>> found = stroke_many(POSES["B"], 2, Guideway(record=0.2), np.random.default_rng(0))
    >>> found.acceleration.shape
    (2, 200)
    """
    model = guideway_model(pose, settings)
    start = _at_rest(model, pose, settings)

    margin = 6 * settings.trigger_jitter  # so that a jittered record has samples at its ends
    begin = settings.lead + settings.trigger - margin
    steps = round((begin + settings.record + 2 * margin) / settings.timestep)
    t = settings.timestep * np.arange(steps, dtype=float)
    control = np.tile(start[1], (count, steps, 1))
    noise = settings.potentiometer_noise / 6 / settings.potentiometer_scale
    control[:, :, 2] += _travel(t - settings.lead, pose, settings) - _seen_by_servo(
        noise, (count, steps), model, settings, rng
    )
    batch = Batch(model, count, 1)
    batch.state[:] = start[0]
    recorded = batch.rollout(steps, control, record=("sensordata",))["sensordata"]
    if not np.isfinite(recorded).all() or batch.warning[:, :, 1].any():
        raise InvalidData("a stroke diverged; use a shorter timestep or softer blocks")

    wanted = np.arange(round(settings.record * settings.rate)) / settings.rate
    first = round(begin / settings.timestep)
    jitter = np.clip(settings.trigger_jitter * rng.standard_normal(count), -margin, margin)
    sampled = np.empty((3, count, len(wanted)))
    for k in range(count):
        # Sensors of a step are those of its start; a sample is the mean over one period.
        at = begin + margin + jitter[k] + wanted
        # The accelerometer has three axes, the first along the boom.
        for channel, column in enumerate((0, 3, 4)):
            smooth = recorded[k, :, column]
            if channel == 0 and settings.every > 1:
                smooth = np.convolve(smooth, np.ones(settings.every) / settings.every, "same")
            sampled[channel, k] = np.interp(at, t[first:], smooth[first:])
    acceleration, reach, pitch = sampled
    shape = reach.shape
    return Strokes(
        time=wanted,
        acceleration=acceleration + settings.accelerometer_noise * rng.standard_normal(shape),
        potentiometer=settings.potentiometer_scale * reach
        + settings.potentiometer_noise / 6 * rng.standard_normal(shape),
        reach=reach,
        pitch=pitch,
    )


def _travel(t: Array, pose: StrokePose, settings: Guideway) -> Array:
    """Commanded reach [m] over time since the start of the stroke: smooth start and stop."""
    distance = pose.end - pose.start
    # A raised-cosine run up, steady speed, and the same down.
    ramp, speed = settings.ramp, settings.speed * np.sign(distance)
    steady = abs(distance) / settings.speed - ramp
    if steady < 0:
        raise InvalidSetting(
            f"a stroke of {distance:g} m is too short for ramps of {ramp:g} s to "
            f"{settings.speed:g} m/s"
        )

    def run_up(x: Array) -> Array:
        x = np.clip(x, 0.0, ramp)
        return np.asarray(speed / 2 * (x - ramp / np.pi * np.sin(np.pi * x / ramp)))

    up = run_up(t) + speed * np.clip(t - ramp, 0.0, None)
    stopped = t - ramp - steady
    down = run_up(stopped) + speed * np.clip(stopped - ramp, 0.0, None)
    return np.asarray(up - down)


def _seen_by_servo(
    noise: float,
    shape: tuple[int, int],
    model: mujoco.MjModel,
    settings: Guideway,
    rng: np.random.Generator,
) -> Array:
    """Noise of the reach potentiometer as an error of the set point [m].

    The drive acts on the position and on its rate, both through the feedback's low-pass.
    """
    dt = settings.timestep
    # White over the recording band; a step's sample carries more, so that the density is kept.
    white = noise * np.sqrt(1 / (settings.rate * dt)) * rng.standard_normal(shape)
    keep = np.exp(-2 * np.pi * settings.feedback_bandwidth * dt)
    # Two poles, so that the rate is low-passed too.
    poles = [1.0, -2 * keep, keep**2]
    low = np.asarray(lfilter([(1 - keep) ** 2], poles, white, axis=1))
    drive = model.actuator("servo_joint3").id
    gain, rate_gain = model.actuator_gainprm[drive, 0], -model.actuator_biasprm[drive, 2]
    rate = np.diff(low, axis=1, prepend=low[:, :1]) / dt
    return np.asarray(low + rate_gain / gain * rate)


def _at_rest(model: mujoco.MjModel, pose: StrokePose, settings: Guideway) -> tuple[Array, Array]:
    """State at rest at the start of the stroke, and the set points that hold it there."""
    data = mujoco.MjData(model)
    target = np.array([pose.swing, pose.lift, pose.start])
    data.qpos[[model.joint(j).qposadr[0] for j in AXES]] = target
    mujoco.mj_forward(model, data)
    weight = data.qfrc_bias[[model.joint(j).dofadr[0] for j in AXES]]
    data.ctrl[:] = target + weight / model.actuator_gainprm[:, 0]
    # Start on the pair of blocks that carries the boom, and let what sags come to rest.
    load = data.qfrc_bias[model.joint(SEAT_HINGE).dofadr[0]]
    data.joint(SEAT_HINGE).qpos[0] = -np.sign(load) * settings.gap / 2
    for _ in range(round(4.0 / settings.timestep)):
        mujoco.mj_step(model, data)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state, data.ctrl.copy()
