"""What the documents show: their examples in Python, and the commands they tell one to type."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAMS = ("python", "python3", ".venv/bin/python", "loose", ".venv/bin/loose", "make", "pip")
"""With what a line begins that is a command."""


@dataclass(frozen=True)
class Block:
    """A block of code of a page."""

    language: str
    """What stands behind its fence; "" for an indented one."""
    text: str
    line: int
    """Where it begins."""


def blocks(page: Path) -> list[Block]:
    """All blocks of code of a page."""
    found = MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8"))
    return [
        Block(
            language=token.info.strip() if token.type == "fence" else "",
            text=token.content,
            line=(token.map or [0])[0] + 1,
        )
        for token in found
        if token.type in ("fence", "code_block")
    ]


def python(page: Path) -> str:
    """The page's examples in Python, one after the other, each at its line of the page."""
    lines: list[str] = []
    for block in blocks(page):
        if block.language == "python":
            lines += [""] * (block.line - len(lines))
            lines += block.text.splitlines()
    return "\n".join(lines) + "\n"


def commands(page: Path) -> list[list[str]]:
    """Commands that the page tells one to type, each split into its words.

    They stand in blocks without a language, or marked as a shell's, where lines that end in a
    backslash go on in the next; or between backticks in the text, with their arguments.
    """
    lines = []
    for block in blocks(page):
        if block.language in ("", "sh", "bash", "console", "shell"):
            lines += block.text.replace("\\\n", " ").splitlines()
    for token in MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8")):
        lines += [
            child.content
            for child in token.children or ()
            if child.type == "code_inline" and " " in child.content.strip()
        ]
    return [_words(line) for line in lines if _is_command(line)]


def _is_command(line: str) -> bool:
    return line.removeprefix("$ ").split(" ")[0] in PROGRAMS


def _words(line: str) -> list[str]:
    """Words of a command, without what it is piped into, and without what is said about it.

    What is said about a command stands three spaces or more behind it.
    """
    typed, _, _ = line.removeprefix("$ ").partition("   ")
    words = shlex.split(typed, comments=True)
    ends = [k for k, word in enumerate(words) if word in (">", "|", "&&")]
    return words[: min(ends, default=len(words))]
