"""A true machine: plain MuJoCo under a sampled servo loop, with everything a case drew."""

from __future__ import annotations

import dataclasses
from collections import deque

import mujoco
import numpy as np

from scripts.suites.machines.arms import STEP, Arm, Array, Extras, Fault, altered, true_xml
from scripts.suites.machines.disturbances import Disturbances

MOST_TURNED = 0.1
"""Departure of a joint from its pose above which a run is unstable [rad]."""
MOST_CHATTER = 0.05
"""Rms torque of a servo at rest over the limit, above which its loop is unstable."""
LOOK = 64
"""Steps between looks at the pose."""


class Unstable(Exception):
    """The servo loop does not hold the pose."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Servo:
    """What the controller of the machine does."""

    every: int
    """Integration steps between its samples."""
    delay: int
    """Samples from reading to torque."""
    smoothing: float
    """Share of a new velocity in the filtered one."""
    kp: Array
    """True stiffness [N m/rad] (n,)."""
    kv: Array
    """True damping [N m s/rad] (n,)."""
    constant: Array
    """True over nominal torque constant (n,)."""
    limit: Array
    """Torque at which the drives saturate [N m] (n,)."""
    resolution: float
    """Step of the servo's encoders [rad], 0 for exact ones."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Played:
    """True motion in a run, at the integration step."""

    acceleration: Array
    """Proper acceleration of the tool [m/s²] (T, 3)."""
    position: Array
    """Angles at the encoders [rad] (T, n)."""
    velocity: Array
    """The servo's estimate of speed [rad/s] (T, n)."""
    torque: Array
    """Torque that the controller asks for [N m] (T, n)."""
    seat: Array
    """Motion in the loose seat [m, rad] (T,); zeros where there is none."""


class Machine:
    """The arm as it is.

    Parameters
    ----------
    nominal : Arm
        Parameters that the user has.
    disturbances : Disturbances
        What else the machine has.
    fault : Fault or None
        What is loose.
    seed : sequence of int
        Of everything that belongs to the machine; the same one with and without the fault.
    """

    def __init__(
        self, nominal: Arm, disturbances: Disturbances, fault: Fault | None, seed: list[int]
    ) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        n = nominal.joints
        self.nominal, self.fault, self.disturbances = nominal, fault, disturbances
        size = disturbances.size
        arm = altered(nominal, size("parameter_errors", "relative"), rng)
        sign = rng.normal(size=3)
        offset = size("tool_offset", "offset") * sign / np.linalg.norm(sign)
        arm = dataclasses.replace(arm, tool=arm.tool + offset)
        spread = rng.uniform(0.7, 1.3, (8, n))
        bent: tuple[int, ...] = tuple(int(i) for i in rng.permutation(n)[: rng.integers(1, 3)])
        if not disturbances.has("flexible_links"):
            bent = ()
        extras = Extras(
            gears=disturbances.has("flexible_joints"),
            bent=bent,
            base=disturbances.has("compliant_base"),
            fault=fault,
        )
        self.arm = arm
        self.model = mujoco.MjModel.from_xml_string(true_xml(arm, extras))
        model = self.model
        model.dof_solref[:] = [0.002, 1.0]
        model.dof_solimp[:, :2] = 0.99
        motors = [model.joint(f"joint{i + 1}") for i in range(n)]
        self.motor_q = np.array([j.qposadr[0] for j in motors])
        self.motor_v = np.array([j.dofadr[0] for j in motors])
        self._springs(spread)
        if disturbances.has("cables"):
            model.jnt_stiffness[[j.id for j in motors]] = (
                size("cables", "stiffness") * arm.limit * spread[3]
            )
            model.qpos_spring[self.motor_q] = rng.uniform(-1, 1, n)
            model.dof_damping[self.motor_v] += size("cables", "damping") * arm.limit * spread[4]
        self.damping = model.dof_damping[self.motor_v].copy()
        coulomb = size("coulomb_friction", "share")
        if disturbances.has("stribeck_friction"):
            coulomb = max(coulomb, 0.005)
        self.coulomb = coulomb * arm.limit * spread[5]
        self.servo = self._servo(rng, spread)

    def _springs(self, spread: Array) -> None:
        """Give the extra joints stiffness and damping by their modes."""
        model, size = self.model, self.disturbances.size
        data = mujoco.MjData(model)
        data.qpos[self.motor_q] = 0.7
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        groups = {"gear": "flexible_joints", "bend": "flexible_links", "base": "compliant_base"}
        for j in range(model.njnt):
            name, dof = model.joint(j).name, model.jnt_dofadr[j]
            for prefix, kind in groups.items():
                if name.startswith(prefix):
                    factor = spread[len(prefix) % 3, j % spread.shape[1]]
                    omega = 2 * np.pi * size(kind, "mode") * factor
                    inertia = full[dof, dof]
                    model.jnt_stiffness[j] = inertia * omega**2
                    model.dof_damping[dof] = 2 * size(kind, "ratio") * inertia * omega

    def _servo(self, rng: np.random.Generator, spread: Array) -> Servo:
        nominal, size, n = self.nominal, self.disturbances.size, self.nominal.joints
        wanted = size("sampled_servo", "rate", 1 / STEP)
        every = max(2 ** round(np.log2(1 / STEP / wanted)), 2)
        bits = size("encoder_quantisation", "bits")
        cutoff = size("velocity_filter", "cutoff", 400.0 if bits else np.inf)
        off = size("servo_gains", "relative")
        errors = 1 + off * rng.uniform(-1, 1, (3, n))
        position = nominal.servoed
        return Servo(
            every=every,
            delay=round(size("sampled_servo", "delay")),
            smoothing=float(1 - np.exp(-2 * np.pi * cutoff * every * STEP)),
            kp=nominal.kp * (errors[0] if position else 1.0),
            kv=nominal.kv * (errors[1] if position else 1.0),
            constant=np.ones(n) if position else 1 + (errors[2] - 1) / 2,
            limit=nominal.limit * size("torque_saturation", "share", 1.0),
            resolution=2 * np.pi / 2 ** (round(bits) + 4) if bits else 0.0,
        )

    def play(
        self, pose: Array, hold: Array, shaken: Array, joint: int, settle: int, friction: float
    ) -> Played:
        """Hold a pose and shake a joint.

        Parameters
        ----------
        pose : (n,) array
            Where the run begins [rad].
        hold : (n,) array
            Position commands that hold it [rad], or torques of its weight [N m] of torque motors.
        shaken : (T,) array
            What is added to the command of the joint, by integration step.
        joint : int
            The joint.
        settle : int
            Steps before the noise, in which the loop must be at rest.
        friction : float
            Friction and damping in this session over those of the machine.

        Raises
        ------
        Unstable
            If the pose is left, or the loop chatters.
        """
        model, servo, n = self.model, self.servo, self.nominal.joints
        data = mujoco.MjData(model)
        self._rest(data, pose, friction)
        steps = len(shaken)
        width = model.nsensordata
        read, told = np.zeros((steps, width)), np.zeros((steps, n))
        speed = np.zeros((steps, n))
        limit, kp, kv = servo.limit, servo.kp, servo.kv
        position = self.nominal.servoed
        coulomb = friction * self.coulomb
        excess = self.disturbances.size("stribeck_friction", "excess")
        slow = self.disturbances.size("stribeck_friction", "speed", 1.0)
        load = friction * self.disturbances.size("load_friction", "share")
        varying = excess > 0 or load > 0
        command = np.array(hold if position else pose, dtype=float)
        rest = np.zeros(n) if position else np.array(hold)
        waiting = deque([np.array(rest if not position else data.ctrl)] * servo.delay)
        measured = self._measured(data)
        before, velocity = measured, np.zeros(n)
        per_second = 1 / (servo.every * STEP)
        torque = np.zeros(n)
        addresses = self.motor_v
        step = mujoco.mj_step
        target = command.copy()
        for k in range(steps):
            if k % servo.every == 0:
                measured = self._measured(data)
                velocity = velocity + servo.smoothing * (
                    (measured - before) * per_second - velocity
                )
                before = measured
                if position:
                    target[joint] = command[joint] + shaken[k]
                torque = kp * (target - measured) - kv * velocity + rest
                if not position:
                    torque[joint] += shaken[k]
                torque = np.minimum(np.maximum(torque, -limit), limit)
                waiting.append(torque)
                data.ctrl[:] = servo.constant * waiting.popleft()
                if varying:
                    true = data.qvel[addresses]
                    loss = coulomb * (1 + excess * np.exp(-((true / slow) ** 2)))
                    model.dof_frictionloss[addresses] = loss + load * np.abs(data.ctrl)
            if k % LOOK == 0 and not np.abs(data.qpos[self.motor_q] - pose).max() < MOST_TURNED:
                raise Unstable(f"a joint left its pose by more than {MOST_TURNED:g} rad")
            step(model, data)
            read[k] = data.sensordata
            told[k] = torque
            speed[k] = velocity
        played = Played(
            acceleration=read[:, :3],
            position=read[:, 3 : 3 + n],
            velocity=speed,
            torque=told,
            seat=read[:, 3 + n] if self.fault is not None else np.zeros(steps),
        )
        self._check(played, pose, settle)
        return played

    def lever(self, pose: Array) -> float:
        """Motion of the tool per motion in the loose seat [1, m/rad]."""
        data = mujoco.MjData(self.model)
        data.qpos[self.motor_q] = pose
        mujoco.mj_forward(self.model, data)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, jacobian, None, self.model.site("tool").id)
        return float(np.linalg.norm(jacobian[:, self.model.joint("seat").dofadr[0]]))

    def _measured(self, data: mujoco.MjData) -> Array:
        q: Array = data.qpos[self.motor_q]
        if self.servo.resolution:
            return np.round(q / self.servo.resolution) * self.servo.resolution
        return q

    def _rest(self, data: mujoco.MjData, pose: Array, friction: float) -> None:
        """Set the pose, springs bent by the arm's weight."""
        model = self.model
        model.dof_frictionloss[self.motor_v] = friction * self.coulomb
        model.dof_damping[self.motor_v] = friction * self.damping
        data.qpos[self.motor_q] = pose
        mujoco.mj_forward(model, data)
        for j in range(model.njnt):
            name = model.joint(j).name
            if not name.startswith(("joint", "seat")):
                dof = model.jnt_dofadr[j]
                data.qpos[model.jnt_qposadr[j]] = -data.qfrc_bias[dof] / model.jnt_stiffness[j]
        data.ctrl[:] = data.qfrc_bias[self.motor_v] / self.servo.constant

    def _check(self, played: Played, pose: Array, settle: int) -> None:
        everything = np.isfinite(played.acceleration).all()
        turned = np.abs(played.position - pose).max() if everything else np.inf
        if not turned < MOST_TURNED:
            raise Unstable(f"a joint left its pose by {turned:.3g} rad")
        still = played.torque[settle // 2 : settle]
        chatter = (still.std(axis=0) / self.nominal.limit).max()
        if chatter > MOST_CHATTER:
            raise Unstable(f"a servo at rest asks for {chatter:.0%} of its limit")
