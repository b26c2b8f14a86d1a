"""Arguments of command lines: numbers of every option of every parser, and parts of a graph."""

import argparse
from pathlib import Path

import pytest

import virtual_studio.__main__ as rendering
from capture_rig.errors import InputError
from capture_rig.settings import number
from sagoma_bringup.graph import camera_node
from sagoma_tools.arguments import require_all_cameras
from sagoma_tools.cli import build_parser
from sagoma_tools.console import BAD_INPUT, commands_of

ABSURD = ("nan", "inf", "-1e300", "1e300", "twelve", "")
TEXTS = (None, str, Path)


PARSERS = {name: leaf for name, leaf, _ in commands_of(build_parser())}
PARSERS |= {"rendering": rendering._session_parser(), "rendering setup": rendering._setup_parser()}
OPTIONS = [
    pytest.param(parser, action, id=f"{name} {(action.option_strings or [action.dest])[0]}")
    for name, parser in PARSERS.items()
    for action in parser._actions
    if action.type not in TEXTS
]


@pytest.mark.parametrize(("parser", "action"), OPTIONS)
def test_absurd_number_ends_with_status_2_and_one_line(parser, action, capsys):
    option, many = (action.option_strings or [""])[-1], isinstance(action.nargs, int)
    for text in ABSURD:
        with pytest.raises(SystemExit) as ended:
            parser.parse_args([option] + [text] * action.nargs if many else [f"{option}={text}" if option else text])
        *_, last = capsys.readouterr().err.splitlines()
        assert ended.value.code == BAD_INPUT and option in last
        assert f"'{text}' cannot be used; give a " in last or (many and text.startswith("-"))  # taken for an option


def test_number_is_read_with_its_bounds_and_its_unit_is_named_and_a_whole_one_takes_no_decimals():
    read, whole = number("kg", 2, 500), number("nodes", 1, 1000, whole=True)
    assert (read("2"), read("72.5"), whole("7")) == (2.0, 72.5, 7) and isinstance(whole("7"), int)
    with pytest.raises(argparse.ArgumentTypeError, match=r"^'1\.9' cannot be used; give a number from 2 to 500 kg$"):
        read("1.9")
    for text in ("7.0", "0", "1001", "9" * 5000):
        with pytest.raises(argparse.ArgumentTypeError, match="give a whole number from 1 to 1000 nodes"):
            whole(text)


def test_one_camera_of_several_without_a_common_beginning_is_refused_and_all_of_them_or_none_need_none():
    cameras = {name: camera_node(name, {"source": "footage"}) for name in ("cam01", "cam02")}
    with pytest.raises(InputError, match=r"of 2 cameras only cam02 plays here.*--set cameras.footage.epoch_ns"):
        require_all_cameras([cameras["cam02"]], list(cameras))
    require_all_cameras(list(cameras.values()), list(cameras))
    require_all_cameras([], list(cameras))
