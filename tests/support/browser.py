"""A headless Chromium that tests drive: pages opened, buttons pressed by their words, pictures taken."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import connect

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
WAIT_S = 180.0
FIELD = """
    const words = %s;
    const shown = [...document.querySelectorAll('label')].filter(l => l.getClientRects().length);
    let box = shown.find(l => l.innerText.trim() === words);
    while (box && !box.querySelector('input[type=text], input:not([type])')) box = box.parentElement;
    const field = box.querySelector('input[type=text], input:not([type])');
"""
"""JavaScript: the text field that follows a label."""
LISTENING = re.compile(r"DevTools listening on (ws://\S+)")


@contextmanager
def browser(width: int = 1400, height: int = 900) -> Iterator[Browser]:
    """A browser with one empty tab; the test is skipped where there is none."""
    program = next((found for name in PROGRAMS if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium here: `apt install chromium`")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", f"--user-data-dir={profile}"]
        flags += ["--enable-unsafe-swiftshader", f"--window-size={width},{height}"]
        flags += ["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
        process = subprocess.Popen([program, *flags, "about:blank"], stderr=subprocess.PIPE, text=True)
        try:
            yield Browser(_debugging_address(process), process.pid)
        finally:
            process.terminate()
            process.wait()


def _debugging_address(process: subprocess.Popen[str]) -> str:
    assert process.stderr is not None
    for line in process.stderr:
        if match := LISTENING.search(line):
            return match[1]
    raise AssertionError("the browser ended before it listened")


class Browser:
    """One tab, by the Chrome DevTools protocol."""

    def __init__(self, address: str, pid: int) -> None:
        self.pid = pid
        host = address.split("/")[2]
        with urllib.request.urlopen(f"http://{host}/json/list") as reply:
            tab = next(target for target in json.load(reply) if target["type"] == "page")
        self._socket = connect(tab["webSocketDebuggerUrl"], max_size=None)
        self._numbers = count(1)

    def call(self, method: str, **parameters: Any) -> Any:
        """One command of the protocol, and its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=2 * WAIT_S))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def open(self, url: str) -> None:
        """Go there."""
        self.call("Page.enable")
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """The value of an expression on the page; promises are awaited."""
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, condition: str) -> Any:
        """The value of an expression once it is true, looked at with every frame that the page draws."""
        script = f"""new Promise((resolve, reject) => {{
            const end = performance.now() + {1e3 * WAIT_S};
            const look = () => {{
                const value = {condition};
                if (value) resolve(value);
                else if (performance.now() > end) reject(new Error("still not: " + {json.dumps(condition)}));
                else setTimeout(look, 50);
            }};
            look();
        }})"""
        return self.run(script)

    def wait_for_text(self, text: str) -> None:
        """Until the page says so."""
        self.wait_for(f"document.body && document.body.innerText.includes({json.dumps(text)})")

    def wait_for_no_text(self, text: str) -> None:
        """Until the page does not say so any more."""
        self.wait_for(f"document.body && !document.body.innerText.includes({json.dumps(text)})")

    def wait_for_value(self, label: str, value: str) -> None:
        """Until the text field that follows this label holds this."""
        self.wait_for(f"(() => {{ {FIELD % json.dumps(label)} return field.value === {json.dumps(value)}; }})()")

    def press(self, words: str) -> None:
        """Click with the mouse on the button or tab of these words, once it stands still and nothing covers it."""
        find = f"""(() => {{
            const all = [...document.querySelectorAll('button, [role=tab]')];
            const found = all.find(each => each.innerText.trim() === {json.dumps(words)});
            if (!found) return null;
            found.scrollIntoView({{block: 'center'}});
            const box = found.getBoundingClientRect();
            const place = [box.x + box.width / 2, box.y + box.height / 2], before = window.placeBefore;
            window.placeBefore = `${{place}} {words}`;
            const stands = before === window.placeBefore && found.contains(document.elementFromPoint(...place));
            return stands ? place : null;
        }})()"""
        x, y = self.wait_for(find)
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = "none" if kind == "mouseMoved" else "left"
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1)

    def write(self, label: str, text: str) -> None:
        """Type into the text field that follows this label, in place of what is there."""
        self.run(f"(() => {{ {FIELD % json.dumps(label)} field.focus(); field.select(); }})()")
        self.call("Input.insertText", text=text)
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13)

    def check(self, label: str) -> None:
        """Click on the checkbox that follows this label."""
        script = f"""(() => {{
            const shown = [...document.querySelectorAll('label')].filter(l => l.getClientRects().length);
            let box = shown.find(l => l.innerText.trim() === {json.dumps(label)});
            while (box && !box.querySelector('input[type=checkbox]')) box = box.parentElement;
            if (!box) return false;
            box.querySelector('input[type=checkbox]').click();
            return true;
        }})()"""
        self.wait_for(script)

    def picture(self, path: Path) -> None:
        """What the page looks like, as a PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
