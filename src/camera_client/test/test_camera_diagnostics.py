"""What a camera client says of itself: the gravest trouble first, and figures that add up."""

from types import SimpleNamespace

import numpy as np
import pytest

from camera_client.diagnostics import CameraState, Level, RecentStatistics, assess, frame_values, source_values
from camera_client.frame_processor import FrameResult
from camera_client.frame_source import Connection, ConnectionState, Downtime, Frame, FrameStatistics
from camera_client.sources.frame_checks import REMEDIES
from camera_client.sources.grab_loop import GrabState
from capture_rig.verdict import GOOD, USABLE, Finding
from mocap_packets.silhouette import Silhouette

STREAMING = Connection(ConnectionState.STREAMING)
OLD = Finding(USABLE, "the background is 14 h old", "learn again", "background.old")
FLICKERS = Finding(GOOD, "the light flickers by 1.5 %", "it is followed", "light.flicker")
RUNNING = {"grab": GrabState.RUNNING, "connection": STREAMING}
LOSSES = {"recent": FrameStatistics(9, 1, 8), "has_background": False}


def seen(*flags, mask=()):
    silhouette = Silhouette(np.zeros((2, 2), np.uint8), np.zeros((2, 2), np.uint8), 0.25, mask, 0.125)
    return {"result": FrameResult(None, flags, silhouette)}


EVERYTHING = {**seen("dark", mask=("full",)), **LOSSES}


def linked(state, reason="", **more):
    return {"connection": Connection(ConnectionState[state], reason, **more)}


@pytest.mark.parametrize(
    "state, level, text",
    [
        ({}, Level.OK, "active"),
        ({"grab": GrabState.WAITING}, Level.OK, "waiting for a consumer"),
        ({"grab": GrabState.ENDED, "frames": 7}, Level.OK, "end of footage after 7 frames"),
        ({"grab": GrabState.FAILED, "failure": "file: gone."}, Level.ERROR, "file: gone."),
        (linked("CONNECTING"), Level.ERROR, "no camera: not connected yet (connecting)"),
        (
            linked("WAITING", "off", next_try_s=1.5, down_s=9.6),
            Level.ERROR,
            "no camera: off (next attempt in 1.5 s, nothing for 10 s)",
        ),
        (
            linked("WAITING", "lacks Mono12", refused=True, next_try_s=2.0),
            Level.ERROR,
            "the camera cannot be used as it is set: lacks Mono12",
        ),
        (linked("STALLED", "nothing came for 0.5 s"), Level.ERROR, "stalled: nothing came for 0.5 s"),
        (linked("CONTROL_LOST", "taken"), Level.ERROR, "control lost: taken; connecting anew"),
        (seen("frozen"), Level.WARN, f"frozen: {REMEDIES['frozen']}"),
        ({"recent": FrameStatistics(100, 97, 1, 2)}, Level.WARN, "3 of the last 100 frames were lost or incomplete"),
        ({"recent": FrameStatistics(9, 8, 1), "connection": None}, Level.OK, "active"),  # footage has no network
        ({"has_background": False}, Level.WARN, "no background: run sagoma background"),
        ({"calibrated": False}, Level.WARN, "uncalibrated: no silhouettes; run sagoma calibrate"),
        ({"placed": False}, Level.WARN, "the camera's place is unknown"),
        ({"findings": (OLD, FLICKERS)}, Level.WARN, "the background is 14 h old: learn again"),
        ({"findings": (FLICKERS,)}, Level.OK, "active"),
        ({"has_background": False, "refused": OLD}, Level.WARN, "the background is 14 h old: learn again"),
        (seen(mask=("empty",)), Level.WARN, "the mask is empty"),
        # the gravest trouble is told alone
        ({**EVERYTHING, **linked("WAITING", "off")}, Level.ERROR, "no camera: off"),
        (EVERYTHING, Level.WARN, "dark: "),
        ({"has_background": False, "findings": (OLD,)}, Level.WARN, "no background"),
    ],
)
def test_level_and_text_follow_the_state(state, level, text):
    got = assess(CameraState(**{**RUNNING, **state}))
    assert got[0] is level and got[1].startswith(text)


def test_recent_losses_are_forgotten_after_the_window():
    recent, total = RecentStatistics(window_s=3.0), FrameStatistics()
    lost = []
    for second in range(10):
        for k in range(10):
            if not (second == 2 and k in (3, 4)):
                total.add(second * 10 + k)
        lost.append(recent.update(float(second), total).lost)
    assert lost == [0, 0, 2, 2, 2, 0, 0, 0, 0, 0]
    window = recent.update(9.5, total)
    assert window.expected == window.delivered + window.incomplete + window.lost


def source(connection=None):
    statistics = FrameStatistics(10, 7, 1, 2, 3)
    return SimpleNamespace(
        connection=connection, statistics=statistics, counters={"stalls": 4}, details={"camera_serial": "S"}
    )


def test_figures_of_a_live_source_are_there_before_anything_happened():
    values = source_values(source(Connection(ConnectionState.STREAMING, downtime_s=1.234, last_outage_s=1.2346)))
    assert values["expected"] == values["delivered"] + values["incomplete"] + values["lost"] == 10
    assert (values["repeated"], values["stalls"], values["reconnects"], values["downtime_s"]) == (3, 4, 0, 1.23)
    assert (values["camera_serial"], values["link"], values["last_outage_s"]) == ("S", "streaming", 1.235)


def test_figures_of_footage_tell_nothing_of_a_connection():
    assert not {"reconnects", "link", "downtime_s"} & set(source_values(source()))


def test_stamp_source_and_its_uncertainty_are_told_with_the_newest_silhouette():
    frame = Frame(np.zeros((2, 2), np.uint8), 5, 1, "ptp", uncertainty_ns=1500)
    values = frame_values(frame, **seen())
    assert values == {
        "stamp_source": "ptp",
        "stamp_uncertainty_us": 1.5,
        "mask_fraction": 0.25,
        "candidate_fraction": 0.125,
    }


def test_downtime_adds_up_outages_and_counts_the_present_one():
    downtime = Downtime()
    downtime.begin(since_s=10.0)
    downtime.begin(since_s=11.0)  # goes on
    assert downtime.present_s(12.0) == 2.0
    downtime.end(13.0, delivered=True)
    assert downtime.last_outage_s == 3.0
    downtime.begin(20.0)
    assert downtime.sum_s(21.0) == 4.0
    downtime.end(22.0, delivered=False)  # suspended: nobody waits any more
    assert downtime.sum_s(99.0) == 5.0 and downtime.last_outage_s == 3.0
