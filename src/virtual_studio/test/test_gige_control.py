"""A simulated camera's control channel, spoken to in bare GVCP; its registers and their GenICam description."""

import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from gige_client import CONTROL_PRIVILEGE, GvcpClient, eventually

from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.gvcp import Action, Command, DeviceRecord, Status
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera, free_address
from virtual_studio.gige.feature_table import feature_table
from virtual_studio.gige.registers import FILE_SPACE, RegisterError, Registers, genicam_xml


@pytest.fixture
def camera():
    with SimulatedCamera(free_address(), PatternScene(), CameraSettings(user_id="left", ptp_settle_s=0.0)) as camera:
        yield camera


@pytest.fixture
def client(camera):
    with GvcpClient(camera.address) as client:
        yield client


def test_nobody_writes_without_control(camera, client):
    assert client.write(bootstrap.HEARTBEAT_TIMEOUT_MS, 5000) == Status.ACCESS_DENIED
    assert client.take_control() == Status.SUCCESS
    assert client.write(bootstrap.HEARTBEAT_TIMEOUT_MS, 5000) == Status.SUCCESS
    assert client.read(bootstrap.HEARTBEAT_TIMEOUT_MS) == 5000


def test_heartbeat_that_stops_frees_the_camera_and_ends_its_stream(camera, client):
    client.take_control()
    client.write(bootstrap.HEARTBEAT_TIMEOUT_MS, 300)
    client.write(bootstrap.STREAM_PORT, 50_000)
    eventually(lambda: camera.status()["controller"] == "")  # asks the camera's program, not the camera
    assert camera.counters["heartbeats_lost"] == 1
    assert client.read(bootstrap.STREAM_PORT) == 0


def test_garbage_is_counted_and_an_unknown_command_is_answered_not_implemented(camera, client):
    client._socket.sendto(b"\x42\x01\x00", client._peer)
    client._socket.sendto(b"not a command at all", client._peer)
    assert client.ask(0x0BAD).status == Status.NOT_IMPLEMENTED
    assert client.ask(Command.DISCOVERY).status == 0
    assert camera.counters["malformed_commands"] == 2


def test_unplugged_camera_is_silent_and_keeps_its_settings(camera, client):
    client.take_control()
    client.write(bootstrap.HEARTBEAT_TIMEOUT_MS, 60_000)
    camera.faults.unplugged = True
    client.send(Command.DISCOVERY)
    assert client.is_silent()
    camera.faults.unplugged = False
    assert client.read(bootstrap.HEARTBEAT_TIMEOUT_MS) == 60_000
    assert client.read(CONTROL_PRIVILEGE) == 2


def test_address_is_taken_while_a_camera_is_on_and_free_when_it_is_off(camera):
    with pytest.raises(InputError, match=rf"camera {camera.address}: .*another camera is there.*loopback address"):
        SimulatedCamera(camera.address, PatternScene()).start()
    camera.power_off()
    other = SimulatedCamera(camera.address, PatternScene(), CameraSettings(serial="OTHER"))
    with other, GvcpClient(other.address) as client:
        assert DeviceRecord.decode(client.ask(Command.DISCOVERY).payload).serial == "OTHER"


def test_action_for_others_is_not_answered(camera, client):
    client.take_control()
    at = {feature.name: feature.address for feature in camera.features}
    for key, value in (("ActionDeviceKey", 1), ("ActionGroupKey", 2), ("ActionGroupMask", 6)):
        assert client.write(at[key], value) == 0
    for stranger in (Action(9, 2, 6, 0), Action(1, 9, 6, 0), Action(1, 2, 8, 0)):
        client.send_packet(stranger.command())
    assert client.is_silent()
    client.send_packet(Action(1, 2, 2, 0).command(request_id=77))
    answer = client.receive()
    assert (answer.acknowledge, answer.status, answer.request_id) == (0x0101, Status.NO_REFERENCE_TIME, 77)


# --- registers and their description ----------------------------------------------------------------------------------

NAMESPACE = "{http://www.genicam.org/GenApi/Version_1_1}"
FEATURES = feature_table(CameraSettings(), "127.0.0.9", 640, 480, colour=True)


def status_of(action):
    with pytest.raises(RegisterError) as refused:
        action()
    return refused.value.status


def test_description_refers_to_what_it_describes_and_to_readable_registers():
    root, memory = ElementTree.fromstring(genicam_xml(FEATURES)), Registers(FEATURES)
    nodes = {node.get("Name") for node in root.iter() if node.get("Name") and node.tag != NAMESPACE + "EnumEntry"}
    tags = ("pFeature", "pValue", "pMax", "pPort")
    references = [node.text for tag in tags for node in root.iter(NAMESPACE + tag)]
    assert len(references) > 120 and set(references) <= nodes
    registers = [
        node for tag in ("IntReg", "FloatReg", "MaskedIntReg", "StringReg") for node in root.iter(NAMESPACE + tag)
    ]
    assert len(registers) > 50
    for node in registers:
        address, length = int(node.findtext(NAMESPACE + "Address"), 16), int(node.findtext(NAMESPACE + "Length"))
        assert len(memory.read(address, length)) == length, node.get("Name")


def test_accesses_are_refused_with_the_status_that_says_why():
    memory, at = Registers(FEATURES, b"0123456789abcdef"), {f.name: f.address for f in FEATURES}
    assert status_of(lambda: memory.read(0x7_0000, 4)) == Status.INVALID_ADDRESS
    assert status_of(lambda: memory.read(at["Width"] + 1, 4)) == Status.BAD_ALIGNMENT
    assert status_of(lambda: memory.read(at["Width"], 3)) == Status.BAD_ALIGNMENT
    assert status_of(lambda: memory.write(at["ExposureTime"] + 4, bytes(4))) == Status.BAD_ALIGNMENT
    assert status_of(lambda: memory.write(at["SensorWidth"], bytes(4))) == Status.WRITE_PROTECT
    assert status_of(lambda: memory.write(at["Width"], struct.pack(">I", 642))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["Width"], struct.pack(">I", 644))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["PixelFormat"], struct.pack(">I", 7))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["ExposureTime"], struct.pack(">d", np.nan))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.read(FILE_SPACE + 16, 4)) == Status.INVALID_ADDRESS
    assert memory.read(FILE_SPACE + 4, 8) == b"456789ab"
    assert memory.integer("Width") == 640
