"""The live page in a real browser: a running graph is driven by its buttons, a take recorded and played."""

import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from browser import browser

from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.recording.recorded_motion import recorded_motions

PATIENCE_S = 240.0
PICTURES = Path("output/live_page")


@pytest.fixture()
def page(built_in_session: Path, tmp_path: Path):
    """The address of the page of a graph that plays the session over and over."""
    command = [sys.executable, "-m", "sagoma_tools.cli", "up", str(built_in_session), "--loop", "--rate", "0.5"]
    command += ["--view", "--port", "0", "--takes", str(tmp_path / "takes"), "--run-folder", str(tmp_path / "run")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    watchdog = threading.Timer(2 * PATIENCE_S, process.kill)
    watchdog.start()
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        if match := re.search(r"the page: (http\S+)", line):
            threading.Thread(target=process.stdout.read, daemon=True).start()
            yield match[1]
            break
    else:
        pytest.fail(said)
    watchdog.cancel()
    process.terminate()
    process.wait(PATIENCE_S)


@pytest.mark.slow
def test_the_graph_is_run_and_a_take_recorded_by_buttons(page, tmp_path):
    PICTURES.mkdir(parents=True, exist_ok=True)
    with browser(1000, 800) as tab:
        tab.open(page)
        tab.wait_for_text("ekf_tracker")
        tab.wait_for_text(": tracking")
        tab.picture(PICTURES / "live.png")

        tab.press("suspend")
        tab.wait_for_text("nodes are inactive")
        tab.press("start")
        tab.wait_for_text("nodes are active")
        tab.press("reset")
        tab.wait_for_text("icp_tracker: looking for the first pose again")

        tab.write("name of the take", "drill")
        tab.press("record")
        tab.wait_for_text("recording drill")
        recorded = tmp_path / "takes" / "drill"
        tab.wait_for_text(": tracking")
        tab.press("finish recording")
        tab.wait_for_text("recorded drill")
        assert "/mocap/joint_states" in bag_topics(recorded)
        assert any(True for _ in read_messages(recorded, "/mocap/reference_points".__eq__))
        assert "b0001" in recorded_motions(recorded)

        tab.press("Takes")
        tab.wait_for_text("back to live")
        tab.press("play")
        tab.wait_for_text("% tracked")
        tab.picture(PICTURES / "take.png")
        tab.press("back to live")
