"""What a process of the graph knew and finds again after a crash, without a person: backgrounds and the body's sizes.

Rig, calibration and parameters are files that every start reads. What is learnt while the graph runs is kept here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rclpy.node import Node
from std_msgs.msg import String

from capture_rig.files import write_text
from sagoma_bringup.graph import NodeSpec, Role
from sagoma_bringup.processes import ProcessSpec
from sagoma_ros.qos import LATCHED

BODY_TOPIC, BODY_FILE, TRACKER = "/icp/body", "restored_body.yaml", "icp_tracker"
SOURCE, ANY_POSE = "initial_pose.source", "auto"


def with_kept_backgrounds(graph: Sequence[NodeSpec], folder: Path) -> tuple[NodeSpec, ...]:
    """Return the graph, the live cameras that save their background nowhere saving it into ``folder``."""
    return tuple(
        spec.with_parameters({"background_file": str((folder / f"{spec.label}_background.npz").resolve())})
        if spec.role is Role.CAMERA and not reads_file(spec) and not spec.parameters.get("background_file")
        else spec
        for spec in graph
    )


def reads_file(spec: NodeSpec) -> bool:
    """Return whether a node is a camera that plays footage."""
    return spec.role is Role.CAMERA and spec.parameters.get("source") == "footage"


class LastBody:
    """The body that the tracker last told of, for a tracker that is started again.

    One that finds whoever comes learns the sizes anew. One that takes its body from a T-pose, a file or a session
    would wait for that pose: it gets the sizes that it had, and finds the person in any pose.
    """

    def __init__(self, node: Node, folder: Path) -> None:
        self.text, self._path = "", (folder / BODY_FILE).resolve()
        self._subscription = node.create_subscription(String, BODY_TOPIC, self._take, LATCHED)

    def restored(self, process: ProcessSpec) -> dict[str, dict[str, object]]:
        """Full node name -> parameters with which the process's nodes find their body again."""
        return {
            node.full_name: self._parameters(node)
            for node in process.nodes
            if node.name == TRACKER and self.text and node.parameters.get(SOURCE, ANY_POSE) != ANY_POSE
        }

    def _parameters(self, tracker: NodeSpec) -> dict[str, object]:
        given = tracker.parameters.get("body_file")
        if not given:
            write_text(self._path, self.text)
        return {SOURCE: ANY_POSE, "body_file": given or str(self._path)}

    def _take(self, message: String) -> None:
        self.text = message.data
