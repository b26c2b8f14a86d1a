"""The service that writes the hull's mesh: on a thread of its own, so that the node goes on taking silhouettes."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import rclpy.task
from rclpy.node import Node
from std_srvs.srv import Trigger

from capture_rig import InputError

from .pipeline import HullResult
from .settings import MeshSettings


class MeshDesk:
    """Answers ``~/save_mesh``: writes the newest hull to ``FOLDER/hull_STAMP.ply``, STAMP in ns, and says so."""

    def __init__(self, node: Node, settings: MeshSettings) -> None:
        self._node, self._settings = node, settings
        self._newest: HullResult | None = None
        self._thread = ThreadPoolExecutor(1, "mesh")
        self._service = node.create_service(Trigger, "~/save_mesh", self._on_save)

    def keep(self, result: HullResult) -> None:
        """Remember the newest hull; any thread."""
        self._newest = result

    def close(self) -> None:
        """Take the service back; a mesh in the making is finished first."""
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
        """Resolved in the node's executor once the file is written."""
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
