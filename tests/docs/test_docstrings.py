"""The "Parameters" sections of docstrings name parameters that exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import ROOT

FILES = [
    file for part in ("loose_env", "agents", "scripts") for file in (ROOT / part).rglob("*.py")
]
SECTION = re.compile(
    r"^Parameters\n-+\n(.*?)(?=\n\n\S|\n[A-Z]\w+\n-+\n|\Z)", re.DOTALL | re.MULTILINE
)
Parametrised = ast.FunctionDef | ast.ClassDef


def described(node: Parametrised) -> set[str]:
    """Names in the section "Parameters" of a docstring, without stars."""
    found = SECTION.search(ast.get_docstring(node) or "")
    heads = re.findall(r"^\S.*$", found[1], re.MULTILINE) if found else []
    return {name.strip().lstrip("*") for head in heads for name in head.split(" : ")[0].split(",")}


def arguments(node: ast.FunctionDef) -> set[str]:
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return {each.arg for each in every if each is not None}


def parameters(node: Parametrised, classes: dict[str, ast.ClassDef]) -> set[str] | None:
    """Parameters of a function, or of a class: of its `__init__` or its fields, inherited too."""
    if isinstance(node, ast.FunctionDef):
        return arguments(node)
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and each.name == "__init__":
            return arguments(each)
    if not any("dataclass" in ast.unparse(each) for each in node.decorator_list):
        return None
    bases = [
        classes[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes
    ]
    own = {
        each.target.id
        for each in node.body
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
    }
    return own.union(*(parameters(base, classes) or () for base in bases))


def unknown(trees: dict[Path, ast.Module]) -> Iterator[str]:
    nodes = {
        file: [n for n in ast.walk(tree) if isinstance(n, Parametrised)]
        for file, tree in trees.items()
    }
    classes = {n.name: n for many in nodes.values() for n in many if isinstance(n, ast.ClassDef)}
    for file, many in nodes.items():
        for node in many:
            known = parameters(node, classes)
            for name in sorted(described(node) - known if known is not None else ()):
                yield f"{file.name}:{node.lineno} {node.name}: {name}"


def test_described_parameters_exist() -> None:
    trees = {file: ast.parse(file.read_text(encoding="utf-8")) for file in FILES}
    assert list(unknown(trees)) == []


@pytest.mark.parametrize(("name", "wrong"), [("span", []), ("length", ["a.py:1 f: length"])])
def test_a_parameter_that_does_not_exist_is_found(name: str, wrong: list[str]) -> None:
    docstring = f"F.\n\nParameters\n----------\n{name} : int\n    It."
    text = f"def f(span):\n {docstring!r}\n"
    assert list(unknown({Path("a.py"): ast.parse(text)})) == wrong
