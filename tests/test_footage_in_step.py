"""Footage at a rate on a live graph: a camera that begins late joins the others' frame sets."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from heard import Heard

from sagoma_bringup.graph import THREE_PROCESSES, Role, build_graph
from sagoma_tools.graph.lifecycle_client import State
from sagoma_tools.graph.processes import ProcessSettings
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor

PATIENCE_S = 120.0
RATE = 0.2  # a busy machine keeps up
SETS = 5


def values_of(message: DiagnosticArray) -> dict[str, str]:
    """What the hull server says of a frame set."""
    return {pair.key: pair.value for pair in message.status[0].values}


@pytest.mark.slow
def test_sets_are_complete_though_one_camera_of_the_footage_begins_late(three_cameras: Path, tmp_path: Path):
    graph = build_graph(session=three_cameras, rate=RATE, loop=True)
    names = [spec.full_name for spec in graph]
    (late,) = (spec.full_name for spec in graph if spec.label == "cam03" and spec.role is Role.CAMERA)
    with (
        RosLink("listener") as link,
        Supervisor(graph, tmp_path / "run", ProcessSettings(THREE_PROCESSES)) as supervisor,
    ):
        seen = Heard(link.node, DiagnosticArray, "/hull/frame_set", PATIENCE_S, values_of)
        supervisor.configure(tolerate_cameras=False)
        assert supervisor.lifecycle.bring([[name for name in names if name != late]], State.ACTIVE).ok
        assert seen.wait_for(SETS, lambda one: one["missing"] == "cam03"), seen.kept
        assert supervisor.lifecycle.bring([[late]], State.ACTIVE).ok
        assert seen.wait_for(SETS, lambda one: not one["missing"]), seen.kept
        assert {float(one["spread_ms"]) for one in seen.kept if not one["missing"]} == {0.0}  # equal stamps of all
        supervisor.stop()
