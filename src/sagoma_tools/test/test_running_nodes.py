"""Nodes of the same names that other processes run: found before anything is asked of them."""

import os
import threading

import pytest

from sagoma_tools.graph import lifecycle_client as looks
from sagoma_tools.graph.lifecycle_client import Place, foreign_nodes, living_nodes, own_machine, places_of, run_already
from sagoma_tools.graph.ros_link import RosLink

HULL, CAMERA = "/hull_server", "/cam01/camera_client"
PIDS = {HULL: 7, CAMERA: 0x10009}
OURS = {HULL: [Place("78fd", 7)], CAMERA: [Place("78fd", 9)]}
UNKNOWN = Place("", 0)  # of another middleware


@pytest.mark.parametrize(
    ("found", "here", "foreign", "unknown"),
    [
        (OURS, "78fd", {}, []),
        (OURS | {"/ekf_tracker": [Place("78fd", 5)]}, "78fd", {}, []),
        ({}, "78fd", {}, [HULL, CAMERA]),
        ({HULL: [Place("3d11", 7)]}, "78fd", {HULL: [Place("3d11", 7)]}, [HULL, CAMERA]),
        (OURS | {HULL: [Place("78fd", 5), Place("78fd", 7)]}, "78fd", {HULL: [Place("78fd", 5)]}, []),
        ({HULL: [Place("78fd", 5)]}, "78fd", {HULL: [Place("78fd", 5)]}, [HULL, CAMERA]),
        ({HULL: [UNKNOWN], CAMERA: [UNKNOWN, UNKNOWN]}, "", {CAMERA: [UNKNOWN]}, []),
    ],
)
def test_nodes_of_other_processes_are_foreign_and_names_without_one_of_ours_are_awaited(found, here, foreign, unknown):
    assert foreign_nodes(found, here, PIDS) == (foreign, unknown)


def test_a_machine_knows_its_own_number_and_process_though_others_have_the_name_of_its_node():
    with RosLink("twin") as first, RosLink("twin") as second:
        here = own_machine(first.node)
        assert here == own_machine(second.node) != ""
        assert foreign_nodes(places_of(first.node), here, {"/twin": os.getpid()})[1] == []


@pytest.mark.parametrize(("places", "where"), [([Place("78fd", 5)], "this"), ([Place("3d11", 5)], "another")])
def test_refusal_names_the_nodes_the_machine_and_the_remedy(places, where):
    said = run_already({HULL: places}, "78fd")
    assert said.startswith(f"/hull_server run already in this ROS domain on {where} machine. End that graph")
    assert "ROS_DOMAIN_ID" in said


@pytest.mark.usefixtures("somebody_is_found")
def test_node_that_is_just_ending_is_waited_for_and_counts_no_longer(link, monkeypatch):
    monkeypatch.setattr(looks, "ANSWER_S", 60.0)
    ending = RosLink("hull_server")

    class Cancel(threading.Event):
        """Whoever waits has seen the node, which then ends."""

        def wait(self, timeout=None):
            ending.close()
            return super().wait(timeout)

    assert living_nodes(link.node, {HULL}, Cancel()) == {}
    assert not ending.context.ok()


@pytest.mark.usefixtures("somebody_is_found")
def test_node_that_answers_nothing_counts_once_its_lease_is_over(link, monkeypatch):
    monkeypatch.setattr(looks, "LEASE_S", 0.0)
    with RosLink("hull_server"):
        found = living_nodes(link.node, {HULL, CAMERA}, threading.Event())
    assert list(found) == [HULL] and found[HULL][0].process == os.getpid() & 0xFFFF
