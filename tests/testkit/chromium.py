"""Controls a headless Chromium over pipes with the DevTools protocol."""

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


def needs_chromium(test):
    """Mark a test that opens a page in Chromium, where there is one."""
    missing = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium on this machine")
    return pytest.mark.system(missing(test))


class Page:
    """One page; messages are JSON with a NUL behind each."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._out = to_browser
        self._in = os.fdopen(from_browser, "rb")
        self._ids = count(1)
        self._session: str | None = None
        self.errors: list[str] = []
        self._waiting: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        self.call("Page.enable")
        self.call("Runtime.enable")
        self.call("Network.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method and return its result."""
        number = next(self._ids)
        message = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._waiting.append(answer)

    def _read(self) -> dict[str, Any]:
        text = bytearray()
        while not text.endswith(b"\0"):
            byte = self._in.read(1)
            assert byte, "the browser ended"
            text += byte
        message = json.loads(text[:-1])
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(message["params"]["exceptionDetails"]))
        return message

    def open(self, path: Path, width: int = 1280, height: int = 800) -> None:
        """Open a file, offline, and wait until it is loaded."""
        offline = {"latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
        self.call("Network.emulateNetworkConditions", offline=True, **offline)
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self._waiting.clear()
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not any(m.get("method") == "Page.loadEventFired" for m in self._waiting):
            self._waiting.append(self._read())

    def run(self, script: str) -> Any:
        """Return the value of an expression, of a promise what it becomes."""
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def key(self, key: str) -> None:
        """Press and release a key."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def close(self) -> None:
        """Close the pipe from the browser."""
        self._in.close()

    def picture(self, file: Path) -> None:
        """Write a PNG of what is in view."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        file.write_bytes(base64.b64decode(data))


@contextmanager
def chromium(profile: Path) -> Iterator[Page]:
    """Start a browser with a profile of its own and return its page."""
    browser_reads, we_write = os.pipe()
    we_read, browser_writes = os.pipe()

    def pipes() -> None:  # Chromium reads from 3 and writes to 4
        read = os.dup(browser_reads)
        write = os.dup(browser_writes)
        os.dup2(read, 3)
        os.dup2(write, 4)
        for number in (3, 4):  # which dup2 leaves as they are where they were these already
            os.set_inheritable(number, True)

    process = subprocess.Popen(
        [
            BROWSER,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--remote-debugging-pipe",
            f"--user-data-dir={profile}",
        ],
        preexec_fn=pipes,
        close_fds=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(browser_reads)
    os.close(browser_writes)
    page = Page(we_write, we_read)
    try:
        yield page
    finally:
        process.kill()
        process.wait()
        os.close(we_write)
        page.close()
