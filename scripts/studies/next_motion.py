"""A stand-in for a real arm, identified only through the files that `loose gap --next` writes.

The machine is plain MuJoCo: an arm of three joints on motors, a PD loop of its own at 50 kHz, two
hidden effects written into the model by hand, parameters 1 to 3 % off those that are known,
encoders that are quantised and noisy torque readings at 250 Hz. Nothing of the package simulates
it.

An operator records two gentle motions. Then `loose gap RECORDING --out A --next` names what it can
and writes the next motion; the machine plays ``next_motion.csv``, twice; and `loose gap A NEW`
goes on, until nothing is left that a motion would tell apart, or a motion has changed nothing and
no rival competes with the answer, or after five motions. The session is printed as a table.
Finished steps are kept: a session that was interrupted goes on.

Usage: python -m scripts.studies.next_motion --out out/next-motion [--pairs 3] [--seed 1]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
from loose_agents.execution.script_errors import errors_in_one_line
from numpy.typing import NDArray

from loose_env.gap import (
    NOTHING,
    GapResult,
    NextMotionSummary,
    PairGain,
    read_next_motion,
    read_result,
)
from loose_env.recording import Run, write_recording

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
KINDS = (
    *("viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag"),
    *("load_friction", "asymmetric_friction", "rotor_inertia", "joint_spring", "torque_ripple"),
    *("link_mass", "link_com", "payload", "gravity_compensation", "base_tilt"),
    *("actuator_gain", "actuator_lag", "command_delay", "torque_limit", "voltage_limit"),
    *("dead_zone", "torque_constant", "encoder_offset", "gear_eccentricity"),
    *("sensor_gain", "sensor_bias", "sensor_delay"),
)
"""Kinds that are considered unless the whole catalogue is: all but springs and parts with stops,
which take ten times as long to simulate."""
MOST_MOTIONS = 5
"""Motions after which a session ends."""


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


def gentle(rng: np.random.Generator) -> Array:
    """What an operator runs first: small slow swings of all joints, 5 s (T, 3) [rad]."""
    time = np.arange(round(5.0 * RATE)) / RATE
    waves = sum(
        rng.uniform(0.03, 0.08, 3) * np.sin(np.outer(time, rng.uniform(0.6, 1.6, 3)))
        for _ in range(2)
    )
    fade = np.clip((time - 0.3) / 1.0, 0.0, 1.0)
    return np.asarray(HOME + waves * (fade**2 * (3 - 2 * fade))[:, None])


def recorded(
    folder: Path, machine: Machine, motions: Sequence[Array], rng: np.random.Generator
) -> None:
    """Record motions of the machine."""
    runs = []
    for number, commands in enumerate(motions, start=1):
        shown, torques = machine.play(commands, rng)
        runs.append(
            Run(
                name=f"run-{number:02d}.csv",
                time=np.arange(len(commands)) / RATE,
                controls={servo: commands[:, k] for k, servo in enumerate(SERVOS)},
                sensors={f"{j}_encoder": shown[:, k] for k, j in enumerate(JOINTS)},
                torques={j: torques[:, k] for k, j in enumerate(JOINTS)},
            )
        )
    write_recording(folder, model_xml=MODEL, runs=runs, file_format="csv")


def loose(*arguments: object) -> None:
    """Run the command line of the package."""
    given = [sys.executable, "-m", "loose_env", *map(str, arguments)]
    print("$ loose " + " ".join(map(str, arguments)), file=sys.stderr, flush=True)
    if subprocess.run(given, check=False, stdout=sys.stderr).returncode:
        raise SystemExit(f"loose {' '.join(map(str, arguments))} failed")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One row of a session."""

    seconds: float
    """Machine time so far [s]."""
    result: GapResult
    """Answer from all runs so far."""
    motion: NextMotionSummary | None
    """The motion that is asked for next."""


def session(
    folder: Path, pair: Sequence[tuple[str, str]], seed: Sequence[int], kinds: Sequence[str]
) -> list[Step]:
    """Run one session, or what is left of it."""
    machine = machine_with(pair, np.random.default_rng([*seed, 0]))
    steps: list[Step] = []
    chosen, seconds = ["--kinds", *kinds] if kinds else [], 0.0
    for number in range(MOST_MOTIONS + 1):
        rng = np.random.default_rng([*seed, 1, number])
        new, out = folder / f"recording-{number}", folder / f"answer-{number}"
        if number:
            table = np.genfromtxt(
                folder / f"answer-{number - 1}" / "next_motion.csv", delimiter=",", names=True
            )
            ctrl = [f"ctrl{servo}" for servo in SERVOS]  # genfromtxt leaves the point out
            commands = np.stack([np.asarray(table[name], dtype=float) for name in ctrl], axis=1)
            motions = [commands, commands]
        else:
            motions = [gentle(rng), gentle(rng)]
        seconds += sum(len(each) for each in motions) / RATE
        if not new.is_dir():
            recorded(new, machine, motions, rng)
        if not (out / "result.json").is_file():
            before = [folder / f"answer-{number - 1}"] if number else []
            loose("gap", *before, new, "--out", out, "--next", "--threads", 1, *chosen)
        file = out / "next_motion.json"
        motion = read_next_motion(file) if file.is_file() else None
        steps.append(Step(seconds=seconds, result=read_result(out), motion=motion))
        if motion is None or _settled(steps):
            break
    return steps


def _settled(steps: Sequence[Step]) -> bool:
    """Return whether a motion has changed nothing, and nothing competes with the answer."""
    motion = steps[-1].motion
    if len(steps) < 2 or motion is None or named(steps[-1].result) != named(steps[-2].result):
        return False
    return not any(pair.effect != NOTHING and pair.separates for pair in motion.pairs)


def named(result: GapResult) -> str:
    """Effects of an answer."""
    found = sorted(f"`{e.kind}` at {e.where}" for e in result.effects)
    return ", ".join(found) or result.verdict


def gain_words(pair: PairGain) -> str:
    """Expected gain of a pair; of an effect that the runs would not show "nothing" is left out."""
    nats = f"{pair.nats:.0f} nats" if pair.separates else "not separated"
    if pair.effect == NOTHING:
        return f"{pair.rival} if it is there: {nats}"
    return f"{pair.effect} from {pair.rival}: {nats}"


def table(pair: Sequence[tuple[str, str]], steps: Sequence[Step]) -> list[str]:
    """Lines of a session's table."""
    hidden = " and ".join(f"`{kind}` at {where}" for kind, where in pair)
    lines = [
        f"Hidden: {hidden}.",
        "",
        "| machine time [s] | named | next motion | expected to show or separate |",
        "|---:|---|---|---|",
    ]
    for step in steps:
        motion = step.motion
        told = "none needed" if motion is None else f"{motion.seconds:.0f} s, {motion.words}"
        gains = "" if motion is None else "; ".join(map(gain_words, motion.pairs))
        lines.append(f"| {step.seconds:.0f} | {named(step.result)} | {told} | {gains} |")
    answer = {(e.kind, e.where) for e in steps[-1].result.effects}
    right = "right" if answer == set(pair) else "not right"
    lines += ["", f"The answer is {right}, after {len(steps) - 1} motions."]
    return lines


def drawn(count: int, seed: int) -> list[list[tuple[str, str]]]:
    """Pairs of hidden effects, at two locations each (count, 2)."""
    pairs = [
        list(pair)
        for pair in combinations(HIDDEN, 2)
        if pair[0][1] != pair[1][1] and pair[0][0] != pair[1][0]
    ]
    order = np.random.default_rng([seed, 34]).permutation(len(pairs))
    return [pairs[k] for k in order[:count]]


def main() -> None:
    """Read the options and run the sessions."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/next-motion"), help="folder")
    parser.add_argument("--pairs", type=int, default=3, help="sessions (default: 3)")
    parser.add_argument("--seed", type=int, default=1, help="of pairs, sizes, noise (default: 1)")
    parser.add_argument("--whole", action="store_true", help="consider the whole catalogue")
    options = parser.parse_args()
    with errors_in_one_line("next_motion"):
        for number, pair in enumerate(drawn(options.pairs, options.seed), start=1):
            folder = options.out / f"session-{options.seed}-{number}"
            folder.mkdir(parents=True, exist_ok=True)
            kinds = () if options.whole else KINDS
            steps = session(folder, pair, (options.seed, number), kinds)
            print("\n".join([f"### Session {number}", "", *table(pair, steps), ""]), flush=True)


if __name__ == "__main__":
    main()
