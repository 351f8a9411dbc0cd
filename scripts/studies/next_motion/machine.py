"""The stand-in for a real arm: plain MuJoCo, a controller of its own, and two hidden effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MODEL = """<mujoco model="stand-in">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002"/>
  <custom><numeric name="max_speed_rad_s" data="1.5"/></custom>
  <default><joint axis="0 1 0"/><geom type="capsule" mass="0" size="0.05"/></default>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1"/>
    <body name="base_link" pos="0 0 0.35">
      <inertial pos="0 0.01 0.05" mass="5" diaginertia="0.03 0.03 0.025"/>
      <joint name="waist" axis="0 0 1" range="-2.5 2.5" armature="0.3" damping="2"/>
      <geom fromto="0 0 -0.2 0 0 0.04" size="0.06"/>
      <body name="upper_arm" pos="0 0 0.12">
        <inertial pos="0.18 0 0" mass="2.8" diaginertia="0.004 0.04 0.04"/>
        <joint name="shoulder" range="-2.2 0.6" armature="0.25" damping="1.8"/>
        <geom fromto="0.03 0 0 0.34 0 0"/>
        <body name="forearm" pos="0.4 0 0">
          <inertial pos="0.16 0 0" mass="1.5" diaginertia="0.001 0.018 0.018"/>
          <joint name="elbow" range="-0.3 2.3" armature="0.09" damping="0.7"/>
          <geom fromto="0.05 0 0 0.32 0 0" size="0.04"/>
          <site name="tool" pos="0.36 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="waist_servo" joint="waist" kp="3000" kv="120" forcerange="-120 120"/>
    <position name="shoulder_servo" joint="shoulder" kp="3000" kv="110" forcerange="-120 120"/>
    <position name="elbow_servo" joint="elbow" kp="1000" kv="35" forcerange="-45 45"/>
  </actuator>
  <sensor>
    <jointpos name="waist_encoder" joint="waist"/>
    <jointpos name="shoulder_encoder" joint="shoulder"/>
    <jointpos name="elbow_encoder" joint="elbow"/>
  </sensor>
</mujoco>
"""
"""The model that is known: position servos with the gains of the controller."""
JOINTS = ("waist", "shoulder", "elbow")
LINKS = ("base_link", "upper_arm", "forearm")
SERVOS = tuple(f"{joint}_servo" for joint in JOINTS)
HOME = np.array([0.0, -0.6, 0.9])
"""Pose in which every run begins [rad]."""
RATE, STEP = 250.0, 2e-5
"""Samples a second, and the step of machine and PD loop [s]."""
ENCODER_STEP, ENCODER_NOISE = 2 * np.pi / 2**16, 3e-5
"""Resolution and noise of the encoders [rad]."""
TORQUE_NOISE = 0.005
"""Noise of the torque readings over the torque limit [1]."""


@dataclass(kw_only=True)
class Machine:
    """The stand-in: its model, and what its controller does that the model does not show."""

    spec: mujoco.MjSpec
    """The mechanics."""
    stiffness: Array
    """Gains of the PD loop on the position [N·m/rad]."""
    damping: Array
    """Gains on the speed [N·m·s/rad]."""
    limits: Array
    """Torque limits [N·m]."""
    delay: Array = field(default_factory=lambda: np.zeros(3))
    """Delay of each command [s]."""
    offset: Array = field(default_factory=lambda: np.zeros(3))
    """What each encoder shows beyond the angle [rad]."""

    def play(self, commands: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Play commands (T, 3) from rest; readings of encoders and torques (T, 3) each."""
        model = self.spec.copy().compile()
        data = mujoco.MjData(model)
        data.qpos[:3] = commands[0] - self.offset
        parts = round(1 / (RATE * STEP))
        late = np.round(self.delay / STEP).astype(int)
        given = np.repeat(commands, parts, axis=0)
        rows = np.arange(len(given))
        reaching = np.stack([given[np.maximum(rows - late[k], 0), k] for k in range(3)], axis=1)
        shown, torques = np.zeros((2, len(commands), 3))

        def step(command: Array) -> None:
            error = command - data.qpos[:3] - self.offset
            torque = self.stiffness * error - self.damping * data.qvel[:3]
            data.ctrl[:] = np.clip(torque, -self.limits, self.limits)
            mujoco.mj_step(model, data)

        for _ in range(round(1.5 / STEP)):  # comes to rest
            step(commands[0])
        for row in range(len(commands)):
            shown[row] = data.qpos[:3] + self.offset
            torques[row] = np.clip(
                self.stiffness * (reaching[row * parts] - shown[row])
                - self.damping * data.qvel[:3],
                -self.limits,
                self.limits,
            )
            for command in reaching[row * parts : (row + 1) * parts]:
                step(command)
        shown += rng.normal(0.0, ENCODER_NOISE, shown.shape)
        torques += rng.normal(0.0, 1.0, torques.shape) * TORQUE_NOISE * self.limits
        return ENCODER_STEP * np.round(shown / ENCODER_STEP), torques


Hide = Callable[[Machine, float], None]


def _friction(joint: str) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        dry = machine.spec.joint(joint)
        dry.frictionloss, dry.solref_friction = size, [5e-4, 1.0]
        dry.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2]

    return hide


def _viscous(joint: str) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        own = machine.spec.joint(joint)
        own.damping = np.asarray(own.damping) + np.array([size, 0.0, 0.0])

    return hide


def _rotor(joint: str) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        machine.spec.joint(joint).armature += size

    return hide


def _payload(machine: Machine, size: float) -> None:
    load = machine.spec.body("forearm").add_body(name="load", pos=[0.36, 0.0, 0.0])
    load.mass, load.inertia, load.explicitinertial = size, [1e-5 * size] * 3, True


def _mass(link: str) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        body = machine.spec.body(link)  # as if of denser material
        factor = 1 + size / body.mass
        body.mass, body.inertia = factor * body.mass, factor * np.asarray(body.inertia)

    return hide


def _gain(number: int) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        machine.stiffness[number] *= 1 + size
        machine.damping[number] *= 1 + size

    return hide


def _delay(number: int) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        machine.delay[number] = size

    return hide


def _offset(number: int) -> Hide:
    def hide(machine: Machine, size: float) -> None:
        machine.offset[number] = size

    return hide


def _tilt(machine: Machine, size: float) -> None:
    machine.spec.option.gravity = [9.81 * np.sin(size), 0.0, -9.81 * np.cos(size)]


HIDDEN: dict[tuple[str, str], tuple[Hide, float, float]] = {
    **{("coulomb_friction", j): (_friction(j), 0.8, 3.0) for j in JOINTS},
    **{("viscous_friction", j): (_viscous(j), 2.0, 8.0) for j in JOINTS},
    **{("rotor_inertia", j): (_rotor(j), 0.08, 0.25) for j in JOINTS},
    ("payload", "tool"): (_payload, 0.3, 0.9),
    ("link_mass", "upper_arm"): (_mass("upper_arm"), 0.4, 1.0),
    **{("actuator_gain", SERVOS[k]): (_gain(k), 0.08, 0.25) for k in range(3)},
    **{("command_delay", SERVOS[k]): (_delay(k), 0.003, 0.010) for k in range(3)},
    **{("encoder_offset", j): (_offset(k), 0.01, 0.04) for k, j in enumerate(JOINTS) if k},
    ("base_tilt", "base"): (_tilt, 0.01, 0.04),
}
"""What may be hidden: kind and location as the catalogue calls them, and least and largest size."""


def machine_with(pair: Sequence[tuple[str, str]], rng: np.random.Generator) -> Machine:
    """Build the machine, its parameters off by 1 to 3 %, with effects of random sizes."""

    def off(count: int = 1) -> Array:
        return 1 + rng.choice([-1.0, 1.0], count) * rng.uniform(0.01, 0.03, count)

    spec = mujoco.MjSpec.from_string(MODEL)
    known = spec.copy().compile()
    for servo in list(spec.actuators):
        spec.delete(servo)
    for joint in JOINTS:
        spec.joint(joint).damping = np.asarray(spec.joint(joint).damping) * off()[0]
        motor = spec.add_actuator(name=f"{joint}_motor", target=joint)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
    for link in LINKS:
        spec.body(link).mass *= off()[0]
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    gains = off(3)
    machine = Machine(
        spec=spec,
        stiffness=np.array(known.actuator_gainprm[:, 0]) * gains,
        damping=-np.array(known.actuator_biasprm[:, 2]) * gains,
        limits=np.array(known.actuator_forcerange[:, 1]),
    )
    for place in pair:
        hide, low, high = HIDDEN[place]
        hide(machine, float(rng.uniform(low, high)))
    return machine


def drawn(count: int, seed: int) -> list[list[tuple[str, str]]]:
    """Pairs of hidden effects, at two locations each (count, 2)."""
    pairs = [
        list(pair)
        for pair in combinations(HIDDEN, 2)
        if pair[0][1] != pair[1][1] and pair[0][0] != pair[1][0]
    ]
    order = np.random.default_rng([seed, 34]).permutation(len(pairs))
    return [pairs[k] for k in order[:count]]
