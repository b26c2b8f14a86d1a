"""The service that saves the bodies that are followed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger

from icp_tracker.icp_ros import SaveBodyService, SaveBodySettings
from stick_figure.body import BUILD_NUMBERS, Body, load_body


def service_and_request(folder):
    """The service on a node that hands requests over at once, and what asks it."""
    handlers, log = [], SimpleNamespace(info=lambda text: None)
    node = SimpleNamespace(create_service=lambda kind, name, handler: handlers.append(handler), get_logger=lambda: log)
    bodies = SaveBodyService(node, SaveBodySettings(str(folder)))
    return bodies, lambda: handlers[0](Trigger.Request(), Trigger.Response())


def test_each_person_has_a_file_with_its_build_and_nobody_is_kept_who_was_forgotten(tmp_path):
    folder, build = tmp_path / "bodies", np.linspace(-1.0, 1.0, BUILD_NUMBERS)
    bodies, ask = service_and_request(folder)
    built, other = replace(Body.from_stature(1.68), build=build), Body.from_stature(1.82)
    bodies.keep(1, 123, built)
    assert ask().message == f"{folder}/body_123.yaml"
    saved = load_body(folder / "body_123.yaml")
    assert saved.lengths == pytest.approx(built.lengths) and np.array_equal(saved.build, build)
    bodies.keep(3, 456, other)
    answer = ask()
    assert answer.success and answer.message == f"{folder}/body_123.yaml, {folder}/body_456_person3.yaml"
    assert load_body(folder / "body_456_person3.yaml").stature == pytest.approx(other.stature)
    bodies.forget()
    answer = ask()
    assert not answer.success and "no body is followed yet" in answer.message


def test_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    bodies, ask = service_and_request(tmp_path / "file" / "bodies")
    bodies.keep(1, 1, Body.from_stature(1.68))
    answer = ask()
    assert not answer.success and str(tmp_path / "file" / "bodies") in answer.message
