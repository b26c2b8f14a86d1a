"""The live page in a real browser: what the graph does is shown, its buttons drive it, a take is recorded and kept."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest
from command_line import command
from take_bags import write_take
from websockets.sync.client import connect

from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.recording.recorded_motion import recorded_motions
from sagoma_tools.takes.folder import TakesFolder
from sagoma_tools.takes.measure import finish_take

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
WAIT_S = 180.0
FIELD, CHECKBOX = "input[type=text], input:not([type])", "input[type=checkbox]"
LISTENING = re.compile(r"DevTools listening on (ws://\S+)")


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with one empty tab; the test is skipped where there is none."""
    program = next((found for name in PROGRAMS if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium here: `apt install chromium`")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", f"--user-data-dir={profile}"]
        flags += ["--enable-unsafe-swiftshader", "--window-size=1280,860"]
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


def beside(label: str, kind: str) -> str:
    """JavaScript: the input of a kind that follows a label; undefined where there is none."""
    return f"""(() => {{
        const shown = [...document.querySelectorAll('label')].filter(l => l.getClientRects().length);
        let box = shown.find(l => l.innerText.trim() === {json.dumps(label)});
        while (box && !box.querySelector('{kind}')) box = box.parentElement;
        return box?.querySelector('{kind}');
    }})()"""


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
        self.wait_for(f"document.body && document.body.innerText.includes({json.dumps(text)})")

    def wait_for_value(self, label: str, value: str) -> None:
        """Until the text field that follows this label holds this."""
        self.wait_for(f"{beside(label, FIELD)}?.value === {json.dumps(value)}")

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
        self.run(f"(field => {{ field.focus(); field.select(); }})({beside(label, FIELD)})")
        self.call("Input.insertText", text=text)
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13)

    def check(self, label: str) -> None:
        """Click on the checkbox that follows this label."""
        self.wait_for(f"!!{beside(label, CHECKBOX)}")
        self.run(f"{beside(label, CHECKBOX)}.click()")


PATIENCE_S = 960.0
VIEW = "window.__viserMutable.camera.position.toArray()"
"""JavaScript: where the view stands, m."""
PERSON = """(() => {
    let joints;
    const {scene, camera} = window.__viserMutable;
    scene?.traverse(node => { if (node.geometry?.attributes.position?.count === 15) joints = node; });
    if (!joints) return {fills: false, y: NaN};
    const place = joints.geometry.attributes.position, shown = [...Array(15).keys()].map(k =>
        camera.position.clone().fromBufferAttribute(place, k).applyMatrix4(joints.matrixWorld).project(camera));
    const heights = shown.map(each => each.y);
    const seen = shown.every(each => Math.max(Math.abs(each.x), Math.abs(each.y), Math.abs(each.z)) < 1);
    return {fills: seen && Math.max(...heights) - Math.min(...heights) > 0.7, y: place.getY(0)};
})()"""
"""JavaScript: y of the person's first joint, m, and whether all joints are on the screen, over a third of it."""


@contextmanager
def served(*arguments: object) -> Iterator[str]:
    """Run a command, and yield its page's address once it has said that."""
    process = subprocess.Popen(command(*arguments, "--port", "0"), stdout=PIPE, stderr=subprocess.STDOUT, text=True)
    watchdog = threading.Timer(PATIENCE_S, process.kill)
    watchdog.start()
    assert process.stdout is not None
    said = ""
    try:
        for line in process.stdout:
            said += line
            if match := re.search(r"the page: (http\S+)", line):
                threading.Thread(target=process.stdout.read, daemon=True).start()
                yield match[1]
                break
        else:
            pytest.fail(said)
    finally:
        watchdog.cancel()
        process.terminate()
        process.wait(PATIENCE_S)


@pytest.mark.slow
def test_a_take_is_played_and_kept_by_buttons(tmp_path):
    takes = tmp_path / "takes"
    finish_take(write_take(takes / "drill", 100))
    with browser() as tab, served("view", takes / "drill") as address:
        tab.open(address)
        tab.wait_for_text("drill: its first pose, at 0.00 s")
        tab.wait_for_text("sets/s")
        tab.wait_for_value("take", "drill")
        tab.wait_for(f"({PERSON}).fills")  # from the first pose on
        begun = tab.run(VIEW)
        tab.press("play")
        assert tab.wait_for(f"({PERSON}).y > 0.8 && {VIEW}") == begun  # the view is left alone while the take plays
        tab.press("pause")
        tab.wait_for_text("paused at")
        keep(tab, takes)


@pytest.mark.slow
def test_the_graph_is_run_and_a_take_recorded_by_buttons(built_in_session, tmp_path):
    """Suspend, start, reset; look at the hull and at every camera's picture; record."""
    takes = tmp_path / "takes"
    graph = ["up", built_in_session, "--loop", "--rate", "0.2", "--run-folder", tmp_path / "run", "--view"]
    with browser() as tab, served(*graph, "--takes", takes) as address:
        tab.open(address)
        tab.wait_for_text("tracking")
        tab.press("suspend")
        tab.wait_for_text("nodes are inactive")
        tab.press("start")
        tab.wait_for_text("nodes are active")
        tab.press("reset")
        tab.wait_for_text("icp_tracker: looking for the first pose again")
        tab.check("hull voxels")
        tab.press("Cameras")
        tab.check("pictures")
        tab.wait_for("document.querySelectorAll('img[src^=\"blob:\"]').length === 5")
        tab.check("pictures")
        tab.press("Live")
        tab.check("hull voxels")
        record(tab, takes)


def record(tab: Browser, takes: Path) -> None:
    """Record a take until somebody is tracked in it."""
    tab.write("name of the take", "drill")
    tab.press("record")
    tab.wait_for_text("recording drill")
    tab.wait_for_text("tracking: ")
    tab.press("finish recording")
    tab.wait_for_text("recorded drill")
    assert "/mocap/joint_states" in bag_topics(takes / "drill")
    assert any(True for _ in read_messages(takes / "drill", "/mocap/reference_points".__eq__))
    assert "b0001" in recorded_motions(takes / "drill")
    tab.press("Takes")
    tab.wait_for_text("back to live")
    tab.press("play")
    tab.wait_for_text("playing drill")
    tab.press("back to live")
    kept = TakesFolder(takes).find("drill")
    assert kept.summary is not None and "b0001" in kept.summary.persons and (kept.path / "rig.yaml").is_file()


def keep(tab: Browser, takes: Path) -> None:
    """Play it, go along it by the slider, rename, trim, export, delete and bring back."""
    folder = TakesFolder(takes)
    tab.press("play")
    tab.wait_for_text("playing drill")
    tab.wait_for_text("shoulder elevation")
    tab.press("pause")
    tab.wait_for_text("paused at")  # the slider stands still
    tab.write("second", "0.1")
    tab.wait_for_value("second", "0.1")
    tab.press("play")
    tab.write("new name", "part")
    tab.press("trim")
    tab.wait_for_text("made part")
    assert folder.find("part").trimmed_from["take"] == "drill"
    tab.press("export")
    tab.wait_for_text("exported ")
    (exported,) = takes.glob("*/export/*.bvh")
    assert exported.read_bytes().startswith(b"HIERARCHY")
    tab.write("new name", "../out")
    tab.press("rename")
    tab.wait_for_text("is no name for a take")
    tab.write("new name", "kept")
    tab.press("rename")
    tab.wait_for_text(" is now kept")
    left = {take.name for take in folder.takes()}
    assert "kept" in left and len(left) == 2 and not (takes.parent / "out").exists()
    tab.press("delete")
    tab.wait_for_text("is in the bin")
    assert len(folder.takes()) == 1 and len(folder.deleted()) == 1
    tab.press("restore")
    tab.wait_for_text(" is back")
    assert {take.name for take in folder.takes()} == left
