"""A headless Chromium, driven by its DevTools protocol, and checks that hold for every page."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars"),
    *(f"--disable-{x}" for x in ("gpu", "quic", "background-networking", "component-update")),
    *(f"--disable-{x}" for x in ("sync", "dev-shm-usage")),
    # Whatever a page asks of a network fails, and is heard of.
    "--host-resolver-rules=MAP * ~NOTFOUND",
)
WAIT = 60.0
"""How long an answer may take before the browser counts as hung [s]."""


def executable() -> str | None:
    """Path of a Chromium on this machine."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One tab. What its console and its loading complain about gathers in `errors`."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.number = 0
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.events: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask the browser for something and wait for its answer."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=WAIT))
            if message.get("id") == self.number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return dict(message["result"])
            self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        method, told = message.get("method", ""), message.get("params", {})
        self.events.append(method)
        if method == "Runtime.exceptionThrown":
            thrown = told["exceptionDetails"]
            said = thrown.get("exception", {}).get("description", "")
            self.errors.append(f"{thrown.get('text')} {said}")
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            self.errors.append(" ".join(str(a.get("value")) for a in told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.errors.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif method == "Network.loadingFailed" and not told.get("canceled"):
            self.errors.append(f"not loaded: {told.get('errorText')}")
        elif method == "Network.requestWillBeSent":
            self.asked.append(told["request"]["url"])

    def open(self, path: Path, *, width: int, dark: bool = False) -> None:
        """Load a file in a window of a size and wait until it is there."""
        self.errors.clear()
        self.asked.clear()
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="", features=[scheme])
        self.events.clear()
        self.call("Page.navigate", url=path.resolve().as_uri())
        until = time.monotonic() + WAIT
        while "Page.loadEventFired" not in self.events and time.monotonic() < until:
            with contextlib.suppress(TimeoutError):
                self._hear(json.loads(self.socket.recv(timeout=1.0)))
        self.value("new Promise(done => requestAnimationFrame(() => setTimeout(done, 50)))")

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression; a promise is waited for."""
        found = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def paper(self, path: Path) -> None:
        """Print the page as a PDF."""
        size = {"paperWidth": 8.27, "paperHeight": 11.7}
        found = self.call("Page.printToPDF", printBackground=True, **size)
        path.write_bytes(base64.b64decode(found["data"]))


@contextlib.contextmanager
def chromium(profile: Path) -> Iterator[Page]:
    """Start a browser with an empty profile of its own; end it afterwards."""
    from websockets.sync.client import connect

    found = executable()
    assert found is not None, f"no Chromium: looked for {', '.join(NAMES)}"
    process = subprocess.Popen(
        [found, *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        address = _address(profile, process)
        # No pings: their thread draws from the global `random`, which Hypothesis takes for a
        # strategy that does, whatever test happens to run just then.
        plain = {"max_size": None, "compression": None, "proxy": None, "ping_interval": None}
        with connect(address, **plain) as socket:
            yield Page(socket)
    finally:
        process.kill()
        process.wait()


def _address(profile: Path, process: subprocess.Popen[bytes]) -> str:
    """Where the browser's one tab listens."""
    from urllib.request import ProxyHandler, build_opener

    told, until = profile / "DevToolsActivePort", time.monotonic() + WAIT
    straight = build_opener(ProxyHandler({}))  # past any proxy: the browser is on this machine
    while time.monotonic() < until and process.poll() is None:
        try:
            port = int(told.read_text().splitlines()[0])
            with straight.open(f"http://127.0.0.1:{port}/json/list", timeout=5) as answer:
                tabs = [tab for tab in json.load(answer) if tab["type"] == "page"]
            if tabs:
                return str(tabs[0]["webSocketDebuggerUrl"])
        except (OSError, ValueError, IndexError):
            pass
        time.sleep(0.1)
    raise RuntimeError(f"the browser did not answer (exit status {process.poll()})")


# ------------------------------------------------------------------------- checks

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
