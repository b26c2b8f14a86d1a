"""The whole graph on simulated GigE cameras in slow motion: Aravis, backgrounds learned live, tracking, and a bag with
its clock."""

from pathlib import Path

import pytest

from capture_rig.errors import InputError
from sagoma_tools.evaluation.live_inputs import StudioProcess
from sagoma_tools.evaluation.live_run import LiveRun, evaluate_run, run_studio
from sagoma_tools.evaluation.track import clock_of_bag
from sagoma_tools.graph.topics import LATENCY_TOPIC
from sagoma_tools.recording.reader import read_messages

CAMERA_FPS, SPEED, BACKGROUND_FRAMES = 10.0, 0.5, 10
QUICK = {"cameras.background_frames": BACKGROUND_FRAMES}


@pytest.fixture(scope="module")
def live(three_cameras: Path, tmp_path_factory: pytest.TempPathFactory) -> LiveRun:
    folder = tmp_path_factory.mktemp("studio_graph")
    return run_studio(three_cameras, folder, CAMERA_FPS, SPEED, settings=QUICK)


def test_every_client_learned_its_background_and_accounts_for_every_frame(live):
    clients = [values for name, values in live.diagnostics.items() if name.endswith("/camera_client")]
    assert len(clients) == 3
    for said in clients:
        assert f"{BACKGROUND_FRAMES} frames" in said["background"]
        values = {key: int(said[key]) for key in ("expected", "delivered", "incomplete", "lost")}
        assert values["expected"] == values["delivered"] + values["incomplete"] + values["lost"]
        assert values["delivered"] > BACKGROUND_FRAMES


def test_cameras_that_run_free_expose_in_step_and_every_set_is_answered_however_busy_the_machine(live):
    assert live.answered == live.sets and live.is_whole and live.speed == SPEED
    assert live.sets >= 0.9 * live.clock.frames / live.session.fps * CAMERA_FPS


def test_the_body_seen_by_simulated_cameras_follows_the_truth(live):
    scores = evaluate_run(live).scores
    assert len(live.track.frames) >= 10
    assert scores.mean_mm < 100.0


def test_the_bag_knows_when_the_session_was_played(live):
    assert clock_of_bag(live.bag, live.session) == live.clock
    stamps = [message.stamp_ns for message in read_messages(live.bag, LATENCY_TOPIC.__eq__)]
    assert any(stamp in live.clock for stamp in stamps) and min(stamps) < live.clock.epoch_ns


def test_studio_that_cannot_start_says_why(tmp_path):
    studio = StudioProcess(tmp_path / "studio", "--session", str(tmp_path / "nothing"))
    with pytest.raises(InputError, match=r"the studio did not start .*nothing"):
        studio.start()
