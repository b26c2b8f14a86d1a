"""Subscriptions that collect facts for the doctor: diagnostics, silhouettes, frame sets."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, cast

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage

from capture_rig.mask_levels import SHADOW_CANDIDATE
from sagoma_ros import mask_png
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import RESULT, SILHOUETTE_SUBSCRIBER

from ...graph.topics import CAMERA_INFO_SUFFIX, DIAGNOSTICS_TOPIC, LOSSLESS, SILHOUETTE_SUFFIX
from .facts import Canvas, FrameSetFacts, NodeFacts, SilhouetteFacts

FRAME_SET_TOPIC = "/hull/frame_set"
LOOK_PERIOD_NS = 100_000_000  # a mask is decoded so often, at most


class DiagnosticsSubscriber:
    """Collects all nodes' diagnostics, and the difference of their stamps from their arrival here."""

    def __init__(self, node: Node) -> None:
        self._lock = threading.Lock()
        self._heard: dict[str, list[tuple[int, int]]] = {}
        self._last: dict[str, Any] = {}
        _subscribe(node, DiagnosticArray, DIAGNOSTICS_TOPIC, self._take, LOSSLESS)

    @property
    def names(self) -> set[str]:
        """The nodes heard so far (the status of a node begins with "/")."""
        with self._lock:
            return {name for name in self._last if name.startswith("/")}

    def facts(self, name: str, **known: Any) -> NodeFacts:
        """Return the facts of this node; ``known`` are those from elsewhere."""
        with self._lock:
            heard, last = list(self._heard.get(name, [])), self._last.get(name)
        if last is None:
            return NodeFacts(name, **known)
        span_s = 1e-9 * (heard[-1][0] - heard[0][0])
        return NodeFacts(
            name,
            reports=len(heard),
            level=last.level[0],
            message=last.message,
            values={pair.key: pair.value for pair in last.values},
            rate_hz=_rate(len(heard), span_s),
            lead_s=tuple(1e-9 * (stamp - arrival) for arrival, stamp in heard),
            **known,
        )

    def _take(self, message: DiagnosticArray, info: Any) -> None:
        stamp_ns = to_ns(message.header.stamp)
        with self._lock:
            for status in message.status:
                self._heard.setdefault(status.name, []).append((info["received_timestamp"], stamp_ns))
                self._last[status.name] = status


class SilhouetteSubscriber:
    """Collects one camera's silhouettes and camera_info."""

    def __init__(self, node: Node, camera: str) -> None:
        self.camera, self._node = camera, node
        self._topic = f"/{camera}{SILHOUETTE_SUFFIX}"
        self._lock = threading.Lock()
        self._arrivals_ns: list[int] = []
        self._numbers: list[int] = []
        self._ages_ns: list[int] = []
        self._shares: list[float] = []
        self._sizes: set[tuple[int, int]] = set()
        self._changes = self._infos = self._largest = self._looked_ns = 0
        self._bad, self._last = "", b""
        self._canvas: Canvas | None = None
        _subscribe(node, CompressedImage, self._topic, self._take, SILHOUETTE_SUBSCRIBER)
        node.create_subscription(CameraInfo, f"/{camera}{CAMERA_INFO_SUFFIX}", self._take_info, SILHOUETTE_SUBSCRIBER)

    def facts(self) -> SilhouetteFacts:
        """Return the facts so far."""
        publishers = self._node.count_publishers(self._topic)
        with self._lock:
            arrivals, numbers = self._arrivals_ns, self._numbers
            span_s = 1e-9 * (arrivals[-1] - arrivals[0]) if arrivals else 0.0
            return SilhouetteFacts(
                self.camera,
                publishers,
                self._infos,
                self._canvas,
                len(arrivals),
                self._bad,
                lost=numbers[-1] - numbers[0] + 1 - len(numbers) if publishers == 1 and numbers else 0,
                sizes=tuple(sorted(self._sizes)),
                shares=tuple(self._shares),
                changes=self._changes,
                age_s=1e-9 * float(np.median(self._ages_ns)) if self._ages_ns else None,
                rate_hz=_rate(len(arrivals), span_s),
                largest_bytes=self._largest,
            )

    def _take(self, message: CompressedImage, info: Any) -> None:
        data, now_ns = bytes(message.data), info["received_timestamp"]
        with self._lock:
            self._arrivals_ns.append(now_ns)
            if info.get("publication_sequence_number") is not None:
                self._numbers.append(info["publication_sequence_number"])
            self._ages_ns.append(now_ns - to_ns(message.header.stamp))
            self._changes += bool(self._last) and data != self._last
            self._last, self._largest = data, max(self._largest, len(data))
            if now_ns - self._looked_ns >= LOOK_PERIOD_NS:
                self._looked_ns = now_ns
                self._look(data)

    def _look(self, data: bytes) -> None:
        mask: np.ndarray | None = mask_png.decode(data)
        if mask is None:
            mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            self._bad = "the image cannot be decoded"
            return
        self._sizes.add((mask.shape[1], mask.shape[0]))
        self._shares.append(float((mask > SHADOW_CANDIDATE).mean()))

    def _take_info(self, message: CameraInfo) -> None:
        k = message.k
        with self._lock:
            self._infos += 1
            self._canvas = Canvas(message.width, message.height, float(k[0]), float(k[4]), float(k[2]), float(k[5]))


class FrameSetSubscriber:
    """Collects the hull server's diagnostics of its frame sets."""

    def __init__(self, node: Node) -> None:
        self._lock = threading.Lock()
        self._sets: list[tuple[int, Mapping[str, str]]] = []
        _subscribe(node, DiagnosticArray, FRAME_SET_TOPIC, self._take, RESULT)

    def facts(self) -> FrameSetFacts | None:
        """Return the facts so far; None when no frame set was heard."""
        with self._lock:
            sets = list(self._sets)
        if not sets:
            return None
        published = [values for _, values in sets]
        return FrameSetFacts(
            len(sets),
            _rate(len(sets), 1e-9 * (sets[-1][0] - sets[0][0])),
            _floats(published, "spread_ms"),
            _floats(published, "published_ms"),
            tuple(int(value) for value in _floats(published, "points")),
            _named(published, "missing"),
            _named(published, "left_out"),
        )

    def _take(self, message: DiagnosticArray, info: Any) -> None:
        values = {pair.key: pair.value for status in message.status for pair in status.values}
        with self._lock:
            self._sets.append((info["received_timestamp"], values))


def _subscribe(node: Node, kind: type, topic: str, take: Callable[[Any, Any], None], qos: QoSProfile) -> None:
    """Subscribe with a callback that gets the message and its times; rclpy's annotation has the message alone."""
    node.create_subscription(kind, topic, cast(Callable[[Any], None], take), qos)


def _rate(count: int, span_s: float) -> float:
    return (count - 1) / span_s if count > 1 and span_s > 0 else 0.0


def _floats(published: list[Mapping[str, str]], key: str) -> tuple[float, ...]:
    return tuple(float(values[key]) for values in published if key in values)


def _named(published: list[Mapping[str, str]], key: str) -> dict[str, int]:
    return dict(Counter(name for values in published for name in values.get(key, "").split(",") if name))
