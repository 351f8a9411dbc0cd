r"""Run and grade `loose`, or any other tool, on blind sessions on simulated robots of many kinds.

Each case is a machine. The tool plans a session for it from a nominal model and a sheet of the
controller, the session is played, the tool answers from the recording, without and with a healthy
reference, and the answers are graded against the sealed truth. Recordings and rows are kept: the
same command goes on where it was stopped, and judging again costs the tool's time only.

    python -m scripts.suites.instrument.run --numbers 0-59              # development
    python -m scripts.suites.instrument.run --numbers 10000-10239 --phrase "words chosen today"
    python -m scripts.suites.instrument.run --series damaged --numbers 0-35
    python -m scripts.suites.instrument.run --series months --numbers 0-11
    python -m scripts.suites.instrument.run --tool module:object        # plan, diagnose, enough
    python -m scripts.suites.instrument.run --ablate                    # the tool's variants
    python -m scripts.suites.instrument.run --show

A tool has ``plan(folder)``, which reads ``model.xml`` and ``session.json`` and returns
``{"rate_hz": r, "runs": [{"name", "pose", "command", "level"}, ...]}`` with commands (samples,
joints) in absolute values; ``diagnose(folder)``, which reads ``recording/`` and, if it is there,
``reference/``, and returns ``{"verdict", "settled", "places", "several", "tested", "remarks",
"remedy"}``; and perhaps ``enough(folder)``, asked between runs of unlike ``level``, and
``variants``, names that ``diagnose(folder, variant=name)`` takes.

Others enter with files: recordings are made from a phrase that is kept back, each answer is
``CASE.json`` with ``alone`` and ``reference``, and truths are checked against the commitments.

    python -m scripts.suites.instrument.run --make SUITE --numbers 10000-10059 --phrase SECRET
    python -m scripts.suites.instrument.run --blind SUITE --numbers 10000-10059 --phrase SECRET \
        --answers ANSWERS --out out/instrument_suite/THEIRS
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import loose_env
from loose_env.cli.command import command, one_of
from loose_env.errors import InvalidData, InvalidSetting, words_of
from loose_env.io import plain, write_text
from scripts.suites.blind import commit, committed, numbers_of, sealed_truth
from scripts.suites.instrument import grading, session
from scripts.suites.instrument.cases import SERIES, Case, Series, drawn, skipped
from scripts.suites.instrument.session import Plan
from scripts.suites.rows import BlindSettings, Row, asked_apart, blind_rows, code_hash, named

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "instrument_suite"
LONGEST = 900.0
"""Time after which a tool counts as failed [s]."""
_HERE = "scripts.suites.instrument"
NAMED = {"loose": f"{_HERE}.loose:Loose", "three-poses": f"{_HERE}.loose:ThreePoses",
         "nine-poses": f"{_HERE}.loose:NinePoses",
         "three-levels": f"{_HERE}.loose:ThreeLevels"}  # fmt: skip
"""Tools by their short names."""
GENERATOR = ("machines", "physics", "standins", "sensing", "cases", "session")


def tool_of(name: str) -> Any:
    """A tool by its short name, or as ``module:object``; a class is instantiated."""
    found = named(NAMED.get(name, name), ", ".join(NAMED))
    found = found() if isinstance(found, type) else found
    if not (hasattr(found, "plan") and hasattr(found, "diagnose")):
        raise InvalidSetting(f"{name} is no tool; it needs plan(folder) and diagnose(folder)")
    return found


def code_of(tool: str) -> str:
    """Hash of the code that the rows of a tool depend on."""
    here = Path(__file__).parent
    module = NAMED.get(tool, tool).partition(":")[0]
    own = [Path(importlib.import_module(module).__file__ or "")]
    if module == NAMED["loose"].partition(":")[0]:
        base = Path(loose_env.__file__).parent
        own += [base / part for part in ("instrument", "recording") if (base / part).is_dir()]
    return code_hash(*own, *(here / f"{name}.py" for name in (*GENERATOR, "grading")))


# --------------------------------------------------------------- the tool, in its own process


def answer_asked(tool: str, question: str, folder: Path, out: Path, variant: str) -> None:
    """Ask a tool in this process; write what it says and what it took."""
    asked, begun = tool_of(tool), time.process_time()
    if question == "plan":
        session.pack(asked.plan(folder), out / "plan.npz")
    elif question == "enough":
        write_text(out / "enough.json", json.dumps(bool(asked.enough(folder))))
    elif variant:
        each = {name: asked.diagnose(folder, variant=name) for name in json.loads(variant)}
        write_text(out / "answer.json", json.dumps(plain(each)))
    else:
        said = {**asked.diagnose(folder), "cpu": round(time.process_time() - begun, 2)}
        write_text(out / "answer.json", json.dumps(plain(said)))


def ask(tool: str, question: str, folder: Path, variant: str = "") -> tuple[Any, str]:
    """What a tool says in a process of its own, or None and its last words."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        words = ["--tool", tool, "--ask", question, "--folder", str(folder), "--out", place]
        words += ["--variant", variant] if variant else []
        in_time, ended = asked_apart(f"{_HERE}.run", words, out / "log.txt", LONGEST)
        if not in_time:
            return None, ended
        if (out / "plan.npz").is_file():
            return session.unpack(out / "plan.npz"), ""
        for name in ("enough.json", "answer.json"):
            if (out / name).is_file():
                return json.loads((out / name).read_text("utf-8")), ""
        return None, ended


# -------------------------------------------------------------------------------- recordings


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where recordings are kept, and of which plan."""

    blind: Path
    phrase: str
    series: Series
    planner: str
    """Tool whose plan is played."""
    plans: Path

    def plan_of(self, case: Case) -> Plan:
        """Plan of a class, asked for once."""
        code = code_of(self.planner)
        path = self.plans / f"{case.machine}-{code}.npz"
        if not path.is_file():
            with tempfile.TemporaryDirectory() as place:
                session.lay_out(case, Path(place))
                plan, words = ask(self.planner, "plan", Path(place))
            if plan is None:
                raise InvalidData(f"{self.planner} made no plan for {case.machine}: {words}")
            session.check_plan(plan, case.sheet)
            session.pack(plan, path)
        return session.unpack(path)

    def played(self, case: Case) -> tuple[Path, Path]:
        """Folder of the recordings of a case, and its sealed truth; played where they lack.

        A suite with commitments is taken as it is, whatever the tool's own plan.
        """
        if known := committed(self.blind):
            name = next((n for n in known if n.startswith(f"{case.name}-")), "")
            if not name:
                raise InvalidSetting(f"{self.blind} has no case {case.number} of this phrase")
            return self.blind / "recordings" / name, self.blind / "truth" / f"{name}.json"
        plan = self.plan_of(case)
        here = Path(__file__).parent
        code = code_hash(here.parent / "blind.py", *(here / f"{name}.py" for name in GENERATOR))
        asks = hasattr(tool_of(self.planner), "enough") and len(session.levels_of(plan["runs"])) > 1
        words = f"{code}{session.plan_hash(plan)}{code_of(self.planner) if asks else ''}"
        name = f"{case.name}-{hashlib.sha256(words.encode()).hexdigest()[:6]}"
        folder, sealed = self.blind / "recordings" / name, self.blind / "truth" / f"{name}.json"
        if not sealed.is_file():
            if case.series == "months":
                truth = session.play_months(case, plan, folder)
            else:
                truth = session.play_case(case, plan, folder, self._enough if asks else None)
            write_text(sealed, json.dumps(plain(truth), indent=1) + "\n")
        return folder, sealed

    def _enough(self, folder: Path) -> bool:
        return bool(ask(self.planner, "enough", folder)[0])


def make(numbers: Sequence[int], place: Place) -> None:
    """Write recordings, truth, what entrants are told, and commitments to the truth."""
    (place.blind / "commitments.json").unlink(missing_ok=True)
    sealed = [place.played(drawn(n, place.phrase, place.series))[1] for n in numbers]
    protocol = {"format": "instrument-benchmark/1", "verdicts": grading.VERDICTS,
                "kinds": grading.KINDS}  # fmt: skip
    commit(place.blind, place.phrase, [s.stem for s in sealed], protocol)


# -------------------------------------------------------------------------------------- rows


def run_case(
    number: int,
    *,
    tool: str,
    variant: str,
    variants: Sequence[str],
    answers: Path | None,
    place: Place,
    code: str,
) -> Row:
    """Play a case where it is not, let the tool answer both ways, and grade the answers.

    Whatever goes wrong in the tool becomes the row, with the message.
    """
    case = drawn(number, place.phrase, place.series)
    row: Row = {
        "number": number, "phrase": place.phrase, "code": code, "error": "", "case": case.name,
        "machine": case.machine, "role": case.role, "kind": case.kind, "damage": case.damage,
    }  # fmt: skip
    try:
        folder, sealed = place.played(case)
    except InvalidData as error:
        row["error"] = words_of(error)
        truth: Mapping[str, Any] = {**case.truth(), "opened": {}, "shaken": None}
        truth = json.loads(json.dumps(plain(truth)))
        none = {"alarms": [False] * 12, "unanswered": 12}
        ways = {way: grading.failed(truth) | {"cpu": None} for way in grading.WAYS}
        return row | (none if place.series == "months" else ways)
    truth = sealed_truth(place.blind, place.phrase, sealed.stem)
    row["shaken"] = truth["shaken"]
    if place.series == "months":
        asked = (_of_variant(tool, each, variant) for each in sorted(folder.iterdir()))
        said = [answer for answer, _ in asked]
        fit = [answer is not None and not grading.unfit(answer) for answer in said]
        row["alarms"] = [f and a["verdict"] == "loose" for f, a in zip(fit, said, strict=True)]
        return row | {"unanswered": fit.count(False), "travel": truth["travel"]}
    for way in grading.WAYS:
        if variant:
            kept_as = place.plans.parent / "variants" / f"{folder.name}-{way}-{code}.json"
            answer, words = _variant_answer(kept_as, way, tool, variant, variants, folder)
        else:
            answer, words = _answer(way, tool, "", answers, folder)
        if answer is not None and (words := grading.unfit(answer)):
            answer = None
        marks = grading.failed(truth) if answer is None else grading.grade(answer, truth)
        row[way] = marks | {"cpu": (answer or {}).get("cpu")}
        row["error"] = row["error"] or words
    return row


def _answer(
    way: str, tool: str, variant: str, answers: Path | None, folder: Path
) -> tuple[Any, str]:
    """The answer one way, from a file or from the tool."""
    if answers is not None:
        path = answers / f"{folder.name}.json"
        try:
            return json.loads(path.read_text("utf-8"))[way], ""
        except (OSError, ValueError, KeyError) as error:
            raise InvalidData(f"{path}: no answer {way!r}; every case needs both") from error
    if way == "reference":
        return ask(tool, "diagnose", folder, variant)
    with tempfile.TemporaryDirectory() as copy:
        return ask(tool, "diagnose", session.without_reference(folder, Path(copy, "case")), variant)


def _variant_answer(
    kept_as: Path, way: str, tool: str, variant: str, variants: Sequence[str], folder: Path
) -> tuple[Any, str]:
    """Answer of a variant; a session is heard once, for all variants."""
    known = json.loads(kept_as.read_text("utf-8")) if kept_as.is_file() else {}
    if variant not in known:
        said, words = _answer(way, tool, json.dumps([*variants]), None, folder)
        if said is None:
            return None, words
        known |= said
        write_text(kept_as, json.dumps(known))
    return known[variant], ""


def _of_variant(tool: str, folder: Path, variant: str) -> tuple[Any, str]:
    """What a tool, or a variant of it, says of a session."""
    said, words = ask(tool, "diagnose", folder, json.dumps([variant]) if variant else "")
    return (said or {}).get(variant) if variant else said, words


@dataclass(frozen=True, kw_only=True)
class RunSettings(BlindSettings):
    """Which cases, which tool, where."""

    series: Annotated[str, one_of(SERIES)] = "cases"
    """Sessions, sessions of which files are damaged, or twelve monthly sessions of a machine."""
    tool: str = "loose"
    """Tool that is graded: loose, its plans three-poses, nine-poses or three-levels, or
    module:object."""
    plan_of: str = ""
    """Tool whose plan is played; the tool that is graded by default."""
    ablate: tuple[str, ...] | None = None
    """Judge the same recordings with the tool's variants too; with words, only those."""
    ask: str = ""
    """Ask the tool one thing, plan, enough or diagnose, of --folder, and write it into --out."""
    folder: Path | None = None
    """Folder of --ask."""
    variant: str = ""
    """Variants of the tool, a list in JSON, of --ask diagnose."""


def run(given: RunSettings) -> None:
    """Run the cases asked for and print how the tool did."""
    if given.ask:
        if given.folder is None or given.out is None:
            raise InvalidSetting("--ask needs --folder and --out")
        answer_asked(given.tool, given.ask, given.folder, given.out, given.variant)
        return
    numbers, series = numbers_of(given.numbers), cast(Series, given.series)
    reasons = {number: skipped(number) for number in numbers}
    if there := [words for words in reasons.values() if words]:
        print(f"{len(there)} of {len(numbers)} cases skipped: {there[0]}", file=sys.stderr)
    numbers = [number for number in numbers if not reasons[number]]
    out = (given.out or OUT / given.tool.replace(":", ".")).resolve()
    place = Place(
        blind=(given.make or given.blind or OUT / "blind").resolve(), phrase=given.phrase,
        series=series, planner=given.plan_of or given.tool, plans=out / "plans",
    )  # fmt: skip
    tool = tool_of(given.tool)
    if given.make is not None:
        make(numbers, place)
        return
    code, end = code_of(given.tool), "" if series == "cases" else f"-{series}"
    work = functools.partial(run_case, tool=given.tool, place=place, code=code)
    found = {}
    variants = _variants(tool, given.ablate)
    for variant in ("", *variants):
        file = out / f"rows{end}{f'@{variant}' if variant else ''}.jsonl"
        each = functools.partial(work, variant=variant, variants=variants, answers=given.answers)
        found[variant or "as shipped"] = blind_rows(given, file, code, numbers, each, line_of)
    rows = found["as shipped"]
    if not rows:
        raise InvalidSetting(f"no rows of these cases in {out}; run them first")
    kinds = {"cases": grading.table, "damaged": grading.damaged_table,
             "months": grading.months_table}  # fmt: skip
    printed = kinds[series](rows)
    if len(found) > 1:
        printed = grading.variants_table(found)
    who = f"tool {given.tool}" if given.answers is None else f"answers in {given.answers}"
    lost = [row for row in rows if row["error"]]
    printed = f"{len(rows)} cases, {who}, {len(lost)} with an error.\n\n{printed}\n"
    print(f"\n{printed}")
    write_text(out / f"summary{end}{'-variants' if len(found) > 1 else ''}.md", printed)


def _variants(tool: Any, words: tuple[str, ...] | None) -> tuple[str, ...]:
    """Variants that are asked for."""
    if words is None:
        return ()
    known = tuple(getattr(tool, "variants", ()))
    if missing := [word for word in words if word not in known] or not known:
        raise InvalidSetting(f"no variants {missing}; the tool has {', '.join(known) or 'none'}")
    return words or known


def line_of(row: Row) -> str:
    """One line about a case."""
    return f"{grading.words_of(row)}  {row['error'] and 'ERROR ' + row['error']}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "instrument suite", __doc__, RunSettings, run, arguments,
        interrupted="the same command goes on",
    )  # fmt: skip


if __name__ == "__main__":
    main()
