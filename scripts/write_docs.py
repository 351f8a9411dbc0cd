"""Write the tables of the documents that the code itself knows.

Usage: python scripts/write_docs.py [--check]

With --check nothing is written; the exit status says whether the files are up to date.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import gymnasium

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms.arm import Arm
from loose_env.envs.diagnosis import DiagnosisEnv
from loose_env.envs.difficulty import DIFFICULTIES
from loose_env.envs.registration import IDS

DOCS = Path(__file__).resolve().parent.parent / "docs"


def environments() -> str:
    """Describe every environment: its arm, its actions, each element of its observation."""
    parts = [
        "# Environments",
        "",
        "Printed by `python scripts/write_docs.py`; edit the code, not this file.",
        "",
        "## Difficulties",
        "",
        *difficulty_table(),
    ]
    for env_id in IDS:
        env = gymnasium.make(env_id).unwrapped
        assert isinstance(env, DiagnosisEnv)
        parts += ["", f"## {env_id}", "", *arm_table(env.arm), "", *observation_table(env)]
    return "\n".join(parts) + "\n"


def difficulty_table() -> list[str]:
    """Ranges of the named difficulties."""
    first = next(iter(DIFFICULTIES.values()))
    names = list(DIFFICULTIES)
    rows = ["| figure | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for field in dataclasses.fields(first):
        values = [getattr(d, field.name) for d in DIFFICULTIES.values()]
        if field.name == "mismatch":
            for part in dataclasses.fields(values[0]):
                cells = " | ".join(f"{getattr(v, part.name):g}" for v in values)
                rows.append(f"| mismatch: {part.name}, standard deviation | {cells} |")
        elif field.name == "kinds":
            cells = " | ".join(
                ", ".join(f"{k} {p:.2f}" for k, p in value.items()) for value in values
            )
            rows.append(f"| kinds of fault | {cells} |")
        else:
            cells = " | ".join(f"{low:g} to {high:g}" for low, high in values)
            rows.append(f"| {field.name} | {cells} |")
    rows += [
        "",
        "Friction is the guide's Coulomb friction over the rms force that the top level drives "
        "across the shut seat; the gap is in metres (play in a joint is the gap at full reach); "
        "contact modes are in Hz; tilt, misalignment and joint zeros are in degrees, the other "
        "mismatches are relative.",
    ]
    return rows


def arm_table(arm: Arm) -> list[str]:
    """Figures of an arm."""
    ranges = ", ".join(
        "endless" if r is None else f"{r[0]:.2f} to {r[1]:.2f}" for r in arm.joint_ranges
    )
    figures = {
        "joints": str(arm.n),
        "reach [m]": f"{arm.reach:g}",
        "peak torque [N·m]": ", ".join(f"{t:g}" for t in arm.torque_limits),
        "joint ranges [rad]": ranges,
        "levels 1 to 3, rms tool acceleration [m/s²]": ", ".join(f"{v:g}" for v in arm.levels),
        "band [Hz]": f"{arm.band[0]:g} to {arm.band[1]:g}",
        "brake stiffness [N·m/rad]": ", ".join(f"{k:.3g}" for k in arm.brake.stiffness),
        "brake damping [N·m·s/rad]": ", ".join(f"{k:.3g}" for k in arm.brake.damping),
        "servo stiffness [N·m/rad]": ", ".join(f"{k:.3g}" for k in arm.servo.stiffness),
        "simulation step [ms]": f"{1e3 * arm.timestep:g}",
    }
    return ["| figure | value |", "|---|---|", *(f"| {k} | {v} |" for k, v in figures.items())]


def observation_table(env: DiagnosisEnv) -> list[str]:
    """Every element of the observation: the globals, and one slot."""
    layout = env.layout
    rows = [
        f"The observation has {layout.size} elements: {len(layout.global_elements)} about now, "
        f"then {layout.slots} slots of {len(layout.slot_elements)}. The action space is "
        f"`{env.action_space}`.",
        "",
        "| element | unit | scaling | bounds |",
        "|---|---|---|---|",
    ]
    groups = (("", layout.global_elements), ("record\\<k\\>.", layout.slot_elements))
    for prefix, elements in groups:
        for e in elements:
            scaling = "value" if e.scaling == "linear" else e.scaling
            rows.append(
                f"| {prefix}{e.name} | {e.unit} | {scaling} / {e.scale:.3g} "
                f"| {e.low:g} to {e.high:g} |"
            )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the files, or check them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only say whether they are current")
    options = parser.parse_args(arguments)
    path, text = DOCS / "environments.md", environments()
    if options.check:
        if not path.is_file() or path.read_text() != text:
            sys.exit(f"{path.name} is out of date: run python scripts/write_docs.py")
        return
    beside = path.with_suffix(".part")
    beside.write_text(text)
    beside.replace(path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
