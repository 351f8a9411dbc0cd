"""Figures as SVG that stands inside a page: light or dark, and no name used twice."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

from loose_env.envs import palette as ink
from loose_env.errors import InvalidData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


THEMED = {
    ink.PAPER: "paper",
    ink.INK: "ink",
    ink.MUTED: "muted",
    ink.FAINT: "faint",
    ink.BODY: "body",
    ink.EDGE: "edge",
    ink.CAP: "cap",
    ink.HELD_CAP: "held-cap",
    ink.SHADOW: "shadow",
    ink.MEASURED: "measured",
    ink.TRUTH: "truth",
}
"""Colours that the page may change, and the names by which it knows them."""

_AWAY = re.compile(r"""(?:href|src)\s*=\s*["']?\s*(?:https?:)?//|url\(\s*["']?(?:https?:)?//""")


def to_svg(figure: Figure) -> bytes:
    """Save a figure as SVG with letters as text, reproducible byte by byte."""
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "loose-env"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()


def inline(svg: bytes, name: str) -> str:
    """Fit an SVG into a page.

    Its ids begin with ``name``, the colours of `THEMED` follow the page, and its letters take
    the page's font.

    Parameters
    ----------
    svg : bytes
        An SVG document, utf-8.
    name : str
        A name that no other figure of the page has.

    Raises
    ------
    InvalidData
        If it is no SVG, holds a script or loads something from elsewhere.

    Examples
    --------
    >>> inline(b'<?xml version="1.0"?><svg><g id="a"/><use href="#a"/></svg>', "f1")
    '<svg><g id="f1-a"/><use href="#f1-a"/></svg>'
    """
    text = svg.decode("utf-8")
    start, end = text.find("<svg"), text.rfind("</svg>")
    if start < 0 or end < 0:
        raise InvalidData("a figure is a PNG, an SVG or a matplotlib figure; this is neither")
    text = text[start : end + len("</svg>")]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    if _AWAY.search(text) or re.search(r"<script|\son\w+\s*=", text, flags=re.IGNORECASE):
        raise InvalidData("a figure of the page may hold no script and load nothing from elsewhere")
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, role in THEMED.items():
        text = text.replace(colour, f"var(--{role},{colour})")
    text = re.sub(r"'DejaVu Sans'(?:, *[^;\"]*?)?(?=[;\"])", "var(--font,sans-serif)", text)
    # The page decides how wide a figure is; its viewBox keeps the shape.
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    return f"{head}>{rest}"


def standalone(svg: bytes, name: str) -> str:
    """Make a file of an SVG, for documents that show it as an image.

    It stands on paper of its own and follows the reader's choice of light or dark.

    Parameters
    ----------
    svg, name
        As for `inline`.

    Raises
    ------
    InvalidData
        If it is no SVG, holds a script or loads something from elsewhere.

    Examples
    --------
    >>> text = standalone(b'<svg viewBox="0 0 4 3"><g id="a"/></svg>', "f1")
    >>> text.startswith('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 4 3"><style>')
    True
    """
    from loose_env.report.pages.style import DARK, FONT, LIGHT, declared

    head, rest = inline(svg, name).split(">", 1)
    if "xmlns=" not in head:
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return (
        f"{head}><style>svg {{ --font: {FONT}; {declared(LIGHT)} background: var(--paper); }} "
        f"@media (prefers-color-scheme: dark) {{ svg {{ {declared(DARK)} }} }}</style>{rest}\n"
    )
