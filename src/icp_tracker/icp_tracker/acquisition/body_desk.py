"""The service that saves the body being followed, so that it can be started without a T-pose the next time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node
from std_srvs.srv import Trigger

from capture_rig.settings import setting
from stick_figure.body import Body
from stick_figure.body_file import save_body

from .flesh_sizes import FleshSizes


@dataclass(frozen=True)
class BodyDeskSettings:
    """Where bodies are saved."""

    folder: str = setting("output/bodies", "folder that ~/save_body writes body_STAMP.yaml to")


@dataclass(frozen=True, eq=False)
class SavedBody:
    """What is worth keeping of a body: its sizes and, where they were measured, its limbs' thickness."""

    stamp_ns: int
    body: Body
    flesh: FleshSizes | None = None


class BodyDesk:
    """Answers ``~/save_body``: writes the body to ``FOLDER/body_STAMP.yaml``, STAMP in ns, and says so."""

    def __init__(self, node: Node, settings: BodyDeskSettings) -> None:
        self._node, self._settings = node, settings
        self._newest: SavedBody | None = None
        self._service = node.create_service(Trigger, "~/save_body", self._on_save)

    def keep(self, newest: SavedBody | None) -> None:
        """Remember the body that is followed (None: nobody any more); any thread."""
        self._newest = newest

    def close(self) -> None:
        """Take the service back."""
        self._node.destroy_service(self._service)

    def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        newest = self._newest
        if newest is None:
            response.success, response.message = False, "no body is followed yet: hold a T-pose, then ask again"
            return response
        path = Path(self._settings.folder).expanduser().resolve() / f"body_{newest.stamp_ns}.yaml"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            thickness = newest.flesh.by_name() if newest.flesh else None
            save_body(newest.body, path, source="icp_tracker", thickness=thickness)
        except OSError as error:
            response.success, response.message = False, f"{path}: cannot be written ({error.strerror})"
        else:
            response.success, response.message = True, str(path)
        self._node.get_logger().info(f"save_body: {response.message}")
        return response
