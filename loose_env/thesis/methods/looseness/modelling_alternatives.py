"""The seven modelling alternatives for looseness, compared on one simulated arm (thesis 3.2.1).

Every alternative predicts one measured quantity from others. What is left over is called the
disagreement. A loose seat changes it, the sensors' noise adds to it, and what the model does not
know is in it even when the arm is healthy. All three are found here for each alternative in
the same arm, pose and drive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from loose_env.arms import Arm, LinearArm, LinearPose, MismatchDraw
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.rig import PlantShop
from loose_env.sensors import SensorSuite
from loose_env.thesis.methods.looseness.looseness_joint import seated_inertia
from loose_env.thesis.methods.looseness.static_force_test import simulate_docked
from loose_env.typing import Array, ComplexArray

ALTERNATIVES = (
    "displacement",
    "velocity",
    "acceleration",
    "static force",
    "unconstrained dynamics",
    "flexible dynamics",
    "constrained dynamics",
)
"""Names of the seven, in the thesis's order."""
MEASURES = (
    ("tool place by tracker, joint angles", "m"),
    ("tool accelerometer integrated, joint angles differenced", "m/s"),
    ("tool accelerometer, joint angles differenced twice", "m/s²"),
    ("jig force, joint torques", "N·m"),
    ("tool accelerometer, joint torques and angles", "m/s²"),
    ("tool accelerometer, joint torques; modes known", "m/s²"),
    ("jig force, joint torques, joint angles differenced twice", "N·m"),
)
"""Measured quantities of each, and the unit of its prediction."""


@dataclass(frozen=True, kw_only=True)
class AlternativeSettings:
    """Drive and sensors of the comparison. All noise is white up to half the rate."""

    sensors: SensorSuite = field(default_factory=SensorSuite)
    """Encoders, tool accelerometer and the rate of every channel."""
    tracker_noise: float = 20e-6
    """Rms noise of a tool position per axis [m]; assumed, as of a laser tracker."""
    force_noise: float = 0.05
    """Rms noise of the jig's force sensor per axis [N]; assumed, as of a six-axis sensor."""
    torque_noise: float = 0.005
    """Rms error of a joint's torque, as a share of its peak torque; assumed."""
    duration: float = 1.2
    """Length of a record [s]."""
    slow_band: tuple[float, float] = (1.0, 10.0)
    """Band of the static-force test [Hz]; friction and inertia hardly matter there."""
    level: int = 3
    """Excitation level of the arm, from 1, for each of its joints."""
    slow_share: float = 0.1
    """Rms torque of the static-force test, as a share of the peak torque."""


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """One alternative: rms disagreements over its band, in the unit of what it predicts."""

    name: str
    """The alternative."""
    measures: str
    """Measured quantities."""
    unit: str
    """Unit of the disagreement."""
    gap: float
    """Change that the gap makes in the disagreement."""
    noise: float
    """Disagreement due to sensor noise."""
    model: float
    """Disagreement of the healthy arm without noise: the model error."""

    @property
    def against_noise(self) -> float:
        """Signal-to-noise ratio of the gap, amplitudes; the model taken as perfect."""
        return self.gap / self.noise

    @property
    def against_all(self) -> float:
        """The same with the model's error counted as noise."""
        return self.gap / float(np.hypot(self.noise, self.model))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Free:
    """Motion of the free arm at every step of a whole period, tool frame of the pose."""

    angle: Array
    rate: Array
    joint: Array
    place: Array
    velocity: Array
    acceleration: Array
    torque: Array


def compare_alternatives(
    arm: Arm,
    pose: Array,
    fault: StructuralLooseness,
    rng: np.random.Generator,
    *,
    settings: AlternativeSettings | None = None,
) -> tuple[Disagreement, ...]:
    """Compare the seven alternatives (3.1, 3.3, 3.9, 3.10, 3.17, flexible, 3.20).

    The free arm is shaken in its band, all joints at once. For the two alternatives with a
    constrained tool, a pin holds it; the static one is driven slowly. Healthy and loose arm get
    the same torques, and the gap counts by the rms difference of their disagreements.

    ``arm``: planar arm with as many joints as `Arm.axes` names directions, its motion in x-y.
    ``pose`` (n,): where it stands [rad].

    Examples
    --------
    >>> ALTERNATIVES[0]
    'displacement'
    """
    s = AlternativeSettings() if settings is None else settings
    q = np.asarray(pose, dtype=float)
    linear = LinearArm(arm).at(q)
    kinematic = linear.kinematic
    inertia = seated_inertia(arm, q, Healthy())
    shake = _excitation(arm, linear, s)
    steps = {"timestep": arm.timestep, "rng": rng}
    run_in = round(arm.settling / arm.timestep)
    fast = torque_signals(shake, before=run_in, after=0, **steps)  # type: ignore[arg-type]
    slow_rms = tuple(s.slow_share * t for t in arm.torque_limits)
    slow = torque_signals(
        Excitation(torque_rms=slow_rms, duration=s.duration, band=s.slow_band),
        before=run_in,
        after=0,
        **steps,  # type: ignore[arg-type]
    )
    count = fast.shape[1] - run_in
    frequency: Array = np.asarray(np.fft.rfftfreq(count, arm.timestep), dtype=np.float64)

    def spectrum(x: Array) -> ComplexArray:
        return np.asarray(np.fft.rfft(x[..., -count:], axis=-1) / count)

    free = [_shake(arm, q, f, fast) for f in (Healthy(), fault)]
    fast_held = [simulate_docked(arm, q, f, fast, jig="pin") for f in (Healthy(), fault)]
    slow_held = [simulate_docked(arm, q, f, slow, jig="pin") for f in (Healthy(), fault)]
    # The pin's force is in world axes, the Jacobian in those of the tool.
    turn = _tool_axes(arm, q)
    flexible = _interpolated(linear, frequency)
    forward = kinematic @ np.linalg.inv(inertia)

    def left_over(name: str, k: int) -> ComplexArray:
        m = free[k]
        tool = spectrum(m.acceleration)
        if name == "displacement":
            return spectrum(m.place - kinematic @ m.angle)
        if name == "velocity":
            return spectrum(m.velocity - kinematic @ m.rate)
        if name == "acceleration":
            return spectrum(m.acceleration - kinematic @ m.joint)
        if name == "unconstrained dynamics":
            return np.asarray(tool - forward @ spectrum(m.torque))
        if name == "flexible dynamics":
            return np.asarray(tool - np.einsum("kdm,mk->dk", flexible, spectrum(fast)))
        held = (slow_held if name == "static force" else fast_held)[k]
        rest = spectrum(held.torques) + kinematic.T @ turn.T @ spectrum(held.forces)
        if name == "static force":
            return np.asarray(rest)
        return np.asarray(rest - inertia @ spectrum(held.accelerations))

    noise = _noise(arm, kinematic, inertia, flexible, frequency, s)
    found = []
    for name, (measures, unit) in zip(ALTERNATIVES, MEASURES, strict=True):
        low, high = _band(name, arm, s)
        inside = (frequency >= low - 1e-9) & (frequency <= high + 1e-9)
        healthy, loose = left_over(name, 0)[:, inside], left_over(name, 1)[:, inside]
        found.append(
            Disagreement(
                name=name,
                measures=measures,
                unit=unit,
                gap=_rms(loose - healthy),
                noise=noise[name],
                model=_rms(healthy),
            )
        )
    return tuple(found)


def _band(name: str, arm: Arm, s: AlternativeSettings) -> tuple[float, float]:
    if name == "displacement":  # slow motion of the seat counts as well
        return 1 / s.duration, arm.band[1]
    return s.slow_band if name == "static force" else arm.band


def _rms(lines: ComplexArray) -> float:
    """Rms of a signal vector from its one-sided Fourier lines."""
    return float(np.sqrt(2 * (np.abs(lines) ** 2).sum()))


def _excitation(arm: Arm, linear: LinearPose, s: AlternativeSettings) -> Excitation:
    """Torques that give the tool the level from each joint, all of them free to move."""
    answer = linear.response([True] * arm.n).tool
    per_torque = np.sqrt(np.mean(np.sum(np.abs(answer) ** 2, axis=1), axis=0))
    torque = np.minimum(arm.levels[s.level - 1] / per_torque, np.array(arm.torque_limits) / 3)
    return Excitation(
        torque_rms=tuple(float(t) for t in torque), duration=s.duration, band=arm.band
    )


def _tool_axes(arm: Arm, pose: Array) -> Array:
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(arm.model, data)
    return np.asarray(data.site(arm.tool).xmat.reshape(3, 3)[:2, :2].copy())


def _shake(arm: Arm, pose: Array, fault: Healthy | StructuralLooseness, torque: Array) -> _Free:
    """Simulate the free arm; every joint driven, none braked."""
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    plant = shop.build(fault, MismatchDraw.none(arm))
    model = plant.model
    data = mujoco.MjData(model)
    data.qpos[plant.position] = plant.hold_at(pose)
    data.eq_active[:] = model.eq_active0
    data.eq_active[plant.brakes] = False
    mujoco.mj_forward(model, data)
    tool = model.site(arm.tool).id
    start, turn = data.site_xpos[tool].copy(), data.site_xmat[tool].reshape(3, 3).copy()
    joints = [model.joint(name) for name in arm.joints]
    dofs = np.array([j.dofadr[0] for j in joints])
    stiffness = model.jnt_stiffness[[j.id for j in joints]]
    steps, n = torque.shape[1], arm.n
    rows = np.empty((steps, 3 * n + 4))
    for k in range(steps):
        data.ctrl[:n] = torque[:, k]
        angle = data.qpos[plant.position] - pose
        passive = stiffness * angle + model.dof_damping[dofs] * data.qvel[dofs]
        mujoco.mj_step(model, data)
        # After the step, site and accelerometer still are those of the state before it.
        rows[k] = np.concatenate(
            [
                angle,
                ((data.site_xpos[tool] - start) @ turn)[:2],
                data.sensordata[:2],
                torque[:, k] - passive,
                data.qacc[dofs],
            ]
        )
    angle, place, acceleration, net, joint = np.split(rows.T, [n, n + 2, n + 4, 2 * n + 4])
    return _Free(
        angle=angle,
        # The integrator's own velocities are these differences.
        rate=np.diff(angle, prepend=0.0) / arm.timestep,
        joint=joint,
        place=place,
        velocity=np.diff(place, prepend=0.0) / arm.timestep,
        acceleration=acceleration,
        torque=net,
    )


def _interpolated(linear: LinearPose, frequency: Array) -> ComplexArray:
    """Tool acceleration per torque of the flexible model at the record's lines (K, d, m)."""
    answer = linear.response([True] * linear.linear.arm.n)
    out = np.zeros((len(frequency), *answer.tool.shape[1:]), dtype=complex)
    for d in range(out.shape[1]):
        for m in range(out.shape[2]):
            h = answer.tool[:, d, m]
            real = np.interp(frequency, answer.frequency, h.real)
            out[:, d, m] = real + 1j * np.interp(frequency, answer.frequency, h.imag)
    return out


def _noise(
    arm: Arm,
    kinematic: Array,
    inertia: Array,
    flexible: ComplexArray,
    frequency: Array,
    s: AlternativeSettings,
) -> dict[str, float]:
    """Rms of every disagreement when there is nothing but sensor noise, in closed form."""
    encoder = s.sensors.encoder
    per_hz = 2 / s.sensors.rate  # one-sided density of a channel of rms 1
    angle = (encoder.noise**2 + encoder.resolution**2 / 12) * per_hz
    accelerometer = s.sensors.accelerometer
    sampled = accelerometer.noise_density**2 + accelerometer.resolution**2 / 12 * per_hz
    torque = (s.torque_noise * np.array(arm.torque_limits)) ** 2 * per_hz
    omega = 2 * np.pi * frequency
    forward = kinematic @ np.linalg.inv(inertia)
    axes = len(kinematic)
    lever = float((kinematic**2).sum())
    flat = np.ones_like(frequency)
    force = lever * s.force_noise**2 * per_hz
    tracker = axes * s.tracker_noise**2 * per_hz
    density: dict[str, Callable[[], Array]] = {
        "displacement": lambda: (tracker + lever * angle) * flat,
        "velocity": lambda: (
            axes * sampled / np.maximum(omega, 1e-9) ** 2 + lever * angle * omega**2
        ),
        "acceleration": lambda: axes * sampled + lever * angle * omega**4,
        "static force": lambda: (torque.sum() + force) * flat,
        "unconstrained dynamics": lambda: (
            (axes * sampled + float((forward**2 @ torque).sum())) * flat
        ),
        "flexible dynamics": lambda: (
            axes * sampled + np.einsum("kdm,m->k", np.abs(flexible) ** 2, torque)
        ),
        "constrained dynamics": lambda: (
            torque.sum() + force + float((inertia**2).sum()) * angle * omega**4
        ),
    }
    step = frequency[1] - frequency[0]
    found = {}
    for name in ALTERNATIVES:
        low, high = _band(name, arm, s)
        inside = (frequency >= low - 1e-9) & (frequency <= high + 1e-9)
        found[name] = float(np.sqrt(density[name]()[inside].sum() * step))
    return found
