"""Camera PCs for the drills: simulated cameras, camera clients as processes, and a listener to what they publish."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage

from sagoma_ros.qos import SILHOUETTE_RELIABLE_SUBSCRIBER
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.ros_link import RosLink
from virtual_studio.gige import CameraSettings, SimulatedCamera, free_addresses

WIDTH, HEIGHT, FPS = 320, 240, 30.0
PATIENCE_S = 60.0  # only ever used up by a failing test
GRACE_S = 10.0  # for a process to end before it is killed
PACKET_DELAY_NS = 200_000  # spreads a frame over some 10 ms, so that a camera can be switched off in its middle
HARMLESS = ("lost or inc", "the light changed suddenly")  # the latter is told for half a minute
OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR


class Room:
    """A textured room, with somebody in it unless empty; the camera's noise makes frames differ."""

    def __init__(self, empty: bool = False) -> None:
        rng = np.random.default_rng(5)
        self._image = cv2.GaussianBlur(rng.uniform(70, 190, (HEIGHT, WIDTH)), (0, 0), 2.0).astype(np.uint8)
        if not empty:
            self._image[40:200, 130:190] = 245

    @property
    def shape(self) -> tuple[int, int]:
        return HEIGHT, WIDTH

    def image(self, instant_ns: int) -> np.ndarray:
        return self._image


class GraphListener:
    """Receives diagnostics and silhouettes of all nodes, and waits for events among them."""

    def __init__(self) -> None:
        self._link = RosLink("drill_listener")
        self._diagnostics = DiagnosticsTable(self._link.node)
        self._masks: Counter[str] = Counter()
        self.received_s: dict[str, float] = {}

    def listen(self, camera: str) -> None:
        topic, qos = f"/{camera}/silhouette/compressed", SILHOUETTE_RELIABLE_SUBSCRIBER
        self._link.node.create_subscription(CompressedImage, topic, lambda mask: self._on_mask(camera, mask), qos)

    @property
    def node(self):
        return self._link.node

    def masks(self, camera: str) -> int:
        return self._masks[camera]

    def until(self, done, what: str) -> None:
        """Wait until ``done()``, which is asked after each report of a node."""
        happened = self._diagnostics.wait_until(done, PATIENCE_S)
        said = {name: self.level(name)[1] for name in self._diagnostics.names()}
        assert happened, f"did not happen: {what}; last said: {said}"

    def level(self, node: str) -> tuple[bytes, str]:
        report = self._diagnostics.report(node)
        return (b"", "") if report is None else (report.level, report.message)

    def values(self, node: str) -> Mapping[str, str]:
        report = self._diagnostics.report(node)
        return {} if report is None else report.values

    def number(self, node: str, key: str) -> float:
        return float(self.values(node).get(key, "nan"))

    def close(self) -> None:
        self._link.close()

    def _on_mask(self, camera: str, message: CompressedImage) -> None:
        self._masks[camera] += 1
        self.received_s[camera] = time.monotonic()


class CameraPC:
    """One simulated camera and the camera client that serves it, a process of its own."""

    def __init__(self, name: str, folder: Path, listener: GraphListener, rig: Path, **parameters: object) -> None:
        self.name, self.folder, self.listener = name, folder, listener
        self.node = f"/{name}/camera_client"
        self.address = free_addresses(1)[0]
        self.camera = SimulatedCamera(
            self.address, Room(), CameraSettings(serial=f"S-{name}", frame_rate=FPS, noise=1.5, seed=len(name))
        ).start()
        background = folder / "background.png"
        cv2.imwrite(str(background), Room(empty=True).image(0))
        self.parameters = {
            "autostart": True,
            "rig_file": str(rig),
            "camera_name": name,
            "source": "aravis",
            "background": str(background),
            "aravis": {
                "address": self.address,
                "pixel_format": "Mono8",
                "frame_rate": FPS,
                "exposure_us": 4000.0,
                "packet_size": 1500,
                "packet_delay_ns": PACKET_DELAY_NS,
                "frame_retention_ms": 200.0,  # busy machines are late with the packets of a frame
            },
            **parameters,
        }
        self._processes: list[subprocess.Popen] = []
        listener.listen(name)

    def start_client(self, namespace: str = "") -> subprocess.Popen:
        """Start a camera client; more than one may want the camera."""
        namespace = namespace or self.name
        path = self.folder / f"{namespace}_{len(self._processes)}.yaml"
        path.write_text(yaml.safe_dump({f"/{namespace}/camera_client": {"ros__parameters": self.parameters}}))
        words = ["--ros-args", "-r", f"__ns:=/{namespace}", "--params-file", str(path)]
        command = [sys.executable, "-m", "camera_client.camera_node", *words]
        with path.with_suffix(".log").open("wb") as log:
            self._processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))
        return self._processes[-1]

    def until_streaming(self) -> None:
        """Five more masks, and the client content."""
        seen = self.listener.masks(self.name)
        self.listener.until(lambda: self.listener.masks(self.name) >= seen + 5, f"masks of {self.name}")

    def until_well(self) -> None:
        """No fault, masks coming, and no other complaint than of frames that a busy machine loses, or of what was."""
        self.camera.faults.clear()
        self.camera.power_on()
        self.until_streaming()

        def well() -> bool:
            level, said = self.listener.level(self.node)
            return level == OK or any(harmless in said for harmless in HARMLESS)

        self.listener.until(well, f"{self.node} is well")

    def until_said(self, level: bytes, text: str, node: str = "") -> None:
        def said() -> bool:
            got = self.listener.level(node or self.node)
            return got[0] == level and text in got[1]

        self.listener.until(said, f"{level!r} {text!r} of {node or self.node}")

    def until_number(self, key: str, above: float) -> float:
        self.listener.until(lambda: self.listener.number(self.node, key) > above, f"{key} > {above}")
        return self.listener.number(self.node, key)

    def close(self) -> None:
        end(*self._processes)
        self.camera.close()


def end(*processes: subprocess.Popen) -> None:
    """SIGTERM to all that still run, and SIGKILL to those that do not heed it."""
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    for process in processes:
        try:
            process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
