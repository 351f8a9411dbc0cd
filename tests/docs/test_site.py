"""The documentation's site: built without a warning, readable without a network, on any screen."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="needs the extra docs: pip install -e '.[docs]'")
pytest.importorskip("myst_parser")
pytest.importorskip("furo")

from tests.browser.chromium import WIDTHS, Page, browser, fits_on_paper, is_in_order, pictures
from tests.docs.pages import ROOT

pytestmark = pytest.mark.slow

__all__ = ["browser"]

WRITTEN = sorted(page.stem for page in (ROOT / "docs").glob("*.md"))
REFERENCE = ["api/index", "api/loose_env.arms", "api/loose_env.statistics.spectra"]


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` does: a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8")
    line = re.search(r"-m (sphinx .*) docs docs/_build$", recipe, flags=re.MULTILINE)
    assert line is not None and "-W" in line[1].split()
    done = subprocess.run(
        [sys.executable, "-m", *line[1].split(), "-d", folder / "trees", "docs", folder / "html"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-6000:]
    return folder / "html"


def test_every_page_is_there_and_can_be_reached(site: Path) -> None:
    missing = [name for name in [*WRITTEN, *REFERENCE] if not (site / f"{name}.html").is_file()]
    assert not missing
    front = (site / "index.html").read_text(encoding="utf-8")
    unreached = [name for name in WRITTEN if f'href="{name}.html' not in front and name != "index"]
    assert not unreached, f"docs/index.md has no place for {unreached}"


def test_the_reference_has_every_public_name(site: Path) -> None:
    import loose_env.arms
    import loose_env.statistics

    for package in (loose_env.arms, loose_env.statistics):
        page = (site / "api" / f"{package.__name__}.html").read_text(encoding="utf-8")
        assert [name for name in package.__all__ if name not in page] == []
    text = (site / "api" / "loose_env.statistics.spectra.html").read_text(encoding="utf-8")
    assert 'id="loose_env.statistics.spectra.bandpass"' in text


def test_nothing_comes_from_a_network(site: Path) -> None:
    for file in site.rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|link|iframe)[^>]+(?:src|href)="(https?:[^"]+)"', text)
        assert not loaded, f"{file.name} loads {loaded}"
    for file in site.rglob("*.css"):
        text = file.read_text(encoding="utf-8", errors="replace")
        assert not re.search(r"@import\s+url\(\s*['\"]?https?:|url\(\s*['\"]?https?:", text), file


@pytest.mark.parametrize("name", [*WRITTEN, *REFERENCE])
def test_pages_are_in_order_in_a_browser(browser: Page, site: Path, name: str) -> None:
    for width in WIDTHS:
        is_in_order(browser, site / f"{name}.html", width=width)
    file = ROOT / "docs" / f"{name}.md"
    shown = file.read_text(encoding="utf-8").count("![") if file.is_file() else 0
    assert len(pictures(browser)) >= shown


def test_the_method_can_be_printed_and_read_in_the_dark(browser: Page, site: Path) -> None:
    fits_on_paper(browser, site / "method.html")
    is_in_order(browser, site / "method.html", width=390, dark=True)
