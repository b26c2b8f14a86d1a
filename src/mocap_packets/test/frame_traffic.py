"""Frames of a rig as they arrive, for the tests of frame sets: each frame carries its camera and its instant."""

from mocap_packets.frame_set import FrameSetCollector

CAMERAS = ("cam01", "cam02", "cam03")
TWO = CAMERAS[:2]
SECOND = 1_000_000_000
PERIOD = SECOND // 60
TOLERANCE = PERIOD // 2
DEADLINE = 2 * PERIOD
EPOCH = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND


def make_collector(cameras=CAMERAS, **options):
    return FrameSetCollector(cameras, **{"tolerance_ns": TOLERANCE, "deadline_ns": DEADLINE, **options})


def send(collector, instants, cameras=CAMERAS, later=0.0, **shifts_ns):
    """Send frames of instants; return the sets that leave.

    They arrive at the pace of the instants, each 1 us after the last, ``later`` by so many periods. ``shifts_ns``: by
    how much the stamps of single cameras are off.
    """
    sets = []
    for k in instants:
        for index, camera in enumerate(cameras):
            stamp = EPOCH + k * PERIOD + shifts_ns.get(camera, 0)
            sets += collector.add(camera, stamp, (camera, k), round((k + later) * PERIOD) + 1000 * index)
    return sets


def instants_of(sets):
    """The instant of each set; fails when a set holds frames of two."""
    found = []
    for each in sets:
        (instant,) = {k for _, k in each.frames.values()}
        found.append(instant)
    return found


def assert_conserved(collector, sets):
    c = collector.counters
    assert c.frames == sum(len(each.frames) for each in sets) + c.late + c.duplicate + c.backwards + c.ahead
    assert c.complete == sum(not each.missing for each in sets)
    assert c.incomplete == sum(bool(each.missing) for each in sets)
    assert c.missing == sum(len(each.missing) for each in sets)
