"""Hours of frames leave nothing behind: what silhouettes, hull, fit and filter keep does not grow with them."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Iterable
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camera_client.background.model import read_background
from capture_rig.session import load_session
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline, make_segmenter
from mocap_pipeline.session_footage import exact_silhouettes, images_of

WARM_SETS, WARM_FRAMES = 500, 1000  # by then what is kept of the last seconds is full, and so are malloc's own caches
SPANS = 5
BYTES, OBJECTS = 150.0, 1.0  # a step: an array of one number takes 160
PERIOD_NS = 33_333_333
NUMPY_KEEPS, NUMPY_KEEPS_BYTES = 7, 1024  # NCACHE and NBUCKETS of numpy/_core/src/multiarray/alloc.c


class Mallinfo(ctypes.Structure):
    """struct mallinfo2 of glibc's malloc.h."""

    names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in names.split()]


def held() -> tuple[int, int]:
    """Return the bytes in use in malloc's heaps, and the small objects of Python, which are outside of them."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo is None:
        pytest.skip("needs mallinfo2 of glibc 2.33")
    mallinfo.restype = Mallinfo
    gc.collect()
    info = mallinfo()
    return info.uordblks + info.hblkhd, sys.getallocatedblocks()


def to_and_fro(there: Iterable[Any]) -> list[Any]:
    """Return items and then the same backwards, to be shown in a loop."""
    items = list(there)
    return items + items[::-1]


def fill_numpys_cache() -> None:
    """Let numpy have what it keeps for good: seven freed blocks of every size below 1024 bytes, 3.6 MiB.

    By itself it comes by them over hours (docs/how-to/faults.md), as arrays of ever other sizes are freed.
    """
    for size in range(1, NUMPY_KEEPS_BYTES):
        _together = [np.empty(size, np.uint8) for _ in range(NUMPY_KEEPS + 1)]


def growth_per_step(step: Callable[[int], object], warm: int, loop: int) -> np.ndarray:
    """Return by how many bytes and small objects a process grows with each step, after so many of them.

    The median of five spans of a whole ``loop`` of the input, as what is held differs between its frames: what is taken
    once, or given back once, is no growth.
    """
    numbers = count()
    for number in islice(numbers, warm):
        step(number)
    fill_numpys_cache()
    held_after = [held()]
    for _ in range(SPANS):
        for number in islice(numbers, loop):
            step(number)
        held_after.append(held())
    return np.median(np.diff(held_after, axis=0), axis=0) / loop


@pytest.mark.slow
def test_frame_sets_leave_no_memory_behind(built_in_session: Path) -> None:
    session = load_session(built_in_session)
    configuration = Configuration.of({"icp_tracker.initial_pose.source": "auto"})
    pipeline, masks = MocapPipeline(session.rig, configuration), to_and_fro(exact_silhouettes(session))
    tracked = []

    def follow(number: int) -> None:
        found = pipeline.step_masks(number * PERIOD_NS, masks[number % len(masks)])
        tracked[:] = [person.state is not None for person in found.people]

    bytes_a_set, objects_a_set = growth_per_step(follow, WARM_SETS, len(masks))
    assert any(tracked)
    assert bytes_a_set < BYTES and objects_a_set < OBJECTS


@pytest.mark.slow
def test_frames_of_a_camera_leave_no_memory_behind(built_in_session: Path) -> None:
    session, configuration = load_session(built_in_session), Configuration.of({})
    name = session.rig.names[0]
    images = to_and_fro(each[name] for each in images_of({name: session.videos[name]}))
    background = read_background(session.backgrounds[name], images[0].shape)
    chain = make_segmenter(session.rig.camera(name), background, configuration.camera, session.rig.volume)
    bytes_a_frame, objects_a_frame = growth_per_step(
        lambda number: chain.run(images[number % len(images)], number * PERIOD_NS), WARM_FRAMES, len(images)
    )
    assert bytes_a_frame < BYTES and objects_a_frame < OBJECTS
