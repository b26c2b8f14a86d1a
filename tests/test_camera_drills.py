"""What goes wrong on a camera PC in a day, one drill each: simulated GigE Vision cameras, real camera clients.

Wrong pictures and stalls: test_camera_frame_checks, _diagnostics and _supervised of camera_client.

The figures that the drills measure are printed (pytest -s).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage

from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource, import_aravis
from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from sagoma_bringup.graph import CAMERA_NODE
from sagoma_ros.qos import SILHOUETTE_RELIABLE_SUBSCRIBER
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.lifecycle_client import LifecycleClient, State
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
        self.address = free_address()
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


HULL = "/hull_server"
DEAD_CAMERA_S = 2.4  # one access to a dead camera blocks longer


@pytest.fixture(scope="module", autouse=True)
def cameras_possible():
    try:
        import_aravis()
        free_address()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def listener():
    listener = GraphListener()
    yield listener
    listener.close()


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    save_rig(ring(3, False, size=(WIDTH, HEIGHT)), path)
    return path


@pytest.fixture(scope="module")
def lasting(listener, rig, tmp_path_factory):
    """A camera PC that goes through one fault after the other without being started again."""
    pc = CameraPC("cam01", tmp_path_factory.mktemp("cam01"), listener, rig)
    pc.start_client()
    yield pc
    pc.close()


@pytest.fixture
def pc(lasting):
    """The lasting camera PC, well at the beginning, and with no fault at the end."""
    lasting.until_well()
    yield lasting
    lasting.camera.faults.clear()


@pytest.fixture(scope="module")
def second(listener, rig, tmp_path_factory):
    """Another camera PC, whose camera is off when its client starts."""
    pc = CameraPC("cam02", tmp_path_factory.mktemp("cam02"), listener, rig)
    pc.camera.power_off()
    pc.client = pc.start_client()
    yield pc
    pc.close()


@pytest.fixture
def fresh(listener, rig, tmp_path):
    """Camera PCs of a test's own."""
    made = []

    def make(name, **parameters):
        folder = tmp_path / name
        folder.mkdir()
        made.append(CameraPC(name, folder, listener, rig, **parameters))
        return made[-1]

    yield make
    for one in made:
        one.close()


def measured(what, value, unit="s"):
    print(f"\n    {what}: {value:.3f} {unit}")


def sum_rule_holds(values):
    expected, *parts = (int(values[key]) for key in ("expected", "delivered", "incomplete", "lost"))
    return expected == sum(parts)


def test_camera_that_is_off_before_start_is_awaited_and_used_when_it_comes(second):
    pc = second
    pc.until_said(ERROR, "no camera: ")
    assert pc.address in pc.listener.level(pc.node)[1]
    pc.camera.power_on()
    on_s = time.monotonic()
    pc.until_streaming()
    measured("first masks after a late power-on", pc.listener.received_s["cam02"] - on_s)
    pc.until_well()
    assert sum_rule_holds(pc.listener.values(pc.node))


def test_other_cameras_and_the_hull_go_on_while_one_camera_is_gone(pc, second, fresh, rig, listener, tmp_path):
    others = [second, fresh("cam03")]
    others[1].start_client()
    given = {"rig_file": rig, "autostart": "true", "backend": "cpu", "voxel_size_m": "0.05"}
    parameters = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    command = [sys.executable, "-m", "hull_server.hull_node", "--ros-args", *parameters]
    with (tmp_path / "hull.log").open("wb") as log:
        hull = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    try:
        for one in (pc, *others):
            one.until_well()
        listener.until(lambda: listener.number(HULL, "sets_complete") > 0, "hulls of all cameras")
        pc.camera.power_off()
        pc.until_said(ERROR, "no camera")
        counts = [listener.masks(other.name) for other in others]
        results = listener.number(HULL, "results")
        listener.until(lambda: listener.number(HULL, "results") > results + 10, "hulls without cam01")
        for other, count in zip(others, counts, strict=True):
            listener.until(lambda name=other.name, count=count: listener.masks(name) > count, f"masks of {other.name}")
        assert "cam01" in listener.level(HULL)[1]
    finally:
        end(hull)


def test_sigterm_releases_control_so_that_the_camera_can_be_opened_at_once(second):
    second.until_well()
    second.client.send_signal(signal.SIGTERM)
    assert second.client.wait(PATIENCE_S) == 0
    with AravisSource(AravisSettings(address=second.address)) as source:  # held, it would be refused for 3 s
        assert source.shape


def test_power_cut_in_the_middle_of_a_frame_leaves_it_incomplete_and_is_survived_and_timed(pc):
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
        pc.until_said(ERROR, "no camera")
        pc.camera.power_on()
        reconnects = pc.until_number("reconnects", reconnects)
        pc.listener.until(lambda earlier=earlier: outage() not in (None, earlier), "frames come again")
        if pc.listener.number(pc.node, "incomplete") > before["incomplete"]:
            break
    assert pc.until_number("incomplete", before["incomplete"]) > before["incomplete"]
    values = pc.listener.values(pc.node)
    measured("whole outage, last frame to first frame", float(values["last_outage_s"]))
    assert float(values["downtime_s"]) - before["downtime_s"] > float(values["last_outage_s"]) - 0.1
    assert sum_rule_holds(values)


def test_second_controller_is_refused_with_a_clear_error_and_the_first_goes_on(pc):
    other = pc.start_client("rival")
    pc.until_said(ERROR, "controlled by another program", node=f"/rival/{CAMERA_NODE}")
    pc.until_streaming()
    other.send_signal(signal.SIGTERM)
    assert other.wait(PATIENCE_S) == 0
    assert pc.listener.values(pc.node)["control_losses"] == "0"


@pytest.mark.slow
def test_client_killed_by_force_gets_its_camera_back_after_the_heartbeat(fresh):
    pc = fresh("cam03")
    client = pc.start_client()
    pc.until_streaming()
    os.kill(client.pid, signal.SIGKILL)
    client.wait(PATIENCE_S)
    killed_s, seen = time.monotonic(), pc.listener.masks("cam03")
    pc.start_client()
    pc.listener.until(lambda: pc.listener.masks("cam03") > seen, "masks of the second client")
    back_s = pc.listener.received_s["cam03"] - killed_s
    measured("from kill -9 to masks of the next client", back_s)
    assert client.returncode == -signal.SIGKILL and back_s > 0


@pytest.mark.slow
def test_services_of_a_client_whose_camera_just_died_answer(pc):
    client = LifecycleClient(pc.listener.node)
    pc.camera.faults.unplugged = True  # every access to it blocks for seconds from now on
    for goal in (State.INACTIVE, State.UNCONFIGURED):
        asked_s = time.monotonic()
        assert not client.bring([pc.node], goal, timeout_s=DEAD_CAMERA_S).failures
        measured(f"{goal} while the camera is dead", time.monotonic() - asked_s)
    pc.camera.faults.clear()
    assert not client.bring([pc.node], State.ACTIVE).failures
    pc.until_well()
