"""Effects of one's own, read from a Python file."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from loose_env.errors import InvalidSetting
from loose_env.gap.catalogue import CATALOGUE

__all__ = ["read_effects"]


def read_effects(path: str | Path) -> tuple[str, ...]:
    """Run a file that registers effects, and return their identifiers.

    Parameters
    ----------
    path : str or Path
        A Python file with classes under ``@register`` of `loose_env.gap.catalogue`.

    Raises
    ------
    InvalidSetting
        If it cannot be read or run, or registers no effect.
    """
    file = Path(path)
    name = f"effects_of_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InvalidSetting(f"{file} is no Python file with effects")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # as an import does: dataclasses look there for their module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the file does
        raise InvalidSetting(f"{file} cannot be run: {type(error).__name__}: {error}") from error
    found = tuple(kind for kind, effect in CATALOGUE.items() if effect.__module__ == name)
    if not found:
        raise InvalidSetting(f"{file} registers no effect; put @register before its class")
    return found
