"""The doctor on a camera PC: real files, a simulated camera, and made-up answers of others."""

import json
import os
import time
from dataclasses import replace
from ipaddress import IPv4Address

import numpy as np
import pytest
import yaml

from camera_client.background.model import BackgroundLearner
from camera_client.gige.discovery import FoundCamera
from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource, import_aravis
from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from gige_vision import bootstrap
from gige_vision.gvcp import DeviceRecord
from sagoma_tools.cli import main
from sagoma_tools.doctor import cameras
from sagoma_tools.doctor.cameras import check_bandwidth, check_control, check_identity, check_interface, check_timing
from sagoma_tools.doctor.findings import Severity, about
from sagoma_tools.doctor.machine import Interface
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera, free_address
from virtual_studio.rig import ring

WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="module")
def camera():
    try:
        address = free_address()
    except InputError as problem:
        pytest.skip(str(problem))
    with SimulatedCamera(address, PatternScene(WIDTH, HEIGHT), CameraSettings(serial="D1", user_id="left")) as camera:
        yield camera


@pytest.fixture(scope="module")
def ready(tmp_path_factory):
    """A folder with a rig and a fresh background."""
    folder = tmp_path_factory.mktemp("ready")
    save_rig(ring(4, False), folder / "rig.yaml")
    save_background(folder / "bg.npz", (HEIGHT, WIDTH))
    return folder


@pytest.fixture
def file(tmp_path, camera, ready):
    """Writes a parameter file of cam01 and returns its path."""

    usual = {"source": "aravis", "rig_file": str(ready / "rig.yaml"), "background": str(ready / "bg.npz")}
    chosen = {"address": camera.address, "exposure_us": 4000.0, "frame_rate": 60.0, "gain": 0.0}
    usual |= {f"aravis.{key}": value for key, value in chosen.items()} | {"aravis.socket_buffer_bytes": 65536}

    def write(name="cam01", **changes):
        path, parameters = tmp_path / f"{name}.yaml", {**usual, "camera_name": name, **changes}
        path.write_text(yaml.safe_dump({f"/{name}/camera_client": {"ros__parameters": parameters}}))
        return path

    return write


def save_background(path, shape):
    learner = BackgroundLearner()
    rng = np.random.default_rng(0)
    for _ in range(10):
        learner.add(rng.integers(100, 110, shape).astype(np.uint8))
    learner.model("a test").save(path)
    return str(path)


def examined(path, capsys, *options):
    """Exit status and the findings by what they are about."""
    status = main(["doctor", "--camera", str(path), "--json", *options])
    document = json.loads(capsys.readouterr().out)
    assert document["status"] == status
    found = {}
    for finding in document["findings"]:
        found.setdefault(finding["about"], []).append(finding)
    return status, found


def test_camera_pc_that_is_ready_has_no_errors(file, capsys):
    status, found = examined(file(), capsys)
    assert status < 2
    codes = {finding["code"] for findings in found.values() for finding in findings}
    assert codes >= {"file.ok", "rig.ok", "background.ok", "camera.ok", "control.ok"}
    assert "serial D1" in found["camera"][0]["what"] and "cam01, 640 x 480" in found["rig"][0]["what"]
    assert found["interface"][0]["what"].startswith("lo, 127.")
    assert "19 MB/s of cam01" in found["bandwidth"][0]["what"]  # 60 x 307 200 bytes, and headers of 37 packets


def test_controlled_camera_is_reported_and_not_disturbed(file, camera, capsys):
    try:
        import_aravis()
    except InputError as problem:
        pytest.skip(str(problem))
    with AravisSource(AravisSettings(address=camera.address)) as source:
        _, found = examined(file(), capsys)
        assert found["control"][0]["code"] == "control.local"
        assert not source.lost
        status, found = examined(file(), capsys, "--open")
        assert status == 2 and found["opened"][0]["code"] == "opened.unusable"


def test_opened_camera_says_what_it_is_and_those_of_a_folder_share_the_link(file, camera, tmp_path, capsys):
    file("cam02", **{"aravis.frame_rate": 30.0})
    (tmp_path / "rig.yaml").write_text("cameras: {}\n")  # is no camera's
    _, found = examined(file(**{"aravis.pixel_format": "Mono8"}), capsys, "--open")
    opened = found["opened"][-1]
    assert opened["code"] == "opened.ok" and "640 x 480" in opened["what"] and "exposure_us 4000" in opened["what"]
    given_back = check_control(AravisSettings(address=camera.address), None)
    assert given_back.code == "control.ok"
    assert "28 MB/s of 2 cameras" in found["bandwidth"][0]["what"]  # 90 frames a second


@pytest.mark.parametrize(
    "changes, severity, code, value",
    [
        ({"aravis.adress": "1.2.3.4"}, "error", "camera.unusable", "'aravis.address'"),
        ({"aravis.exposure_us": "long"}, "error", "camera.unusable", "aravis.exposure_us = 'long'"),
        ({"camera_name": "cam09"}, "error", "calibration.unusable", "'cam09'"),
        ({"rig_file": "/nowhere/rig.yaml"}, "error", "calibration.unusable", "/nowhere/rig.yaml"),
        ({"rig_file": ""}, "note", "rig.uncalibrated", ""),  # not yet
        ({"background": "/nowhere/bg.npz"}, "error", "background.unusable", "/nowhere/bg.npz"),
        ({"background": ""}, "note", "background.none_named", ""),
        ({"background": "SMALL"}, "error", "background.size_differs", "320 x 240"),
        ({"background": "OLD"}, "warning", "background.old", "30 h"),
        ({"aravis.serial": "X9"}, "error", "serial.differs", "'D1'"),
        ({"aravis.address": "127.0.0.78"}, "error", "camera.silent", "127.0.0.78"),
    ],
)
def test_what_does_not_serve_is_found_with_a_remedy(file, tmp_path, capsys, changes, severity, code, value):
    if changes.get("background") == "SMALL":
        changes = {"background": save_background(tmp_path / "small.npz", (240, 320))}
    elif changes.get("background") == "OLD":
        changes = {"background": save_background(tmp_path / "old.npz", (HEIGHT, WIDTH))}
        os.utime(changes["background"], (time.time() - 30 * 3600,) * 2)
    status, found = examined(file(**changes), capsys)
    (finding,) = [one for one in found[code.partition(".")[0]] if one["code"] == code]
    assert finding["severity"] == severity and value in finding["what"] + finding["remedy"]
    assert finding["remedy"] or severity in ("note", "ok")
    assert status in {"error": (2,), "warning": (1,)}.get(severity, (0, 1))  # of this machine there may be warnings


LINK = Interface("enp3s0", "192.168.1.1", mtu=9000, speed_mbit=1000)
RECORD = DeviceRecord("192.168.1.11", "Maker", "Model", serial="123", user_id="left", subnet_mask="255.255.255.0")
SETTINGS = AravisSettings(address="192.168.1.11", exposure_us=4000.0, gain=0.0, frame_rate=60.0)


OTHER = replace(SETTINGS, user_id="right")
FOR_LARGE_PACKETS = replace(SETTINGS, packet_size=8000)
EACH = 100.0 * cameras.wire_bytes(640 * 480, LINK.mtu)  # 30.99 of 125 MB/s: 74 bytes of headers on each packet


@pytest.mark.parametrize(
    "check, arguments, code, value",
    [
        (check_interface, (SETTINGS, None), "interface.none", "ip route get 192.168.1.11"),
        (check_interface, (SETTINGS, replace(LINK, up=False)), "interface.down", "ip link set enp3s0 up"),
        (check_interface, (SETTINGS, replace(LINK, mtu=1500)), "mtu.no_jumbo_frames", "ip link set enp3s0 mtu 9000"),
        (check_interface, (FOR_LARGE_PACKETS, replace(LINK, mtu=1500)), "mtu.packet_too_large", "mtu 9000"),
        (check_interface, (SETTINGS, replace(LINK, mtu=1500, address="127.0.0.1")), "interface.ok", ""),
        (check_identity, (OTHER,), "user_id.differs", "'left'"),
        (check_timing, (replace(SETTINGS, exposure_us=2e4),), "exposure.longer_than_frame", "16667 us"),
        (check_bandwidth, ({"cam01": EACH}, LINK), "bandwidth.ok", "25 % of the 1000 Mbit/s"),
        (check_bandwidth, (dict.fromkeys("abc", EACH), LINK), "bandwidth.tight", "74 %"),
        (check_bandwidth, (dict.fromkeys("abcd", EACH), LINK), "bandwidth.exceeded", "99 %"),
    ],
)
def test_link_and_settings_are_judged(monkeypatch, check, arguments, code, value):
    monkeypatch.setattr(cameras, "discover_at", lambda address: FoundCamera(RECORD, LINK.address))
    found = list(about("camera", check(*arguments)))
    finding = max(found, key=lambda finding: finding.severity)
    assert finding.code == code and value in finding.what + finding.remedy
    assert finding.remedy or finding.severity is Severity.OK


@pytest.mark.parametrize(
    "privilege, owner, code, named",
    [
        (0, None, "control.ok", "no program"),
        (2, "192.168.1.1", "control.local", "192.168.1.1"),
        (2, "192.168.1.9", "control.taken", "192.168.1.9"),
        (2, None, "control.taken", "another program"),
    ],
)
def test_program_that_controls_the_camera_is_named(monkeypatch, privilege, owner, code, named):
    told = {
        bootstrap.CONTROL_PRIVILEGE: privilege,
        bootstrap.PRIMARY_ADDRESS: None if owner is None else int(IPv4Address(owner)),
    }
    monkeypatch.setattr(cameras, "read_register", lambda address, register: told[register])
    finding = check_control(SETTINGS, LINK)
    assert finding.code == code and named in finding.what
