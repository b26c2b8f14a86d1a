"""The service that saves the bodies that are followed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger

from icp_tracker.icp_ros import SaveBodyService, SaveBodySettings
from stick_figure.body import BUILD_NUMBERS, Body, load_body


class Asked:
    """The service on a node that hands requests over at once."""

    def __init__(self, folder):
        log = SimpleNamespace(info=lambda text: None)
        node = SimpleNamespace(create_service=self._take, get_logger=lambda: log)
        self.bodies = SaveBodyService(node, SaveBodySettings(str(folder)))

    def _take(self, kind, name, handler):
        self._handler = handler

    def __call__(self):
        return self._handler(Trigger.Request(), Trigger.Response())


def test_each_person_has_a_file_with_its_build_and_nobody_is_kept_who_was_forgotten(tmp_path):
    ask, folder, build = Asked(tmp_path / "bodies"), tmp_path / "bodies", np.linspace(-1.0, 1.0, BUILD_NUMBERS)
    built, other = replace(Body.from_stature(1.68), build=build), Body.from_stature(1.82)
    ask.bodies.keep(1, 123, built)
    assert ask().message == f"{folder}/body_123.yaml"
    assert load_body(folder / "body_123.yaml").lengths == pytest.approx(built.lengths)
    assert np.array_equal(load_body(folder / "body_123.yaml").build, build)
    ask.bodies.keep(3, 456, other)
    answer = ask()
    assert answer.success and answer.message == f"{folder}/body_123.yaml, {folder}/body_456_person3.yaml"
    assert load_body(folder / "body_456_person3.yaml").stature == pytest.approx(other.stature)
    ask.bodies.forget()
    answer = ask()
    assert not answer.success and "no body is followed yet" in answer.message


def test_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    ask = Asked(tmp_path / "file" / "bodies")
    ask.bodies.keep(1, 1, Body.from_stature(1.68))
    answer = ask()
    assert not answer.success and str(tmp_path / "file" / "bodies") in answer.message
