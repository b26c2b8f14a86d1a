"""Supervision of a camera that stalls, dies, refuses and comes back; a clock that only the test moves."""

import threading
from itertools import count
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camera_client.frame_source import ConnectionState, Frame, FrameSource, SourceUnavailable
from camera_client.sources.supervised_source import RETRY_S, SupervisedSource
from capture_rig.errors import InputError

PATIENCE_S = 20.0  # only ever used up by a failing test
STEP_S = 0.01
OFF, WRONG = SourceUnavailable("does not answer", where="camera"), InputError("lacks Mono12", where="camera")


class World:
    """One camera, its power switch, and the time; every connection to it is a FakeSource."""

    def __init__(self):
        self.now_s, self.fault, self.start_fault = 0.0, None, None
        self.silent = self.control_taken = self.starved = False
        self.made, self.shape = [], (2, 3)
        self.answering = threading.Event()  # while clear, connecting blocks as to a dead device
        self.answering.set()

    def make(self):
        self.made.append(FakeSource(self))
        return self.made[-1]

    def wait(self, seconds):
        self.now_s += seconds

    def supervised(self, accept=lambda source: None, stall_timeout_s=0.5):
        return SupervisedSource(
            self.make, accept, lambda source: stall_timeout_s, clock=lambda: self.now_s, pause=self.wait
        )


class FakeSource(FrameSource):
    def __init__(self, world):
        super().__init__()
        self.world, self.calls, self.taken, self.next_ids = world, [], False, count(1)
        self.hold = threading.Event()  # while clear, starting, stopping and closing block as on a dead device
        self.hold.set()
        self.connected, self.closed = threading.Event(), threading.Event()

    def connect(self):
        self.calls.append("connect")
        self.world.answering.wait(PATIENCE_S)
        if self.world.fault is not None:
            raise self.world.fault
        self.connected.set()

    def start(self):
        self.calls.append("start")
        self.hold.wait(PATIENCE_S)
        if self.world.start_fault is not None:
            raise self.world.start_fault
        self.statistics.restart()

    def read(self, timeout_s):
        if self.world.fault is not None or self.world.silent:
            self.world.now_s += 5.0 if self.world.starved else timeout_s
            self.taken = self.taken or self.world.control_taken
            return None
        self.world.now_s += STEP_S
        frame_id = next(self.next_ids)
        self.statistics.add(frame_id)
        self.count("packets", 10)
        return Frame(np.zeros(self.world.shape, np.uint8), round(self.world.now_s * 1e9), frame_id, "test")

    def stop(self):
        self.calls.append("stop")
        self.hold.wait(PATIENCE_S)

    def close(self):
        self.calls.append("close")
        self.hold.wait(PATIENCE_S)
        self.calls.append("closed")
        self.closed.set()

    @property
    def lost(self):
        return self.taken

    shape = property(lambda self: self.world.shape)
    description = "a fake camera"
    details = property(lambda self: {"camera_serial": "F1"})


@pytest.fixture
def world():
    world = World()
    yield world
    for source in world.made:
        source.hold.set()


@pytest.fixture
def streaming(world):
    """A supervised source that has delivered its first frame."""
    with world.supervised() as source:
        source.start()
        frames_of(source, 1)
        yield source


def until(source, done, reads=10_000):
    frames = []
    for _ in range(reads):
        frame = source.read(0.2)
        frames += [] if frame is None else [frame]
        if done(source, frames):
            return frames
    raise AssertionError(f"did not come about: {source.connection}")


def frames_of(source, wanted):
    return until(source, lambda _, frames: len(frames) == wanted)


def test_camera_that_is_there_streams_from_the_first_read(world):
    with world.supervised() as source:
        assert source.connection.state is ConnectionState.CONNECTED and source.shape == (2, 3)
        source.start()
        assert [frame.frame_id for frame in frames_of(source, 3)] == [1, 2, 3]
        assert source.connection.state is ConnectionState.STREAMING and not source.lost
        assert source.connection.downtime_s == 0.0 and source.counters == {"packets": 30}
        assert source.details == {"camera_serial": "F1"}


def test_camera_that_is_off_is_tried_again_every_second(world):
    world.fault = OFF
    source = world.supervised()
    source.connect()
    assert source.connection.state is ConnectionState.WAITING and "does not answer" in source.connection.reason
    assert source.shape == ()
    source.start()
    tries = []
    for _ in range(50):
        before = len(world.made)
        source.read(0.2)
        if len(world.made) > before:
            tries.append(world.now_s)
    assert np.diff(tries) == pytest.approx(RETRY_S) and len(tries) > 5
    world.fault = None
    frames_of(source, 1)
    assert source.connection.state is ConnectionState.STREAMING and source.shape == (2, 3)
    assert source.connection.downtime_s == pytest.approx(world.now_s, abs=1e-6)


def test_power_cycle_is_noticed_and_the_first_frame_after_it_is_timed(world, streaming):
    last_s = world.now_s
    world.fault = OFF
    until(streaming, lambda s, _: s.connection.state is ConnectionState.WAITING)
    assert world.now_s - last_s == pytest.approx(0.5)
    assert streaming.counters["stalls"] == 1
    until(streaming, lambda s, _: world.now_s - last_s > 5.0)
    world.fault, back_s = None, world.now_s
    frames_of(streaming, 1)
    link = streaming.connection
    assert link.last_outage_s == pytest.approx(world.now_s - last_s)
    assert world.now_s - back_s <= RETRY_S + STEP_S
    assert streaming.counters["reconnects"] == 1
    assert link.downtime_s == pytest.approx(link.last_outage_s) and link.down_s == 0.0


@pytest.mark.parametrize(
    "taken, state, reason, counter",
    [
        (False, ConnectionState.STALLED, "nothing came for 0.5 s", "stalls"),
        (True, ConnectionState.CONTROL_LOST, "control", "control_losses"),
    ],
)
def test_camera_that_stalls_or_loses_control_is_connected_anew_at_once(world, streaming, taken, state, reason, counter):
    world.silent, world.control_taken = True, taken
    until(streaming, lambda s, _: s.connection.state is state)
    assert reason in streaming.connection.reason and streaming.counters == {"packets": 10, counter: 1}
    world.silent = world.control_taken = False
    before_s = world.now_s
    frames_of(streaming, 1)
    assert world.now_s - before_s == pytest.approx(STEP_S)
    assert world.made[0].calls[-1] == "closed" and len(world.made) == 2


def test_process_that_did_not_get_to_run_does_not_blame_the_camera(world, streaming):
    world.silent = world.starved = True
    for _ in range(2):
        streaming.read(0.2)  # takes 5 s each
    world.silent = world.starved = False
    frames_of(streaming, 1)
    assert world.now_s > 10.0 and len(world.made) == 1 and "stalls" not in streaming.counters


def test_incomplete_frames_are_a_sign_of_life(world, streaming):
    world.silent = True
    for frame_id in range(2, 40):
        world.made[0].statistics.add(frame_id, complete=False)
        streaming.read(0.2)
    assert streaming.connection.state is ConnectionState.STREAMING
    assert streaming.statistics.incomplete == 38


def test_settings_that_the_camera_or_the_node_refuses_fail_connect_or_start(world):
    world.fault = WRONG
    with pytest.raises(InputError, match="Mono12"):
        world.supervised().connect()
    world.fault, world.start_fault = None, WRONG
    with pytest.raises(InputError, match="Mono12"):
        world.supervised(accept=Mock(side_effect=WRONG)).connect()
    assert world.made[-1].calls[-1] == "closed"
    with world.supervised() as source:
        with pytest.raises(InputError, match="Mono12"):
            source.start()
        world.start_fault = None
        source.start()
        frames_of(source, 1)


@pytest.mark.parametrize(
    "attribute, error, said, refused",
    [
        ("fault", WRONG, "Mono12", True),
        ("fault", RuntimeError("a defect of the driver"), "defect", False),
        ("start_fault", OFF, "does not answer", False),
    ],
)
def test_reconnection_that_fails_is_shown_and_retried(world, streaming, attribute, error, said, refused):
    setattr(world, attribute, error)
    world.silent = True
    until(streaming, lambda s, _: s.connection.state is ConnectionState.WAITING)
    link = streaming.connection
    assert said in link.reason and link.refused == refused and link.next_try_s == pytest.approx(RETRY_S)
    assert world.made[0].closed.wait(PATIENCE_S)
    setattr(world, attribute, None)
    world.silent = False
    frames_of(streaming, 1)
    assert streaming.connection.reason == "" and not streaming.connection.refused


@pytest.fixture
def impatient(monkeypatch):
    """Who waits for a camera to stop gives up after a moment."""
    monkeypatch.setattr("camera_client.sources.supervised_source.RELEASE_S", 0.05)


def test_dead_camera_blocks_neither_stop_nor_close(impatient, world, streaming):
    world.made[0].hold.clear()
    streaming.stop()
    assert "did not answer" in streaming.connection.reason
    streaming.close()
    assert "closed" not in world.made[0].calls
    world.made[0].hold.set()
    assert world.made[0].closed.wait(PATIENCE_S)


def test_dead_connection_that_cannot_be_closed_yet_does_not_delay_the_next_one(impatient, world, streaming):
    world.made[0].hold.clear()
    world.silent = True
    until(streaming, lambda s, _: s.lost)
    world.silent = False
    frames_of(streaming, 1)
    assert len(world.made) == 2 and "closed" not in world.made[0].calls


@pytest.mark.parametrize("lost", [False, True])
def test_suspension_is_no_downtime_and_keeps_the_connection_unless_it_was_lost(world, streaming, lost):
    streaming.stop()
    assert streaming.connection.state is ConnectionState.CONNECTED
    world.now_s += 100.0
    world.made[0].taken = lost
    streaming.start()
    frames_of(streaming, 3)
    assert len(world.made) == 1 + lost and streaming.counters.get("control_losses", 0) == lost
    assert streaming.connection.downtime_s == pytest.approx(0.0, abs=2 * STEP_S)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=1, max_size=5))
def test_accounts_and_counters_add_up_over_reconnections(runs):
    world = World()
    delivered = 0
    with world.supervised() as source:
        source.start()
        for wanted, loses_some in runs:
            frames = frames_of(source, wanted)
            delivered += len(frames)
            if loses_some:
                for _ in range(3):
                    next(world.made[-1].next_ids)
            delivered += len(frames_of(source, 1))
            world.silent = True
            until(source, lambda s, _: s.lost)
            world.silent = False
        total = source.statistics
        assert total.delivered == delivered
        assert total.lost == 3 * sum(loses_some for _, loses_some in runs)
        assert total.expected == total.delivered + total.incomplete + total.lost
        assert source.counters["packets"] == 10 * delivered
        assert source.counters["stalls"] == len(runs)


@pytest.mark.parametrize("made", ["after the stop", "before it, and not used yet"])
def test_connection_that_a_stopped_source_does_not_use_is_closed_again(world, made):
    world.answering.clear()
    source = world.supervised()
    source.start()
    source.read(0.01)  # an attempt is under way
    if made == "after the stop":
        source.stop()
        assert world.made[0].calls == ["connect"]
        world.answering.set()
    else:
        world.answering.set()
        world.made[0].connected.wait(PATIENCE_S)
    source.close()
    assert world.made[0].calls == ["connect", "close", "closed"]
