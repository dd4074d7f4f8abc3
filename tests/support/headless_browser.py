"""A headless Chromium, driven over its debugging protocol with the websockets package that viser needs."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
_FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars")
_PATIENCE = 120.0  # s


class HeadlessBrowser:
    """A page of a headless Chromium.

    Args:
        url: address of the page.
        width: of the window, pixels.
        height: of the window, pixels.
    """

    def __init__(self, url: str, width: int, height: int) -> None:
        from websockets.sync.client import connect

        assert CHROMIUM is not None
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)  # processes of the browser may still write
        options = [
            *_FLAGS,
            f"--user-data-dir={self._folder.name}",
            f"--window-size={width},{height}",
            "--remote-debugging-port=0",
        ]
        self._process = subprocess.Popen([CHROMIUM, *options, url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = int(self.wait(lambda: _read(Path(self._folder.name) / "DevToolsActivePort").split("\n")[0]))
        targets = self.wait(lambda: _pages(port))
        self._socket = connect(targets[0]["webSocketDebuggerUrl"], max_size=2**26)
        self._id = 0

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol, and return its result."""
        self._id += 1
        self._socket.send(json.dumps({"id": self._id, "method": method, "params": parameters}))
        while True:
            reply = json.loads(self._socket.recv(timeout=_PATIENCE))
            if reply.get("id") == self._id:
                return reply["result"]

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def text(self) -> str:
        """Return the visible text of the page."""
        return str(self.evaluate("document.body.innerText"))

    def click(self, words: str) -> None:
        """Click on the button with these words."""
        find = f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === {json.dumps(words)})"
        self.wait(lambda: self.evaluate(f"!!{find}"))
        self.evaluate(f"{find}.click()")

    def set_number(self, label: str, value: float) -> None:
        """Type a number into the field beside the slider with this label."""
        row = f"[...document.querySelectorAll('label')].find(l => l.innerText.trim() === {json.dumps(label)})"
        find = f"""(() => {{ let e = {row};
            while (e && !e.querySelector("input[inputmode], input[type=text]")) e = e.parentElement;
            return e && e.querySelector("input[inputmode], input[type=text]"); }})()"""
        self.wait(lambda: self.evaluate(f"!!{find}"))
        self.evaluate(f"{find}.focus()")
        self.evaluate(f"{find}.select()")
        self.call("Input.insertText", text=str(value))
        self.evaluate(f"{find}.blur()")

    def image(self) -> np.ndarray:
        """Return a screenshot, (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def number_after(self, words: str) -> float:
        """Return the number that follows words in the page's text."""
        found = re.search(re.escape(words) + r"\s*([-\d.]+)", self.text())
        assert found is not None, self.text()
        return float(found[1])

    @staticmethod
    def wait(condition: Any) -> Any:
        """Return the value of a condition as soon as it is true."""
        end = time.monotonic() + _PATIENCE
        while not (value := condition()):
            assert time.monotonic() < end, "the browser did not answer in time"
            time.sleep(0.1)
        return value

    def close(self) -> None:
        """Close the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait(_PATIENCE)
        self._folder.cleanup()


def _read(path: Path) -> str:
    """Return the text of a file; an empty text without the file."""
    return path.read_text() if path.exists() else ""


def _pages(port: int) -> list[dict[str, Any]]:
    """Return the pages of a browser; none while it starts."""
    from urllib.request import urlopen

    try:
        with urlopen(f"http://127.0.0.1:{port}/json", timeout=5.0) as reply:
            return [page for page in json.load(reply) if page["type"] == "page"]
    except OSError:
        return []
