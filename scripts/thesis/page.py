"""Sections of the thesis page: text and printed values, runs in processes, and the HTML page.

A section is a function of the seed in a module of this folder. It computes; ``text/KEY.toml`` holds
what the page says, what the thesis printed, and the function behind every equation.
"""

from __future__ import annotations

import math
import re
import string
import time
import tomllib
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.report import FigureCard, shown, template, to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SECTIONS: dict[str, str] = {
    "simulations": "simulations",
    "correlation_simulations": "simulations",
    "pose_choice": "pose_choice",
    "signals": "signals",
    "experiment_one": "experiment_one",
    "experiment_four": "experiment_four",
    "experiment_five": "shaken_vera",
    "experiment_six": "shaken_vera",
    "index_tables": "index_tables",
    "vera_link_finding": "link_finding",
}
"""Module of each section, which has a function of the section's name, in the order of the page."""

LEFT_OUT = (
    "Models of looseness with their Jacobians and inertia matrices (3.2), identification joint by "
    "joint (3.3) and the docked tool (8.1.2): the thesis prints no result of them.",
    "The search for the loose link (4.2.2, 7.1.2) beyond the step that VERA allows: the agents "
    "classical and classical_literal play it.",
    "Listening for looseness (8.3.3): the thesis heard the pitch of the rig rise but recorded no "
    "sound, and the simulation makes none.",
    "A data bus along the arm, or signals over the motors' power lines (8.3.5): how the data "
    "travel does not change what they say.",
    "Inspection by telepresence (8.3.5): it concerns the person who looks, not the statistics.",
    "Sizing of VERA: loads, drives, frequencies of links, stinger (5.2, 6.1.2, 6.3.2, 7.2.2): the "
    "design of a rig says nothing of what is loose.",
)
"""What no section reproduces, with its place in the thesis."""

Rows = Sequence[Sequence[str]]
_NUMBER = re.compile(r"[≈~<>≤≥]?\s*[-−+±]?\s*[\d.]")
_LONG, _LONGER = 24, 60  # letters; a cell with more may break into lines


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page; every cell is formatted text, the first column names the row."""

    caption: str
    columns: Sequence[str]
    rows: Rows


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """One experiment or method of the thesis, reproduced."""

    key: str
    """Short name, also the anchor on the page."""
    title: str
    finding: str
    """Printed beside found in one sentence, for the table at the top of the page."""
    words: Sequence[str]
    tables: Sequence[Table] = ()
    cards: Sequence[FigureCard] = ()
    equations: Mapping[str, str] = field(default_factory=dict)
    """Function that implements each equation, by its number."""
    left_out: Sequence[str] = ()


@cache
def text_of(key: str) -> dict[str, Any]:
    """Text, printed figures and equations of a section."""
    file = Path(__file__).with_name("text") / f"{key}.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def printed(key: str) -> dict[str, Any]:
    """Figures that the thesis printed for a section."""
    found: dict[str, Any] = text_of(key)["printed"]
    return found


class _Words(string.Formatter):
    """Text with names in it: ``!p`` per cent, ``!d`` degrees, ``!m`` milli, ``!u`` micro."""

    scale: ClassVar[dict[str, float]] = {"p": 100.0, "d": 180.0 / math.pi, "m": 1e3, "u": 1e6}

    def convert_field(self, value: Any, conversion: Any) -> Any:
        known = conversion in self.scale
        return value * self.scale[conversion] if known else super().convert_field(value, conversion)


def section(
    key: str, say: Mapping[str, Any], tables: Sequence[Any] = (), figures: Sequence[Figure] = ()
) -> Section:
    """Fill the text of a section; tables and figures in the order of the text.

    The text knows what was printed, ``say``, which is mostly the section's ``locals()``, and the
    constants of its module.

    A table that has no columns in the text has them in its first row. One with ``cells`` formats
    the values of a row by them, but for rows of text alone; one with ``rows`` is all in the text.
    """
    text = text_of(key)
    module = vars(import_module(f"scripts.thesis.{SECTIONS[key]}"))
    names = {**module, **text.get("printed", {}), **say}

    def fill(words: str, *values: Any) -> str:
        return _Words().vformat(words, values, names)

    computed = iter(tables)

    def formatted(table: Mapping[str, Any]) -> Table:
        """A table of the text with its rows, the next ones where the text has none."""
        if "rows" in table:
            rows = [[fill(cell) for cell in row] for row in table["rows"]]
        else:
            rows = list(next(computed))
        if "cells" in table:
            rows = [
                row if all(isinstance(v, str) for v in row) else [fill(c, *row) for c in cells]
                for cells in [table["cells"]]
                for row in rows
            ]
        columns = [fill(c) for c in table["columns"]] if "columns" in table else rows[0]
        rows = rows if "columns" in table else rows[1:]
        return Table(caption=paragraphs(table["caption"])[0], columns=columns, rows=rows)

    def paragraphs(words: str) -> list[str]:
        parts = (" ".join(part.split("\n")) for part in words.strip().split("\n\n"))
        return [filled for part in parts if (filled := fill(part))]

    return Section(
        key=key,
        title=text["title"],
        finding=paragraphs(text["finding"])[0],
        words=paragraphs(text["words"]),
        tables=[formatted(table) for table in text.get("table", ())],
        cards=[
            FigureCard(
                image=image,
                title=fill(card["title"]),
                caption=paragraphs(card["caption"])[0],
                heading=card.get("heading", ""),
            )
            for card, image in zip(text.get("figure", ()), figures, strict=True)
        ],
        equations={
            number: path
            for path, numbers in text.get("equations", {}).items()
            for number in numbers.split()
        },
        left_out=paragraphs(text.get("left_out", "")),
    )


def choose(only: Sequence[str] | None = None) -> list[str]:
    """Keys asked for, in the order of the page; all of them by default."""
    unknown = [key for key in only or () if key not in SECTIONS]
    if unknown:
        raise UnknownName(
            f"no section {', '.join(map(repr, unknown))}; there are {', '.join(SECTIONS)}"
        )
    return [key for key in SECTIONS if not only or key in only]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Outcome of a run: the section with its figures as SVG, or the error."""

    key: str
    seconds: float
    section: Section | None = None
    error: str = ""
    """The error in one line."""
    trace: str = ""


def run_section(key: str, seed: int) -> Outcome:
    """Run one section; whatever it raises comes back as its outcome."""
    begin = time.perf_counter()
    try:
        (key,) = choose([key])
        found: Section = getattr(import_module(f"scripts.thesis.{SECTIONS[key]}"), key)(seed)
        # Figures become SVG here, so that the work is shared and little travels back.
        cards = [
            card if isinstance(card.image, bytes) else replace(card, image=to_svg(card.image))
            for card in found.cards
        ]
    except (Exception, SystemExit) as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        spent, trace = time.perf_counter() - begin, traceback.format_exc()
        return Outcome(key=key, seconds=spent, error=line, trace=trace)
    done = replace(found, cards=cards)
    return Outcome(key=key, seconds=time.perf_counter() - begin, section=done)


def run_sections(keys: Sequence[str], *, seed: int, workers: int = 2) -> Iterator[Outcome]:
    """Run sections in processes of their own and yield each outcome as it is done.

    A section depends on the seed alone, so only the order of the outcomes changes with the number
    of workers. A section whose process dies is reported as failed.
    """
    if workers < 1:
        raise InvalidSetting(f"workers is {workers}; there must be 1 or more")
    if seed < 0:
        raise InvalidSetting(f"seed is {seed}; it must be 0 or more")
    choose(keys)
    threads = ThreadPoolExecutor(workers)
    try:
        for future in as_completed([threads.submit(_run_alone, key, seed) for key in keys]):
            yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)


def _run_alone(key: str, seed: int) -> Outcome:
    """Run a section in a process that takes no other section along when it dies."""
    begin = time.perf_counter()
    # Spawned, not forked: a fork would inherit the threads' locks of MuJoCo and BLAS.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        try:
            return process.submit(run_section, key, seed).result()
        except BrokenProcessPool:
            spent = time.perf_counter() - begin
            return Outcome(key=key, seconds=spent, error="its process died")


def render_thesis_page(outcomes: Sequence[Outcome], **about: Any) -> str:
    """Return the page; ``about`` is its title, text, command, seed and versions."""
    done = [o.section for o in outcomes if o.section is not None]
    page: str = template("scripts.thesis/page.html").render(
        sections=[_shown(outcome) for outcome in outcomes],
        failed=len(outcomes) - len(done),
        equations=_equations(done),
        left_out=[(s.key, s.title, list(s.left_out)) for s in done if s.left_out],
        fixed=LEFT_OUT,
        **about,
    )
    return page


def natural(text: str) -> list[tuple[int, int, str]]:
    """Key that sorts numbers inside a text by their value."""
    parts = re.findall(r"\d+|\D+", text)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def ranges(numbers: Sequence[str]) -> str:
    """Write equation numbers short, neighbours as a range.

    >>> ranges(["6.18", "6.15", "6.17", "6.16", "4.7", "3.2", "3.1"])
    '3.1, 3.2, 4.7, 6.15 to 6.18'
    """
    runs: list[list[str]] = []
    for number in sorted(set(numbers), key=natural):
        chapter, _, count = number.partition(".")
        if runs and count.isdecimal() and runs[-1][-1] == f"{chapter}.{int(count) - 1}":
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 2 else ", ".join(r) for r in runs)


def _shown(outcome: Outcome) -> dict[str, Any]:
    section = outcome.section
    if section is None:
        title = outcome.key.replace("_", " ").capitalize()
        return {"key": outcome.key, "title": title, "error": outcome.error, "numbers": ""}
    return {
        "key": section.key,
        "title": section.title,
        "error": "",
        "finding": section.finding,
        "words": section.words,
        "tables": [_table(table) for table in section.tables],
        "cards": [shown(card, f"{section.key}-f{k}") for k, card in enumerate(section.cards)],
        "numbers": ranges(list(section.equations)),
    }


def _table(table: Table) -> dict[str, Any]:
    """Rows with the class of each column: numbers are right-aligned, text may wrap."""
    kinds = []
    for k in range(len(table.columns)):
        cells = [row[k] for row in table.rows]
        filled = [cell for cell in cells if cell.strip(" –-—")]
        longest = max(map(len, cells), default=0)
        numbers = sum(bool(_NUMBER.match(cell)) for cell in filled)
        words = k == 0 or longest > _LONG or 2 * numbers < len(filled)
        size = " long longer" if longest > _LONGER else " long" if longest > _LONG else ""
        kinds.append(("words" if words else "number") + size)
    return {
        "caption": table.caption,
        "columns": list(zip(table.columns, kinds, strict=True)),
        "rows": [list(zip(row, kinds, strict=True)) for row in table.rows],
    }


def _equations(sections: Sequence[Section]) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Number, function and the sections that use it, sorted by number."""
    found: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for section in sections:
        for number, function in section.equations.items():
            found.setdefault((number, function), []).append((section.key, section.title))
    order = sorted(found, key=lambda pair: (natural(pair[0]), pair[1]))
    return [(number, function, found[number, function]) for number, function in order]
