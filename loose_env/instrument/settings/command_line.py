"""Settings and paths formatted as words of a command line; those that are not the defaults."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any


def option_words(settings: Mapping[str, Any]) -> str:
    """Settings as options, each after a blank.

    Examples
    --------
    >>> option_words({"most_tool": 2.0, "payload_at_m": (0.0, 0.1, 0.0), "tool": "my site"})
    " --most-tool 2 --payload-at-m 0 0.1 0 --tool 'my site'"
    >>> option_words({"reference": True})
    ' --reference'
    """
    words = []
    for name, value in settings.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
            continue
        words.append(f"--{option}")
        for one in value if isinstance(value, tuple | list) else [value]:
            words.append(f"{one:.12g}" if isinstance(one, float) else shlex.quote(str(one)))
    return "".join(f" {word}" for word in words)


def path_word(path: str | Path) -> str:
    """A path as one word of a command line that is no option.

    Examples
    --------
    >>> path_word("runs/my session"), path_word("-old")
    ("'runs/my session'", './-old')
    """
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def unlike(settings: Any, usual: Any) -> dict[str, Any]:
    """Those of a dataclass's settings that are not the usual ones."""
    before = asdict(usual)
    return {name: value for name, value in asdict(settings).items() if value != before[name]}
