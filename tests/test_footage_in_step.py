"""Footage at a rate on a live graph: a camera that begins late joins the others' frame sets."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray

from sagoma_bringup.graph import Role, build_graph
from sagoma_bringup.processes import THREE_PROCESSES
from sagoma_ros.qos import RESULT
from sagoma_tools.graph.lifecycle_client import State
from sagoma_tools.graph.processes import ProcessSettings
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor

PATIENCE_S = 120.0
RATE = 0.2  # a busy machine keeps up
SETS = 5


class FrameSets:
    """What the hull server says of each frame set."""

    def __init__(self, link: RosLink) -> None:
        self._came, self.sets = threading.Condition(), list[dict[str, str]]()
        link.node.create_subscription(DiagnosticArray, "/hull/frame_set", self._take, RESULT)

    def wait_for(self, count: int, missing: str) -> list[dict[str, str]]:
        """Return so many sets that lack just these cameras; fewer after PATIENCE_S."""

        def found() -> list[dict[str, str]]:
            return [one for one in self.sets if one["missing"] == missing]

        with self._came:
            self._came.wait_for(lambda: len(found()) >= count, PATIENCE_S)
            return found()

    def _take(self, message: DiagnosticArray) -> None:
        with self._came:
            self.sets.append({pair.key: pair.value for pair in message.status[0].values})
            self._came.notify_all()


@pytest.mark.slow
def test_sets_are_complete_though_one_camera_of_the_footage_begins_late(three_cameras: Path, tmp_path: Path):
    graph = build_graph(session=three_cameras, rate=RATE, loop=True)
    names = [spec.full_name for spec in graph]
    (late,) = (spec.full_name for spec in graph if spec.label == "cam03" and spec.role is Role.CAMERA)
    with (
        RosLink("listener") as link,
        Supervisor(graph, tmp_path / "run", ProcessSettings(THREE_PROCESSES)) as supervisor,
    ):
        seen = FrameSets(link)
        supervisor.configure(tolerate_cameras=False)
        assert supervisor.lifecycle.bring([[name for name in names if name != late]], State.ACTIVE).ok
        early = seen.wait_for(SETS, "cam03")
        assert len(early) >= SETS, seen.sets
        assert supervisor.lifecycle.bring([[late]], State.ACTIVE).ok
        whole = seen.wait_for(SETS, "")
        assert len(whole) >= SETS, seen.sets
        assert {float(one["spread_ms"]) for one in whole} == {0.0}  # equal stamps of all three
        supervisor.stop()
