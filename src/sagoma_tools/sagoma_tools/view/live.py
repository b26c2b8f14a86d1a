"""The live graph as the page shows it: persons, voxels, pictures, states; subscribed to only while somebody looks."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from functools import partial
from typing import Any

import cv2
import numpy as np
import viser
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from mocap_packets.hull import VoxelSamples
from motion_export.motion import point_deviations
from sagoma_ros.packets import read_packet, read_reference_points

from ..graph.diagnostics_table import DiagnosticsTable, NodeReport
from ..graph.ros_link import RosLink, in_graph, is_in_graph, namespace_of, our_nodes, topics_of
from ..graph.topics import FIRST_BODY_ID, OF_A_PERSON, cameras_in, message_class, persons_in
from .scene import Figure

LOOK_S = 1.0
"""How often the graph is asked who is there: names are cheap, but not free."""
GONE_S = 1.0
"""A person of whom nothing has come for so long is not drawn any more."""
VOXELS = ("/hull/voxels", "sensor_msgs/msg/PointCloud2")
PREVIEW = "/preview/compressed"
PICTURE_TYPE = "sensor_msgs/msg/CompressedImage"
PICTURE_WIDTH = 320


class LiveGraph:
    """Reads the graph through a node that another thread spins."""

    def __init__(self, link: RosLink, diagnostics: DiagnosticsTable) -> None:
        self._node, self._diagnostics = link.node, diagnostics
        self._feed = Feed(link.node)
        self._looked_s, self._wanted = -LOOK_S, (False, False)
        self._bodies: dict[str, str] = {}
        self._figures: dict[str, tuple[float, Figure]] = {}
        self._states: dict[str, str] = {}
        self._cameras: dict[str, str] = {}
        self._pictures: dict[str, viser.GuiImageHandle] = {}

    @property
    def watched(self) -> frozenset[str]:
        """The topics subscribed to."""
        return self._feed.watched

    def watch_nothing(self) -> None:
        """Leave all topics."""
        if self._feed.watched:
            self._feed.watch(())
            self._figures.clear()
        self._looked_s = -LOOK_S

    def watch(self, *, voxels: bool, pictures: bool) -> None:
        """Subscribe to what is shown, and, once a second, to persons and cameras who have come."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_S and (voxels, pictures) == self._wanted:
            return
        self._looked_s, self._wanted = now_s, (voxels, pictures)
        names = topics_of(self._node)
        others = [body_id for body_id in persons_in(names) if body_id != FIRST_BODY_ID]
        self._bodies = {FIRST_BODY_ID: "/mocap", **{body_id: f"/mocap/bodies/{body_id}" for body_id in others}}
        self._cameras = {
            camera: preview if (preview := f"/{camera}{PREVIEW}") in names else f"/{camera}/silhouette/compressed"
            for camera in cameras_in(names)
        }
        wanted = [
            (f"{prefix}/{what}", OF_A_PERSON[what])
            for prefix in self._bodies.values()
            for what in ("reference_points", "state")
        ]
        wanted += [VOXELS] if voxels else []
        wanted += [(topic, PICTURE_TYPE) for topic in self._cameras.values()] if pictures else []
        self._feed.watch(wanted)

    def new_figures(self) -> dict[str, Figure] | None:
        """Return everybody who is there, by id; None when nothing has changed."""
        now_s, changed = time.monotonic(), False
        for body_id, prefix in self._bodies.items():
            state = self._feed.pop_newest(f"{prefix}/state")
            if state is not None:
                self._states[body_id] = state.message
            cloud = self._feed.pop_newest(f"{prefix}/reference_points")
            if cloud is None:
                continue
            points = read_reference_points(cloud, f"{prefix}/reference_points")
            sigma = point_deviations(points.covariance)
            self._figures[body_id] = now_s, Figure(points.points_world, sigma, self._states.get(body_id, ""))
            changed = True
        gone = [body_id for body_id, (seen_s, _) in self._figures.items() if now_s - seen_s > GONE_S]
        for body_id in gone:
            del self._figures[body_id]
        if not (changed or gone):
            return None
        return {body_id: figure for body_id, (_, figure) in self._figures.items()}

    def new_voxels(self) -> np.ndarray | None:
        """Return the hull's voxels (m, 3), when there are newer ones."""
        cloud = self._feed.pop_newest(VOXELS[0])
        return None if cloud is None else read_packet(cloud, VoxelSamples, VOXELS[0]).points_world

    def reports(self) -> dict[str, NodeReport | None]:
        """Return the last report of every node that is in the graph or was heard, by its name in the namespace."""
        heard = {name for name in self._diagnostics.names() if is_in_graph(self._node, name)}
        namespace = namespace_of(self._node)
        names = sorted(our_nodes(self._node) | heard)
        return {name.removeprefix(namespace): self._diagnostics.report(name) for name in names}

    def draw_pictures(self, gui: viser.GuiApi, folder: viser.GuiFolderHandle) -> None:
        """Draw each camera's newest picture: its preview where the client publishes one, else its silhouette."""
        for order, (camera, topic) in enumerate(self._cameras.items()):
            message = self._feed.pop_newest(topic)
            if message is None:
                continue
            image = cv2.imdecode(np.frombuffer(bytes(message.data), np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                continue
            height = max(1, round(image.shape[0] * PICTURE_WIDTH / image.shape[1]))
            small = cv2.cvtColor(cv2.resize(image, (PICTURE_WIDTH, height)), cv2.COLOR_BGR2RGB)
            if camera in self._pictures:
                self._pictures[camera].image = small
            else:
                with folder:
                    self._pictures[camera] = gui.add_image(small, label=camera, format="jpeg", order=order)


# topics ---------------------------------------------------------------------------------------------------------------


NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""A page that is late drops what it missed, and no publisher waits for it."""


class Feed:
    """Keeps serialized messages as they come, and reads one only when the page draws it; safe from any thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._subscriptions: dict[str, Any] = {}
        self._kinds: dict[str, Any] = {}
        self._newest: dict[str, bytes] = {}

    def watch(self, wanted: Iterable[tuple[str, str]]) -> None:
        """Subscribe to these topics (name, type), and to no others any more."""
        kinds = dict(wanted)
        for name in [name for name in self._subscriptions if name not in kinds]:
            self._node.destroy_subscription(self._subscriptions.pop(name))
            with self._lock:
                self._newest.pop(name, None)
        for name, msgtype in kinds.items():
            if name not in self._subscriptions:
                self._kinds[name] = message_class(msgtype)
                keep = partial(self._keep, name)
                self._subscriptions[name] = self._node.create_subscription(
                    self._kinds[name], in_graph(self._node, name), keep, NEWEST, raw=True
                )

    @property
    def watched(self) -> frozenset[str]:
        """The topics that are subscribed to."""
        return frozenset(self._subscriptions)

    def pop_newest(self, name: str) -> Any | None:
        """Return the newest message of a topic, once; None while there is no newer one."""
        with self._lock:
            data = self._newest.pop(name, None)
        return None if data is None else deserialize_message(data, self._kinds[name])

    def _keep(self, name: str, data: bytes) -> None:
        with self._lock:
            if name in self._kinds:
                self._newest[name] = data
