"""The text of the one error that users see."""

from __future__ import annotations

import pickle

from capture_rig.errors import InputError


def test_error_reads_where_what_remedy() -> None:
    error = InputError("fps = 0 is not a frame rate", where="session.yaml", remedy="Give frames per second.")
    assert str(error) == "session.yaml: fps = 0 is not a frame rate. Give frames per second."


def test_error_without_place_or_remedy_is_one_sentence() -> None:
    assert str(InputError("the mask is empty")) == "the mask is empty."
    assert str(InputError("Is it plugged in?")) == "Is it plugged in?"


def test_error_survives_the_way_between_processes() -> None:
    error = InputError("what", where="where", remedy="remedy.")
    again = pickle.loads(pickle.dumps(error))
    assert (again.what, again.where, again.remedy, str(again)) == ("what", "where", "remedy.", str(error))
