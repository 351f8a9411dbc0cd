"""A page that holds all it shows: words, a table, figures, and nothing from elsewhere."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loose_env.errors import InvalidData, MissingExtra
from loose_env.report.plate import Plate
from loose_env.report.svg import inline, to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["render_page", "write_comparison_page"]

_PNG = b"\x89PNG\r\n"

Image = Plate | tuple[str, "bytes | Figure"]
"""A plate, or its caption and its image."""


def write_comparison_page(
    path: str | os.PathLike[str],
    *,
    title: str,
    table: Sequence[Mapping[str, object]],
    figures: Sequence[Image],
    text: str | Sequence[str],
    result: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
    story: Sequence[Image] = (),
    story_text: str | Sequence[str] = (),
    notes: str | Sequence[str] = (),
) -> Path:
    """Write the page of a comparison of agents.

    The file is written beside its final name and renamed into place.

    Parameters
    ----------
    path : path-like
        Where the page goes; its folder is made where there is none.
    title : str
        Title of the page.
    table : sequence of mapping
        One row an agent. The keys of the first row are the columns; the first of them names
        the agent.
    figures : sequence of Plate or (caption, image)
        Figures in order; an image is a matplotlib figure, or an SVG or a PNG as bytes.
    text : str or sequence of str
        Paragraphs that stand first: what was played.
    result : str or sequence of str
        Paragraphs about the outcome; the first of them stands out.
    colours : mapping, optional
        Colour of each agent, ``#rrggbb``, shown beside its name in the table.
    story : sequence of Plate or (caption, image)
        One episode in pictures.
    story_text, notes : str or sequence of str
        Paragraphs above the story and at the foot of the page.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InvalidData
        If a figure cannot be shown, or rows of the table have different columns.
    MissingExtra
        If jinja2 is not installed.
    """
    page = render_page(
        title=title,
        table=table,
        figures=figures,
        text=text,
        result=result,
        colours=colours,
        story=story,
        story_text=story_text,
        notes=notes,
    )
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        beside.write_text(page, encoding="utf-8")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target


def render_page(
    *,
    title: str,
    table: Sequence[Mapping[str, object]],
    figures: Sequence[Image],
    text: str | Sequence[str],
    result: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
    story: Sequence[Image] = (),
    story_text: str | Sequence[str] = (),
    notes: str | Sequence[str] = (),
) -> str:
    """Return the page that `write_comparison_page` writes."""
    template = _template()
    columns = list(table[0]) if table else []
    for row in table:
        if list(row) != columns:
            raise InvalidData(f"every row of the table has columns {columns}, got {list(row)}")
    shown = [_shown(item, f"f{k}") for k, item in enumerate(figures)]
    page: str = template.render(
        title=title,
        text=_paragraphs(text),
        result=_paragraphs(result),
        columns=columns,
        table=[[str(value) for value in row.values()] for row in table],
        colours=dict(colours or {}),
        groups=_groups(shown),
        story=[_shown(item, f"s{k}") for k, item in enumerate(story)],
        story_text=_paragraphs(story_text),
        notes=_paragraphs(notes),
    )
    return page


def _template() -> Any:
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError as error:
        raise MissingExtra(
            "the page needs jinja2: install it with pip install 'loose-env[report]'"
        ) from error
    source = files("loose_env.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(source)


def _paragraphs(text: str | Sequence[str]) -> list[str]:
    return [text] if isinstance(text, str) else list(text)


def _shown(item: Image, name: str) -> dict[str, str]:
    """Return heading, caption and either SVG markup or the address of a PNG."""
    plate = item if isinstance(item, Plate) else Plate(caption=item[0], image=item[1])
    image = plate.image if isinstance(plate.image, bytes) else to_svg(plate.image)
    shown = {
        "heading": plate.heading,
        "intro": plate.intro,
        "title": plate.title,
        "caption": plate.caption,
        "svg": "",
        "png": "",
    }
    if image.startswith(_PNG):
        shown["png"] = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
    else:
        shown["svg"] = inline(image, name)
    return shown


def _groups(shown: Sequence[dict[str, str]]) -> list[dict[str, Any]]:
    """Put figures under their headings."""
    groups: list[dict[str, Any]] = []
    for plate in shown:
        if plate["heading"] or not groups:
            groups.append({"heading": plate["heading"], "intro": plate["intro"], "plates": []})
        groups[-1]["plates"].append(plate)
    return groups
