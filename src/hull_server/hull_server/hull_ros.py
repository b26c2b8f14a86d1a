"""The hull node's messages about one frame set, its check of camera_info, and its service that saves a mesh."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import rclpy.task
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger

from capture_rig import InputError
from capture_rig.camera import CameraModel
from sagoma_ros.messages import HOST, key_values, to_stamp

from .hull_pipeline import HullResult
from .settings import MeshSettings

# Thresholds: judgement, no measurement.
INTRINSICS_TOLERANCE_PX = 1e-3


def frame_set_message(result: HullResult, times_ms: dict[str, float]) -> DiagnosticArray:
    """Report a set's cameras, their faults, and the time of each stage; ``times_ms`` are further times, by key."""
    texts = {
        "cameras": ",".join(result.cameras),
        "missing": ",".join(result.missing),
        "blank": ",".join(result.blank),
        "min_seeing": str(result.min_seeing),
        "backend": result.backend,
        "voxels": str(result.volume.count),
        "litres": f"{result.volume.litres:.2f}",
        "points": str(len(result.products.centerline)),
        "contour_rays": str(len(result.products.contour_rays)),
        "bodies": str(len(result.bodies)),
        "bodies_numbers": _row(result.bodies.number, "d"),
        "bodies_litres": _row(result.bodies.litres, ".1f"),
        "bodies_at": "; ".join(_row(place, ".2f") for place in result.bodies.centroid_world),
        "left_out": ",".join(result.camera_faults.left_out),
        "suspects": ",".join(result.camera_faults.suspects),
    } | calibration_values(result)
    stages_ms = {f"{stage}_ms": time for stage, time in result.stage_ms.items()}
    texts |= {key: f"{time:.3f}" for key, time in (stages_ms | times_ms).items()}
    level, message = summarise(result)
    status = DiagnosticStatus(level=level, name="hull/frame_set", message=message, hardware_id=HOST)
    status.values = key_values(texts)
    array = DiagnosticArray(status=[status])
    array.header.stamp = to_stamp(result.stamp_ns)
    return array


def camera_values(result: HullResult) -> dict[str, str]:
    """Report which cameras are left out, how far each contradicts the others, and its calibration."""
    faults = result.camera_faults
    vetoes = " ".join(f"{camera}={share:.3f}" for camera, share in faults.veto_fraction.items())
    return {"left_out": ",".join(faults.left_out), "veto_fraction": vetoes} | calibration_values(result)


def calibration_values(result: HullResult) -> dict[str, str]:
    """Report how far each camera is from its calibration, in degrees, and how well it agrees with the others."""
    calibration = result.extrinsic_errors
    texts = {"calibration_suspects": ",".join(calibration.suspects)}
    angles = {
        "rotation_error": calibration.rotation_error_rad,
        "rotation_error_sd": calibration.sd_rad,
        "roll": calibration.roll_rad,
    }
    for name, angle_rad in angles.items():
        texts |= {f"calibration_{name}_deg_{camera}": f"{np.degrees(rad):.3f}" for camera, rad in angle_rad.items()}
    for camera, share in result.camera_faults.consistency.items():
        texts[f"calibration_consistency_{camera}"] = f"{share:.3f}"
    return texts


def summarise(result: HullResult) -> tuple[bytes, str]:
    """Return level and one line of text about what is wrong with this frame set."""
    troubles = []
    if result.missing:
        troubles.append(f"nothing in time from {', '.join(result.missing)}")
    if result.blank:
        troubles.append(f"empty silhouette from {', '.join(result.blank)}")
    troubles += [
        result.camera_faults.reasons[camera]
        for camera in (*result.camera_faults.left_out, *result.camera_faults.suspects)
    ]
    named = {*result.camera_faults.left_out, *result.camera_faults.suspects}
    troubles += [why for camera, why in result.extrinsic_errors.suspects.items() if camera not in named]
    if result.camera_faults.warning:
        troubles.append(result.camera_faults.warning)
    if len(result.cameras) < result.min_seeing:
        troubles.append(f"a hull needs {result.min_seeing} cameras")
    if result.empty:
        troubles.append("the hull is empty")
    return (DiagnosticStatus.WARN, "; ".join(troubles)) if troubles else (DiagnosticStatus.OK, "complete")


def calibration_mismatch(info: CameraInfo, canvas: CameraModel) -> str:
    """Say how a camera_info differs from the undistorted canvas of the rig's camera; empty when it does not."""
    if info.k[0] == 0:  # as CameraInfo says it
        return "K = 0: its client is not calibrated"
    if (info.width, info.height) != (canvas.width, canvas.height):
        size = f"{canvas.width} x {canvas.height}"
        return f"size {info.width} x {info.height}, but the rig's undistorted canvas is {size}"
    if any(info.d):
        return f"distortion {list(info.d)}, but silhouettes must be undistorted"
    K = np.asarray(info.k).reshape(3, 3)
    if not np.allclose(K, canvas.K, rtol=0, atol=INTRINSICS_TOLERANCE_PX):
        given, wanted = (f"fx {M[0, 0]:.3f} fy {M[1, 1]:.3f} cx {M[0, 2]:.3f} cy {M[1, 2]:.3f}" for M in (K, canvas.K))
        return f"K with {given}, but the rig has {wanted}"
    return ""


def _row(values: np.ndarray, spec: str) -> str:
    return ",".join(format(value, spec) for value in values.tolist())


class SaveMeshService:
    """Answers ``~/save_mesh``: writes the newest hull to ``FOLDER/hull_STAMP.ply``, STAMP in ns, on its own thread."""

    def __init__(self, node: Node, settings: MeshSettings) -> None:
        self._node, self._settings = node, settings
        self._newest: HullResult | None = None
        self._thread = ThreadPoolExecutor(1, "mesh")
        self._service = node.create_service(Trigger, "~/save_mesh", self._on_save)

    def keep(self, result: HullResult) -> None:
        """Remember the newest hull; any thread."""
        self._newest = result

    def close(self) -> None:
        """Remove the service; a mesh that is being written is finished first."""
        self._node.destroy_service(self._service)
        self._thread.shutdown(wait=True)

    async def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        result = self._newest
        try:
            if result is None:
                raise InputError("no frame set has been carved yet", remedy="Start the cameras, then ask again.")
            response.message = await self._in_background(result)
            response.success = True
        except InputError as error:
            response.success, response.message = False, str(error)
        self._node.get_logger().info(f"save_mesh: {response.message}")
        return response

    def _in_background(self, result: HullResult) -> rclpy.task.Future:
        """Return a future that the node's executor resolves once the file is written."""
        answer = rclpy.task.Future(executor=self._node.executor)

        def hand_over(work: Future[str]) -> None:
            error = work.exception()
            if error is None:
                answer.set_result(work.result())
            else:
                answer.set_exception(error)

        self._thread.submit(self._write, result).add_done_callback(hand_over)
        return answer

    def _write(self, result: HullResult) -> str:
        from .mesh import surface_mesh, write_ply  # imports scikit-image: 50 MB that most nodes never need

        mesh = surface_mesh(result.volume, self._settings.smoothing_voxels)
        path = Path(self._settings.folder).expanduser().resolve() / f"hull_{result.stamp_ns}.ply"
        write_ply(mesh, path)
        return f"{path}: {len(mesh.faces)} triangles, {mesh.litres:.1f} litres"
