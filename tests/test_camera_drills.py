"""What goes wrong on a camera PC in a day, one drill each: simulated GigE Vision cameras, real camera clients.

Wrong pictures and stalls: test_camera_frame_checks, _diagnostics and _supervised of camera_client.

The figures that the drills measure are printed (pytest -s).
"""

import os
import signal
import subprocess
import sys
import time

import pytest
from camera_pc import ERROR, HEIGHT, PATIENCE_S, WIDTH, CameraPC, GraphListener, end

from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource, import_aravis
from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from sagoma_bringup.graph import CAMERA_NODE
from sagoma_tools.graph.lifecycle_client import LifecycleClient, State
from virtual_studio.gige import free_addresses
from virtual_studio.rig import ring

HULL = "/hull_server"
DEAD_CAMERA_S = 2.4  # one access to a dead camera blocks longer


@pytest.fixture(scope="module", autouse=True)
def cameras_possible():
    try:
        import_aravis()
        free_addresses(1)
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
    measured("noticed after the last frame", float(values["last_outage_noticed_s"]))
    measured("whole outage, last frame to first frame", float(values["last_outage_s"]))
    measured("from the attempt that succeeded to the first frame", float(values["last_restart_s"]))
    assert float(values["last_outage_noticed_s"]) >= 0.5
    assert float(values["downtime_s"]) - before["downtime_s"] > float(values["last_outage_s"]) - 0.1
    assert sum_rule_holds(values)


@pytest.mark.slow
def test_cable_out_for_a_moment_is_survived(pc):
    reconnects, seen = pc.until_number("reconnects", -1), pc.listener.masks(pc.name)
    pc.camera.faults.unplugged = True
    pc.until_said(ERROR, "")
    pc.camera.faults.unplugged = False
    back_s = time.monotonic()
    pc.listener.until(
        lambda: pc.listener.masks(pc.name) > seen and pc.listener.received_s[pc.name] > back_s, "masks again"
    )
    measured("from cable back to the first mask", pc.listener.received_s[pc.name] - back_s)
    pc.until_number("reconnects", reconnects)
    assert sum_rule_holds(pc.listener.values(pc.node))


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
        assert not client.bring([[pc.node]], goal, timeout_s=DEAD_CAMERA_S).failures
        measured(f"{goal} while the camera is dead", time.monotonic() - asked_s)
    pc.camera.faults.clear()
    assert not client.bring([[pc.node]], State.ACTIVE).failures
    pc.until_well()
