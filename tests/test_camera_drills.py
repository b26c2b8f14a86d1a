"""What goes wrong on a camera PC in a day, one drill each: simulated GigE Vision cameras, real camera clients.

Wrong pictures, stalls, second controllers, dead cameras: test_camera_frame_checks, _diagnostics, _aravis and
_supervised of camera_client; killed clients: test_supervision_live.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage

from camera_client.sources.aravis_source import import_aravis
from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from sagoma_ros.qos import SILHOUETTE_RELIABLE_SUBSCRIBER
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.ros_link import RosLink
from virtual_studio.gige import CameraSettings, SimulatedCamera, free_address
from virtual_studio.rig import ring

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
        self.link = RosLink("drill_listener")
        self.diagnostics = DiagnosticsTable(self.link.node)
        self.masks: Counter[str] = Counter()

    def listen(self, camera: str) -> None:
        topic, qos = f"/{camera}/silhouette/compressed", SILHOUETTE_RELIABLE_SUBSCRIBER
        self.link.node.create_subscription(CompressedImage, topic, lambda mask: self.masks.update([camera]), qos)

    def until(self, done, what: str) -> None:
        """Wait until ``done()``, which is asked after each report of a node."""
        happened = self.diagnostics.wait_until(done, PATIENCE_S)
        said = {name: self.level(name)[1] for name in self.diagnostics.names()}
        assert happened, f"did not happen: {what}; last said: {said}"

    def level(self, node: str) -> tuple[bytes, str]:
        report = self.diagnostics.report(node)
        return (b"", "") if report is None else (report.level, report.message)

    def values(self, node: str) -> Mapping[str, str]:
        report = self.diagnostics.report(node)
        return {} if report is None else report.values

    def number(self, node: str, key: str) -> float:
        return float(self.values(node).get(key, "nan"))


class CameraPC:
    """One simulated camera and the camera client that serves it, a process of its own."""

    def __init__(self, name: str, folder: Path, listener: GraphListener, rig: Path, is_on: bool) -> None:
        self.name, self.listener, self.node, self.address = name, listener, f"/{name}/camera_client", free_address()
        settings = CameraSettings(serial=f"S-{name}", frame_rate=FPS, noise=1.5, seed=len(name))
        self.camera = SimulatedCamera(self.address, Room(), settings).start()
        if not is_on:
            self.camera.power_off()
        background, file = folder / "background.png", folder / f"{name}.yaml"
        cv2.imwrite(str(background), Room(empty=True).image(0))
        aravis = {
            "address": self.address,
            "pixel_format": "Mono8",
            "frame_rate": FPS,
            "exposure_us": 4000.0,
            "packet_size": 1500,
            "packet_delay_ns": PACKET_DELAY_NS,
            "frame_retention_ms": 200.0,  # busy machines are late with the packets of a frame
        }
        given = {"autostart": True, "rig_file": str(rig), "camera_name": name, "background": str(background)}
        parameters = {**given, "source": "aravis", "aravis": aravis}
        file.write_text(yaml.safe_dump({self.node: {"ros__parameters": parameters}}))
        listener.listen(name)
        words = ["--ros-args", "-r", f"__ns:=/{name}", "--params-file", str(file)]
        self.client = start("camera_client.camera_node", words, folder / "client.log")

    def until_well(self) -> None:
        """No fault, five more masks, and no other complaint than of frames that a busy machine loses or of what was."""
        self.camera.faults.clear()
        self.camera.power_on()
        seen = self.listener.masks[self.name]
        self.listener.until(lambda: self.listener.masks[self.name] >= seen + 5, f"masks of {self.name}")

        def well() -> bool:
            level, said = self.listener.level(self.node)
            return level == OK or any(harmless in said for harmless in HARMLESS)

        self.listener.until(well, f"{self.node} is well")

    def until_error(self, text: str) -> None:
        def said() -> bool:
            level, told = self.listener.level(self.node)
            return level == ERROR and text in told

        self.listener.until(said, f"{text!r} of {self.node}")

    def until_number(self, key: str, above: float) -> float:
        self.listener.until(lambda: self.listener.number(self.node, key) > above, f"{key} > {above}")
        return self.listener.number(self.node, key)

    def close(self) -> None:
        end(self.client)
        self.camera.close()


def start(module: str, words: list[str], log: Path) -> subprocess.Popen:
    """Start a node as a process of its own."""
    with log.open("wb") as file:
        return subprocess.Popen([sys.executable, "-m", module, *words], stdout=file, stderr=subprocess.STDOUT)


def end(process: subprocess.Popen) -> None:
    """SIGTERM, and SIGKILL where that is not heeded."""
    process.terminate()
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


HULL = "/hull_server"


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    save_rig(ring(3, False, size=(WIDTH, HEIGHT)), path)
    return path


@pytest.fixture(scope="module")
def pcs(rig, tmp_path_factory):
    """Three camera PCs that go through one fault after the other; cam02's camera is off when its client starts."""
    try:
        import_aravis()
        free_address()
    except InputError as error:
        pytest.skip(str(error))
    listener, names = GraphListener(), ("cam01", "cam02", "cam03")
    made = [CameraPC(name, tmp_path_factory.mktemp(name), listener, rig, name != "cam02") for name in names]
    yield made
    for pc in made:
        pc.close()
    listener.link.close()


def sum_rule_holds(values):
    expected, *parts = (int(values[key]) for key in ("expected", "delivered", "incomplete", "lost"))
    return expected == sum(parts)


def test_camera_that_is_off_before_start_is_awaited_and_used_when_it_comes(pcs):
    _, pc, _ = pcs
    pc.until_error("no camera: ")
    assert pc.address in pc.listener.level(pc.node)[1]
    pc.until_well()
    assert sum_rule_holds(pc.listener.values(pc.node))


def test_other_cameras_and_the_hull_go_on_while_one_camera_is_gone(pcs, rig, tmp_path):
    (pc, *others), listener = pcs, pcs[0].listener
    given = {"rig_file": rig, "autostart": "true", "backend": "cpu", "voxel_size_m": "0.05"}
    parameters = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    hull = start("hull_server.hull_node", ["--ros-args", *parameters], tmp_path / "hull.log")
    try:
        for one in pcs:
            one.until_well()
        listener.until(lambda: listener.number(HULL, "sets_complete") > 0, "hulls of all cameras")
        pc.camera.power_off()
        pc.until_error("no camera")
        counts = [listener.masks[other.name] for other in others]
        results = listener.number(HULL, "results")
        listener.until(lambda: listener.number(HULL, "results") > results + 10, "hulls without cam01")
        for other, count in zip(others, counts, strict=True):
            listener.until(lambda name=other.name, count=count: listener.masks[name] > count, f"masks of {other.name}")
        assert "cam01" in listener.level(HULL)[1]
    finally:
        end(hull)


def test_power_cut_in_the_middle_of_a_frame_leaves_it_incomplete_and_is_survived_and_timed(pcs):
    pc, *_ = pcs
    pc.until_well()
    report: dict[str, str] = {}  # the sum counts an outage that goes on, as a busy machine may have one: begin without

    def streams():
        values = pc.listener.values(pc.node)
        over = "last_outage_s" in values or values.get("reconnects") == "0"  # not only connected: frames come
        report.update(values if values.get("link") == "streaming" and over else {})
        return report

    def outage():
        return pc.listener.values(pc.node).get("last_outage_s")

    pc.listener.until(streams, "the camera streams")
    before = {key: float(report[key]) for key in ("incomplete", "reconnects", "downtime_s")}
    reconnects = before["reconnects"]
    for _ in range(5):  # one cut may fall between two frames
        earlier = outage()
        sent = pc.camera.counters["frames_sent"]
        while pc.camera.counters["frames_sent"] == sent:
            pass
        pc.camera.power_off()
        pc.until_error("no camera")
        pc.camera.power_on()
        reconnects = pc.until_number("reconnects", reconnects)
        pc.listener.until(lambda earlier=earlier: outage() not in (None, earlier), "frames come again")
        if pc.listener.number(pc.node, "incomplete") > before["incomplete"]:
            break
    assert pc.until_number("incomplete", before["incomplete"]) > before["incomplete"]
    values = pc.listener.values(pc.node)
    assert float(values["downtime_s"]) - before["downtime_s"] > float(values["last_outage_s"]) - 0.1
    assert sum_rule_holds(values)
