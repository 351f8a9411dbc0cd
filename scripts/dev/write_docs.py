"""Write the tables of the documents that the code itself knows.

Usage: python scripts/dev/write_docs.py [--check]

With --check nothing is written; the exit status says whether the files are up to date.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import gymnasium

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import Arm
from loose_env.cli.command import command
from loose_env.envs import DIFFICULTIES, DiagnosisEnv
from loose_env.errors import InvalidData
from loose_env.io import write_text
from loose_env.registration import IDS, TIERS

DOCS = Path(__file__).resolve().parents[2] / "docs"
COLUMNS = 100
"""Width of prose."""
LEFT_OUT = ("Version History",)
"""Sections of the environments' docstring that the page does without."""

SCALINGS = {"linear": "value / {}", "log10": "log10(value / {})", "asinh": "asinh(value / {})"}
"""How a scaling is written in the tables."""
TIER_WORDS = {
    "loose_env/ControlTier-v0": "little: one record of all joints nearly decides",
    "loose_env/StoppingTier-v0": "when to stop, more than which records",
    "loose_env/GravityTier-v0": "joints and poses that open the seat against gravity, on a wall",
    "loose_env/WeakDriveTier-v0": "joints and poses that open the seat at half the drive",
}
"""What tells agents apart on each tier."""
MEANINGS = {
    "sin_pose, cos_pose": "the pose: sine and cosine of a joint that turns; of one that slides its "
    "place in its range, from -1 at the low end to 1 at the high end, and a zero",
    "valid": "1 where the record was measured; 0 in a slot that is empty",
    "level": "level asked for at the joint, 0 for one that was held",
    "torque": "rms torque that shook the joint (force where it slides), as a share of the most it "
    "can give",
    "level_share": "share of the level that was left once torque was kept within its limit; 1 for "
    "a joint that was held",
    "duration": "length of the record",
    "transmission": "acceleration of the tool along an axis for each unit of the joint's measured "
    "acceleration: covariance of the two over the variance of the joint's, in the band",
    "transmission_by_instrument": "the same, with the command as instrument: covariance of command "
    "and tool over that of command and joint; noise of the encoder does not shrink it",
    "joint_rms": "rms acceleration of the joint, in the band",
    "inertia": "apparent inertia of the joint: its torque for each unit of its acceleration "
    "(mass where it slides)",
    "tool_rms": "rms acceleration of the tool along an axis, in the band",
    "tool_correlation": "correlation of the tool's accelerations along two different axes",
    "lowest_direction": "direction along which the tool follows the shaken joints least, a unit "
    "vector without a sign: products of two of its components, xx, xy, yy and so on",
    "coherence.lowest": "squared correlation of the tool with the shaken joints along that "
    "direction; 0 by construction where fewer joints are shaken than the tool has axes",
    "correlation.maximum": "highest correlation (not squared) of the tool with the shaken joints "
    "along any direction",
    "skewness, kurtosis": "shape of the tool's motion along an axis, not limited to the band; "
    "kurtosis is counted from that of a Gaussian, so both are 0 for one",
    "lowest_skewness, lowest_kurtosis": "the same along the direction of `lowest_direction`",
    "nominal_*": "the same statistic as the nominal, healthy arm would show it",
    "now.*": "the pose in which the arm is now",
    "spent.records, spent.seconds, spent.levels": "what has been spent: records as a share of "
    "those allowed, seconds of excitation, levels added up over joints and records",
    "left.records": "share of the records that are left",
}
"""What each name of an element means; ``*`` stands for any of the other names."""


def environments() -> str:
    """Describe every environment: its arm, its actions, each element of its observation."""
    parts = [
        "# Environments",
        "",
        *prose(
            "Every environment hides a fault in an arm; an agent moves and shakes the arm, and "
            "names the fault. What all of them have in common comes first: actions, observation, "
            "rewards, arguments, options of `reset`. Then each environment has its arm and every "
            "element of its observation."
        ),
        "",
        *prose(
            "Links and joints are numbered from the base here: `structural_looseness@link3` is the "
            "link that the third driven joint carries, loose on it, and `backlash@joint3` play in "
            "that joint. [The instrument](instrument.md) names the same faults by the names in the "
            "arm's model, such as `structural_looseness@forearm`."
        ),
        "",
        *prose("Printed by `python scripts/dev/write_docs.py`; edit the code, not this page."),
        "",
        *docstring_sections(),
        "",
        "## Difficulties",
        "",
        *difficulty_table(),
        "",
        "## Tiers",
        "",
        *tiers(),
        "",
        "## Names of elements",
        "",
        *prose(
            "One row of an observation's table stands for as many elements as its second column "
            "says: \\<joint\\> is each joint's name, base first, \\<axis\\> each measured axis of "
            "the tool frame, \\<axes\\> two of these axes: in `tool_correlation` two different "
            "ones (xy), in `lowest_direction` also the same one twice (xx, xy, yy). Where an arm "
            "has both kinds of joints, \\<hinge\\> is one that turns and \\<slide\\> one that "
            "slides. Elements of a record begin with record\\<k\\>, k from 1. Joints run slower "
            "than axes, and `print(env.unwrapped.layout.table())` lists every element in order."
        ),
        "",
        *prose(
            "Each element is scaled, as the fourth column says, and then clipped to its bounds: "
            "`value / s` for what has a natural range, `log10(value / s)` for amplitudes, "
            "`asinh(value / s)` for what may have either sign and any size (it is linear near zero "
            "and a logarithm far from it). The amplitude of a joint that was not shaken is at its "
            "lower bound. A slot in which nothing has been measured is zero throughout."
        ),
        "",
        "| name | meaning |",
        "|---|---|",
        *(f"| {names_cell(names)} | {meaning} |" for names, meaning in MEANINGS.items()),
    ]
    for env_id in IDS:
        env = gymnasium.make(env_id).unwrapped
        assert isinstance(env, DiagnosisEnv)
        env.close()
        parts += ["", f"## {env_id}", "", *arm_table(env.arm), "", *observation_table(env)]
    return "\n".join(parts) + "\n"


def prose(text: str) -> list[str]:
    """Break a paragraph into lines; what stands between backticks stays on one line."""
    kept = re.sub(r"`[^`]*`", lambda code: code[0].replace(" ", "\0"), " ".join(text.split()))
    lines = textwrap.wrap(kept, COLUMNS, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines]


def docstring_sections() -> list[str]:
    """What the environments' docstring says, section by section, tables as they stand."""
    text = inspect.cleandoc(DiagnosisEnv.__doc__ or "")
    lines: list[str] = []
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        title, _, body = section.partition("\n")
        if title in LEFT_OUT:
            continue
        lines += ["", f"## {title}"]
        for paragraph in body.strip().split("\n\n"):
            table = paragraph.startswith("|")
            lines += ["", *(paragraph.splitlines() if table else prose(paragraph))]
    return lines[1:]


def names_cell(names: str) -> str:
    """Names of a row of meanings as code."""
    return ", ".join(f"`{name}`" for name in names.split(", "))


def meaning_of(name: str) -> str | None:
    """What an element's name means, by the table of meanings; None where it has no row.

    Examples
    --------
    >>> meaning_of("duration")
    'length of the record'
    >>> meaning_of("nominal_joint_rms.joint1") == MEANINGS["nominal_*"]
    True
    """
    rows = {each: meaning for names, meaning in MEANINGS.items() for each in names.split(", ")}
    for prefix in ("nominal_", "now."):
        if name.startswith(prefix):
            known = meaning_of(name.removeprefix(prefix)) is not None
            return rows[f"{prefix}*"] if known else None
    return rows.get(name) or rows.get(name.partition(".")[0])


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
        elif field.name == "friction_over":
            rows.append(f"| friction: pose that counts | {' | '.join(values)} |")
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
        *prose(
            "Friction is the guide's Coulomb friction over the rms force that the top level drives "
            "across the shut seat, the best single joint excited, in the median or in the best of "
            "48 poses; with the best pose and friction below 1 no seat is shut for every agent, "
            "gravity aside. The gap is in metres (play in a joint that turns is the gap at "
            "full reach, in one that slides the gap itself); contact modes are in Hz; tilt, "
            "misalignment and joint zeros are in degrees, the other mismatches are relative."
        ),
    ]
    return rows


def tiers() -> list[str]:
    """Ids of the tiers, and the value of choice measured on each."""
    arguments = {
        tier: ", ".join(f"`{name}={value!r}`" for name, value in how.items()) or "none"
        for tier, (_, how) in TIERS.items()
    }
    return [
        *prose(
            "Tiers are environments of the arms below with arguments of their own, by what a good "
            "agent needs on them. Arguments given to `make` replace a tier's."
        ),
        "",
        "| id | arm's id | arguments | what separates agents |",
        "|---|---|---|---|",
        *(
            f"| `{tier}` | `{of}` | {arguments[tier]} | {TIER_WORDS[tier]} |"
            for tier, (of, _) in TIERS.items()
        ),
        "",
        *prose(
            "Paired differences of returns on the same fresh arms say what choosing records is "
            "worth on each: [table and definitions](benchmark.md#metrics)."
        ),
    ]


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
        *prose(
            f"The observation has {layout.size} elements: {len(layout.global_elements)} about now, "
            f"then {layout.slots} slots of {len(layout.slot_elements)}. The action space is "
            f"`{env.action_space}`."
        ),
        "",
        "| elements | number | unit | scaling | bounds |",
        "|---|---|---|---|---|",
    ]
    groups = (("", layout.global_elements), ("record\\<k\\>.", layout.slot_elements))
    for prefix, elements in groups:
        counts: Counter[tuple[str, ...]] = Counter()
        for e in elements:
            scaling = SCALINGS[e.scaling]
            counts[
                prefix + pattern(env.arm, e.name),
                e.unit,
                scaling.format(f"{e.scale:.3g}"),
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """What is done."""

    check: bool = False
    """Write nothing: fail where the page is out of date."""


def write(options: Options) -> None:
    """Write the page, or check it."""
    path, text = DOCS / "environments.md", environments()
    if not options.check:
        print(f"wrote {write_text(path, text)}")
    elif not path.is_file() or path.read_text(encoding="utf-8") != text:
        raise InvalidData(f"{path.name} is out of date: run python scripts/dev/write_docs.py")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page, with errors in one line."""
    command("write_docs", __doc__, Options, write, arguments)


if __name__ == "__main__":
    main()
