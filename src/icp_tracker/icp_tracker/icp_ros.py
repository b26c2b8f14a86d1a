"""What the node has besides the tracker: the service that saves the body, and the filter's awaited answer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node
from std_srvs.srv import Trigger

from mocap_packets.state import Prediction
from sagoma_ros.worker import Mailbox
from stick_figure.body import Body
from stick_figure.body_file import save_body

from .acquisition.body_sizes import LimbGirths
from .settings import SaveBodySettings


@dataclass(frozen=True, eq=False)
class SavedBody:
    """What is kept of a body: its sizes and, where they were measured, its limbs' thickness."""

    stamp_ns: int
    body: Body
    girths: LimbGirths | None = None


class SaveBodyService:
    """Answers ``~/save_body``: writes the body to ``FOLDER/body_STAMP.yaml``, STAMP in ns, and says so."""

    def __init__(self, node: Node, settings: SaveBodySettings) -> None:
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
            thickness = newest.girths.by_name() if newest.girths else None
            save_body(newest.body, path, source="icp_tracker", thickness=thickness)
        except OSError as error:
            response.success, response.message = False, f"{path}: cannot be written ({error.strerror})"
        else:
            response.success, response.message = True, str(path)
        self._node.get_logger().info(f"save_body: {response.message}")
        return response


KEPT = 64


class FilterFeedback:
    """Hands the fit of set k the filter's state after set k-1; what comes too late serves as the newest there is."""

    def __init__(self, wait_s: float) -> None:
        self.mailbox: Mailbox[Prediction] = Mailbox(KEPT, wait_s)
        self._asked_ns: int | None = None

    def put(self, prediction: Prediction) -> None:
        """Take a state that arrived (any thread)."""
        self.mailbox.put(prediction.stamp_ns, prediction)

    def asked(self, stamp_ns: int) -> None:
        """Remember the set whose reference points went out: the filter will answer with its stamp."""
        self._asked_ns = stamp_ns

    def after_previous_set(self) -> Prediction | None:
        """Return the state after the set last asked for, or the newest one when it did not come in time, or None."""
        if self._asked_ns is None:
            return None
        return self.mailbox.take(self._asked_ns) or self.mailbox.newest()
