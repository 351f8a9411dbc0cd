"""Pages of the reference: one for every public module, written from the code's own words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

PARTS = (
    "errors",
    "typing",
    "io",
    "streams",
    "arms",
    "faults",
    "excitation",
    "sensors",
    "recording",
    "importing",
    "rig",
    "statistics",
    "inference",
    "kinematics",
    "diagnosis",
    "gap",
    "doctor",
    "envs",
    "wrappers",
    "simulation",
    "registration",
    "evaluation",
    "instrument",
    "report",
    "api",
)
"""Parts of the package in the order in which data flow, without the command line."""

AGENTS = ("base", "belief", "evaluation", "sharded_play", "policies/choice", "registry")
"""Modules of the agents that somebody who adds one meets."""


@dataclass(frozen=True)
class Module:
    """What a module says of itself."""

    name: str
    """Its full name."""
    summary: str
    """First line of its docstring."""
    names: tuple[str, ...]
    """What it offers, in the order of its ``__all__``, or of the file where it has none."""


def modules(part: str) -> Iterator[Module]:
    """Public modules of a part of the package, its own page first.

    The code is read, not run.
    """
    home = ROOT / "loose_env" / part
    files = [home.with_suffix(".py")] if not home.is_dir() else sorted(home.rglob("*.py"))
    for file in files:
        found = module_of(file)
        if found is not None:
            yield found


def module_of(file: Path) -> Module | None:
    """What a file offers; None where it is private or has no words."""
    inside = file.relative_to(ROOT).with_suffix("").parts
    if inside[0] == "agents":  # the folder, not a package
        inside = inside[1:]
    name = ".".join(inside[:-1] if inside[-1] == "__init__" else inside)
    if any(part.startswith("_") for part in name.split(".")):
        return None
    tree = ast.parse(file.read_text(encoding="utf-8"))
    words = ast.get_docstring(tree) or ""
    own = {
        node.name
        for node in tree.body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_")
    }
    listed = _listed(tree)
    names = tuple(sorted(own) if listed is None else listed)
    return Module(name=name, summary=words.partition("\n")[0], names=names) if words else None


def _listed(tree: ast.Module) -> list[str] | None:
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            try:
                return [str(name) for name in ast.literal_eval(node.value)]
            except ValueError:
                return None
    return None


def write(folder: Path) -> None:
    """Write the pages that changed, and remove those of modules that are gone."""
    pages = dict(_pages())
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        file = folder / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            beside = folder / f".{name}.part"
            beside.write_text(text, encoding="utf-8")
            beside.replace(file)


def _pages() -> Iterator[tuple[str, str]]:
    groups = [(f"loose_env.{part}", list(modules(part))) for part in PARTS]
    home = ROOT / "agents" / "loose_agents"
    agents = [module_of(home / f"{name}.py") for name in ("__init__", *AGENTS)]
    groups.append(("loose_agents", [module for module in agents if module is not None]))
    names = [name for name, found in groups if found]
    yield (
        "index.rst",
        _titled("Reference")
        + "Every public module, from the bottom up: a part uses what stands above it.\n\n"
        + ".. toctree::\n   :maxdepth: 1\n\n"
        + "".join(f"   {name}\n" for name in names),
    )
    for name, found in groups:
        own = next((module for module in found if module.name == name), None)
        others = [module for module in found if module.name != name and module.names]
        text = _titled(name) + (f"{_escaped(own.summary)}\n\n" if own else "")
        if own is not None and (own.names or not others):
            text += f"Import from ``{name}``: {_names(own, found)}.\n\n" if others else _auto(own)
        for module in others:
            text += (
                f":doc:`{module.name.removeprefix(name + '.')} <{module.name}>`\n"
                f"   {_escaped(module.summary)}\n"
                f"   {', '.join(f'``{each}``' for each in module.names)}\n\n"
            )
        yield f"{name}.rst", text
        for module in others:
            head = f":orphan:\n\n{_titled(module.name)}Part of :doc:`{name} <{name}>`.\n\n"
            yield f"{module.name}.rst", head + _auto(module)


def _names(own: Module, found: list[Module]) -> str:
    """Names that a package passes on, each leading to the module that defines it."""
    homes = {each: m.name for m in found if m is not own for each in m.names}
    return ", ".join(
        f":py:obj:`{name} <{homes[name]}.{name}>`" if name in homes else f"``{name}``"
        for name in own.names
    )


def _auto(module: Module) -> str:
    return f".. automodule:: {module.name}\n   :members: {', '.join(module.names)}\n"


def _titled(text: str) -> str:
    shown = text.replace("_", r"\_")
    return f"{shown}\n{'=' * len(shown)}\n\n"


_CODE = re.compile(r"(``.+?``|`[^`]+`_?)")


def _escaped(line: str) -> str:
    """A line of a docstring, in which only code is marked up, and full names are links."""
    parts = _CODE.split(line)
    return "".join(
        _code(part) if k % 2 else re.sub(r"([*|]|_(?=\W|$))", r"\\\1", part)
        for k, part in enumerate(parts)
    )


def _code(marked: str) -> str:
    """Code between backticks: a link where it is the full name of something here."""
    inner = marked.strip("`_")
    return f":py:obj:`{inner}`" if inner.startswith("loose_env.") else f"``{inner}``"


_KEPT: dict[str, list[str]] = {}
"""Words about attributes, for `as_written`."""


def as_meant(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Take bars, stars and trailing underscores in docstrings for what they are, not for markup."""
    del app, item, options
    _prose(lines)
    if what in ("attribute", "data", "property"):
        _KEPT[name] = list(lines)


def as_written(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Take back what was made of a colon in the words about an attribute: it names no type."""
    del app, what, item, options
    if name in _KEPT:
        lines[:] = _KEPT.pop(name)


def _prose(lines: list[str]) -> None:
    inside = False
    for k, line in enumerate(lines):
        bare = line.strip()
        if bare.startswith(">>>") or (inside and bare):
            inside = True
            continue
        inside = False
        if bare.endswith(":") and not bare.startswith((":", "..")) and _indents(lines, k):
            lines[k] = f"{_escaped(line)}:"  # what follows is code
        elif not bare.startswith((":", "..")):
            lines[k] = _escaped(line)
        elif bare.startswith(":") and (cut := line.find(": ")) > 0:
            lines[k] = line[: cut + 2] + _escaped(line[cut + 2 :])


def _indents(lines: list[str], k: int) -> bool:
    """Whether an indented block follows a line after a blank one."""
    following = next((line for line in lines[k + 1 :] if line.strip()), "")
    blank = k + 1 < len(lines) and not lines[k + 1].strip()
    deep = len(following) - len(following.lstrip())
    return blank and deep > len(lines[k]) - len(lines[k].lstrip())


_ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], "
    r"~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]"
)
_LIKE = re.compile(
    r"~?(?:[\w.]+\.)?_Buffer \| .*?complex \| bytes \| str \| "
    r"~?(?:[\w.]+\.)?_NestedSequence\[complex \| bytes \| str\]"
)


def shortened(types: str) -> str:
    """Types of arrays as they are written in the code, not as NumPy spells them out.

    >>> shortened("numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]] | None")
    'NDArray[float64] | None'
    """
    return _LIKE.sub("ArrayLike", _ARRAY.sub(r"NDArray[\1]", types))


def short_types(
    app: Any, what: str, name: str, item: Any, options: Any, given: str | None, back: str | None
) -> tuple[str | None, str | None]:
    """Shorten the types of a signature and of what it returns."""
    del app, what, name, item, options
    return given and shortened(given), back and shortened(back)


def unlinked(app: Any, tree: Any) -> None:
    """Leave names in annotations that say no module as words: they could lead to another thing."""
    from docutils.nodes import Text
    from sphinx.addnodes import desc_annotation, pending_xref

    del app
    for node in tree.findall(desc_annotation):
        types = node.astext()
        if shortened(types) != types:
            node.children = []
            node += Text(shortened(types))
    for node in list(tree.findall(pending_xref)):
        if node.get("refdomain") == "py" and "." not in node["reftarget"]:
            node.replace_self(node.children)
