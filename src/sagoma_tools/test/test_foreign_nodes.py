"""Nodes of the same names on other machines: found before anything is asked of them."""

import pytest

from sagoma_tools.graph.foreign_nodes import foreign_names, machines_of, own_machine
from sagoma_tools.graph.ros_link import RosLink

HULL, CAMERA = "/hull_server", "/cam01/camera_client"


@pytest.mark.parametrize(
    ("machines", "here", "foreign", "unknown"),
    [
        ({HULL: {"78fd"}, CAMERA: {"78fd"}}, "78fd", [], []),
        ({HULL: {"3d11"}}, "78fd", [HULL], [CAMERA]),
        ({HULL: {"3d11", "78fd"}, CAMERA: {"78fd"}}, "78fd", [HULL], []),
        ({"/ekf_tracker": {"3d11"}}, "78fd", [], [HULL, CAMERA]),
        ({HULL: {""}, CAMERA: {""}}, "", [], []),
    ],
)
def test_names_on_other_machines_are_foreign_and_those_that_nobody_has_are_awaited(machines, here, foreign, unknown):
    assert foreign_names(machines, here, [HULL, CAMERA]) == (foreign, unknown)


def test_a_machine_knows_its_own_number_though_others_have_the_name_of_its_node():
    with RosLink("twin") as first, RosLink("twin") as second:
        assert own_machine(first.node) == own_machine(second.node) != ""
        assert all(places <= {own_machine(first.node)} for places in machines_of(first.node).values())
