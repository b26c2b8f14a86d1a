"""The service that saves the bodies that are followed."""

import os
from dataclasses import replace

import numpy as np
import pytest
import rclpy
from node_probe import Spinner
from std_srvs.srv import Trigger

from icp_tracker.icp_ros import SaveBodyService, SaveBodySettings
from stick_figure.body import BUILD_NUMBERS, Body, load_body

NAMESPACE = f"/test_body_desk_{os.getpid()}"


class SavingProbe(Spinner):
    """A node with the service, and its client."""

    def __init__(self, context, folder):
        super().__init__(context)
        self.node = self.add(rclpy.create_node("tracker", context=context, namespace=NAMESPACE))
        self.service = SaveBodyService(self.node, SaveBodySettings(str(folder)))
        self.client = self.node.create_client(Trigger, "~/save_body")

    def ask(self):
        self.until(self.client.service_is_ready)
        response = self.client.call_async(Trigger.Request())
        self.until(response.done)
        return response.result()

    def close(self):
        self.service.close()
        super().close()


@pytest.fixture
def counter(open_probe, tmp_path):
    return lambda folder=tmp_path / "bodies": open_probe(SavingProbe, folder)


def test_each_person_has_a_file_with_its_build_and_nobody_is_kept_who_was_forgotten(counter, tmp_path):
    asked, folder, build = counter(), tmp_path / "bodies", np.linspace(-1.0, 1.0, BUILD_NUMBERS)
    built, other = replace(Body.from_stature(1.68), build=build), Body.from_stature(1.82)
    asked.service.keep(1, 123, built)
    assert asked.ask().message == f"{folder}/body_123.yaml"
    assert load_body(folder / "body_123.yaml").lengths == pytest.approx(built.lengths)
    assert np.array_equal(load_body(folder / "body_123.yaml").build, build)
    asked.service.keep(3, 456, other)
    answer = asked.ask()
    assert answer.success and answer.message == f"{folder}/body_123.yaml, {folder}/body_456_person3.yaml"
    assert load_body(folder / "body_456_person3.yaml").stature == pytest.approx(other.stature)
    asked.service.forget()
    answer = asked.ask()
    assert not answer.success and "no body is followed yet" in answer.message


def test_folder_that_cannot_be_written_is_named(counter, tmp_path):
    (tmp_path / "file").write_text("")
    asked = counter(tmp_path / "file" / "bodies")
    asked.service.keep(1, 1, Body.from_stature(1.68))
    answer = asked.ask()
    assert not answer.success and str(tmp_path / "file" / "bodies") in answer.message
