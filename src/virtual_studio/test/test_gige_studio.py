"""A whole studio: its cameras, its control channel, its command line."""

import json
import socket
from fractions import Fraction
from itertools import pairwise

import pytest
import yaml
from gige_client import GvcpClient, eventually

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from gige_vision import bootstrap
from gige_vision.gvcp import Command, DeviceRecord
from virtual_studio.gige import Studio, StudioSettings, free_address
from virtual_studio.gige.__main__ import main, request_from, speed_argument, write_rig_files
from virtual_studio.gige.device import consecutive_addresses, is_free
from virtual_studio.gige.loop import ask


def first_of_free(count):
    """The first of so many free addresses in a row."""
    for _ in range(200):
        first = free_address()
        if int(first.split(".")[3]) + count < 255 and all(is_free(a) for a in consecutive_addresses(first, count)):
            return first
    pytest.skip("no row of free loopback addresses was found")


WORDS = {
    "status": {"do": "status", "cameras": []},
    "set cam03 packet_loss=0.005": {"do": "set", "cameras": ["cam03"], "faults": {"packet_loss": 0.005}},
    "set stall=true": {"do": "set", "cameras": [], "faults": {"stall": True}},
    "off cam02 cam03": {"do": "off", "cameras": ["cam02", "cam03"]},
    "room empty": {"do": "room", "state": "empty"},
    "play once at_ns=5": {"do": "play", "loop": False, "at_ns": 5},
    "wire rate=50": {"do": "wire", "cameras": [], "rate": 50},
}


@pytest.mark.parametrize("words", WORDS)
def test_words_of_the_command_line_become_requests(words):
    assert request_from(words.split()) == WORDS[words]


def test_speed_is_a_number_or_a_fraction():
    assert speed_argument("0.25") == speed_argument("1/4") == 0.25


def settings(cameras=3, **more):
    return StudioSettings(cameras=cameras, pattern=True, address=first_of_free(cameras), **more)


@pytest.fixture
def studio(tmp_path):
    with Studio(settings(), tmp_path / "control.sock") as studio:
        yield studio


@pytest.fixture
def control(studio, tmp_path):
    return lambda request: ask(request, tmp_path / "control.sock")


def test_studio_s_cameras_have_consecutive_addresses_and_the_rig_s_names(studio):
    records = []
    for camera in studio.cameras.values():
        with GvcpClient(camera.address) as client:
            records.append(DeviceRecord.decode(client.ask(Command.DISCOVERY).payload))
    assert [record.user_id for record in records] == ["cam01", "cam02", "cam03"]
    assert [record.serial for record in records] == ["STUDIO001", "STUDIO002", "STUDIO003"]
    last_bytes = [int(record.address.split(".")[3]) for record in records]
    assert all(b - a == 1 for a, b in pairwise(last_bytes))


def test_faults_and_power_are_those_of_the_named_cameras(studio, control):
    cameras, loss = studio.cameras.values(), {"packet_loss": 0.25}
    assert control({"do": "set", "cameras": ["cam02"], "faults": loss}) == {"set": loss}
    assert [camera.faults.packet_loss for camera in cameras] == [0.0, 0.25, 0.0]
    control({"do": "clear"})
    assert all(camera.faults.active() == {} for camera in cameras)
    control({"do": "off", "cameras": ["cam03"]})
    assert [camera.powered for camera in cameras] == [True, True, False]
    assert control({"do": "status"})["cameras"]["cam03"]["power"] is False
    control({"do": "on"})
    assert all(camera.powered for camera in cameras)


def test_status_tells_who_controls_a_camera(studio, control):
    camera = studio.cameras["cam01"]
    with GvcpClient(camera.address) as client, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        client.take_control()
        client.write(bootstrap.STREAM_DESTINATION, 0x7F000001)
        client.write(bootstrap.STREAM_PORT, receiver.getsockname()[1])
        client.write(next(f.address for f in camera.features if f.name == "AcquisitionStart"), 1)
        eventually(lambda: camera.counters["frames_sent"])
        entry = control({"do": "status"})["cameras"]["cam01"]
        assert entry["controller"].startswith("127.0.0.1:") and entry["streaming"] is True
        assert entry["user_id"] == "cam01" and entry["counters"]["frames_sent"] >= 1
        assert set(entry["late_us"]) == {"p50", "p99", "max"}


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"do": "dance"}, r"'dance' is nothing a studio does.*status"),
        ({"do": "set", "cameras": ["cam09"], "faults": {}}, r"no camera cam09.*cam01"),
        ({"do": "set", "faults": {"stal": True}}, r"no fault 'stal'"),
        ({"do": "room", "state": "empty"}, r"empty room"),
        ({"do": "play"}, r"test pattern has no playback"),
        ({"do": "wire", "rate": -1}, r"rate = -1"),
        ({"do": "show", "phase": "floor"}, "--scene setup"),
    ],
)
def test_request_that_makes_no_sense_is_answered_with_the_reason(studio, control, request_, message):
    with pytest.raises(InputError, match=message):
        control(request_)


def test_line_that_is_no_json_is_answered_and_the_next_one_served(studio, tmp_path):
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(tmp_path / "control.sock"))
        lines = link.makefile("rwb")
        lines.write(b'nonsense\n[1]\n{"do": "status"}\n')
        lines.flush()
        assert "not a line of JSON" in json.loads(lines.readline())["error"]
        assert "JSON object" in json.loads(lines.readline())["error"]
        assert "cam01" in json.loads(lines.readline())["cameras"]


def test_control_socket_is_its_owner_s_alone_and_goes_with_the_studio(tmp_path):
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as left:  # by a studio that was killed
        left.bind(str(path))
    with Studio(settings(1), path):
        assert path.stat().st_mode & 0o777 == 0o600
        with pytest.raises(InputError, match=r"control\.sock.*Another studio"):
            Studio(settings(1), path).start()
        assert "cameras" in ask({"do": "status"}, path)
    assert not path.exists()
    with pytest.raises(InputError, match=r"no studio answers.*sagoma studio"):
        ask({"do": "status"}, path)


def test_written_files_describe_the_studio_and_the_speed_of_its_clock(tmp_path):
    with Studio(settings(speed=0.25)) as studio:
        folder = write_rig_files(studio, tmp_path / "rig")
        assert {camera.loop.clock.speed for camera in studio.cameras.values()} == {Fraction(1, 4)}
    assert load_rig(folder / "rig.yaml").names == ("cam01", "cam02", "cam03")
    document = yaml.safe_load((folder / "cameras" / "cam02.yaml").read_text())
    parameters = document["/cam02/camera_client"]["ros__parameters"]
    address = studio.cameras["cam02"].address
    assert parameters["source"] == "aravis"
    assert parameters["aravis"] == {"address": address, "frame_rate": 60.0, "clock_speed": 0.25}


def test_program_says_what_is_wrong_in_one_line(tmp_path, capsys):
    assert main(["--session", str(tmp_path / "none")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "is not a folder" in said


def test_addresses_outside_of_loopback_are_refused():
    for first, count in (("192.168.1.5", 1), ("127.0.0.254", 3), ("here", 1)):
        with pytest.raises(InputError, match="loopback"):
            consecutive_addresses(first, count)


def test_session_studio_shows_its_footage(shared_data):
    folder = shared_data("sessions", "zombie_he3")
    with Studio(StudioSettings(session=str(folder), address=first_of_free(3), memory_mb=30.0)) as studio:
        assert "first" in studio.scene.notes[0]
        scene = studio.cameras["cam01"].scene
        assert scene.shape == (480, 640) and scene.image(10**18) is scene.frames[studio.playback.frame_at(10**18)]
