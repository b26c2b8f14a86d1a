"""What the hull node says beside its products: a set's state, the cameras' frames, what is thinned out, a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic_ns

import numpy as np
import rclpy.task
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger

from capture_rig import InputError, Rig
from capture_rig.camera import CameraModel
from mocap_packets.people import AnsweredSet
from sagoma_ros.intra_process import Delivery, PacketSubscription
from sagoma_ros.messages import HOST, THINNING_TOPIC, key_values, thinning_message, to_stamp
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import LATENCY
from sagoma_ros.poses import frame
from sagoma_ros.qos import LATCHED

from .hull_pipeline import HullResult
from .overload import ThinningControl
from .settings import MeshSettings

# Thresholds: judgement, no measurement.
INTRINSICS_TOLERANCE_PX = 1e-3
NO_TRACKER_NS = 1_000_000_000  # without an answer: the hull's products are the end of the graph
UPDATE_S = 0.1  # of the overload control
OPTICAL_TO_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the optical frame's x (right), y (down), z (forward) in the camera's x forward, y left, z up (REP-103)."""


def frame_set_message(result: HullResult, backend: str, times_ms: dict[str, float]) -> DiagnosticArray:
    """Report a set's cameras, their faults, and the time of each stage; ``times_ms`` are further times, by key."""
    texts = {
        "cameras": ",".join(result.masks),
        "missing": ",".join(result.frame_set.missing),
        "blank": ",".join(result.blank),
        "min_seeing": str(result.min_seeing),
        "backend": backend,
        "voxels": str(result.volume.count),
        "litres": f"{result.volume.litres:.2f}",
        "points": str(len(result.products.centerline)),
        "contour_rays": str(len(result.products.contour_rays)),
        "bodies": str(len(result.bodies)),
        "bodies_numbers": _row(result.bodies.number, "d"),
        "bodies_litres": _row(result.bodies.litres, ".1f"),
        "bodies_at": "; ".join(_row(place, ".2f") for place in result.bodies.centroid_world),
        "suspects": ",".join(result.camera_faults.suspects),
    } | camera_values(result)
    stages_ms = {f"{stage}_ms": time for stage, time in result.stage_ms.items()}
    texts |= {key: f"{time:.3f}" for key, time in (stages_ms | times_ms).items()}
    level, message = summarise(result)
    status = DiagnosticStatus(level=level, name="hull/frame_set", message=message, hardware_id=HOST)
    status.values = key_values(texts)
    array = DiagnosticArray(status=[status])
    array.header.stamp = to_stamp(result.stamp_ns)
    return array


def camera_values(result: HullResult) -> dict[str, str]:
    """Report which cameras are left out, and how well each agrees with the others."""
    faults = result.camera_faults
    vetoes = " ".join(f"{camera}={mean.veto_fraction:.3f}" for camera, mean in faults.means.items())
    agreement = {f"consistency_{camera}": f"{mean.consistency:.3f}" for camera, mean in faults.means.items()}
    return {"left_out": ",".join(faults.left_out), "veto_fraction": vetoes} | agreement


def summarise(result: HullResult) -> tuple[bytes, str]:
    """Return level and one line of text about what is wrong with this frame set."""
    faults, troubles = result.camera_faults, []
    if result.frame_set.missing:
        troubles.append(f"nothing in time from {', '.join(result.frame_set.missing)}")
    if result.blank:
        troubles.append(f"empty silhouette from {', '.join(result.blank)}")
    troubles += [faults.reasons[camera] for camera in (*faults.left_out, *faults.suspects)]
    if faults.warning:
        troubles.append(faults.warning)
    if len(result.masks) < result.min_seeing:
        troubles.append(f"a hull needs {result.min_seeing} cameras")
    if result.empty:
        troubles.append("the hull is empty")
    return (DiagnosticStatus.WARN, "; ".join(troubles)) if troubles else (DiagnosticStatus.OK, "complete")


def calibration_mismatch(info: CameraInfo, canvas: CameraModel) -> str:
    """Say how a camera_info differs from the undistorted canvas of the rig's camera; empty when it does not."""
    K, size, undistorted = np.reshape(info.k, (3, 3)), (info.width, info.height), not any(info.d)
    same = size == (canvas.width, canvas.height) and np.allclose(K, canvas.K, rtol=0, atol=INTRINSICS_TOLERANCE_PX)
    if same and undistorted:
        return ""
    given, wanted = (
        f"{width} x {height} px, fx {M[0, 0]:.3f} fy {M[1, 1]:.3f} cx {M[0, 2]:.3f} cy {M[1, 2]:.3f}"
        for (width, height), M in ((size, K), ((canvas.width, canvas.height), canvas.K))
    )
    return f"{given}, distortion {list(info.d)}, but the rig's undistorted canvas has {wanted}"


def _row(values: np.ndarray, spec: str) -> str:
    return ",".join(format(value, spec) for value in values.tolist())


def camera_frames(rig: Rig, frame_id: str, stamp_ns: int, tf_prefix: str = "") -> Iterator[TransformStamped]:
    """Yield the two frames of every camera: map -> CAM (x forward, z up), CAM -> CAM_optical (z forward, y down)."""
    for camera in rig.cameras:
        R_world_optical = camera.T_camera_world[:3, :3].T
        turned = Rotation.from_matrix(R_world_optical @ OPTICAL_TO_BODY.T).as_quat().tolist()
        name = tf_prefix + camera.name
        yield frame(frame_id, name, stamp_ns, camera.centre_world.tolist(), turned)
        optical = Rotation.from_matrix(OPTICAL_TO_BODY).as_quat().tolist()
        yield frame(name, f"{name}_optical", stamp_ns, (0.0, 0.0, 0.0), optical)


class OverloadControl:
    """The thinning control among messages: answers of the tracker in, hull/thinning out."""

    def __init__(self, node: SagomaNode, control: ThinningControl) -> None:
        self._node, self._control = node, control
        self._publisher = node.create_publisher(DiagnosticArray, THINNING_TOPIC, LATCHED)
        self._answers = PacketSubscription(node, LATENCY, self._on_answer)
        self._timer = node.create_timer(UPDATE_S, self._update, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._answered_ns, self._logged = 0, ""

    def close(self) -> None:
        """Release timer and topics."""
        self._answers.close()
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def add_finished(self, stamp_ns: int, carver_ns: int, slicer_ns: int, handed_over_ns: int) -> None:
        """Add what carver and slicer took for a set, and when it was published; any thread."""
        now_ns = monotonic_ns()
        self._control.add_work(stamp_ns, carver_ns, slicer_ns, handed_over_ns)
        if now_ns - self._answered_ns > NO_TRACKER_NS:
            self._control.add_answer(stamp_ns, now_ns)

    def _on_answer(self, answer: Delivery[AnsweredSet]) -> None:
        self._answered_ns = monotonic_ns()
        self._control.add_answer(answer.stamp_ns, self._answered_ns)

    def _update(self) -> None:
        rule, summary = self._control.update(monotonic_ns()), self._control.summary
        self._node.health.set("thinning", summary)
        if rule is not None:
            self._publisher.publish(thinning_message(rule, summary))
        kind = summary.partition(":")[0]
        if kind != self._logged:
            self._logged = kind
            self._node.get_logger().info(summary or "every frame is processed again")


class SaveMeshService:
    """Answers ``~/save_mesh``: writes the newest hull to ``FOLDER/hull_STAMP.ply``, STAMP in ns, on its own thread."""

    def __init__(self, node: Node, settings: MeshSettings) -> None:
        self._node, self._settings = node, settings
        self.newest: HullResult | None = None  # set by the slicer's thread
        self._thread = ThreadPoolExecutor(1, "mesh")
        self._service = node.create_service(Trigger, "~/save_mesh", self._on_save)

    def close(self) -> None:
        """Remove the service; a mesh that is being written is finished first."""
        self._node.destroy_service(self._service)
        self._thread.shutdown(wait=True)

    async def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = rclpy.task.Future(executor=self._node.executor)
        self._thread.submit(self._answer, self.newest, response, done)
        return await done

    def _answer(self, result: HullResult | None, response: Trigger.Response, done: rclpy.task.Future) -> None:
        try:
            if result is None:
                raise InputError("no frame set has been carved yet", remedy="Start the cameras, then ask again.")
            response.message, response.success = self._write(result), True
        except InputError as error:
            response.message = str(error)
        except Exception as error:  # the node's executor reports it
            return done.set_exception(error)
        self._node.get_logger().info(f"save_mesh: {response.message}")
        done.set_result(response)

    def _write(self, result: HullResult) -> str:
        from .mesh import surface_mesh, write_ply  # imports scikit-image: 50 MB that most nodes never need

        mesh = surface_mesh(result.volume, self._settings.smoothing_voxels)
        path = Path(self._settings.folder).expanduser().resolve() / f"hull_{result.stamp_ns}.ply"
        write_ply(mesh, path)
        return f"{path}: {len(mesh.faces)} triangles, {mesh.litres:.1f} litres"
