"""Arguments of command lines: numbers of every option of every parser, settings, and the instant of --start-at."""

import argparse
import datetime
from pathlib import Path

import pytest

import virtual_studio.__main__ as rendering
from capture_rig.errors import InputError
from capture_rig.settings import number
from sagoma_bringup.graph import Role, camera_node
from sagoma_tools.arguments import in_step, start_instant_ns
from sagoma_tools.cli import build_parser
from sagoma_tools.console import BAD_INPUT, commands_of

ABSURD = ("nan", "inf", "-1e300", "1e300", "twelve", "")
TEXTS = (None, str, Path)


def parsers():
    """Every command line of ours: its name and its parser."""
    yield from ((name, leaf) for name, leaf, _ in commands_of(build_parser()))
    yield "rendering", rendering._session_parser()
    yield "rendering setup", rendering._setup_parser()


OPTIONS = [
    pytest.param(parser, action, id=f"{name} {(action.option_strings or [action.dest])[0]}")
    for name, parser in parsers()
    for action in parser._actions
    if action.type not in TEXTS
]


def test_numbers_of_many_commands_are_found():
    assert len({each.id.rpartition(" ")[0] for each in OPTIONS}) > 12 and len(OPTIONS) > 35


@pytest.mark.parametrize(("parser", "action"), OPTIONS)
def test_absurd_number_ends_with_status_2_and_one_line(parser, action, capsys):
    option, many = (action.option_strings or [""])[-1], isinstance(action.nargs, int)
    for text in ABSURD:
        with pytest.raises(SystemExit) as ended:
            parser.parse_args([option] + [text] * action.nargs if many else [f"{option}={text}" if option else text])
        *_, last = capsys.readouterr().err.splitlines()
        assert ended.value.code == BAD_INPUT and option in last
        assert f"'{text}' cannot be used; give a " in last or (many and text.startswith("-"))  # taken for an option


def test_number_is_read_with_its_bounds_and_its_unit_is_named():
    read = number("kg", 2, 500)
    assert (read("2"), read("72.5"), read("500")) == (2.0, 72.5, 500.0)
    with pytest.raises(argparse.ArgumentTypeError, match=r"^'1\.9' cannot be used; give a number from 2 to 500 kg$"):
        read("1.9")


def test_whole_number_stays_one_and_takes_no_decimals():
    read = number("nodes", 1, 1000, whole=True)
    assert read("7") == 7 and isinstance(read("7"), int)
    for text in ("7.0", "0", "1001", "9" * 5000):
        with pytest.raises(argparse.ArgumentTypeError, match="give a whole number from 1 to 1000 nodes"):
            read(text)


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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((text, r"is no time.*14:30:05") for text in ("soon", "25:00", "", "14.30")),
        ("14:00:00Z", r"2:00:00 ahead: it is \d\d:00:00"),
    ],
)
def test_what_is_no_time_or_of_another_hour_is_refused(text, said):
    with pytest.raises(InputError, match=said):
        start_instant_ns(text, NOON_NS)


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
