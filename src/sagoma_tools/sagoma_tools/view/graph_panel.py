"""The controls of the live graph beside the scene: lifecycle, background, recording, every node's state, pictures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from html import escape
from typing import Any

import cv2
import numpy as np
import viser
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from mocap_packets.hull import VoxelSamples
from motion_export.motion import point_deviations
from sagoma_ros.packets import read_packet, read_reference_points

from ..graph import ROUND_S
from ..graph.diagnostics_table import LATENCY, STALE_S, DiagnosticsTable, NodeReport
from ..graph.lifecycle_client import LifecycleState
from ..graph.ros_link import RosLink, in_graph, is_camera, is_in_graph, label_of, namespace_of, our_nodes, topics_of
from ..graph.topics import FIRST_BODY_ID, OF_A_PERSON, cameras_in, message_class, persons_in
from ..takes.folder import TakesFolder
from .control import Control, Deliver, Jobs, Work, add_buttons
from .scene import PersonPose

VOXELS = ("/hull/voxels", "sensor_msgs/msg/PointCloud2")
PREVIEW = "/preview/compressed"
PICTURE_TYPE = "sensor_msgs/msg/CompressedImage"
PICTURE_WIDTH = 320


class LiveGraph:
    """Reads the graph through a node that another thread spins."""

    def __init__(self, link: RosLink, diagnostics: DiagnosticsTable) -> None:
        self._node, self._diagnostics = link.node, diagnostics
        self._feed = Feed(link.node)
        self._looked_s, self._wanted = -ROUND_S, (False, False)
        self._bodies: dict[str, str] = {}
        self._figures: dict[str, tuple[float, PersonPose]] = {}
        self._states: dict[str, str] = {}
        self._cameras: dict[str, str] = {}
        self._pictures: dict[str, viser.GuiImageHandle] = {}

    def watch_nothing(self) -> None:
        """Leave all topics."""
        self._feed.watch(())
        self._figures.clear()
        self._looked_s = -ROUND_S

    def watch(self, *, voxels: bool, pictures: bool) -> None:
        """Subscribe to the shown topics, and once a round to new persons and cameras, as discovery is expensive."""
        now_s = time.monotonic()
        if now_s - self._looked_s < ROUND_S and (voxels, pictures) == self._wanted:
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

    def figures(self) -> dict[str, PersonPose]:
        """Return everybody with a message within the last round, by id."""
        now_s = time.monotonic()
        for body_id, prefix in self._bodies.items():
            if (state := self._feed.pop_newest(f"{prefix}/state")) is not None:
                self._states[body_id] = state.message
            if (cloud := self._feed.pop_newest(f"{prefix}/reference_points")) is not None:
                points = read_reference_points(cloud, f"{prefix}/reference_points")
                sigma_m = point_deviations(points.covariance)
                self._figures[body_id] = now_s, PersonPose(points.points_world, sigma_m, self._states.get(body_id, ""))
        return {body_id: figure for body_id, (seen_s, figure) in self._figures.items() if now_s - seen_s < ROUND_S}

    def new_voxels(self) -> np.ndarray | None:
        """Return the hull's voxels (m, 3), when there are newer ones."""
        cloud = self._feed.pop_newest(VOXELS[0])
        return None if cloud is None else read_packet(cloud, VoxelSamples, VOXELS[0]).points_world

    def reports(self) -> dict[str, NodeReport | None]:
        """Return the last report of every node in the graph or with a report, by its name in the namespace."""
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
"""A page that is late drops messages, and no publisher waits for it."""


class Feed:
    """Keeps serialized messages as they come, and reads one only when the page draws it; safe from any thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: dict[str, Any] = {}
        self._newest: dict[str, tuple[Any, bytes]] = {}

    def watch(self, wanted: Iterable[tuple[str, str]]) -> None:
        """Subscribe to these topics (name, type), and to no others any more."""
        kinds = dict(wanted)
        for name in self._subscriptions.keys() - kinds.keys():
            self._node.destroy_subscription(self._subscriptions.pop(name))
            self._newest.pop(name, None)
        for name in kinds.keys() - self._subscriptions.keys():
            kind = message_class(kinds[name])
            self._subscriptions[name] = self._node.create_subscription(
                kind, in_graph(self._node, name), partial(self._keep, name, kind), NEWEST, raw=True
            )

    def pop_newest(self, name: str) -> Any | None:
        """Return the newest message of a topic, once; None while there is no newer one."""
        kind, data = self._newest.pop(name, (None, b""))
        return None if kind is None else deserialize_message(data, kind)

    def _keep(self, name: str, kind: Any, data: bytes) -> None:
        self._newest[name] = kind, data


# the live graph -------------------------------------------------------------------------------------------------------


COUNTDOWN_S = 10


class GraphPanel:
    """The tabs "Live" and "Cameras" of the graph that ``link`` is in; recordings go into ``takes``."""

    def __init__(
        self, gui: viser.GuiApi, tabs: viser.GuiTabGroupHandle, link: RosLink, takes: TakesFolder, jobs: Jobs
    ) -> None:
        diagnostics = DiagnosticsTable(link.node)
        self.live, self.control, self._gui = LiveGraph(link, diagnostics), Control(link, diagnostics, takes, jobs), gui
        with tabs.add_tab("Live"):
            _add_controls(gui, self.control, jobs)
            self.voxels = gui.add_checkbox("hull voxels", False)
            self._states = gui.add_html("")  # below: its length changes, and buttons must not move under the mouse
        with tabs.add_tab("Cameras"):
            hint = "what each camera sees with its silhouette's outline, a few times a second"
            self._pictures = gui.add_checkbox("pictures", False, hint=hint)
            self._picture_folder = gui.add_folder(None)

    def figures(self) -> dict[str, PersonPose]:
        """Return everybody, and subscribe to the requested topics."""
        self.live.watch(voxels=self.voxels.value, pictures=self._pictures.value)
        return self.live.figures()

    def show(self) -> None:
        """Show every node's state and the cameras' newest pictures."""
        self._states.content = states_html(self.live.reports(), time.monotonic())
        if self._pictures.value:
            self.live.draw_pictures(self._gui, self._picture_folder)

    def close(self) -> None:
        """Finish a recording under way; subscribe to nothing any more."""
        self.live.watch_nothing()
        self.control.close()


def _add_controls(gui: viser.GuiApi, control: Control, jobs: Jobs) -> None:
    """Recording, lifecycle, reset, and the countdown to learn the background."""

    def job(what: str, work: Work) -> Callable[[Deliver], object]:
        return lambda send: jobs.request(what, work)

    name = gui.add_text("name of the take", "", hint="by date and time without one")
    recording = {
        "record": job("recording", lambda: control.start_recording(name.value)),
        "finish recording": job("finishing", control.stop_recording),
    }
    add_buttons(gui, "recording", recording)
    nodes = {
        "connect": job("connecting", lambda: control.bring(LifecycleState.INACTIVE)),
        "start": job("starting", lambda: control.bring(LifecycleState.ACTIVE)),
        "suspend": job("suspending", lambda: control.bring(LifecycleState.INACTIVE)),
        "stop": job("stopping", lambda: control.bring(LifecycleState.UNCONFIGURED)),
    }
    add_buttons(gui, "nodes", nodes)
    add_buttons(gui, "persons", {"reset": job("resetting", control.reset)}, hint="forget everybody, and look anew")
    seconds = gui.add_number("countdown, s", COUNTDOWN_S, min=0, max=120, step=1)
    background: dict[str, Callable[[Deliver], object]] = {
        "learn background": job("learning", lambda: control.learn_background(int(seconds.value))),
        "cancel": lambda send: jobs.cancelled.set(),
    }
    add_buttons(gui, "background", background)


# states as HTML -------------------------------------------------------------------------------------------------------


GREEN, AMBER, RED, GREY = "#3cbe5a", "#f0aa1e", "#e5484d", "#868e96"
COLOURS = {DiagnosticStatus.OK: GREEN, DiagnosticStatus.WARN: AMBER, DiagnosticStatus.ERROR: RED}
RATE = "rate_hz"  # of the diagnostics: results a second
SILENT = (
    "no word since {} ({:.0f} s): its process has ended, or its computer or network is down; see its log, and start it "
    "again"
)
NO_NODES = "no node is in the graph yet: `sagoma up SESSION` plays footage, docs/tutorials/first_capture.md to cameras"
UNHEARD = "has not been heard yet"


def states_html(reports: Mapping[str, NodeReport | None], now_s: float) -> str:
    """Return a block a node (full name -> its last report), cameras last; those in trouble first of their kind."""
    if not reports:
        return _html(GREY, "nothing to see yet", "", NO_NODES)
    blocks = {name: _condition(report, now_s) for name, report in reports.items()}
    order = sorted(blocks, key=lambda name: (is_camera(name), blocks[name][0] != RED, name))
    return "".join(_html(blocks[name][0], label_of(name), *blocks[name][1:]) for name in order)


def _condition(report: NodeReport | None, now_s: float) -> tuple[str, str, str]:
    """Return a node's colour, figures and message."""
    if report is None:
        return GREY, "", UNHEARD
    silent_s = now_s - report.heard_s
    if silent_s > STALE_S:
        since = time.strftime("%H:%M:%S", time.localtime(time.time() - silent_s))
        return RED, "", SILENT.format(since, silent_s)
    figures = [f"{report.values[RATE]} Hz"] if RATE in report.values else []
    figures += [f"{report.values[LATENCY]} ms old"] if LATENCY in report.values else []
    figures += [f"{count} {key.replace('_', ' ')}" for key, count in report.losses().items()]
    return COLOURS.get(report.level, RED), ", ".join(figures), report.message


def _html(colour: str, label: str, figures: str, says: str) -> str:
    return (
        f'<div style="border-left: 4px solid {colour}; padding: 0 0 2px 8px; margin: 0 10px 6px 10px; font-size: 13px; '
        f'line-height: 1.35; overflow-wrap: anywhere">'
        f"<b>{escape(label)}</b> "
        f'<span style="opacity: 0.7">{escape(figures)}</span>'
        f"<br>{escape(says)}</div>"
    )
