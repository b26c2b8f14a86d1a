"""YAML files within limits: what is damaged or hostile is an error with file, line and remedy, and is found at once."""

import pytest

from capture_rig.errors import InputError
from capture_rig.yaml_file import MOST_YAML_BYTES, format_mapping, parse_mapping, read_mapping, save_mapping

REMEDY = "Mend it."
ALIASES = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "\n".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 9)}]" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: " + "[" * 1000 + "]" * 1000, "line 1, column 43: nested more than 40 deep"),
        ("- " * 1000 + "a", "nested more than 40 deep"),
        ("b: 1\na: {b: " * 1000, "nested more than 40 deep|mapping"),
        (ALIASES, "line 6.* more than 100000 values"),
        ("a: &a [*a]", "holds itself"),
        ("b: 0\na: 1\na: 2", r"line 3, column 1: key 'a' appears twice"),
        ("? [1, 2]\n: 3", "a key is a list"),
        ("a: 1" + "0" * 30, "whole number of 31 digits"),
        ("a: " + "9" * 6000, "whole number of 6000 digits"),
        ("a: 2001-99-99", "a value does not fit its type"),
        ("a: !!timestamp soon", "a value does not fit its type"),
        ("a: !!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("a: \0", "unacceptable character"),
        ("a: [1", "line 1"),
        ("a: 1\n---\nb: 2", "line 2.*single document"),
        ("just text", "is not a mapping"),
    ],
)
def test_damaged_or_hostile_yaml_is_refused_with_its_place(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as refused:
        parse_mapping(text, "some.yaml", REMEDY)
    assert str(refused.value).startswith("some.yaml: ") and str(refused.value).endswith(REMEDY)
    assert len(str(refused.value)) < 400


def test_an_alias_within_the_limits_is_followed() -> None:
    assert parse_mapping("a: &x [1, 2]\nb: *x", "", REMEDY) == {"a": [1, 2], "b": [1, 2]}


def test_what_a_document_holds_twice_is_written_twice() -> None:
    shared = [1, 2]
    text = format_mapping({"a": shared, "b": shared}, default_flow_style=None)
    assert text == "a: [1, 2]\nb: [1, 2]\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"a: 1\nb: \xff\n", "line 2: invalid start byte"), (b"#" * (MOST_YAML_BYTES + 1), "is larger than 4 MiB")],
)
def test_a_file_that_is_no_text_or_too_large_is_refused(tmp_path, content: bytes, says: str) -> None:
    path = tmp_path / "some.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as refused:
        read_mapping(path, REMEDY)
    assert str(path) in str(refused.value) and REMEDY in str(refused.value)


def test_a_file_that_cannot_be_opened_is_refused(tmp_path) -> None:
    for path, says in (
        (tmp_path / "absent.yaml", "No such file"),
        (tmp_path, "directory|regular"),
        (tmp_path / ("x" * 5000), "File name too long"),
        (tmp_path / "nu\0ll", "is not a path"),
        ("/dev/zero", "is not a regular file"),
    ):
        with pytest.raises(InputError, match=says) as refused:
            read_mapping(path, REMEDY)
        assert len(str(refused.value)) < 500


def test_what_is_written_is_read_back(tmp_path) -> None:
    document = {"b": [1.5, 2.0], "a": {"name": "Küche", "on": True}}
    save_mapping(tmp_path / "some.yaml", document, "a heading")
    assert read_mapping(tmp_path / "some.yaml", REMEDY) == document
    assert (tmp_path / "some.yaml").read_text(encoding="utf-8").startswith("# a heading\nb:")
