"""Frames of a rig as they arrive, for the tests of frame sets: each frame carries its camera and its instant."""

from __future__ import annotations

from collections.abc import Iterable

from mocap_packets.frame_set import FrameSet, FrameSetCollector

CAMERAS = ("cam01", "cam02", "cam03")
SECOND = 1_000_000_000
PERIOD = SECOND // 60
TOLERANCE = PERIOD // 2
DEADLINE = 2 * PERIOD
EPOCH = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND

Frame = tuple[str, int]  # camera and instant: what a test frame carries


def make_collector(
    cameras: Iterable[str] = CAMERAS, deadline_ns: int = DEADLINE, max_open: int = 8, give_up: int = 0
) -> FrameSetCollector[Frame]:
    return FrameSetCollector(
        cameras, tolerance_ns=TOLERANCE, deadline_ns=deadline_ns, max_open=max_open, give_up=give_up
    )


def send(collector: FrameSetCollector, instants: Iterable[int], cameras: Iterable[str] = CAMERAS, shift: int = 0):
    """Frames of the given instants, each arriving 1 us after the last and at the pace of the instants."""
    sets = []
    for k in instants:
        for index, camera in enumerate(cameras):
            stamp = EPOCH + k * PERIOD + shift
            sets += collector.add(camera, stamp, (camera, k), k * PERIOD + 1000 * index)
    return sets


def instants_of(sets: list[FrameSet[Frame]]) -> list[int]:
    """The instant of each set; fails when a set holds frames of two."""
    found = []
    for each in sets:
        (instant,) = {k for _, k in each.frames.values()}
        found.append(instant)
    return found


def assert_conserved(collector: FrameSetCollector, sets: list[FrameSet], waiting: int = 0) -> None:
    c = collector.counters
    in_sets = sum(len(each.frames) for each in sets)
    assert c.frames == in_sets + c.late + c.duplicate + c.backwards + c.ahead + waiting
    assert c.complete == sum(not each.missing for each in sets)
    assert c.incomplete == sum(bool(each.missing) for each in sets)
    assert c.missing == sum(len(each.missing) for each in sets)
