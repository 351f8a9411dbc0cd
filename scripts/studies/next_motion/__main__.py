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
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from loose_agents.execution.script_errors import errors_in_one_line

from loose_env.gap import (
    NOTHING,
    GapResult,
    NextMotionSummary,
    PairGain,
    read_next_motion,
    read_result,
)
from loose_env.recording import Run, write_recording
from scripts.studies.next_motion.machine import (
    HOME,
    JOINTS,
    MODEL,
    RATE,
    SERVOS,
    Array,
    Machine,
    drawn,
    machine_with,
)

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
        gains = (
            ""
            if motion is None
            else "; ".join(
                gain_words(pair)
                for pair in motion.pairs
                if pair.separates or pair.effect != NOTHING
            )
        )
        lines.append(f"| {step.seconds:.0f} | {named(step.result)} | {told} | {gains} |")
    answer = {(e.kind, e.where) for e in steps[-1].result.effects}
    right = "correctly" if answer == set(pair) else "incorrectly"
    further = len(steps) - 1
    lines += ["", f"Identified {right} after {further} further motion{'s' * (further != 1)}."]
    return lines


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
            print("\n".join([f"**Session {number}**", "", *table(pair, steps), ""]), flush=True)


if __name__ == "__main__":
    main()
