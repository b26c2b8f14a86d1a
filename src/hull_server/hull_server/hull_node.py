"""The hull server's node: collects silhouettes into frame sets, carves them, publishes the results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import monotonic_ns

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image, PointCloud2

from capture_rig import CameraModel, InputError, Rig, load_rig
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import PARTS
from mocap_packets.table import SetAges
from sagoma_ros import mask_png
from sagoma_ros.health import WARN
from sagoma_ros.images import support_message
from sagoma_ros.inputs import Worker
from sagoma_ros.intra_process import LazyPublisher, PacketPublisher
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import HULL_PRODUCTS, packet_cloud
from sagoma_ros.poses import FramePublisher
from sagoma_ros.process import run_node

from .hull_pipeline import HullPipeline, HullResult, Mask, PendingHull
from .hull_ros import OverloadControl, SaveMeshService, camera_frames, camera_values, frame_set_message, summarise
from .overload import ThinningControl
from .settings import NodeSettings
from .silhouette_input_ros import SilhouetteInput


class HullNode(SagomaNode):
    """Silhouettes of all cameras in; hull/products, its parts as clouds, and hull/frame_set out, one each per set; a
    few times a second CAM/silhouette/support."""

    Settings = NodeSettings

    def __init__(self, **options: object) -> None:
        super().__init__("hull_server", **options)
        self._pipeline: HullPipeline | None = None
        self.silhouettes: SilhouetteInput | None = None
        # one thread begins the next set, closed at a time, while the other finishes and publishes this one, closed and
        # begun at two times, by the ROS clock
        self._carver: Worker[tuple[FrameSet[Mask], int]] | None = None
        self._slicer: Worker[tuple[PendingHull, int, int]] | None = None
        self._mesh: SaveMeshService | None = None
        self._canvases: dict[str, CameraModel] = {}
        self._newest: HullResult | None = None
        self.health.describe(self._describe)
        self._thinning = ThinningControl()  # keeps every frame unless an overload control updates it
        self._overload: OverloadControl | None = None
        self._closing: list[Callable[[], object]] = []  # releases what configure has opened

    def configure(self) -> None:
        """Load the rig, compute the calibration's tables, subscribe."""
        settings: NodeSettings = self.settings
        rig = self._load_rig()
        self._pipeline = HullPipeline(rig, settings)
        self._closing.append(self._pipeline.close)
        self._pipeline.warm_up()
        mask_png.warm_up()
        self.get_logger().info(f"carving with {self._pipeline.backend.name}: {self._pipeline.backend_reason}")
        self.health.set("backend", f"{self._pipeline.backend.name} ({self._pipeline.backend.device})")
        self._advertise()
        if settings.publish_tf:
            self._publish_frames(rig)
        self._mesh = SaveMeshService(self, self.settings.mesh)
        self._closing.append(self._mesh.close)
        self._thinning, self._overload = ThinningControl(), None
        if settings.thin_out and not settings.reliable:
            self._overload = OverloadControl(self, self._thinning)
            self._closing.append(self._overload.close)
        self.silhouettes = SilhouetteInput(self, self._canvases, self._thinning, self._on_frame_set)
        self._closing.append(self.silhouettes.close)

    def _publish_frames(self, rig: Rig) -> None:
        """Publish the cameras' frames (latched)."""
        frames = FramePublisher(self, static=True)
        now_ns = self.get_clock().now().nanoseconds
        frames.publish(lambda: list(camera_frames(rig, self.settings.frame_id, now_ns, self.tf_prefix)))
        self._closing.append(frames.close)

    def _load_rig(self) -> Rig:
        """Load the rig of the settings and its canvases."""
        if not self.settings.rig_file:
            raise InputError(
                "rig_file is not set",
                where=f"parameters of {self.get_name()}",
                remedy="Give the path of the rig YAML file.",
            )
        rig = load_rig(self.settings.rig_file)
        self._canvases = {camera.name: camera.undistorted_view().camera for camera in rig.cameras}
        return rig

    def activate(self) -> None:
        """Start collecting."""
        assert self.silhouettes is not None
        dropped = partial(self.health.count, "sets_dropped")
        self._slicer = Worker("slicer", self._finish, 1, on_drop=dropped, on_error=self.report)
        self._carver = Worker("carver", self._begin, self.settings.queue_depth, on_drop=dropped, on_error=self.report)
        self.silhouettes.start()

    def deactivate(self) -> None:
        """Stop collecting; the sets already closed are finished, those still open are dropped."""
        if self.silhouettes is not None:
            self.silhouettes.stop()
        for worker in (self._carver, self._slicer):
            if worker is not None:
                worker.close(finish=True)
        self._carver = self._slicer = None

    def cleanup(self) -> None:
        """Release subscriptions, publishers and the backend."""
        for close in reversed(self._closing):
            close()
        self._closing = []
        self.silhouettes = self._pipeline = self._newest = None

    def _advertise(self) -> None:
        self._products = PacketPublisher(self, HULL_PRODUCTS)
        self._clouds = {part: LazyPublisher(self, PointCloud2, f"hull/{part}") for part in PARTS}
        self._frame_set = LazyPublisher(self, DiagnosticArray, "hull/frame_set")
        self._supports = {
            camera: LazyPublisher(self, Image, f"{camera}/silhouette/support") for camera in self._canvases
        }
        publishers = (self._frame_set, *self._clouds.values(), *self._supports.values())
        self._closing += [self._products.close, *(publisher.close for publisher in publishers)]

    def _on_frame_set(self, frame_set: FrameSet[Mask]) -> None:
        """Hand a frame set to the carver's thread."""
        if self._carver is not None:
            closed_ns, stamp_ns = self.get_clock().now().nanoseconds, frame_set.stamp_ns
            self._thinning.add_closed(stamp_ns, frame_set.frames, closed_ns - stamp_ns, monotonic_ns())
            self._carver.put((frame_set, closed_ns))

    def _begin(self, closed: tuple[FrameSet[Mask], int]) -> None:
        """Carve one frame set, on the carver's thread."""
        frame_set, closed_ns = closed
        assert self._pipeline is not None and self._slicer is not None
        begun_ns = self.get_clock().now().nanoseconds
        self._slicer.put_blocking((self._pipeline.begin(frame_set), closed_ns, begun_ns))

    def _finish(self, carved: tuple[PendingHull, int, int]) -> None:
        """Finish, convert and publish one frame set, on the slicer's thread."""
        assert self._pipeline is not None and self._mesh is not None
        pending, closed_ns, begun_ns = carved
        frame_set, frame_id, taken_ns = pending.frame_set, self.settings.frame_id, monotonic_ns()
        result = self._pipeline.finish(pending)
        self._mesh.newest = result
        # before the products: the tracker's answer to them paces footage, and the cameras need this by then
        for report in result.support:
            self._supports[report.camera].publish(support_message, report, self.tf_prefix)
        products, handed_over_ns = result.products, monotonic_ns()
        age_ns = self.get_clock().now().nanoseconds - products.stamp_ns
        self._products.publish(replace(products, ages=SetAges(closed_ns - products.stamp_ns, age_ns)), frame_id)
        for part, publisher in self._clouds.items():
            publisher.publish(packet_cloud, getattr(products, part), products.stamp_ns, frame_id)
        published_ns = self.get_clock().now().nanoseconds
        times_ms = {
            "spread_ms": frame_set.spread_ns / 1e6,
            "received_ms": (closed_ns - frame_set.stamp_ns) / 1e6,  # capture to set closed
            "queued_ms": (begun_ns - closed_ns) / 1e6,
            "hull_ms": (published_ns - begun_ns) / 1e6,
            "published_ms": (published_ns - frame_set.stamp_ns) / 1e6,  # capture to published
        }
        self._frame_set.publish(frame_set_message, result, self._pipeline.backend.name, times_ms)
        self._report(result)
        self.health.tick(frame_set.stamp_ns)
        if self._overload is not None:
            carver_ns = round(1e6 * sum(pending.stage_ms.values()))
            self._overload.add_finished(frame_set.stamp_ns, carver_ns, monotonic_ns() - taken_ns, handed_over_ns)

    def _describe(self) -> dict[str, object]:
        """Return the counters and the newest set's camera faults for the diagnostics."""
        values: dict[str, object] = {} if self.silhouettes is None else dict(self.silhouettes.counters())
        return values | (camera_values(self._newest) if self._newest is not None else {})

    def _report(self, result: HullResult) -> None:
        """Update the state that the diagnostics show; log what has changed."""
        if result.empty:
            self.health.count("sets_empty")
        before = set(self._newest.camera_faults.left_out) if self._newest else set()
        self._newest, faults = result, result.camera_faults
        for camera in {*faults.left_out} - before:
            self.get_logger().warning(f"left out: {faults.reasons[camera]}")
        for camera in before - {*faults.left_out}:
            self.get_logger().info(f"used again: {camera} agrees with the others")
        if self.silhouettes is None or not self.silhouettes.refused:
            level, text = summarise(result)
            thinned = self._thinning.summary
            self.health.status(max(level, WARN), f"{thinned}; {text}") if thinned else self.health.status(level, text)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run_node(HullNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
