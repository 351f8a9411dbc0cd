"""Colours of the report's figures: one an agent, safe for colour-blind readers."""

from __future__ import annotations

from collections.abc import Sequence

AGENTS = ("#0173b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#8a8f98")
"""Okabe and Ito's palette without black and yellow, which vanish on one background or other.

None of them is a colour that `loose_env.report.pages.svg.THEMED` changes in the dark."""


def agent_colours(agents: Sequence[str]) -> dict[str, str]:
    """Give each agent its colour, in the order of the names; after seven they repeat.

    Examples
    --------
    >>> agent_colours(["thesis", "random", "thesis"])
    {'thesis': '#0173b2', 'random': '#e69f00'}
    """
    names = dict.fromkeys(agents)
    return {name: AGENTS[k % len(AGENTS)] for k, name in enumerate(names)}


def is_light(colour: str) -> bool:
    """True if dark letters read better than white ones on a colour ``#rrggbb``.

    Examples
    --------
    >>> is_light("#0173b2"), is_light("#e69f00")
    (False, True)
    """
    channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] > 0.2
