"""ROS parts of the node: the service that saves bodies, inputs of 2D pose detectors, and the filter's feedback."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.files import make_folder
from capture_rig.rig import Rig
from capture_rig.stamps import NS_PER_S
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.keypoints import NUMBERS, Detections, keypoints_of
from mocap_packets.people import Predictions
from mocap_packets.state import Prediction
from sagoma_ros.health import LOG_EVERY_S
from sagoma_ros.messages import oversize, to_ns
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import vectors_of_cloud
from sagoma_ros.qos import SILHOUETTE_SUBSCRIBER
from stick_figure.body import Body, save_body
from stick_figure.least_squares.keypoint_factor import Keypoints

from .settings import SaveBodySettings

KEPT_IMAGES = 64  # of each camera: detections may be a second early, where the hull is late


class SaveBodyService:
    """Answers ``~/save_body``: writes the bodies and names the files, ``FOLDER/body_STAMP.yaml``, STAMP in ns, of the
    first person, ``body_STAMP_personN.yaml`` of the others."""

    def __init__(self, node: Node, settings: SaveBodySettings) -> None:
        self._node, self._settings = node, settings
        self._newest: dict[int, tuple[int, Body]] = {}  # by person, with the stamp of its first set
        self._service = node.create_service(Trigger, "~/save_body", self._on_save)

    def keep(self, person: int, stamp_ns: int, body: Body) -> None:
        """Keep the newest body of a tracked person, valid from a set on; any thread."""
        self._newest = self._newest | {person: (stamp_ns, body)}

    def forget(self) -> None:
        """Forget all bodies; any thread."""
        self._newest = {}

    def close(self) -> None:
        """Destroy the service."""
        self._node.destroy_service(self._service)

    def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        newest, written = self._newest, list[str]()
        response.success, response.message = False, "no body is followed yet: hold a T-pose, then ask again"
        for person, (stamp_ns, body) in sorted(newest.items()):
            others = "" if person == FIRST_PERSON else f"_person{person}"
            path = Path(self._settings.folder).expanduser().resolve() / f"body_{stamp_ns}{others}.yaml"
            try:
                make_folder(path.parent)
                save_body(body, path, source="icp_tracker")
            except InputError as error:
                response.success, response.message = False, str(error)
                break
            written.append(str(path))
            response.success, response.message = True, ", ".join(written)
        self._node.get_logger().info(f"save_body: {response.message}")
        return response


class KeypointInputs:
    """Collects detections that users' detectors publish on CAM/keypoints, and returns those of a frame set.

    A message is a cloud of one point a skeleton and one field a joint, of `mocap_packets.keypoints.NUMBERS` each; its
    stamp is that of the image.
    """

    def __init__(self, node: SagomaNode, rig: Rig, wait_s: float, recent_s: float) -> None:
        """A set waits ``wait_s`` at most for cameras whose last detections are less than ``recent_s`` older."""
        self._node, self._rig, self._wait_s, self._recent_ns = node, rig, wait_s, recent_s * NS_PER_S
        self._found = {name: deque[Detections](maxlen=KEPT_IMAGES) for name in rig.names}
        self._changed = threading.Condition()
        self._last_ns: int | None = None  # the stamp of the set before
        self._subscriptions = [
            node.create_subscription(
                PointCloud2, f"{name}/keypoints", partial(self._on_message, name), SILHOUETTE_SUBSCRIBER
            )
            for name in rig.names
        ]

    def of_set(self, stamp_ns: int) -> Keypoints:
        """Return the joints detected within half a period of a frame set."""
        half_ns = 0 if self._last_ns is None else max(stamp_ns - self._last_ns, 0) // 2
        self._last_ns = stamp_ns

        def off_ns(one: Detections) -> int:
            return abs(one.stamp_ns - stamp_ns)

        with self._changed:
            self._changed.wait_for(lambda: not self._is_awaited(stamp_ns - half_ns), self._wait_s)
            images = [min(found, key=off_ns) for found in self._found.values() if found]
        return keypoints_of(self._rig, (one for one in images if off_ns(one) <= half_ns))

    def forget(self) -> None:
        """Reset when stamps have gone back; any thread."""
        with self._changed:
            self._last_ns = None
            for found in self._found.values():
                found.clear()

    def close(self) -> None:
        """Destroy the subscriptions and end a wait."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self.forget()
        with self._changed:
            self._changed.notify_all()

    def _is_awaited(self, stamp_ns: int) -> bool:
        """Whether a camera's detector is behind the stamp, but not silent."""
        return any(0 < stamp_ns - found[-1].stamp_ns < self._recent_ns for found in self._found.values() if found)

    def _on_message(self, camera: str, message: PointCloud2) -> None:
        where = f"{camera}/keypoints"
        try:
            if excess := oversize(message):
                raise InputError(f"a message is refused: {excess}", where=where)
            names, values = vectors_of_cloud(message, len(NUMBERS), where)
        except InputError as error:
            self._node.health.count("bad_keypoints")
            self._node.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)
            return
        with self._changed:
            self._found[camera].append(Detections(camera, to_ns(message.header.stamp), names, values))
            self._changed.notify_all()


class FilterFeedback:
    """Provides the fit of set k with the filter's state after set k-1, after a bounded wait.

    A filter that did not answer in time is not waited for again until it answers; its newest state is used meanwhile.
    ``timeouts`` counts the waits that ended without an answer.
    """

    def __init__(self, wait_s: float) -> None:
        self._wait_s = wait_s
        self._changed = threading.Condition()
        self._open, self._silent = True, False
        self._sent_ns: int | None = None
        self._newest: Predictions | None = None
        self.waiting, self.timeouts = False, 0

    def update(self, predictions: Predictions) -> None:
        """Update the state (any thread); states of sets that were not sent yet are ignored."""
        with self._changed:
            if self._sent_ns is not None and predictions.stamp_ns <= self._sent_ns:
                self._newest, self._silent = predictions, False
                self._changed.notify_all()

    def sent(self, stamp_ns: int) -> None:
        """Set the stamp of the fits that go out; the filter answers with it."""
        with self._changed:
            self._sent_ns = stamp_ns

    def forget(self) -> None:
        """Reset when stamps have gone back: they may repeat those of earlier answers."""
        with self._changed:
            self._sent_ns = self._newest = None

    def close(self) -> None:
        """Release the thread that waits."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def after_previous_set(self) -> Mapping[int, Prediction]:
        """Return each person's state after the set last sent, or the newest earlier one when that did not come in time;
        empty without any."""
        with self._changed:
            if self._sent_ns is None:
                return {}
            self.waiting = True
            in_time = self._changed.wait_for(
                lambda: not self._open or self._stamp_ns == self._sent_ns, 0.0 if self._silent else self._wait_s
            )
            self.waiting = False
            self.timeouts += not in_time and not self._silent
            self._silent = not in_time
            return {} if self._newest is None else self._newest.of

    @property
    def _stamp_ns(self) -> int | None:
        return None if self._newest is None else self._newest.stamp_ns
