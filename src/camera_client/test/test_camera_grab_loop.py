"""The grab loop, with a source made of lists."""

import threading

import numpy as np
import pytest

from camera_client.frame_source import EndOfFootage, Frame
from camera_client.sources.grab_loop import GrabLoop, GrabState
from capture_rig.errors import InputError

PATIENCE_S = 20.0  # only ever used up by a failing test


class ListSource:
    """Delivers frames with the given ids; an exception in the list is raised instead."""

    def __init__(self, items):
        self._items, self.calls = list(items), []
        self.start, self.stop = (lambda: self.calls.append("start")), (lambda: self.calls.append("stop"))

    def read(self, timeout_s):
        if not self._items:
            raise EndOfFootage
        item = self._items.pop(0)
        if isinstance(item, Exception):
            raise item
        return None if item is None else Frame(np.zeros((2, 2), np.uint8), item * 1000, item, "test")


def run(source, on_frame=lambda frame: None, **options):
    errors = []
    loop = GrabLoop(source, on_frame, errors.append, **options)
    loop.start()
    assert loop.wait(PATIENCE_S)
    return loop, errors


def test_every_frame_is_handed_on_until_the_end():
    stamps = []
    loop, errors = run(ListSource([1, None, 2, 3]), lambda frame: stamps.append(frame.stamp_ns))
    assert stamps == [1000, 2000, 3000] and errors == []
    assert (loop.state, loop.frames) == (GrabState.ENDED, 3)


def test_bad_frame_costs_only_itself():
    seen = []

    def on_frame(frame):
        if frame.frame_id == 2:
            raise InputError("bad")
        seen.append(frame.frame_id)

    loop, errors = run(ListSource([1, 2, 3]), on_frame)
    assert seen == [1, 3] and [str(error) for error in errors] == ["bad."]
    assert loop.state is GrabState.ENDED


def test_error_of_the_source_ends_the_loop_and_is_kept_and_a_defect_reported():
    loop, errors = run(ListSource([1, InputError("unplugged", where="camera"), 2]))
    assert (loop.state, loop.frames) == (GrabState.FAILED, 1)
    assert loop.reason == "camera: unplugged." and errors == []
    loop, errors = run(ListSource([1, ZeroDivisionError("a defect")]))
    assert (loop.state, loop.reason) == (GrabState.FAILED, "a defect")
    assert repr(errors[0]) == "ZeroDivisionError('a defect')"


@pytest.mark.parametrize("becomes_ready", [True, False], ids=["ready", "stopped"])
def test_source_is_started_only_when_ready_and_never_when_stopped_before(becomes_ready):
    source, ready, asked = ListSource([1]), threading.Event(), threading.Event()

    def is_ready():
        asked.set()
        return ready.is_set()

    loop = GrabLoop(source, lambda frame: None, lambda error: None, is_ready, ready_timeout_s=3600.0)
    loop.start()
    assert asked.wait(PATIENCE_S)
    assert loop.state is GrabState.WAITING and source.calls == []
    if becomes_ready:
        ready.set()
    else:
        loop.stop()
    assert loop.wait(PATIENCE_S)
    assert source.calls == (["start"] if becomes_ready else ["stop"]) and loop.frames == int(becomes_ready)
