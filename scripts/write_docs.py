"""Write the tables of the documents that the code itself knows.

Usage: python scripts/write_docs.py [--check]

With --check nothing is written; the exit status says whether the files are up to date.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections import Counter
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
        "",
        "## Names of elements",
        "",
        "One row of an observation's table stands for as many elements as its second column says: "
        "\\<joint\\> is each joint's name, base first, \\<axis\\> each measured axis of the tool "
        "frame, \\<axes\\> each pair of them. Where an arm has both, \\<hinge\\> is a joint that "
        "turns and \\<slide\\> one that slides. Joints run slower than axes, and "
        "`print(env.unwrapped.layout.table())` lists every single element in order. The place of a "
        "sliding joint runs from -1 at the low end of its range to 1 at the high end; a move of "
        "90 degrees takes it through half of its range.",
    ]
    for env_id in IDS:
        env = gymnasium.make(env_id).unwrapped
        assert isinstance(env, DiagnosisEnv)
        env.close()
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
                ", ".join(f"{k} {p:.2f}" for k, p in d.probabilities().items())
                for d in DIFFICULTIES.values()
            )
            rows.append(f"| kinds of fault | {cells} |")
        else:
            cells = " | ".join(f"{low:g} to {high:g}" for low, high in values)
            rows.append(f"| {field.name} | {cells} |")
    rows += [
        "",
        "Friction is the guide's Coulomb friction over the rms force that the top level drives "
        "across the shut seat; the gap is in metres (play in a joint that turns is the gap at full "
        "reach, in one that slides the gap itself); contact modes are in Hz; tilt, misalignment "
        "and joint zeros are in degrees, the other mismatches are relative.",
    ]
    return rows


def arm_table(arm: Arm) -> list[str]:
    """Figures of an arm, then those of each joint with their units."""
    gravity = [float(g) for g in arm.model.opt.gravity]
    figures = {
        "arm": arm.name,
        "joints": str(arm.n),
        "reach [m]": f"{arm.reach:.4g}",
        "gravity, world axes [m/s²]": ", ".join(f"{g:g}" for g in gravity),
        "measured axes of the tool": ", ".join("xyz"[a] for a in arm.axes),
        "levels 1 to 3, rms tool acceleration [m/s²]": ", ".join(f"{v:g}" for v in arm.levels),
        "band [Hz]": f"{arm.band[0]:g} to {arm.band[1]:g}",
        "simulation step [ms]": f"{1e3 * arm.timestep:g}",
    }
    rows = ["| figure | value |", "|---|---|", *(f"| {k} | {v} |" for k, v in figures.items())]
    rows += [
        "",
        "| joint | kind | range | peak torque | brake stiffness | brake damping "
        "| servo stiffness |",
        "|---|---|---|---|---|---|---|",
    ]
    for j, name in enumerate(arm.joints):
        slides, span = bool(arm.sliding[j]), arm.joint_ranges[j]
        place, force, spring, damper = (
            ("m", "N", "N/m", "N·s/m") if slides else ("rad", "N·m", "N·m/rad", "N·m·s/rad")
        )
        cells = (
            name,
            "slide" if slides else "hinge",
            "endless" if span is None else f"{span[0]:.3g} to {span[1]:.3g} {place}",
            f"{arm.torque_limits[j]:g} {force}",
            f"{arm.brake.stiffness[j]:.3g} {spring}",
            f"{arm.brake.damping[j]:.3g} {damper}",
            f"{arm.servo.stiffness[j]:.3g} {spring}",
        )
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def observation_table(env: DiagnosisEnv) -> list[str]:
    """Elements of the observation, those that differ in joint and axis alone in one row."""
    layout = env.layout
    rows = [
        f"The observation has {layout.size} elements: {len(layout.global_elements)} about now, "
        f"then {layout.slots} slots of {len(layout.slot_elements)}. The action space is "
        f"`{env.action_space}`.",
        "",
        "| elements | number | unit | scaling | bounds |",
        "|---|---|---|---|---|",
    ]
    groups = (("", layout.global_elements), ("record\\<k\\>.", layout.slot_elements))
    for prefix, elements in groups:
        counts: Counter[tuple[str, ...]] = Counter()
        for e in elements:
            scaling = "value" if e.scaling == "linear" else e.scaling
            counts[
                prefix + pattern(env.arm, e.name),
                e.unit,
                f"{scaling} / {e.scale:.3g}",
                f"{e.low:g} to {e.high:g}",
            ] += 1
        for (name, *cells), count in counts.items():
            rows.append(f"| {' | '.join([name, str(count), *cells])} |")
    return rows


def pattern(arm: Arm, name: str) -> str:
    """Name of an element with <joint> for its joint, <axis> or <axes> for its axes.

    Where an arm has hinges and slides, <hinge> and <slide> tell them apart.
    """
    group, dot, last = name.rpartition(".")
    mixed = bool(arm.sliding.any() and not arm.sliding.all())
    # The longest name first: a joint may be called like the beginning of another.
    for joint in sorted(arm.joints, key=len, reverse=True):
        if last == joint or last.startswith(f"{joint}_"):
            slides = bool(arm.sliding[arm.joints.index(joint)])
            kind = ("slide" if slides else "hinge") if mixed else "joint"
            rest = last.removeprefix(joint)
            axis = rest[1:] in ("x", "y", "z")
            return f"{group}.\\<{kind}\\>" + ("_\\<axis\\>" if axis else rest)
    if dot and set(last) <= set("xyz"):
        return f"{group}.\\<{'axis' if len(last) == 1 else 'axes'}\\>"
    return name


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
