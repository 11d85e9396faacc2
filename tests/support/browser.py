"""A headless Chromium driven over a pipe of its own debugging protocol: no package is needed.

Messages are JSON, each ended by a zero byte; the browser reads from file descriptor 3 and writes to 4.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

VARIABLE = "FG_ORIENT_CHROMIUM"
#: The process becomes the browser; the ends of the pipes have the numbers that it expects.
_EXEC = "import os, sys; a, b, *c = sys.argv[1:]; os.dup2(int(a), 3); os.dup2(int(b), 4); os.execv(c[0], c)"
#: A browser that does not answer is ended after these seconds.
PATIENCE = 600.0


def executable() -> str | None:
    """Return the first browser found: of the variable, then on the path; None if there is none."""
    for name in (os.environ.get(VARIABLE, ""), "chromium", "google-chrome"):
        if name and (found := shutil.which(name)):
            return found
    return None


class BrowserError(RuntimeError):
    """The browser refused, died or did not answer."""


class Page:
    """One tab.

    Parameters
    ----------
    browser : Browser
    session : str
        Its name in the protocol.
    """

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self.troubles: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        return self._browser.call(method, session=self._session, **parameters)

    def open(self, path: Path, *, wait: str = "document.readyState === 'complete'") -> None:
        """Open a file and wait for a condition; forget errors of earlier pages."""
        self.troubles.clear()
        self.call("Page.navigate", url=path.absolute().as_uri())
        self.until(f"location.href !== 'about:blank' && ({wait})")

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page; promises are awaited."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise BrowserError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def until(self, condition: str, seconds: float = PATIENCE) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.value(condition):
            if time.monotonic() > end:
                raise BrowserError(f"never true: {condition}")
            time.sleep(0.02)

    def size(self, width: int, height: int, *, dark: bool = False, script: bool = True) -> None:
        """Set the size of the window, the colours and whether scripts run, for pages to come."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Emulation.setScriptExecutionDisabled", value=not script)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send ``mouseMoved``, ``mousePressed``, ``mouseReleased`` or ``mouseWheel``."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def key(self, name: str, text: str = "", code: int = 0) -> None:
        """Press and release a key."""
        key = {"key": name, "text": text, "windowsVirtualKeyCode": code}
        self.call("Input.dispatchKeyEvent", type="keyDown", **key)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=name)

    def picture(self, path: Path, clip: dict[str, float] | None = None) -> None:
        """Save the visible part, or a part of the page (``x, y, width, height``), as PNG."""
        part = {"clip": {**clip, "scale": 1}, "captureBeyondViewport": True} if clip else {}
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png", **part)["data"]))


class Browser:
    """A browser process; see :func:`open_browser`."""

    def __init__(self, process: subprocess.Popen[bytes], to: int, from_: int) -> None:
        self._process, self._to, self._from = process, to, from_
        self._number, self._buffer = 0, b""
        self.pages: dict[str, Page] = {}

    def page(self) -> Page:
        """Open a tab that notes every error of its console."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self.pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Log"):
            page.call(f"{domain}.enable")
        return page

    def call(self, method: str, *, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer; what happens meanwhile is noted at its page."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        page = self.pages.get(event.get("sessionId", ""))
        if page is None:
            return
        what = event["params"]
        if event["method"] == "Runtime.exceptionThrown":
            page.troubles.append(json.dumps(what["exceptionDetails"]))
        elif event["method"] == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
            page.troubles.append(what["entry"]["text"])
        elif event["method"] == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning", "assert"):
            page.troubles.append(json.dumps(what["args"]))

    def _read(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
            part = os.read(self._from, 1 << 20) if ready else b""
            if not part:
                raise BrowserError(f"no answer from the browser (exit code {self._process.poll()})")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        found: dict[str, Any] = json.loads(message)
        return found


@contextmanager
def open_browser(program: str, profile: Path) -> Iterator[Browser]:
    """Start a headless browser with an empty profile and end it.

    Parameters
    ----------
    program : str
        See :func:`executable`.
    profile : Path
        Folder for its files.
    """
    theirs_in, to = os.pipe()
    from_, theirs_out = os.pipe()
    flags = ["--headless=new", "--remote-debugging-pipe", f"--user-data-dir={profile}", "--no-first-run",
             "--disable-gpu", "--hide-scrollbars", "--disable-extensions", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", "--force-color-profile=srgb"]  # fmt: skip
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # Chromium does not run as root with its sandbox
    ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (theirs_in, theirs_out)]  # clear of 3 and 4
    process = subprocess.Popen(
        [sys.executable, "-c", _EXEC, *map(str, ends), program, *flags], pass_fds=ends, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    for end in (theirs_in, theirs_out, *ends):
        os.close(end)
    browser = Browser(process, to, from_)
    try:
        yield browser
        browser.call("Browser.close")
    finally:
        os.close(to)
        os.close(from_)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
