"""Typed settings: what is accepted, converted and refused."""

import dataclasses
import pickle
from dataclasses import dataclass, field
from typing import Any

import pytest

from capture_rig.errors import InputError
from capture_rig.settings import build_settings, leaves, setting


@dataclass(frozen=True)
class Blob:
    min_area_m2: float = setting(0.002, "smallest blob", unit="m^2", low=0, high=1)
    max_elongation: float = setting(2.0, "longest blob", low=1)


@dataclass(frozen=True)
class Example:
    backend: str = setting("auto", "what carves", choices=("auto", "cpu", "gl"))
    cameras: int = setting(4, "how many", low=1, high=64)
    loop: bool = setting(False, "start again at the end")
    gain: float = setting(1.0, "without limits")
    axes: list[str] = setting(["x", "y"], "slicing directions", choices=("x", "y", "z"))
    low: list[float] = setting([0.0, 0.0], "corner", unit="m", low=-10, high=10)
    ids: list[int] = setting([], "numbers")
    frame: str = setting("map", "a frame", is_name=True)
    blob: Blob = field(default_factory=Blob)


def refusal(values: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        build_settings(Example, values, "hull.yaml")
    assert str(caught.value).startswith("hull.yaml: ")
    assert caught.value.remedy
    return str(caught.value)


def test_given_values_replace_the_defaults_and_nothing_else() -> None:
    settings = build_settings(Example, {"cameras": 6, "axes": ["z"], "loop": True}, "hull.yaml")
    assert settings == dataclasses.replace(Example(), cameras=6, axes=["z"], loop=True)


@pytest.mark.parametrize("values", [{"blob.min_area_m2": 0.01}, {"blob": {"min_area_m2": 0.01}}])
def test_nested_settings_are_written_dotted_or_as_a_mapping(values: dict[str, Any]) -> None:
    settings = build_settings(Example, values, "hull.yaml")
    assert settings.blob == Blob(min_area_m2=0.01, max_elongation=2.0)


def test_settings_share_no_list() -> None:
    one, two = build_settings(Example, {}, ""), build_settings(Example, {}, "")
    one.axes.append("z")
    assert two.axes == ["x", "y"] and Example().axes == ["x", "y"]


@pytest.mark.parametrize(
    ("key", "given", "value"),
    [
        ("cameras", 1, 1),  # the limits of a range belong to it
        ("cameras", 64, 64),
        ("low", (-10, 10), [-10.0, 10.0]),
        ("gain", 3, 3.0),  # a whole number serves as a float
        ("frame", "studio_2/map", "studio_2/map"),
        ("frame", "floor-1", "floor-1"),
    ],
)
def test_value_within_its_limits_is_taken_and_converted(key: str, given: object, value: object) -> None:
    found = getattr(build_settings(Example, {key: given}, ""), key)
    assert found == value and type(found) is type(value)
    assert not isinstance(found, list) or all(type(item) is float for item in found)


OTHER_TYPES = [
    ("cameras", True, "int"),
    ("cameras", 4.0, "int"),
    ("gain", True, "float"),
    ("gain", "1.0", "float"),
    ("loop", 1, "bool"),
    ("backend", 3, "str"),
    ("backend", None, "str"),
    ("axes", "x", "list[str]"),
    ("low", [1.0, True], "list[float]"),
    ("low", 1.0, "list[float]"),
    ("ids", [1, 2.0], "list[int]"),
]
OUT_OF_RANGE = [
    ("cameras", 0, "1 to 64"),
    ("cameras", 65, "1 to 64"),
    ("blob.min_area_m2", -0.1, "0 to 1 m^2"),
    ("blob.max_elongation", 0.5, "1 to 1e+12"),
    ("blob.max_elongation", float("nan"), "1 to 1e+12"),
    ("gain", float("-inf"), "-1e+12 to 1e+12"),
    ("gain", 1e300, "-1e+12 to 1e+12"),
    ("ids", [1 << 63], "-9.22337203685e+18 to 9.22337203685e+18"),
    ("low", [0.0, 11.0], "-10 to 10 m"),
]
NO_NAMES = ["", "..", "../..", "/map", "map/", "a//b", "a/../b", "two words", "a\nb"]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"backnd": "cpu"}, "hull.yaml: unknown key 'backnd'. Did you mean 'backend'?"),
        ({"blob": {"min_area": 0.1}}, "unknown key 'blob.min_area'. Did you mean 'blob.min_area_m2'?"),
        ({"blob": 3}, "unknown key 'blob'"),
        *(({"quux": 1}, leaf.key) for leaf in leaves(Example)),  # unlike any: all are listed
        ({"backend": "cuda"}, "'cuda' is not one of 'auto', 'cpu', 'gl'. Choose one of them; the default is 'auto'."),
        ({"axes": ["x", "w"]}, "axes = ['x', 'w'] is not one of 'x', 'y', 'z'"),
        *(
            ({key: value}, f"{key} = {value!r} is not of type {kind}. Give a {kind}; the default is ")
            for key, value, kind in OTHER_TYPES
        ),
        *(({key: value}, f"Allowed: {allowed}; the default is ") for key, value, allowed in OUT_OF_RANGE),
        *(({"frame": name}, f"frame = {name!r} is not a name") for name in NO_NAMES),
    ],
    ids=str,
)
def test_value_that_cannot_be_used_is_refused_with_key_value_and_what_can(values: dict[str, Any], says: str) -> None:
    assert says in refusal(values)


def test_a_plain_field_is_an_option_of_the_code_and_no_setting() -> None:
    @dataclass(frozen=True)
    class WithOption(Example):
        option: float = 0.5

    assert list(leaves(WithOption)) == list(leaves(Example))
    with pytest.raises(InputError, match="unknown key 'option'"):
        build_settings(WithOption, {"option": 1.0}, "hull.yaml")


# --- The text of the one error that users see.


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"what": "fps = 0", "where": "session.yaml", "remedy": "Give more."}, "session.yaml: fps = 0. Give more."),
        ({"what": "the mask is empty"}, "the mask is empty."),
        ({"what": "Is it plugged in?"}, "Is it plugged in?"),
    ],
)
def test_error_reads_where_what_remedy(given: dict[str, str], says: str) -> None:
    assert str(InputError(given.pop("what"), **given)) == says


def test_error_survives_the_way_between_processes() -> None:
    error = InputError("what", where="where", remedy="remedy.")
    again = pickle.loads(pickle.dumps(error))
    assert (again.what, again.where, again.remedy, str(again)) == ("what", "where", "remedy.", str(error))
