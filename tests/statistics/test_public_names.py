"""The package offers its public names in one place; it leans on arrays alone."""

import ast
from pathlib import Path

import loose_env.statistics as statistics


def test_every_public_name_exists_and_says_what_it_is():
    assert statistics.__all__ == sorted(statistics.__all__)
    for name in statistics.__all__:
        assert getattr(statistics, name).__doc__


def test_every_name_on_covariances_has_its_twin_on_arrays():
    for name in statistics.__all__:
        if name.endswith("_from"):
            assert name.removesuffix("_from") in statistics.__all__


def test_it_leans_on_arrays_alone():
    # odrpack fits arrays by orthogonal distances; it knows no arm either.
    allowed = {"numpy", "scipy", "odrpack", "loose_env.errors", "loose_env.statistics"}
    allowed |= {"loose_env.typing"}
    standard = {"__future__", "collections", "dataclasses", "functools", "math", "typing"}
    found = set()
    for path in Path(statistics.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module]
            for name in names:
                parts = name.split(".")
                found.add(".".join(parts[:2]) if parts[0] == "loose_env" else parts[0])
    assert "numpy" in found
    assert found <= allowed | standard
