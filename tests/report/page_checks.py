"""Checks that hold for every page."""

from __future__ import annotations

import re
from html import unescape
from html.parser import HTMLParser


class Parsed(HTMLParser):
    """Elements of a page, checked to close in order; its headings and ids."""

    VOID = frozenset({"meta", "img", "br", "link", "use", "path", "input", "wbr"})

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.ids: list[str] = []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def checked(page: str) -> Parsed:
    """A page whose elements close, whose ids are unique, and that loads and runs nothing."""
    parsed = Parsed(page)
    assert len(parsed.ids) == len(set(parsed.ids))
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', page))
    assert used <= set(parsed.ids)
    outside = re.findall(r'(?:src|href)\s*=\s*"(?!#|data:)[^"]*"|@import|url\(\s*[^#)\s]', page)
    assert not [found for found in outside if "xmlns" not in found]
    assert "<script" not in page and "<link" not in page
    assert 'name="viewport"' in page and "@media print" in page
    assert page.count("<figure") == page.count("<svg")
    assert not re.search(r"\b(nan|None|inf)\b", words(page))
    return parsed


def words(page: str) -> str:
    """The text of a page, without its figures."""
    body = re.sub(r"<svg.*?</svg>", " ", page[page.index("<body>") :], flags=re.DOTALL)
    body = body.replace("<wbr>", "")
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body)))
