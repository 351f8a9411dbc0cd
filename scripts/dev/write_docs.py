"""Write the generated parts of the documentation: tables of pages, JSON Schemas of file formats.

Usage: python scripts/dev/write_docs.py [--check]

With --check nothing is written; the exit status says whether the pages are up to date.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import Arm
from loose_env.cli.command import command
from loose_env.envs import DIFFICULTIES, DiagnosisEnv, JointPose
from loose_env.errors import InvalidData
from loose_env.gap import GapResult, NextMotion, Tolerances
from loose_env.instrument import PRESETS, Diagnosis, Numbers, Plan, Trend
from loose_env.io import plain, write_text
from loose_env.recording import Description
from loose_env.registration import IDS, TIERS
from scripts.dev.threshold_table import entries, threshold_table
from scripts.study import between
from scripts.suites.gap.ablation import NUMBERS, PACKAGE, tried

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "environments.md"
GAP = DOCS / "gap.md"
INSTRUMENT = DOCS / "instrument.md"
SCHEMAS = DOCS / "schemas"
COLUMNS = 100
"""Width of prose."""
LEFT_OUT = ("Version History",)
"""Sections of the environments' docstring that the page does without."""

SCALINGS = {"linear": "value / {}", "log10": "log10(value / {})", "asinh": "asinh(value / {})"}
"""How a scaling is written in the tables."""
TIER_WORDS = {
    "loose_env/ControlTier-v0": "a sanity check: one record of all joints nearly decides",
    "loose_env/StoppingTier-v0": "when to stop, more than which records",
    "loose_env/GravityTier-v1": "joints and poses that open the seat against gravity, on a wall",
    "loose_env/WeakDriveTier-v1": "joints and poses that open the seat at half the drive",
    "loose_env/SearchTier-v0": "results: each move splits the links that are left in two",
}
"""What tells agents apart on each tier."""
MEANINGS = {
    "sin_pose": "sine of a hinge's position; of a slide its place in its range, -1 to 1",
    "cos_pose": "cosine of a hinge's position; 0 for a slide",
    "range_pose": "place in its range of each hinge of more than a whole turn",
    "valid": "1 where the record was measured, 0 in an empty slot",
    "level": "level asked for; 0 for a held joint",
    "torque": "rms torque over the limit (force of a slide)",
    "level_share": "share of the level left once torque was limited; 1 for a held joint",
    "duration": "length of the record",
    "transmission": "cov(tool, joint acceleration) / var(joint acceleration), in the band",
    "transmission_by_instrument": "cov(tool, command) / cov(joint, command): unbiased by encoder "
    "noise",
    "joint_rms": "rms acceleration of the joint, in the band",
    "inertia": "apparent inertia: torque per acceleration of the joint",
    "tool_rms": "rms acceleration of the tool along an axis, in the band",
    "tool_correlation": "correlation of the tool's accelerations along two axes",
    "lowest_direction": "direction of lowest coherence u: products of its components xx, xy, yy, "
    "...",
    "coherence.lowest": "squared correlation along it; 0 if fewer joints are shaken than d",
    "correlation.maximum": "highest correlation along any direction",
    "skewness": "skewness of the tool along an axis, not limited to the band",
    "kurtosis": "its excess kurtosis",
    "lowest_skewness": "skewness along `lowest_direction`",
    "lowest_kurtosis": "excess kurtosis along it",
    "spent.records": "records, as a share of those allowed",
    "spent.seconds": "seconds of excitation",
    "spent.levels": "levels, added up over joints and records",
    "left.records": "share of the records that are left",
}
"""Meaning of each name of an element; `nominal_` and `now.` stand before some of them."""


FORMATS: dict[str, type[Any]] = {
    "loose-recording/1": Description,
    "loose-gap/1": GapResult,
    "loose-next-motion/1": NextMotion,
    "loose-plan/2": Plan,
    "loose-diagnosis/2": Diagnosis,
    "loose-trend/2": Trend,
}
"""Value of a file's key "format" -> dataclass of its content."""


class FileSchema(GenerateJsonSchema):
    """JSON Schema in which a number that is not known is null."""

    def float_schema(self, schema: core_schema.FloatSchema) -> dict[str, Any]:
        """Schema of a number."""
        return super().float_schema(schema) | {"type": ["number", "null"]}


FORMULAS: dict[str, Callable[[int, int, int], int]] = {
    "w": lambda n, d, w: w,
    "1": lambda n, d, w: 1,
    "n": lambda n, d, w: n,
    "d": lambda n, d, w: d,
    "n d": lambda n, d, w: n * d,
    "d (d - 1) / 2": lambda n, d, w: d * (d - 1) // 2,
    "d (d + 1) / 2": lambda n, d, w: d * (d + 1) // 2,
}
"""Number of elements of one name, for n joints, d axes and w hinges of more than a whole turn."""


def sizes(arm: Arm) -> tuple[int, int, int]:
    """Joints, axes and hinges of more than a whole turn of an arm."""
    return arm.n, len(arm.axes), len(JointPose(arm).wide)


def environments() -> str:
    """Text of the page, with every generated part as the code has it now."""
    text = PAGE.read_text(encoding="utf-8")
    arms = [(env_id, made(env_id)) for env_id in IDS]
    parts = {
        "docstring": docstring_sections(),
        "difficulties": difficulty_table(),
        "tiers": tiers(),
        "arms": arm_table(arms),
        "elements": element_table([env for _, env in arms]),
    }
    for name, lines in parts.items():
        text = between(text, "\n".join(lines), name, PAGE)
    return text


def gap() -> str:
    """Text of the page on model errors, its tables of numbers as the code has them now."""
    text = between(GAP.read_text(encoding="utf-8"), numbers_table(), "numbers", GAP)
    return between(text, "\n".join(tolerance_table()), "tolerances", GAP)


def instrument() -> str:
    """Text of the page on the instrument, its numbers and presets as the code has them now."""
    numbers = threshold_table(inspect.getsource(Numbers)).splitlines()
    text = between(INSTRUMENT.read_text("utf-8"), "\n".join(numbers), "numbers", INSTRUMENT)
    return between(text, "\n".join(preset_sections()), "presets", INSTRUMENT)


def preset_sections() -> list[str]:
    """A section for each controller preset."""
    lines = []
    for name, one in PRESETS.items():
        c = one.controller
        lines += [
            f"### {name}",
            "",
            f"{one.machine}. Commands: {c.commands}, {c.rate_hz:g} Hz, lines up to "
            f"{c.bandwidth_hz:g} Hz, at most {c.max_speed_rad_s[0]:g} rad/s and "
            f"{c.max_acceleration_rad_s2[0]:g} rad/s². Log: {one.log}.",
            "",
            "```text",
            *one.code.splitlines(),
            "```",
            "",
        ]
    return lines[:-1]


def tolerance_table() -> list[str]:
    """Tolerances of a nominal model, from their dataclass."""
    rows = entries(inspect.getsource(Tolerances))
    lines = [f"| `{name}` | {sd} | {of} |" for name, sd, of in rows]
    return ["| `--tolerances.` | standard deviation | of |", "|---|---|---|", *lines]


def numbers_table() -> str:
    """Numbers of `loose gap` that decide, with the reasons that stand where they are defined."""
    lines = ["| number | value | meaning and reason | also tried |", "|---|---|---|---|"]
    for path in NUMBERS:
        module, _, constant = f"{PACKAGE}.{path}".rpartition(".")
        known = entries(inspect.getsource(importlib.import_module(module)))
        value, meaning = next(rest for name, *rest in known if name == constant)
        others = ", ".join(f"{x:g}" for x in tried(path))
        lines.append(f"| `{path.removeprefix('core.')}` | {value} | {meaning} | {others} |")
    return "\n".join(lines)


def made(env_id: str) -> DiagnosisEnv:
    """Environment of an id, without Gymnasium's wrappers."""
    env = gymnasium.make(env_id).unwrapped
    assert isinstance(env, DiagnosisEnv)
    env.close()
    return env


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
        lines += ["", f"### {title}"]
        for paragraph in body.strip().split("\n\n"):
            table = paragraph.startswith("|")
            lines += ["", *(paragraph.splitlines() if table else prose(paragraph))]
    return lines[1:]


def difficulty_table() -> list[str]:
    """Ranges of the named difficulties."""
    first = next(iter(DIFFICULTIES.values()))
    names = list(DIFFICULTIES)
    rows = ["| parameter | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for field in dataclasses.fields(first):
        values = [getattr(d, field.name) for d in DIFFICULTIES.values()]
        if field.name == "mismatch":
            for part in dataclasses.fields(values[0]):
                cells = " | ".join(f"{getattr(v, part.name):g}" for v in values)
                rows.append(f"| sd of {part.name} | {cells} |")
        elif field.name == "friction_over":
            rows.append(f"| friction over the seat drive in the pose | {' | '.join(values)} |")
        elif field.name == "kinds":
            shares = [d.probabilities().items() for d in DIFFICULTIES.values()]
            kinds = ", ".join(f"{k} {p:.2f}" for k, p in first.probabilities().items())
            assert len(set(map(frozenset, shares))) == 1
        else:
            cells = " | ".join(f"{low:g} to {high:g}" for low, high in values)
            rows.append(f"| {field.name} | {cells} |")
    return [*rows, "", *prose(f"Kinds of fault, in all of them: {kinds}.")]


def tiers() -> list[str]:
    """Ids of the tiers."""
    arguments = {
        tier: ", ".join(f"`{name}={value!r}`" for name, value in how.items()) or "none"
        for tier, (_, how) in TIERS.items()
    }
    return [
        "| id | arm's id | arguments | what separates agents |",
        "|---|---|---|---|",
        *(
            f"| `{tier}` | `{of}` | {arguments[tier]} | {TIER_WORDS[tier]} |"
            for tier, (of, _) in TIERS.items()
        ),
    ]


def arm_table(arms: Sequence[tuple[str, DiagnosisEnv]]) -> list[str]:
    """Parameters of the arm of each id, and the sizes of its spaces."""
    rows = [
        "| id | joints | reach [m] | tool axes | levels 1 to 3 [m/s²] | band [Hz] | step [ms] "
        "| peak torques [N·m, N] | observation | hypotheses |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for env_id, env in arms:
        arm, layout = env.arm, env.layout
        axes = " ".join("xyz"[a] for a in arm.axes)
        levels, limits = (", ".join(f"{v:.3g}" for v in w) for w in (arm.levels, arm.torque_limits))
        size = f"{len(layout.global_elements)} + {layout.slots} · {len(layout.slot_elements)}"
        rows.append(
            f"| `{env_id}` | {arm.n} | {arm.reach:.3g} | {axes} | {levels} | {arm.band[0]:g} to "
            f"{arm.band[1]:g} | {1e3 * arm.timestep:g} | {limits} | {layout.size} = {size} | "
            f"{len(env.hypotheses)} |"
        )
    return rows


def element_table(envs: Sequence[DiagnosisEnv]) -> list[str]:
    """Elements of the observation of every environment, a row for each name.

    The number is a formula in n joints, d axes and w hinges of more than a turn, for every arm.
    """
    seen: dict[str, list[tuple[DiagnosisEnv, list[Any]]]] = {}
    for env in envs:
        layout = env.layout
        named: dict[str, list[Any]] = {}
        for prefix, elements in (("", layout.global_elements), ("record.", layout.slot_elements)):
            for element in elements:
                named.setdefault(prefix + name_of(env.arm, element.name), []).append(element)
        for name, alike in named.items():
            seen.setdefault(name, []).append((env, alike))
    rows = ["| element | number | unit | scaling | meaning |", "|---|---|---|---|---|"]
    for name, found in seen.items():
        bare = name.removeprefix("record.")
        if bare.startswith(("nominal_", "now.")):
            continue
        every = [element for _, elements in found for element in elements]
        units = " or ".join(dict.fromkeys(e.unit for e in every))
        scales = {f"{e.scale:.3g}" for e in every}
        scaling = SCALINGS[every[0].scaling].format(scales.pop() if len(scales) == 1 else "s")
        number = formula(found) + ("" if name == bare else " a record")
        number += ", and nominal" if f"record.nominal_{bare}" in seen else ""
        number += ", and now" if f"now.{bare}" in seen else ""
        low, high = f"{every[0].low:g}", f"{every[0].high:g}"
        rows.append(
            f"| `{bare}` | {number} | {units} | {scaling}, {low} to {high} | {MEANINGS[bare]} |"
        )
    return rows


def formula(found: Sequence[tuple[DiagnosisEnv, list[Any]]]) -> str:
    """The formula that counts an element in every environment."""
    for text, count in FORMULAS.items():
        if all(count(*sizes(env.arm)) == len(each) for env, each in found):
            return text
    raise AssertionError("no formula counts these elements")


def name_of(arm: Arm, name: str) -> str:
    """Name of an element without its joint and axis.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> name_of(scara(), "transmission.joint3_y"), name_of(scara(), "tool_correlation.xz")
    ('transmission', 'tool_correlation')
    >>> name_of(scara(), "spent.records")
    'spent.records'
    """
    group, _, last = name.rpartition(".")
    of_joint = any(last == joint or last.startswith(f"{joint}_") for joint in arm.joints)
    return group if of_joint or (last and set(last) <= set("xyz")) else name


def schema(format: str) -> dict[str, Any]:
    """JSON Schema of the files of a format."""
    whole = TypeAdapter(FORMATS[format]).json_schema(schema_generator=FileSchema)
    whole["properties"]["format"] = {"const": format}
    whole["required"] = list(dict.fromkeys(["format", *whole.get("required", ())]))
    found: dict[str, Any] = plain({"$schema": GenerateJsonSchema.schema_dialect, **whole})
    return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """What is done."""

    check: bool = False
    """Write nothing: fail where a page is out of date."""


def write(options: Options) -> None:
    """Write the pages, or check them."""
    pages = {PAGE: environments(), GAP: gap(), INSTRUMENT: instrument()}
    for format in FORMATS:
        file = SCHEMAS / f"{format.replace('/', '-')}.json"
        pages[file] = json.dumps(schema(format), indent=1) + "\n"
    for page, text in pages.items():
        if not options.check:
            print(f"wrote {write_text(page, text)}")
        elif page.read_text(encoding="utf-8") != text:
            raise InvalidData(f"{page.name} is out of date: run python scripts/dev/write_docs.py")


if __name__ == "__main__":
    command("write_docs", __doc__, Options, write)
