"""What the node has besides the tracker: the service that saves the body, and the filter's awaited answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.files import make_folder
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.people import Predictions
from mocap_packets.state import Prediction
from sagoma_ros.worker import Mailbox
from stick_figure.body import Body
from stick_figure.body_file import save_body

from .settings import SaveBodySettings


@dataclass(frozen=True, eq=False)
class SavedBody:
    """What is kept of a body: its sizes and its build."""

    stamp_ns: int
    body: Body


class SaveBodyService:
    """Answers ``~/save_body``: writes the bodies and names the files, ``FOLDER/body_STAMP.yaml``, STAMP in ns, of the
    first person, ``body_STAMP_personN.yaml`` of the others."""

    def __init__(self, node: Node, settings: SaveBodySettings) -> None:
        self._node, self._settings = node, settings
        self._newest: dict[int, SavedBody] = {}
        self._service = node.create_service(Trigger, "~/save_body", self._on_save)

    def keep(self, person: int, newest: SavedBody) -> None:
        """Remember the body of a person who is followed; any thread."""
        self._newest = self._newest | {person: newest}

    def forget(self) -> None:
        """Forget everybody: nobody is followed any more; any thread."""
        self._newest = {}

    def close(self) -> None:
        """Take the service back."""
        self._node.destroy_service(self._service)

    def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        newest, written = self._newest, list[str]()
        response.success, response.message = False, "no body is followed yet: hold a T-pose, then ask again"
        for person, saved in sorted(newest.items()):
            others = "" if person == FIRST_PERSON else f"_person{person}"
            path = Path(self._settings.folder).expanduser().resolve() / f"body_{saved.stamp_ns}{others}.yaml"
            try:
                make_folder(path.parent)
                save_body(saved.body, path, source="icp_tracker")
            except InputError as error:
                response.success, response.message = False, str(error)
                break
            written.append(str(path))
            response.success, response.message = True, ", ".join(written)
        self._node.get_logger().info(f"save_body: {response.message}")
        return response


KEPT = 64


class FilterFeedback:
    """Hands the fit of set k the filter's state after set k-1; what comes too late serves as the newest there is."""

    def __init__(self, wait_s: float) -> None:
        self.mailbox: Mailbox[Predictions] = Mailbox(KEPT, wait_s)
        self._asked_ns: int | None = None

    def put(self, predictions: Predictions) -> None:
        """Take a state that arrived (any thread)."""
        self.mailbox.put(predictions.stamp_ns, predictions)

    def asked(self, stamp_ns: int) -> None:
        """Remember the set whose reference points went out: the filter will answer with its stamp."""
        self._asked_ns = stamp_ns

    def forget(self) -> None:
        """Forget what was asked and what was answered: stamps begin anew, and may be those of earlier answers."""
        self._asked_ns = None
        self.mailbox.forget()

    def after_previous_set(self) -> Mapping[int, Prediction]:
        """Return each person's state after the set last asked for, or the newest before it when that did not come in
        time; nobody's when there is none."""
        if self._asked_ns is None:
            return {}
        found = self.mailbox.take(self._asked_ns) or self.mailbox.newest()
        return found.of if found is not None and found.stamp_ns <= self._asked_ns else {}
