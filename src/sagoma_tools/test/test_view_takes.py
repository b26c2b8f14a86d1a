"""The page's work with takes: what its buttons do, what it says of a take, and how it plays one."""

import io
import time
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import take_bags
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from take_bags import EPOCH_NS, PERIOD_NS
from tools_waiting import until

from capture_rig.errors import InputError
from motion_export.motion import UNTRACKED
from sagoma_ros.messages import key_values
from sagoma_tools.graph.diagnostics_table import LATENCY, STALE_S, DiagnosticsTable, NodeReport
from sagoma_tools.takes.folder import TakesFolder, describe
from sagoma_tools.view.control import ALL_FORMATS, Jobs, export_files
from sagoma_tools.view.graph_panel import states_html
from sagoma_tools.view.page import Page
from sagoma_tools.view.scene import GREEN, RED, PersonPose, confidence_colours
from sagoma_tools.view.server import Guard
from sagoma_tools.view.takes_panel import TakePlayback, about_html, first_pose_ns, last_frame
from stick_figure.skeleton import POINT_NAMES

FRAMES = 50


@pytest.fixture()
def takes(tmp_path, take_at):
    take_at(tmp_path / "takes" / "walk", FRAMES, lost=range(10, 20))
    return TakesFolder(tmp_path / "takes")


def test_an_export_is_written_into_the_take_and_sent_to_who_asked(takes):
    sent = {}
    assert "walk.bvh" in export_files(takes, Jobs(), "walk", "bvh", sent.__setitem__)
    assert sent["walk.bvh"].startswith(b"HIERARCHY")
    export_files(takes, Jobs(), "walk", ALL_FORMATS, sent.__setitem__)
    names = set(zipfile.ZipFile(io.BytesIO(sent["walk_all_formats.zip"])).namelist())
    assert names == {path.name for path in (takes.path / "walk" / "export").iterdir()} and "walk.c3d" in names


def test_one_job_runs_at_a_time_and_a_failure_is_said():
    jobs, begun = Jobs(), []
    assert jobs.request("waiting", lambda: begun.append(1) or str(jobs.cancelled.wait(30.0)))
    assert not jobs.request("second", lambda: "never") and "busy with: waiting" in jobs.said
    jobs.cancelled.set()
    until(lambda: jobs.said == "True")

    def fails():
        raise InputError("no such thing", remedy="Give another.")

    assert jobs.request("failing", fails)
    until(lambda: "no such thing" in jobs.said)


def test_a_take_is_played_by_its_own_seconds_and_stands_still_when_paused(takes):
    playback = TakePlayback.of(takes.find("walk"))
    assert playback.begins_ns == EPOCH_NS and playback.seconds == pytest.approx((FRAMES - 1) * PERIOD_NS / 1e9)
    playback.playing = False
    now_s, figure = time.monotonic(), None
    for seconds, there in ((0.1, True), (0.3, False), (0.5, True)):  # frames 10 to 19 are lost
        playback.jump(seconds)
        figures = playback.figures_at(now_s)
        assert ("b0001" in figures) is there
        assert playback.position_s == seconds
        figure = figures.get("b0001")
    assert figure.points_world[0, 1] == pytest.approx(0.25, abs=0.01)  # 1 cm a frame along y
    assert figure.sigma_m == pytest.approx(take_bags.SIGMA_M)
    playback.playing = True
    playback.jump(0.5)
    now_s = time.monotonic()
    playback.figures_at(now_s)
    playback.figures_at(now_s + 0.2)
    assert playback.position_s == pytest.approx(0.7, abs=0.1)


def test_a_take_begins_at_its_first_pose_holds_it_over_gaps_and_waits_while_nobody_looks(tmp_path, take_at):
    missing = [*range(20), *range(30, 33)]
    playback = TakePlayback.of(describe(take_at(tmp_path / "late", FRAMES, missing=missing)))
    assert last_frame(playback.motions["b0001"], EPOCH_NS + 32 * PERIOD_NS) == 9
    assert playback.seconds == pytest.approx((FRAMES - 1) * PERIOD_NS / 1e9)  # from the first set, with nobody there
    assert playback.position_s == playback.first_pose_s == pytest.approx(20 * PERIOD_NS / 1e9)
    motion = playback.motions["b0001"]
    untracked = replace(motion, states=np.where(np.arange(len(motion)) < 7, UNTRACKED, motion.states))
    assert first_pose_ns(untracked) == EPOCH_NS + 27 * PERIOD_NS
    now_s = time.monotonic() + 1000.0  # the page stood open for long before somebody came
    assert set(playback.figures_at(now_s)) == {"b0001"} and playback.position_s == playback.first_pose_s
    for later_s in (1000.4, 1000.8, 1001.2):  # over the end: from the first pose again
        playback.figures_at(now_s + later_s)
    assert playback.position_s == playback.first_pose_s
    playback.playing = False
    playback.jump(0.64)  # frame 32
    assert set(playback.figures_at(now_s)) == {"b0001"}


def test_the_page_of_a_take_opens_on_its_first_pose_with_the_take_chosen_and_named(takes):
    take_bags.write_take(takes.new_path("newer"), 5)
    page = Page(Guard("127.0.0.1", None), 0, takes)
    try:
        page.show_take(takes.path / "walk")
        page._draw_people(time.monotonic())
        page._draw_panels()
        assert page._take_panel.chosen == "walk"
        assert "walk: its first pose" in page._said.content
        assert set(page._scene._people) == {"b0001"}
    finally:
        page.close()


def test_curves_are_two_a_plot_in_degrees_with_the_signs_that_are_named(takes):
    playback = TakePlayback.of(takes.find("walk"))  # of somebody in the T-pose, who is lost for ten frames
    plots = {title: (times_s, sides) for title, times_s, sides in playback.plots("b0001")}
    assert list(plots) == ["knee flexion", "elbow flexion", "shoulder elevation", "hip flexion"]
    for title, (times_s, sides) in plots.items():
        assert sides.shape == (2, len(times_s)) and np.isfinite(sides).any(1).all()
        expected_deg = 90.0 if title == "shoulder elevation" else 0.0
        assert np.nanmax(np.abs(sides - expected_deg)) < 1e-3, title


def test_what_the_page_says_of_a_take_cannot_be_markup(takes):
    take = takes.find("walk")
    assert "persons" in about_html(take) and "80 %" in about_html(take)
    hostile = takes.path / "<img src=x onerror=alert(1)>"
    hostile.mkdir()
    (hostile / "x.mcap").write_bytes(b"")
    assert "<img" not in about_html(takes.find(hostile.name))


def test_a_silent_camera_is_said_with_since_when_and_what_to_do():
    now_s = time.monotonic()
    running = NodeReport(DiagnosticStatus.OK, "active", {"rate_hz": "30.0", "frames_lost": "3"}, now_s)
    warned = NodeReport(DiagnosticStatus.WARN, "<b>the lens</b> is foggy", {}, now_s)
    gone = NodeReport(DiagnosticStatus.OK, "active", {}, now_s - STALE_S - 5.0)
    reports = {"/cam01/camera_client": running, "/cam02/camera_client": warned, "/cam03/camera_client": gone}
    said = states_html({**reports, "/hull_server": None}, now_s)
    assert said.index("hull_server") < said.index("cam03") < said.index("cam01")
    assert "no word since" in said and "(8 s)" in said and "start it again" in said
    assert "30.0 Hz" in said and "3 frames lost" in said and "&lt;b&gt;the lens" in said and "not been heard" in said
    assert "sagoma up" in states_html({}, now_s)


@pytest.mark.parametrize(("of_camera", "shown"), [({LATENCY: "9.00"}, True), ({}, False)], ids=["live", "slow footage"])
def test_results_have_an_age_where_the_stamps_of_the_cameras_are_the_time_of_exposure(of_camera, shown):
    hear = []
    table = DiagnosticsTable(SimpleNamespace(create_subscription=lambda *about: hear.append(about[2])))
    for name, values in (("/cam01/camera_client", of_camera), ("/ekf_tracker", {LATENCY: "13261.76"})):
        status = DiagnosticStatus(name=name, values=key_values({"rate_hz": "30.0"} | values))
        hear[0](DiagnosticArray(status=[status]), {"received_timestamp": 0})
    said = states_html({"/ekf_tracker": table.report("/ekf_tracker")}, time.monotonic())
    assert "30.0 Hz" in said and ("13261.76 ms old" in said) == shown


def test_sure_points_are_green_unsure_ones_red_and_all_of_somebody_lost():
    sigma = np.full(15, 0.01)
    sigma[POINT_NAMES.index("left_hand")] = 0.3
    colours = confidence_colours(PersonPose(np.zeros((15, 3)), sigma, "tracking"))
    assert (colours[POINT_NAMES.index("left_hand")] == RED).all() and (colours[0] == GREEN).all()
    assert (confidence_colours(PersonPose(np.zeros((15, 3)), sigma, "lost")) == RED).all()
