"""Headless Chromium, driven over a pipe by the DevTools protocol; a page as it is seen."""

import base64
import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PROGRAM = "chromium"
_OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
    *("--hide-scrollbars", "--remote-debugging-pipe"),
)
_TIME_LIMIT = 60.0
_MOST_LOOKS = 6000
# The browser reads from descriptor 3 and writes to 4, whatever the pipes' numbers in this process.
_LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for number, end in enumerate(ends, 3):
    os.dup2(end, number)
os.execvp(sys.argv[3], sys.argv[3:])
"""
# Text with a contrast to its background below 4.5, with the ratio.
_FAINT = """
(() => {
  const linear = (v) => v < 0.04 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const luminance = (c) => [0.2126, 0.7152, 0.0722].reduce((sum, w, i) => sum + w * linear(c[i] / 255), 0);
  const rgba = (text) => text.match(/[\\d.]+/g).map(Number);
  const behind = (element) => {
    const colour = element ? rgba(getComputedStyle(element).backgroundColor) : [255, 255, 255];
    return colour.length < 4 || colour[3] === 1 ? colour.slice(0, 3) : behind(element.parentElement);
  };
  const written = [...document.body.querySelectorAll("*")].filter((element) =>
    [...element.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim()));
  return written.map((element) => {
    const [a, b] = [rgba(getComputedStyle(element).color).slice(0, 3), behind(element)].map(luminance);
    return [element.tagName, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
  }).filter(([_, ratio]) => ratio < 4.5).map(([name, ratio]) => name + " " + ratio.toFixed(2));
})()
"""
_OPEN_ALL = "document.querySelectorAll('details').forEach((d) => { d.open = true })"
# Invisible figures: not loaded, without area, or outside the window and unreachable by scrolling.
_UNSEEN = """
[...document.images].filter((i) => {
  const box = i.getBoundingClientRect();
  return !i.complete || !i.naturalWidth || box.width < 200 || box.height < 40 || box.left < 0
    || (box.right > document.documentElement.clientWidth && !i.closest(".scroll")) || !i.checkVisibility();
}).map((i) => i.alt)
"""
# Figures so small that letters of 8 points are below 9 pixels.
_SMALL = """
[...document.images].filter((i) => i.getBoundingClientRect().width < 0.85 * i.getAttribute("width"))
  .map((i) => i.alt)
"""
# Parts that scroll sideways on their own but cannot be reached by keyboard.
_OUT_OF_REACH = """
[...document.querySelectorAll("*")].filter((e) => e.scrollWidth > e.clientWidth + 1 && e.clientWidth
  && getComputedStyle(e).overflowX === "auto" && e.tabIndex < 0).length
"""


@dataclass
class Browser:
    """One open page; requests, console : everything that it requested and logged, from its first page on."""

    to: int
    back: int
    session: str = ""
    requests: list[str] = field(default_factory=list)
    console: list[str] = field(default_factory=list)
    _number: int = 0
    _unread: bytes = b""
    _events: list[str] = field(default_factory=list)

    def call(self, method: str, may_fail: bool = False, **params: Any) -> dict[str, Any]:
        """Answer to one call of the protocol; {} if the call failed and may fail."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        message |= {"sessionId": self.session} if self.session else {}
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while (said := self._next()).get("id") != self._number:
            pass
        assert may_fail or "error" not in said, said
        return dict(said.get("result", {}))

    def show(self, page: Path, width: int, height: int = 900) -> None:
        self.visit(page.resolve().as_uri(), width, height)

    def visit(self, url: str, width: int, height: int = 900) -> None:
        """Open an address in a window of this width, and wait until it has loaded."""
        window = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **window)
        self._events.clear()
        self.call("Page.navigate", url=url)
        while "Page.loadEventFired" not in self._events:
            self._next()

    def value(self, expression: str) -> Any:
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true on the page, even if the page changes meanwhile."""
        later = f"new Promise((done) => setTimeout(() => done(!!({expression})), 100))"
        for _ in range(_MOST_LOOKS):
            asked = {"expression": later, "awaitPromise": True, "returnByValue": True}
            said = self.call("Runtime.evaluate", True, **asked)
            if said.get("result", {}).get("value"):
                return
        raise AssertionError(f"never: {expression}")

    def picture(self, path: Path, *, whole: bool = True) -> None:
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self.back], [], [], _TIME_LIMIT)
            assert ready, f"{PROGRAM}: no answer for {_TIME_LIMIT:g} s"
            chunk = os.read(self.back, 1 << 20)
            assert chunk, f"{PROGRAM}: ended"
            self._unread += chunk
        text, _, self._unread = self._unread.partition(b"\0")
        said: dict[str, Any] = json.loads(text)
        method, params = said.get("method", ""), said.get("params", {})
        self._events.append(method)
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Log.entryAdded":
            self.console.append(params["entry"]["text"])
        elif method == "Runtime.consoleAPICalled":
            self.console.append(str(params["args"]))
        elif method == "Runtime.exceptionThrown":
            self.console.append(params["exceptionDetails"]["text"])
        return said


@contextmanager
def open_browser() -> Iterator[Browser]:
    from_us, to_browser = os.pipe()
    from_browser, to_us = os.pipe()
    # a process of the browser may still write into its profile after it has ended
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        ends = (str(from_us), str(to_us))
        command = [sys.executable, "-c", _LAUNCH, *ends, PROGRAM, *_OPTIONS, f"--user-data-dir={profile}"]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, pass_fds=(from_us, to_us), **silent)
        for end in (from_us, to_us):
            os.close(end)
        browser = Browser(to_browser, from_browser)
        try:
            target = browser.call("Target.createTarget", url="about:blank")["targetId"]
            attached = browser.call("Target.attachToTarget", targetId=target, flatten=True)
            browser.session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                browser.call(f"{domain}.enable")
            yield browser
        finally:
            for end in (to_browser, from_browser):
                os.close(end)
            process.terminate()
            process.wait(_TIME_LIMIT)


def faults(browser: Browser, page: Path, width: int) -> list[str]:
    """Defects that a reader would see on a page on disk, with its folded parts opened too."""
    for former in (browser.requests, browser.console):
        former.clear()
    browser.show(page, width)
    found = _wider(browser, width)
    browser.value(_OPEN_ALL)
    for what, expression in (("not seen", _UNSEEN), ("small letters", _SMALL)):
        found += [f"{what}: {alt}" for alt in browser.value(expression)]
    found += disturbing(browser, width) + [f"console: {text}" for text in browser.console]
    asked = [url for url in browser.requests if not url.startswith("data:")]
    return found + [f"asked for {url}" for url in asked if url != page.as_uri()]


def disturbing(browser: Browser, width: int) -> list[str]:
    """Parts of the open page that are wider than its window, too faint, or out of reach of the keyboard."""
    found = _wider(browser, width) + [f"faint: {text}" for text in browser.value(_FAINT)]
    return found + ["a part scrolls that no key reaches"] * browser.value(_OUT_OF_REACH)


def _wider(browser: Browser, width: int) -> list[str]:
    wide = browser.value("document.documentElement.scrollWidth")
    return [f"{wide} px wide in a window of {width}"] if wide > width else []
