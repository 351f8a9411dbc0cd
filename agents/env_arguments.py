"""The environment's arguments as scripts take them."""

from __future__ import annotations

import json
from typing import Any

from loose_env.errors import InvalidSetting

__all__ = ["arguments_of"]


def arguments_of(text: str) -> dict[str, Any]:
    """Read the environment's arguments from the option ``--arguments``.

    Raises
    ------
    InvalidSetting
        If they are no JSON object.

    Examples
    --------
    >>> arguments_of('{"n_links": 3}')
    {'n_links': 3}
    """
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidSetting(
            f"--arguments must be JSON such as '{{\"n_links\": 3}}': {error}"
        ) from error
    if not isinstance(found, dict):
        raise InvalidSetting(f"--arguments must be a JSON object, got {text!r}")
    return found
