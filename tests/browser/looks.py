"""What every page has to be, in a browser: whole, quiet, within its window, its figures there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.chromium import Page, chromium, executable

WIDTHS = (390, 768, 1280)
"""A phone, a tablet, a desk [pixels]."""
PAPER = 718
"""Width of an A4 sheet within its margins [pixels]."""

TOO_WIDE = """
(() => {
  const wide = document.documentElement.clientWidth;
  const boxes = ['pre', '.scroll', '.table-wrapper', 'svg', '.sidebar-drawer', '.toc-drawer',
    '.strip figcaption'].join();
  const held = e => e.closest(boxes);
  return [...document.body.querySelectorAll('*')]
    .filter(e => e.getBoundingClientRect().right > wide + 1 && !held(e.parentElement))
    .slice(0, 5)
    .map(e => `${e.tagName}.${e.className} ends at ${Math.round(e.getBoundingClientRect().right)}`);
})()
"""
"""Elements that reach beyond the window, but for those in boxes that scroll on their own."""

PICTURES = """
[...document.querySelectorAll('main figure svg, main figure img, article img')].map(e => {
  const box = e.getBoundingClientRect();
  const parts = e.tagName.toLowerCase() === 'svg'
    ? e.querySelectorAll('path, use, text, rect, circle').length : e.naturalWidth;
  return [e.tagName + ' ' + (e.getAttribute('alt') || ''), box.width, box.height, parts];
})
"""
"""Every picture: its name, its size on the page, and how much is in it."""


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """One tab of a headless Chromium."""
    pytest.importorskip("websockets", reason="driving a browser needs the package websockets")
    if executable() is None:
        pytest.skip("no Chromium on this machine: install one, as chromium or google-chrome")
    with chromium(tmp_path_factory.mktemp("chromium")) as page:
        yield page


def is_in_order(page: Page, file: Path, *, width: int, dark: bool = False) -> None:
    """Load a page and check what holds for all of them."""
    page.open(file, width=width, dark=dark)
    where = f"{file.name} at {width} pixels"
    assert not page.errors, f"{where}: {page.errors}"
    outside = [url for url in page.asked if not url.startswith(("file:", "data:"))]
    assert not outside, f"{where} asks for {outside}"
    assert page.value("document.title"), where
    reach = page.value("document.documentElement.scrollWidth")
    assert reach <= width, f"{where} is {reach} wide: {page.value(TOO_WIDE)}"
    for name, wide, high, parts in pictures(page):
        assert wide > 40 and high > 40 and parts > 3, f"{where}: {name} is {wide} x {high}"


def pictures(page: Page) -> list[list[Any]]:
    """Name, width, height and content of every picture of the page that is open."""
    return list(page.value(PICTURES))


def fits_on_paper(page: Page, file: Path) -> None:
    """Check that nothing is cut off in print, where nothing scrolls."""
    page.open(file, width=PAPER)
    page.call("Emulation.setEmulatedMedia", media="print", features=[])
    reach = page.value("document.documentElement.scrollWidth")
    assert reach <= PAPER, f"{file.name} in print is {reach} wide: {page.value(TOO_WIDE)}"
    ink = page.value("getComputedStyle(document.body).color")
    assert sum(map(int, ink[4:-1].split(","))) < 200, f"{file.name} prints in {ink}"
