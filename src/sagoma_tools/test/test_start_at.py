"""--start-at: which instant is meant, what is refused, and what the cameras of several machines are given."""

import datetime

import pytest

from capture_rig.errors import InputError
from sagoma_bringup.graph import Role, camera_node
from sagoma_tools.arguments import in_step, start_instant_ns

NOON = datetime.datetime(2026, 3, 1, 12, 0, 0, tzinfo=datetime.UTC)
NOON_NS = round(NOON.timestamp() * 1e9)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("12:00:30Z", 30),
        ("12:01Z", 60),
        ("11:59:00+00:00", -60),
        ("2026-03-01T12:05:00Z", 300),
        ("2026-03-01T13:05:00+01:00", 300),
        ("13:00:30+01:00", 30),
        (NOON.astimezone().strftime("%H:%M:%S"), 0),
    ],
)
def test_every_way_to_write_a_moment_means_the_same_instant(text, seconds):
    assert start_instant_ns(text, NOON_NS) == NOON_NS + seconds * 10**9


def test_a_time_just_after_midnight_is_said_with_its_date():
    late_ns = round(datetime.datetime(2026, 3, 1, 23, 59, 30, tzinfo=datetime.UTC).timestamp() * 1e9)
    with pytest.raises(InputError, match="ago"):
        start_instant_ns("00:00:10Z", late_ns)
    assert start_instant_ns("2026-03-02T00:00:10Z", late_ns) == late_ns + 40 * 10**9


@pytest.mark.parametrize("text", ["soon", "25:00", "", "14.30"])
def test_what_is_no_time_is_refused_with_an_example(text):
    with pytest.raises(InputError, match=r"is no time.*14:30:05"):
        start_instant_ns(text, NOON_NS)


def test_a_moment_of_another_hour_is_refused_with_the_time_it_is():
    with pytest.raises(InputError, match=r"2:00:00 ahead: it is \d\d:00:00"):
        start_instant_ns("14:00:00Z", NOON_NS)


def footage(*names):
    return [camera_node(name, {"source": "footage", "footage.epoch_ns": 0}) for name in names]


def test_one_camera_of_several_without_a_common_beginning_is_refused_and_all_of_them_or_none_need_none():
    with pytest.raises(InputError, match=r"of 4 cameras only cam02 plays here.*--start-at"):
        in_step(footage("cam02"), 4, None, 1.0)
    for names in (("cam01", "cam02"), ()):
        assert in_step(footage(*names), 2, None, 1.0) == footage(*names)
    assert in_step([], 4, NOON_NS, 1.0) == []


def test_cameras_of_several_machines_share_the_beginning_and_keep_up_or_wait_for_each_other():
    (node,) = in_step(footage("cam02"), 4, NOON_NS, 1.0)
    assert node.role is Role.CAMERA
    assert node.parameters["footage.epoch_ns"] == NOON_NS and node.parameters["footage.keep_up"] is True
    assert node.parameters["footage.wait_for_cameras"] is False  # nobody waits for a machine that is late
    (node,) = in_step(footage("cam02"), 4, NOON_NS, 0.0)  # as fast as the graph can
    assert node.parameters["footage.wait_for_cameras"] is True and "footage.keep_up" not in node.parameters
