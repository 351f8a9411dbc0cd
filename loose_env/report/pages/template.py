"""Templates of the pages, inlined figures, and atomic writing."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from loose_env.errors import MissingExtra
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.style import style
from loose_env.report.pages.svg import inline, to_svg

_LONG = re.compile(r"\S{25,}")
"""Words that do not fit into a cell of a table."""
_PNG = b"\x89PNG\r\n"


def template(name: str) -> Any:
    """Return a template by package and file.

    A template takes from others by the same kind of name, as in
    ``{% import "loose_env.report/shared.html" as shared %}``.

    Parameters
    ----------
    name : str
        ``package/file``, such as ``"loose_env.report/page.html"``.

    Raises
    ------
    MissingExtra
        If jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, FunctionLoader, StrictUndefined
    except ImportError as error:
        raise MissingExtra(
            "the page needs jinja2: install it with pip install 'loose-env[report]'"
        ) from error
    environment = Environment(
        autoescape=True,
        loader=FunctionLoader(_source),
        lstrip_blocks=True,
        trim_blocks=True,
        undefined=StrictUndefined,
    )
    environment.globals["style"] = style
    environment.filters["breakable"] = _breakable
    return environment.get_template(name)


def _breakable(text: Any) -> Any:
    """Text whose long words may be broken after an underscore: a model's names can be long."""
    from markupsafe import Markup, escape

    return Markup(_LONG.sub(lambda found: found[0].replace("_", "_<wbr>"), str(escape(text))))


def _source(name: str) -> str:
    package, _, file = name.partition("/")
    return files(package).joinpath(file).read_text(encoding="utf-8")


def paragraphs(text: str | Sequence[str]) -> list[str]:
    """Return one paragraph or several as a list."""
    return [text] if isinstance(text, str) else list(text)


def shown(card: FigureCard, name: str) -> dict[str, str]:
    """Return heading, caption and either SVG markup or the address of a PNG.

    Parameters
    ----------
    card : FigureCard
        Picture and words.
    name : str
        A name that no other figure of the page has.

    Raises
    ------
    InvalidData
        If the picture cannot be shown.
    """
    image = card.image if isinstance(card.image, bytes) else to_svg(card.image)
    found = {
        "heading": card.heading,
        "intro": card.intro,
        "title": card.title,
        "caption": card.caption,
        "svg": "",
        "png": "",
    }
    if image.startswith(_PNG):
        found["png"] = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
    else:
        found["svg"] = inline(image, name)
    return found


def write_whole(path: str | os.PathLike[str], text: str) -> Path:
    """Write a file beside its final name and rename it into place.

    Parameters
    ----------
    path : path-like
        Path of the file; its folder is made if missing.
    text : str
        Its content, written as utf-8.

    Returns
    -------
    Path
        The file written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target
