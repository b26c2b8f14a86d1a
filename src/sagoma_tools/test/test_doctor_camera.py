"""The doctor on real files, a simulated camera, and this machine, whatever it is."""

import json
import os
import time

import numpy as np
import pytest
import yaml

from camera_client.background.model import BackgroundLearner
from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource, import_aravis
from capture_rig.errors import InputError
from capture_rig.rig import Rig, save_rig
from sagoma_tools.cli import main
from sagoma_tools.doctor.camera_network import ask_camera
from sagoma_tools.doctor.collect import collect_host, collect_interface
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera, free_addresses
from virtual_studio.rig import ring

WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="module")
def camera():
    try:
        address = free_addresses(1)[0]
    except InputError as problem:
        pytest.skip(str(problem))
    with SimulatedCamera(address, PatternScene(WIDTH, HEIGHT), CameraSettings(serial="D1", user_id="left")) as camera:
        yield camera


@pytest.fixture
def file(tmp_path, camera):
    """Writes a parameter file of cam01 and returns its path; the rig and a fresh background are there."""
    rig = ring(4, False)
    save_rig(Rig(tuple(rig.cameras), rig.volume), tmp_path / "rig.yaml")
    learner = BackgroundLearner()
    rng = np.random.default_rng(0)
    for _ in range(10):
        learner.add(rng.integers(100, 110, (HEIGHT, WIDTH)).astype(np.uint8))
    learner.model("a test").save(tmp_path / "bg.npz")

    def write(name="cam01", **changes):
        parameters = {
            "autostart": True,
            "rig_file": str(tmp_path / "rig.yaml"),
            "camera_name": name,
            "source": "aravis",
            "background": str(tmp_path / "bg.npz"),
            "aravis.address": camera.address,
            "aravis.exposure_us": 4000.0,
            "aravis.frame_rate": 60.0,
            "aravis.gain": 0.0,
            "aravis.socket_buffer_bytes": 65536,
            **changes,
        }
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump({f"/{name}/camera_client": {"ros__parameters": parameters}}))
        return path

    return write


def examined(path, capsys, *options):
    """Exit status and the findings by what they are about."""
    status = main(["doctor", "camera", str(path), "--json", *options])
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


def test_cameras_of_the_same_folder_share_the_link(file, capsys):
    file("cam02", **{"aravis.frame_rate": 30.0})
    _, found = examined(file(), capsys)
    assert "28 MB/s of 2 cameras" in found["bandwidth"][0]["what"]  # 90 frames a second


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
        assert status == 2 and found["opened"][0]["code"] == "opened.failed"


def test_opened_camera_is_set_up_and_says_what_it_is(file, camera, capsys):
    _, found = examined(file(**{"aravis.pixel_format": "Mono8"}), capsys, "--open")
    opened = found["opened"][-1]
    assert opened["code"] == "opened.ok" and "640 x 480" in opened["what"] and "exposure_us 4000" in opened["what"]
    assert ask_camera(camera.address).controlled is False  # given back


@pytest.mark.parametrize(
    "changes, code, value",
    [
        ({"aravis.adress": "1.2.3.4"}, "file.invalid", "'aravis.address'"),
        ({"aravis.exposure_us": "long"}, "file.invalid", "aravis.exposure_us = 'long'"),
        ({"camera_name": "cam09"}, "rig.invalid", "'cam09'"),
        ({"rig_file": "/nowhere/rig.yaml"}, "rig.invalid", "/nowhere/rig.yaml"),
        ({"background": "/nowhere/bg.npz"}, "background.unusable", "/nowhere/bg.npz"),
        ({"aravis.serial": "X9"}, "serial.differs", "'D1'"),
        ({"aravis.address": "127.0.0.78"}, "camera.silent", "127.0.0.78"),
    ],
)
def test_what_cannot_work_is_an_error_with_a_remedy(file, capsys, changes, code, value):
    status, found = examined(file(**changes), capsys)
    assert status == 2
    (wrong,) = [finding for finding in found[code.partition(".")[0]] if finding["code"] == code]
    assert wrong["severity"] == "error" and wrong["remedy"] and value in wrong["what"] + wrong["remedy"]


def test_old_background_is_a_warning(file, tmp_path, capsys):
    path = file()
    yesterday = time.time() - 30 * 3600
    os.utime(tmp_path / "bg.npz", (yesterday, yesterday))
    status, found = examined(path, capsys)
    assert status == 1 and found["background"][0]["code"] == "background.old"
    assert "30 h" in found["background"][0]["what"]


def test_camera_that_is_not_calibrated_yet_is_a_note(file, capsys):
    status, found = examined(file(rig_file=""), capsys)
    assert status < 2 and found["rig"][0]["code"] == "rig.uncalibrated"


def test_missing_file_is_told_in_words_too(tmp_path, capsys):
    assert main(["doctor", "camera", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml: cannot be read" in capsys.readouterr().out


def test_footage_needs_no_network(file, capsys):
    _, found = examined(file(source="footage"), capsys)
    assert found["camera"][0]["code"] == "camera.not_gige" and "interface" not in found


def test_absent_camera_is_asked_by_unicast_only_and_told_with_the_reason():
    facts = ask_camera("127.0.0.78")
    assert "no GigE Vision camera answers at 127.0.0.78" in facts.error and facts.controlled is None


def test_facts_of_this_machine_agree_with_the_system():
    host = collect_host()
    with open("/proc/sys/net/core/rmem_max") as file:
        assert host.rmem_max == int(file.read())
    assert 1 <= host.cores <= os.cpu_count() and host.available_bytes > 1 << 20
    link = collect_interface("127.0.0.1")
    assert link.loopback and link.up and link.mtu > 1500
