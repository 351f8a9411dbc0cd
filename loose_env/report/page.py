"""Reports as pages: tables, figure cards and sections in one HTML file; `Brief` for terminals."""

from __future__ import annotations

import base64
import io
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from importlib.resources import files
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from loose_env.envs import palette as ink
from loose_env.errors import InvalidData, MissingExtra
from loose_env.io import sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
"""Letters of every page: those of the reader's own system, so that nothing is loaded."""

LIGHT: Mapping[str, str] = {
    "paper": ink.PAPER, "ink": ink.INK, "muted": "#5b6671", "faint": ink.FAINT, "body": ink.BODY,
    "edge": ink.EDGE, "measured": ink.MEASURED, "truth": ink.TRUTH, "page": "#f5f6f8",
    "rule": "#e1e5e9",
}  # fmt: skip
"""Role of a colour -> the colour by day."""
DARK: Mapping[str, str] = {
    "paper": "#1a1f25", "ink": "#e9edf1", "muted": "#9ba6b1", "faint": "#434d57", "body": "#3a4550",
    "edge": "#a3b0bc", "measured": "#4db3ee", "truth": "#ff7d54", "page": "#12161a",
    "rule": "#2c343c",
}  # fmt: skip
"""Role of a colour -> the colour in the dark."""
PAPER: Mapping[str, str] = {**LIGHT, "page": ink.PAPER}
"""Role of a colour -> the colour in print."""
THEMED = {
    **{colour: role for role, colour in LIGHT.items() if role not in ("page", "rule")},
    ink.MUTED: "muted",
}
"""Colours of figures that follow the page, and their roles."""

_WIDTH, _NAME = 120, 20  # columns of a terminal, and of the names in its first one
_LONG = re.compile(r"\S{12,}")  # words that may not fit into a cell of a table
_GRADES = {
    "critical": ("Critical", "Invalidates the result"),
    "warning": ("Warnings", "Limits the result"),
    "note": ("Notes", "Notes"),
}
"""Severity -> title in a notebook and on a page."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """A table for terminal and page."""

    rows: Sequence[Mapping[str, str]]
    """Cells by column; the first column names the row."""
    title: str = ""
    """Name above the table."""
    note: str = ""
    """Meaning of the columns."""
    heads: Sequence[str] = ()
    """Headings in the terminal, of several lines each; those of the page by default."""

    @property
    def columns(self) -> list[str]:
        """Headings of the columns."""
        return list(self.rows[0])

    @property
    def worded(self) -> list[bool]:
        """True for the columns of words, which are set to the left."""
        columns = zip(*(row.values() for row in self.rows), strict=True)
        said = [[cell for cell in own if cell.strip("-–")] for own in columns]
        bare = [[re.sub("^(over|under) ", "", cell) for cell in own] for own in said]
        return [2 * sum(cell[:1].isalpha() for cell in own) > len(own) for own in bare]

    def text(self) -> str:
        """The table for a terminal: title, parts of at most 120 columns, note.

        Examples
        --------
        >>> print(Table(rows=[{"agent": "a", "records": "1.5"}]).text())
        agent  records
        --------------
        a          1.5
        """
        heads = [head.split("\n") for head in self.heads or self.columns]
        deep = max(map(len, heads))
        cells = zip(*(row.values() for row in self.rows), strict=True)
        columns = [
            [*head, *[""] * (deep - len(head)), *own]
            for head, own in zip(heads, cells, strict=True)
        ]
        columns[0] = [_short(name) for name in columns[0]]
        widths = [max(map(len, column)) for column in columns]
        parts: list[list[int]] = [[]]
        for k in range(1, len(widths)):
            if parts[-1] and widths[0] + sum(widths[j] + 2 for j in [*parts[-1], k]) > _WIDTH:
                parts.append([])
            parts[-1].append(k)
        shown = []
        for part in parts:
            padded = [[c.rjust(widths[k] + 2) for c in columns[k]] for k in part]
            names = [name.ljust(widths[0]) for name in columns[0]]
            drawn = ["".join(row) for row in zip(names, *padded, strict=True)]
            rule = "-" * len(drawn[0])
            shown.append("\n".join(row.rstrip() for row in [*drawn[:deep], rule, *drawn[deep:]]))
        note = textwrap.fill(self.note, 100)
        return "\n\n".join(filter(None, [self.title, *shown, note]))


def _short(name: str) -> str:
    """A row's name in at most `_NAME` letters."""
    kept = (_NAME - 2) // 2
    return name if len(name) <= _NAME else f"{name[: _NAME - 2 - kept]}..{name[-kept:]}"


@dataclass(frozen=True, kw_only=True, eq=False)
class FigureCard:
    """One figure with its text."""

    image: bytes | Figure
    """A figure of matplotlib, or the bytes of an SVG or a PNG."""
    caption: str
    """Caption below the figure, and its alternative text."""
    title: str = ""
    """Name above the figure."""
    heading: str = ""
    """Section heading; a figure without one joins the section before."""
    intro: str = ""
    """A paragraph below the heading."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """A part of a page; one without content is left out."""

    heading: str = ""
    intro: Sequence[str] = ()
    """Paragraphs below the heading."""
    answers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Short headings, each with its sentences."""
    warnings: Sequence[tuple[str, str, Sequence[str]]] = ()
    """Severity, its label and its sentences, the most severe first."""
    tables: Sequence[Table] = ()
    cards: Sequence[Any] = ()
    """Figure cards, below the tables."""
    points: Sequence[str] = ()
    """A numbered list."""
    code: str = ""
    beside: bool = False
    """Put the first table beside the first figure where there is room."""
    strip: bool = False
    """Draw the figures small, in a row, with captions only read aloud."""

    @property
    def filled(self) -> bool:
        """True if there is more than a heading."""
        parts = (self.answers, self.warnings, self.tables, self.cards, self.points, self.code)
        return any(map(bool, parts))


def warnings_section(graded: Iterable[tuple[str, str]]) -> Section:
    """Section of warnings by severity, the most severe first.

    Examples
    --------
    >>> warnings_section([("note", "a"), ("critical", "b")]).warnings[0]
    ('critical', 'Invalidates the result', ['B.'])
    """
    found = [(grade, _GRADES[grade][1], said) for grade, said in _by_grade(graded) if said]
    return Section(heading="Warnings", warnings=found)


def _by_grade(graded: Iterable[tuple[str, str]]) -> list[tuple[str, list[str]]]:
    many = list(graded)
    return [(g, [sentence(words) for own, words in many if own == g]) for g in _GRADES]


def render_page(
    title: str,
    sections: Sequence[Section],
    *,
    kicker: Sequence[str] = (),
    text: str | Sequence[str] = (),
    result: Sequence[str] = (),
    notes: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
) -> str:
    """Return a page.

    Parameters
    ----------
    title : str
        Headline.
    sections : sequence of Section
        Content in order.
    kicker : sequence of str
        Words above the headline.
    text, result, notes : str or sequence of str
        Paragraphs below the headline, the outcome with its first paragraph in bold, and the foot.
    colours : mapping, optional
        First cell of a row -> colour of the mark beside it.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    whole, number = [], 0
    for each in sections:
        tables = [table for table in each.tables if table.rows]
        cards = [shown(card, f"f{number + k}") for k, card in enumerate(each.cards)]
        number += len(cards)
        beside = each.beside and bool(tables and cards)
        whole.append(replace(each, tables=tables, cards=cards, beside=beside))
    page: str = template("loose_env.report/page.html").render(
        title=title,
        kicker=" · ".join(filter(None, kicker)),
        text=paragraphs(text),
        result=result,
        sections=[each for each in whole if each.filled],
        notes=paragraphs(notes),
        colours=colours or {},
    )
    return page


def template(name: str) -> Any:
    """Return a jinja2 template by package and file, such as ``"loose_env.report/page.html"``.

    It imports from others by the same kind of name.

    Raises
    ------
    MissingExtra
        If jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, FunctionLoader, StrictUndefined
        from markupsafe import Markup
    except ImportError as error:
        raise MissingExtra(
            "the page needs jinja2: install it with pip install 'loose-env[report]'"
        ) from error

    def source(name: str) -> str:
        package, _, file = name.partition("/")
        return files(package).joinpath(file).read_text(encoding="utf-8")

    def breakable(text: Any) -> Any:  # long names of a model break after an underscore
        return Markup(_LONG.sub(lambda m: m[0].replace("_", "_<wbr>"), escape(str(text))))

    environment = Environment(
        autoescape=True, loader=FunctionLoader(source), lstrip_blocks=True, trim_blocks=True,
        undefined=StrictUndefined,
    )  # fmt: skip
    environment.globals["style"] = style
    environment.filters["breakable"] = breakable
    environment.filters["typographic"] = typographic
    return environment.get_template(name)


def typographic(cell: object) -> str:
    """A cell with true minus signs and dashes.

    Examples
    --------
    >>> typographic("-0.5 (80.1-90.2)"), typographic("-"), typographic("2026-03-18")
    ('−0.5 (80.1–90.2)', '–', '2026-03-18')
    """
    text = re.sub(r"(?<=\.\d)-(?=\d)", "–", str(cell)).replace(" %", "\u00a0%")
    return "–" if text == "-" else re.sub(r"(?<![\w.])-(?=\d)", "−", text)


def paragraphs(text: str | Sequence[str]) -> list[str]:
    """Return one paragraph or several as a list."""
    return [text] if isinstance(text, str) else list(text)


def style() -> str:
    """Style sheet of a page: colours by day, in the dark and in print, then `page.css`."""
    rules = files("loose_env.report").joinpath("page.css").read_text(encoding="utf-8")
    return (
        f":root {{ color-scheme: light dark; --font: {FONT}; {_declared(LIGHT)} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {_declared(DARK)} }} }}\n"
        f"@media print {{ :root {{ color-scheme: light; {_declared(PAPER)} }} }}\n{rules}"
    )


def _declared(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{role}: {colour};" for role, colour in colours.items())


def shown(card: FigureCard, name: str) -> dict[str, str]:
    """Text of a figure card with its SVG markup or the data address of its PNG.

    Parameters
    ----------
    card : FigureCard
        Figure and text.
    name : str
        A name that no other figure of the page has.
    """
    image = card.image if isinstance(card.image, bytes) else to_svg(card.image)
    png = image.startswith(b"\x89PNG\r\n")
    address = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
    return {
        "heading": card.heading, "intro": card.intro, "title": card.title, "caption": card.caption,
        "svg": "" if png else inline(image, name), "png": address if png else "",
    }  # fmt: skip


def to_svg(figure: Figure) -> bytes:
    """Save a figure as SVG with letters as text, reproducible byte by byte."""
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "loose-env"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()


def inline(svg: bytes, name: str) -> str:
    """Fit an SVG into a page: ids of its own, the page's colours, letters and width.

    Examples
    --------
    >>> inline(b'<?xml version="1.0"?><svg width="9"><g id="a"/><use href="#a"/></svg>', "f1")
    '<svg><g id="f1-a"/><use href="#f1-a"/></svg>'
    """
    text = svg.decode("utf-8")
    start, end = text.find("<svg"), text.rfind("</svg>")
    if start < 0 or end < 0:
        raise InvalidData("a figure is a PNG, an SVG or a matplotlib figure; this is neither")
    text = text[start : end + len("</svg>")]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, role in THEMED.items():
        text = text.replace(colour, f"var(--{role},{colour})")
    text = re.sub(r"'DejaVu Sans'(?:, *[^;\"]*?)?(?=[;\"])", "var(--font,sans-serif)", text)
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)  # its viewBox keeps the shape
    return f"{head}>{rest}"


def standalone(svg: bytes, name: str) -> str:
    """Make a file of an SVG: on paper of its own, light or dark by the reader's choice.

    Parameters
    ----------
    svg, name
        As for `inline`.
    """
    head, rest = inline(svg, name).split(">", 1)
    if "xmlns=" not in head:
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return (
        f"{head}><style>svg {{ --font: {FONT}; {_declared(LIGHT)} background: var(--paper); }} "
        f"@media (prefers-color-scheme: dark) {{ svg {{ {_declared(DARK)} }} }}</style>{rest}\n"
    )


@dataclass(frozen=True, kw_only=True)
class Brief:
    """A result in a few lines, for terminals and notebooks."""

    headline: str
    parts: Sequence[tuple[str, str, Any]] = ()
    """Title in a notebook, beginning of each line in a terminal, and either lines or rows of cells,
    headings first. A cell that is a number from 0 to 1 is drawn as a bar in a notebook."""

    def text(self) -> str:
        """The result for a terminal."""
        lines = [self.headline]
        for _, prefix, own in self.parts:
            if own and not isinstance(own[0], str):
                words = [k for k, cell in enumerate(own[-1]) if isinstance(cell, str)]
                own = aligned([[row[k] for k in words] for row in own])
            lines += [f"{prefix}{line}" for line in own]
        return "\n".join(lines)

    def html(self) -> str:
        """The result as a fragment of HTML without style sheet or colours of its own."""
        found = [f"<p><strong>{escape(self.headline)}</strong></p>"]
        for title, _, own in self.parts:
            if not own:
                continue
            if isinstance(own[0], str):
                items = "".join(f"<li>{escape(line)}</li>" for line in own)
                found.append(f"<p style='margin-bottom:0'>{title}</p>")
                found.append(f"<ul style='margin-top:0'>{items}</ul>")
                continue
            head, *rows = ("".join(map(_cell, row)) for row in own)
            cells = "".join(f"<tr>{row}</tr>" for row in [head.replace("td", "th"), *rows])
            found.append(f"<div style='overflow-x:auto'><table>{cells}</table></div>")
        return "".join(found)


def graded_parts(graded: Iterable[tuple[str, str]]) -> list[tuple[str, str, list[str]]]:
    """Warnings as parts of a `Brief`, by severity."""
    return [(_GRADES[grade][0], f"{grade}: ", said) for grade, said in _by_grade(graded)]


def _cell(value: str | float) -> str:
    """A cell of a notebook's table; a number is drawn as a bar."""
    shown = escape(value) if isinstance(value, str) else bar(value)
    return f"<td style='text-align:left'>{shown}</td>"


def bar(share: float) -> str:
    """Draw a share, clipped to 0 to 1, as a horizontal bar, an SVG element.

    Examples
    --------
    >>> bar(0.5).count('width="60.0"'), bar(7.0).count('width="120.0"')
    (1, 2)
    """
    frame = '<rect width="{:.1f}" height="10" fill="{}"{}/>'
    filled = frame.format(120 * min(max(share, 0.0), 1.0), ink.MEASURED, "")
    ground = frame.format(120, "currentColor", ' opacity="0.12"')
    return f'<svg width="120" height="10" role="presentation">{ground}{filled}</svg>'


def aligned(rows: Sequence[Sequence[str]], most: int = _WIDTH) -> list[str]:
    """Format rows as lines of at most so many letters, with aligned columns; cells are wrapped.

    Examples
    --------
    >>> aligned([["a", "1"], ["long", ""]]), aligned([["of two words", "1"]], 9)
    (['a     1', 'long'], ['of two  1', 'words'])
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    while sum(widths) + 2 * (len(widths) - 1) > most:
        widths[widths.index(max(widths))] -= 1
    lines = []
    for row in rows:
        # a number stays with its per cent
        whole = (
            textwrap.wrap(c.replace(" %", "\0%"), w or 1) for c, w in zip(row, widths, strict=True)
        )
        cells = [[part.replace("\0", " ") for part in parts] for parts in whole]
        for parts in zip_longest(*cells, fillvalue=""):
            own = zip(parts, widths, strict=True)
            lines.append("  ".join(part.ljust(width) for part, width in own).rstrip())
    return lines


def named_list(names: Sequence[str], last: str = "and") -> str:
    """Names as a sentence lists them."""
    return f" {last} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
