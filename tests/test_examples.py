"""Each of the examples, run as a user would run it, and what comes of it."""

import ast
import csv
import io
import re
import runpy
import select
import signal
import sys
import threading
from itertools import islice
from pathlib import Path
from subprocess import PIPE, Popen

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import JointState
from take_bags import write_take

from capture_rig.session import load_session
from mocap_pipeline import session_footage
from mocap_pipeline.session_footage import frame_sets
from sagoma_ros.qos import RESULT
from sagoma_tools.graph.ros_link import RosLink
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
PATIENCE_S = 30.0


@pytest.fixture
def result_of(monkeypatch, capsys):
    """``result_of(NAME, *arguments)``: what an example prints; in this process, whose compiled code is loaded."""

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def numbers(printed: str) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Columns (C,), frames (F,) and values (F, C) of a printed table."""
    header, *rows = csv.reader(io.StringIO(printed))
    table = np.array(rows, float)
    return header[1:], table[:, 0].astype(int), table[:, 1:]


def test_tracked_session_has_the_true_elbows_and_knees(three_cameras, result_of):
    names, frames, angles_deg = numbers(result_of("01_track_session.py", three_cameras))
    truth = load_session(three_cameras).truth
    assert truth is not None and truth.angles is not None
    assert tuple(names) == ANGLE_NAMES and len(frames) > 30 and frames[-1] == truth.frames[-1]
    hinges = [column for column, name in enumerate(names) if name.endswith(("elbow", "knee"))]
    off_deg = np.abs(angles_deg - np.degrees(truth.angles[np.searchsorted(truth.frames, frames)]))[:, hinges]
    assert len(hinges) == 4 and np.median(off_deg) < 8.0


def test_the_example_of_the_readme_prints_the_angles_of_each_frame(three_cameras, capsys, monkeypatch):
    monkeypatch.setattr(session_footage, "frame_sets", lambda session: islice(frame_sets(session), 16))
    block = re.search(r"```python\n(from .*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert block is not None
    exec(block[1].replace("my_session", str(three_cameras)), {})
    stamps, angles = zip(*(line.split(" ", 1) for line in capsys.readouterr().out.splitlines()), strict=True)
    assert len(stamps) > 8 and sorted(set(map(int, stamps))) == list(map(int, stamps))
    assert tuple(ast.literal_eval(angles[-1])) == ANGLE_NAMES


def test_own_silhouettes_give_the_true_places_of_the_hands(tmp_path, result_of):
    body, look = Body.from_stature(1.75), RenderSettings(shadow=False)
    session = write_session(tmp_path / "s", ring(3, ceiling=False), body, fps=20.0, seconds=1.6, settings=look)
    _, frames, hands = numbers(result_of("02_own_silhouettes.py", session))
    truth = load_session(session).truth
    assert truth is not None and len(frames) > 20 and frames[-1] == truth.frames[-1]
    true_points = truth.stick_figure_points()[np.searchsorted(truth.frames, frames)]
    expected = true_points[:, [POINT_NAMES.index("left_hand"), POINT_NAMES.index("right_hand")]]
    assert np.linalg.norm(hands.reshape(-1, 2, 3) - expected, axis=2).mean() < 0.03


def test_take_becomes_a_bvh_file_whose_root_walks_as_the_person_did(tmp_path, result_of):
    take = write_take(tmp_path / "walk", frames=40)
    said = result_of("04_take_to_bvh.py", take, tmp_path / "animations")
    path = tmp_path / "animations" / "walk.bvh"
    assert said == f"{path}: 40 frames at 50 Hz, 0 gaps filled\n"
    lines = path.read_text().splitlines()
    motion = lines.index("MOTION")
    assert lines[0] == "HIERARCHY" and lines[motion + 1 : motion + 3] == ["Frames: 40", "Frame Time: 0.020000000"]
    roots_cm = np.array([row.split()[:3] for row in lines[motion + 3 :]], float)
    np.testing.assert_allclose(np.linalg.norm(np.diff(roots_cm, axis=0), axis=1), 1.0, atol=0.02)


def next_line(process, publisher, message):
    """The next line that the example prints, while the message is published: it may not listen yet."""
    while not select.select([process.stdout], [], [], 0.2)[0]:
        publisher.publish(message)
    return process.stdout.readline()


def test_subscriber_prints_torso_and_joint_as_it_hears_them_and_ends_at_ctrl_c():
    pose, joints = PoseWithCovarianceStamped(), JointState(name=list(ANGLE_NAMES))
    place = pose.pose.pose.position
    place.x, place.y, place.z = 1.0, -0.5, 1.1
    joints.position, joints.velocity = np.eye(18)[8] * -0.75, np.eye(18)[8] * 1.25
    command = [sys.executable, str(EXAMPLES / "03_subscribe_pose.py")]
    with RosLink("pose_source") as link, Popen(command, stdout=PIPE, stderr=PIPE, text=True) as process:
        watchdog = threading.Timer(2 * PATIENCE_S, process.kill)  # a hung example ends the reads below
        watchdog.start()
        torso = link.node.create_publisher(PoseWithCovarianceStamped, "/mocap/torso", RESULT)
        assert next_line(process, torso, pose) == "torso at 1.00 -0.50 1.10 m\n"
        states = link.node.create_publisher(JointState, "/mocap/joint_states", RESULT)
        lines = (next_line(process, states, joints) for _ in range(1000))
        assert "left_elbow -0.750 rad, 1.25 rad/s\n" in lines
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert (process.stdout.read().splitlines()[-1], process.stderr.read()) == ("bye", "")
        watchdog.cancel()
