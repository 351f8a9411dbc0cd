"""Style of reports and documentation: colours for light, dark and print."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

from loose_env.envs import palette as ink

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
"""Letters of every page: those of the reader's own system, so that nothing is loaded."""

LIGHT: Mapping[str, str] = {
    "paper": ink.PAPER,
    "ink": ink.INK,
    "muted": "#5b6671",
    "faint": ink.FAINT,
    "body": ink.BODY,
    "edge": ink.EDGE,
    "cap": ink.CAP,
    "held-cap": ink.HELD_CAP,
    "shadow": ink.SHADOW,
    "measured": ink.MEASURED,
    "truth": ink.TRUTH,
    "page": "#f5f6f8",
    "rule": "#e1e5e9",
}
"""Role of a colour -> the colour by day. Figures know them by
`loose_env.report.pages.svg.THEMED`."""

DARK: Mapping[str, str] = {
    "paper": "#1a1f25",
    "ink": "#e9edf1",
    "muted": "#9ba6b1",
    "faint": "#434d57",
    "body": "#3a4550",
    "edge": "#a3b0bc",
    "cap": "#4a5661",
    "held-cap": "#8d9aa6",
    "shadow": "#242b32",
    "measured": "#4db3ee",
    "truth": "#ff7d54",
    "page": "#12161a",
    "rule": "#2c343c",
}
"""The same in the dark."""

PAPER: Mapping[str, str] = {**LIGHT, "page": ink.PAPER}
"""The same in print."""


def declared(colours: Mapping[str, str]) -> str:
    """Write colours as custom properties of CSS.

    Examples
    --------
    >>> declared({"ink": "#000000", "paper": "#ffffff"})
    '--ink: #000000; --paper: #ffffff;'
    """
    return " ".join(f"--{role}: {colour};" for role, colour in colours.items())


def style() -> str:
    """Style sheet of a standalone page: colours, then the rules of `page.css`.

    Examples
    --------
    >>> sheet = style()
    >>> [sheet.count(f"--{role}:") for role in ("paper", "truth")]  # by day, in the dark, in print
    [3, 3]
    >>> "@import" in sheet or "http" in sheet
    False
    """
    rules = files("loose_env.report").joinpath("page.css").read_text(encoding="utf-8")
    return (
        f":root {{ color-scheme: light dark; --font: {FONT}; {declared(LIGHT)} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {declared(DARK)} }} }}\n"
        f"@media print {{ :root {{ color-scheme: light; {declared(PAPER)} }} }}\n"
        f"{rules}"
    )
