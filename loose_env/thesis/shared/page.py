"""Page of the reproduction: sections, implemented equations, omissions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from loose_env.errors import InvalidData
from loose_env.report import paragraphs, shown, template
from loose_env.thesis.shared.sections import Outcome, Section, Table

LEFT_OUT = (
    "Listening for looseness (8.3.3): the thesis heard the pitch of the rig rise but recorded no "
    "sound, and the simulation makes none.",
    "A data bus along the arm, or signals over the motors' power lines (8.3.5): how the data "
    "travel does not change what they say.",
    "Inspection by telepresence (8.3.5): it concerns the person who looks, not the statistics.",
)
"""Future work of the thesis that no section reproduces, with its reference."""

_NUMBER = re.compile(r"[≈~<>≤≥]?\s*[-−+±]?\s*[\d.]")
_LONG, _LONGER = 24, 60  # letters; a cell with more may break into lines


def render_thesis_page(
    outcomes: Sequence[Outcome],
    *,
    title: str,
    text: str | Sequence[str],
    command: str,
    seed: int,
    versions: Mapping[str, str],
) -> str:
    """Return the page of the reproduction.

    Parameters
    ----------
    outcomes : sequence of Outcome
        Sections in the order of the page, failed ones among them.
    title : str
        Title of the page.
    text : str or sequence of str
        Paragraphs that stand first.
    command : str
        The command that makes this page.
    seed : int
        Seed of all sections.
    versions : mapping
        Version of each package by its name.

    Raises
    ------
    InvalidData
        If two sections have the same key, or a figure cannot be shown.
    MissingExtra
        If jinja2 is not installed.
    """
    keys = [outcome.key for outcome in outcomes]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise InvalidData(f"sections {', '.join(twice)} come twice; each may stand once")
    done = [o.section for o in outcomes if o.section is not None]
    page: str = template("loose_env.thesis.shared/page.html").render(
        title=title,
        text=paragraphs(text),
        sections=[_section(outcome) for outcome in outcomes],
        failed=len(outcomes) - len(done),
        equations=_equations(done),
        left_out=[(s.key, s.title, list(s.left_out)) for s in done if s.left_out],
        fixed=LEFT_OUT,
        command=command,
        seed=seed,
        versions=versions,
    )
    return page


def natural(text: str) -> list[tuple[int, int, str]]:
    """Key that sorts numbers inside a text by their value.

    Examples
    --------
    >>> sorted(["6.15", "3.41", "6.2", "A.1"], key=natural)
    ['3.41', '6.2', '6.15', 'A.1']
    """
    parts = re.findall(r"\d+|\D+", text)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def ranges(numbers: Sequence[str]) -> str:
    """Write equation numbers short, neighbours as a range.

    Examples
    --------
    >>> ranges(["6.18", "6.15", "6.17", "6.16", "4.7", "3.2", "3.1"])
    '3.1, 3.2, 4.7, 6.15 to 6.18'
    """
    runs: list[list[str]] = []
    for number in sorted(set(numbers), key=natural):
        if runs and _follows(runs[-1][-1], number):
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 2 else ", ".join(r) for r in runs)


def _follows(one: str, other: str) -> bool:
    a, b = re.fullmatch(r"(\d+)\.(\d+)", one), re.fullmatch(r"(\d+)\.(\d+)", other)
    return bool(a and b and a[1] == b[1] and int(a[2]) + 1 == int(b[2]))


def _section(outcome: Outcome) -> dict[str, Any]:
    section = outcome.section
    if section is None:
        title = outcome.key.replace("_", " ").capitalize()
        error = outcome.error or "it failed"
        return {"key": outcome.key, "title": title, "error": error, "numbers": ""}
    return {
        "key": section.key,
        "title": section.title,
        "error": "",
        "finding": section.finding,
        "words": list(section.words),
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
