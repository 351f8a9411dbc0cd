"""The "Parameters" sections of docstrings name parameters that exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from itertools import chain

from tests.docs.pages import ROOT

SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=\n\n\S|\Z)", re.DOTALL | re.MULTILINE)
Classes = dict[str, ast.ClassDef]


def described(node: ast.FunctionDef | ast.ClassDef) -> set[str]:
    """Names in the section "Parameters" of a docstring, without stars."""
    found = SECTION.search(ast.get_docstring(node) or "")
    heads = re.findall(r"^\S.*$", found[1], re.MULTILINE) if found else []
    return {name.strip().lstrip("*") for head in heads for name in head.split(" : ")[0].split(",")}


def parameters(node: ast.FunctionDef | ast.ClassDef, classes: Classes) -> set[str] | None:
    """Of a function, an `__init__` or a dataclass, inherited fields included; None of others."""
    if isinstance(node, ast.FunctionDef):
        return {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and each.name == "__init__":
            return parameters(each, classes)
    if not any("dataclass" in ast.unparse(each) for each in node.decorator_list):
        return None
    bases = (classes[base.id] for base in node.bases if getattr(base, "id", "") in classes)
    fields = {ast.unparse(each.target) for each in node.body if isinstance(each, ast.AnnAssign)}
    return fields.union(*(parameters(base, classes) or () for base in bases))


def unknown(texts: Iterable[str]) -> Iterator[str]:
    """Described parameters that do not exist, with what has none of them."""
    nodes = list(chain.from_iterable(ast.walk(ast.parse(text)) for text in texts))
    classes = {node.name: node for node in nodes if isinstance(node, ast.ClassDef)}
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            known = parameters(node, classes)
            lost = described(node) - known if known is not None else ()
            yield from (f"{node.name}: {name}" for name in sorted(lost))


def test_described_parameters_exist() -> None:
    files = chain(*((ROOT / part).rglob("*.py") for part in ("loose_env", "agents", "scripts")))
    assert list(unknown(file.read_text(encoding="utf-8") for file in files)) == []
