"""Capture stamps and synchronisation against simulated cameras, whose pictures carry the instant of mid-exposure."""

import threading
from itertools import pairwise

import numpy as np
import pytest
from camera_pictures import frames_of, taken

from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource
from capture_rig.errors import InputError
from capture_rig.stamps import CaptureClock
from virtual_studio.gige import EventLoop, PatternScene, TriggerWire

MS = 1_000_000
RATE = 50.0
PERIOD_NS = 20 * MS
SETTLE_S = 0.1  # of the cameras' PTP
COUNT = 15  # frames of each camera that are compared


def source_of(camera, **settings):
    return AravisSource(AravisSettings(address=camera.address, frame_rate=RATE, **settings))


def errors_ns(frames):
    """Stamp minus the instant of mid-exposure that the picture shows."""
    return np.array([frame.stamp_ns - PatternScene.read(frame.image)[1] for frame in frames])


# --- stamps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exposure_us", [500.0, 15000.0])
def test_camera_clock_gives_mid_exposure_within_its_own_uncertainty(gige_camera, exposure_us):
    camera = gige_camera(drift_ppm=50, nominal_exposure_us=500)
    frames = taken(source_of(camera, stamp_source="camera", exposure_us=exposure_us))
    assert all("camera" in frame.clock for frame in frames)
    uncertainty_ns = np.array([frame.uncertainty_ns for frame in frames])
    assert (np.abs(errors_ns(frames)) <= uncertainty_ns + 0.1 * MS).all()  # and the drift since the start
    assert np.median(np.abs(errors_ns(frames))) < 1 * MS


def test_ptp_gives_mid_exposure_in_utc(gige_camera):
    frames = taken(source_of(gige_camera(ptp_offset_ns=80, ptp_settle_s=SETTLE_S), stamp_source="ptp"))
    assert {frame.clock for frame in frames} == {"PTP"}
    assert np.abs(errors_ns(frames)).max() <= 80  # the camera's own offset from the master
    assert all(0 < frame.uncertainty_ns < 100 * MS for frame in frames)


@pytest.mark.parametrize("stamp_source", ["camera", "ptp"])
def test_slow_camera_is_stamped_by_its_own_clock_at_its_full_rate(gige_camera, stamp_source):
    speed, clock = 0.5, CaptureClock(0.5)
    loop = EventLoop("slow", clock)
    loop.start()
    camera = gige_camera(loop=loop, ptp_settle_s=SETTLE_S)
    try:
        began_ns = clock.now_ns()
        frames = taken(source_of(camera, stamp_source=stamp_source, clock_speed=speed))
        assert began_ns < frames[0].stamp_ns < frames[-1].stamp_ns < clock.now_ns()
        assert np.median(np.diff([frame.stamp_ns for frame in frames])) == pytest.approx(PERIOD_NS, abs=MS)
        assert np.median(np.abs(errors_ns(frames))) < 1 * MS
    finally:
        camera.close()
        loop.stop()


@pytest.mark.parametrize("stamp_source, jump_ms", [("camera", -300), ("ptp", 3000)])
def test_clock_that_jumps_is_noticed_and_stamps_stay_true(gige_camera, stamp_source, jump_ms):
    camera = gige_camera(ptp_settle_s=SETTLE_S)
    with source_of(camera, stamp_source=stamp_source) as source:
        source.start()
        frames = frames_of(source, 20)  # its counter has to be further than the jump back
        camera.faults.stamp_jump_ns = jump_ms * MS
        sent = camera.counters["frames_sent"]
        frames += frames_of(source, 15)
    after = [frame for frame in frames if frame.frame_id > sent + 2]
    assert source.counters["stamp_jumps"] == 1
    claimed_ns = np.array([frame.uncertainty_ns for frame in after])  # a busy machine hears late of the jump
    assert np.median(np.abs(errors_ns(after)) - claimed_ns) < 2 * MS
    assert {"camera" in frame.clock for frame in after} == {True}
    assert all(b.stamp_ns > a.stamp_ns for a, b in pairwise(frames))


# --- synchronisation ---------------------------------------------------------------------------------------------


def instants_of(sources):
    """True instants of mid-exposure, (cameras, frames), ns, of the frames that all cameras have taken."""
    seen = [{} for _ in sources]

    def collect(source, instants):
        for frame in frames_of(source, COUNT):
            instant_ns = PatternScene.read(frame.image)[1]
            instants[round(instant_ns / PERIOD_NS)] = instant_ns

    threads = [threading.Thread(target=collect, args=pair) for pair in zip(sources, seen, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    common = set.intersection(*(set(instants) for instants in seen))
    assert len(common) >= COUNT // 3, [len(instants) for instants in seen]
    return np.array([[instants[number] for number in sorted(common)] for instants in seen])


@pytest.fixture
def three_cameras(gige_camera):
    """Three cameras with clocks of their own, which were switched on one after the other, and their trigger wire."""
    loop = EventLoop()
    wire = TriggerWire(loop)
    loop.start()
    made = {"loop": loop, "wire": wire, "nominal_exposure_us": 1000, "ptp_settle_s": SETTLE_S}
    cameras = [gige_camera(seed=seed, drift_ppm=10.0 * seed, **made) for seed in (1, 2, 3)]
    yield cameras, wire
    for camera in cameras:
        camera.close()
    loop.stop()


def run_in(mode, cameras, **settings):
    sources = [source_of(camera, sync=mode, exposure_us=1000.0, **settings) for camera in cameras]
    try:
        for source in sources:
            source.connect()
        for source in sources:
            source.start()
        return sources, instants_of(sources)
    finally:
        for source in sources:
            source.close()


def assert_begin_at_multiples_of_ptp_time(instants_ns):
    assert np.ptp(instants_ns, axis=0).max() < 1000  # the cameras' offsets from the master: 80 ns at most, twice
    begins_ns = instants_ns - MS // 2 + 37 * 1000 * MS
    assert np.abs((begins_ns + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2).max() < 1000


def test_ptp_exposes_at_multiples_of_the_period_of_the_ptp_clock(three_cameras):
    assert_begin_at_multiples_of_ptp_time(run_in("ptp", three_cameras[0], stamp_source="ptp")[1])


def test_action_commands_expose_all_cameras_at_the_scheduled_instant(three_cameras):
    sources, instants_ns = run_in("action", three_cameras[0], action_lead_ms=300.0)
    assert_begin_at_multiples_of_ptp_time(instants_ns)
    assert all(source.counters["actions"] >= COUNT for source in sources)
    assert all(source.counters["actions_refused"] == 0 for source in sources)


def test_line_exposes_all_cameras_at_the_edge(three_cameras):
    cameras, wire = three_cameras
    wire.run(RATE)
    _, instants_ns = run_in("line", cameras, trigger_line="Line1", features=["TriggerDelay=300"])
    assert np.ptp(instants_ns, axis=0).max() == 0
    assert ((instants_ns - MS // 2 - 300_000) % PERIOD_NS == 0).all()  # the wire's generator counts in UTC


def test_software_triggers_come_at_multiples_of_the_period_of_the_host_clock(three_cameras):
    sources, instants_ns = run_in("software", three_cameras[0])
    late_ns = (instants_ns - MS // 2) % PERIOD_NS
    assert np.median(late_ns) < 5 * MS  # as late as network and scheduling make it, but never early
    assert all(source.counters["triggers"] >= COUNT for source in sources)


def test_actions_that_come_too_late_or_without_ptp_are_refused_by_the_camera_and_counted(gige_camera):
    camera = gige_camera()
    with source_of(camera, sync="action", action_lead_ms=200.0) as source:
        source.start()
        frames_of(source, 3)
        source._actions.send(1)  # one nanosecond after the epoch of PTP
        frames_of(source, 5)
        assert source.counters["actions_late"] >= 1 and source.counters["actions"] >= 8
        camera.faults.ptp_lost = True
        for _ in range(60):
            source.read(0.1)
            if source.counters["actions_refused"]:
                break
    assert source.counters["actions_refused"] > 0


@pytest.mark.parametrize("mode", ["ptp", "action", "software"])
def test_mode_that_counts_periods_needs_a_frame_rate(gige_camera, mode):
    source = AravisSource(AravisSettings(address=gige_camera().address, sync=mode))
    with pytest.raises(InputError, match=r"needs a frame rate.*aravis\.frame_rate"):
        source.connect()


def test_free_run_switches_off_what_an_earlier_program_left_on(gige_camera):
    camera = gige_camera()
    with source_of(camera, sync="line"):
        pass
    with source_of(camera) as source:
        source.start()
        assert len(frames_of(source, 2)) == 2
