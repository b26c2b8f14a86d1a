"""``sagoma background`` on camera clients that behave as they are told, and on backgrounds that were saved."""

import io
import json
import threading

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from footage_clips import write_clip
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.task import Future
from rich.console import Console
from std_srvs.srv import Trigger

from camera_client.background.model import BackgroundLearner, load_background
from camera_client.background.training import KEY, TrainingReport
from capture_rig.verdict import GOOD, REDO, USABLE, Finding
from sagoma_tools.cli import main
from sagoma_tools.commands.background import count_down
from sagoma_tools.graph.ros_link import RosLink

MOVED = Finding(REDO, "something moved: lower left", "clear the scene")
NOISE = Finding(USABLE, "the noise is high", "lower the gain", "noise.high")
OUTCOMES = {GOOD: (), USABLE: (NOISE,), REDO: (MOVED, NOISE)}
PERIOD_S = 0.1


class Pretender:
    """A camera client that answers ~/learn_background with one verdict after the other, and tells its diagnostics."""

    def __init__(self, node, camera, verdicts):
        self.name, self.camera, self.verdicts, self.asked = f"/{camera}/camera_client", camera, list(verdicts), 0
        self.values = {}
        self.publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 20)
        node.create_timer(PERIOD_S, self.tell)
        alone = MutuallyExclusiveCallbackGroup()
        node.create_service(Trigger, f"{self.name}/learn_background", self.learn, callback_group=alone)

    def tell(self):
        values = [KeyValue(key=key, value=value) for key, value in self.values.items()]
        status = DiagnosticStatus(name=self.name, message="active", values=values)
        self.publisher.publish(DiagnosticArray(status=[status]))

    async def learn(self, request, response):
        self.asked += 1
        grade, _, lost = self.verdicts.pop(0).partition(" ")
        if grade == "away":
            response.message = "no frames are coming: the camera is off"
            return response
        if grade == "silent":
            await Future()
        text = f"{grade}; lesson {self.asked} of {self.camera}"
        report = TrainingReport(self.asked, grade, OUTCOMES[grade], 100, 1.5, 0.0, f"{self.camera}.npz", text)
        self.values[KEY] = report.to_json()
        if grade != REDO:
            self.values["background"] = text
        response.success, response.message = grade != REDO, text
        if lost:
            await Future()
        return response


@pytest.fixture
def clients():
    """``clients(cam01=[GOOD], ...)``: clients of these cameras and their verdicts, in a graph of their own."""
    links = []

    def make(**verdicts):
        links.append(RosLink("pretenders"))
        return {camera: Pretender(links[-1].node, camera, listed) for camera, listed in verdicts.items()}

    yield make
    for link in links:
        link.close()


def learn(capsys, clients, *arguments):
    """Exit status, what was printed, and the figures."""
    expect = ["--expect", str(len(clients)), "--wait", "30"]
    status = main(["background", *expect, "--countdown", "0", "--timeout", "20", "--json", *arguments])
    said = capsys.readouterr().out
    lines = [line for line in said.splitlines() if line.startswith("{")]
    return status, said, json.loads(lines[-1]) if lines else {}


def test_every_camera_that_is_found_learns_and_the_worst_verdict_is_the_status(clients, capsys):
    status, said, result = learn(capsys, clients(cam01=[GOOD], cam02=[USABLE]))
    assert status == 1 and "learning: cam01, cam02" in said
    assert {camera: (r["grade"], r["frames"], r["saved"]) for camera, r in result.items()} == {
        "cam01": (GOOD, 100, "cam01.npz"),
        "cam02": (USABLE, 100, "cam02.npz"),
    }
    assert "the noise is high" in said and "lower the gain" in said
    assert result["cam02"]["findings"] == [
        {"grade": USABLE, "what": NOISE.what, "remedy": NOISE.remedy, "code": "noise.high"}
    ]


def test_camera_without_frames_or_answer_is_named_and_the_others_keep_what_they_learned(clients, capsys, monkeypatch):
    monkeypatch.setattr("sagoma_tools.graph.background_training.ANSWER_S", 1e6)  # no report of cam02 is awaited
    made = clients(cam01=[GOOD], cam02=["away"], cam03=["silent"], cam04=[f"{USABLE} lost"])
    status, said, result = learn(capsys, made, "--timeout", "1.5")
    assert (status, result["cam01"]["grade"]) == (2, GOOD)
    assert "no frames are coming: the camera is off" in said
    assert result["cam03"] == {"said": "did not answer", "grade": REDO}
    assert result["cam04"]["findings"][0]["what"] == NOISE.what  # known from its diagnostics


def test_subset_leaves_the_others_alone_and_a_stranger_is_an_error(clients, capsys):
    made = clients(cam01=[GOOD], cam02=[GOOD])
    assert learn(capsys, made, "--cameras", "cam02")[0] == 0
    assert (made["cam01"].asked, made["cam02"].asked) == (0, 1)
    assert main(["background", "--expect", "2", "--wait", "30", "--countdown", "0", "--cameras", "cam07"]) == 2
    assert "no client of cam07 is there. There are: cam01, cam02." in capsys.readouterr().err


def test_repeat_asks_only_those_that_need_it_and_those_that_must_be_redone_are_named(clients, capsys):
    made = clients(cam01=[GOOD], cam02=[REDO, GOOD])
    status, said, _ = learn(capsys, made)
    assert status == 2 and "something moved" in said and "clear the scene" in said
    status, said, result = learn(capsys, made, "--repeat")
    assert status == 0 and "learning: cam02\n" in said and result["cam02"]["number"] == 2
    status, said, _ = learn(capsys, made, "--repeat")
    assert status == 0 and "every background is fine" in said
    assert (made["cam01"].asked, made["cam02"].asked) == (1, 2)


def test_countdown_in_a_log_says_the_last_seconds_and_stops_when_told():
    log, stop = io.StringIO(), threading.Event()
    stop.set()
    assert not count_down(Console(file=log), 10, stop)
    assert log.getvalue() == "leave the room: 10 s\n"
    assert count_down(Console(file=log), 0, stop)


def noise(grey, sigma, seed):
    rng = np.random.default_rng(seed)
    return [np.clip(np.rint(rng.normal(grey, sigma, (60, 80))), 0, 255).astype(np.uint8) for _ in range(40)]


@pytest.fixture
def saved(tmp_path):
    """A saved background: noise of 2 grey levels, and a lamp that blinked in columns 50..59 of rows 10..19."""
    learner = BackgroundLearner()
    for k, image in enumerate(noise(100, 2, seed=0)):
        image[10:20, 50:60] = 250 * (k % 2)
        learner.add(image)
    about = {"camera_serial": "S1", "exposure_us": "5000", "gain": "0", "verdict": "usable: a lamp blinks"}
    learner.model("camera 10.0.0.1", created="2026-03-01T08:00:00+00:00", **about).save(tmp_path / "cam01.npz")
    return tmp_path / "cam01.npz"


def test_show_draws_a_background_and_says_its_origin_and_what_speaks_against_it_or_has_changed(saved, tmp_path, capsys):
    assert main(["background", "show", str(saved), "--output", str(tmp_path / "pictures")]) == 0
    said = capsys.readouterr().out
    about = ("camera 10.0.0.1", "S1", "5000", "2026-03-01T08:00:00", "usable: a lamp blinks", "80 x 60 mono")
    assert all(text in said for text in about)
    assert "redo: something moved: upper right at 50..59, 10..19" in said and "clear the scene" in said
    mean = cv2.imread(str(tmp_path / "pictures" / "cam01_mean.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(mean, np.rint(load_background(saved).mean).astype(np.uint8))
    sigma = cv2.imread(str(tmp_path / "pictures" / "cam01_sigma.png"))
    assert sigma.shape == (60, 80, 3) and sigma[12:18, 52:58].mean() > 1.5 * sigma[40:, :40].mean()
    assert sigma[10, 50].tolist() == [0, 0, 255]
    assert main(["background", "show", str(saved), "--output", str(saved)]) == 2
    assert "cannot be made (File exists)" in capsys.readouterr().err
    learner = BackgroundLearner()
    for image in noise(112, 5, seed=1):
        image[20:50, 20:32] = 190
        learner.add(image)
    learner.model("later").save(tmp_path / "later.npz")
    assert main(["background", "show", str(tmp_path / "later.npz"), "--against", str(saved)]) == 0
    said = capsys.readouterr().out
    assert "usable: something else than in the background of 2026-03-01T08:00:00+00:00: left at 20..3" in said


def test_footage_with_people_gives_a_background_and_says_where_it_is_uncertain(tmp_path, capsys):
    rng, pictures = np.random.default_rng(0), []
    for k in range(40):
        picture = np.full((120, 160), 120, np.uint8)
        picture[60:, 3 * k : 3 * k + 16] = 20  # somebody crosses
        if k % 5 < 2:
            picture[:48, 96:144] = 240  # somebody lingers
        pictures.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8))
    video = write_clip(tmp_path / "cam01.mp4", pictures, 10.0)
    assert main(["background", "--from-footage", str(video)]) == 1  # an eighth of the picture is uncertain
    said = capsys.readouterr().out
    model = load_background(tmp_path / "cam01_background.npz")
    assert model.shape[:2] == (120, 160) and abs(float(np.median(model.mean)) - 120) < 4
    assert model.sigma[10:40, 104:136].mean() > 20 > 5 > model.sigma[70:110].mean()
    assert "uncertain" in said and "rows 0 to" in said
