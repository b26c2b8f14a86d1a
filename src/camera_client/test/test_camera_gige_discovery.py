"""Finding a camera: by address on loopback; by serial and name in a network of its own, made for the test."""

import os
import pathlib
import shutil
import socket
import subprocess
import sys
import threading

import pytest

from camera_client.frame_source import SourceUnavailable
from camera_client.gige import discovery
from camera_client.gige.discovery import discover_at, find_camera, select_interface
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError
from gige_vision.gvcp import PORT, AcknowledgePacket, DeviceRecord
from virtual_studio.gige import free_address

PATIENCE_S = 20.0  # only ever used up by a failing test
NETWORK_SCRIPT = pathlib.Path(__file__).with_name("discovery_network.py")


@pytest.fixture
def listener(monkeypatch):
    """A socket where a camera would answer; who asks it gives up soon."""
    monkeypatch.setattr(discovery, "ANSWER_TIMEOUT_S", 0.1)
    address = free_address()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((address, PORT))
        yield sock


def test_mute_and_absent_cameras_are_unavailable_and_nobody_else_is_asked(listener):
    address = listener.getsockname()[0]
    with pytest.raises(SourceUnavailable, match=rf"no GigE Vision camera answers at {address} \(nothing answered\)"):
        discover_at(address)
    listener.setblocking(False)
    assert [listener.recv(2048) for _ in range(discovery.ATTEMPTS)] == [discovery.DISCOVERY.encode()] * 3
    absent = free_address()
    with pytest.raises(SourceUnavailable, match=rf"{absent} \(Connection refused\).*ping"):
        discover_at(absent)


def test_answer_that_is_no_discovery_record_is_no_camera(listener):
    address = listener.getsockname()[0]
    short = AcknowledgePacket(0x0003, b"short", 1).encode()
    other = AcknowledgePacket(0x0081, bytes(0xF8), 1).encode()

    def answer():
        _, peer = listener.recvfrom(2048)
        for packet in (b"x", short, other):
            listener.sendto(packet, peer)

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    with pytest.raises(SourceUnavailable, match="nothing answered"):
        discover_at(address)
    thread.join(PATIENCE_S)


@pytest.mark.parametrize(
    "wanted, said",
    [
        *(({"address": each}, "aravis.address") for each in ("cam01", "224.0.0.1", "0.0.0.0", "192.168.1.255")),
        ({}, r"aravis\.address, aravis\.serial or aravis\.user_id"),
        ({"serial": "S7"}, r"needs an interface.*lo \(127\.0\.0\.1/8\)"),
        ({"serial": "S7", "interface": "eth77"}, r"no interface 'eth77'.*lo \(127\.0\.0\.1/8\)"),
    ],
)
def test_choice_that_names_no_camera_or_interface_is_refused(wanted, said):
    with pytest.raises(InputError, match=said) as raised:
        find_camera(AravisSettings(**wanted))
    assert not isinstance(raised.value, SourceUnavailable)


def test_interface_is_chosen_by_name_or_own_address():
    assert select_interface("lo") == select_interface("127.0.0.1")


# --- searching, in a network namespace ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def searched():
    """What find_camera() said in a network of two interfaces, with cameras on one of them; see discovery_network.py."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("unshare or ip is not installed: no network of its own for this test")
    unshare = ["unshare", "--user", "--map-root-user", "--net"]
    probe = ["sh", "-c", "ip link add probe0 type veth peer name probe1"]
    if subprocess.run([*unshare, *probe], capture_output=True).returncode:
        pytest.skip("this system lets us make no network namespace with a pair of interfaces")
    run = subprocess.run(
        [*unshare, sys.executable, str(NETWORK_SCRIPT)],
        capture_output=True,
        text=True,
        timeout=6 * PATIENCE_S,
        env=os.environ,
    )
    assert run.returncode == 0, run.stderr
    return dict(line.split("\t", 1) for line in run.stdout.splitlines())


def test_camera_is_found_by_serial_or_name_on_the_interface_named_and_no_other_hears_of_it(searched):
    assert searched["serial"] == "10.1.0.2 from 10.1.0.1"
    assert searched["user_id"] == "10.1.0.3 from 10.1.0.1"
    assert searched["other interface"] == "0"
    assert searched["wrong interface"].startswith("SourceUnavailable: camera serial S2: does not answer on other")
    assert int(searched["other interface when named"]) > 0


@pytest.mark.parametrize(
    "wanted, kind, said",
    [
        ({"serial": "S99"}, SourceUnavailable, r"camera serial S99: does not answer on lo \(127\.0\.0\.1/8\).*S2.*S6"),
        ({"user_id": "twin"}, InputError, "camera user id twin: is not one camera but 2"),
        (
            {"serial": "S6"},
            InputError,
            r"192\.168\.77\.5/255\.0\.0\.0 is in another subnet.*a free address in 127\.0\.0\.0/8",
        ),
    ],
)
def test_search_that_finds_no_single_camera_in_reach_says_why(monkeypatch, wanted, kind, said):
    twins = (DeviceRecord(f"127.0.0.{k}", serial=f"S{k}", user_id="twin") for k in (2, 3))
    answers = (*twins, DeviceRecord("192.168.77.5", serial="S6"))
    monkeypatch.setattr(discovery, "discover_on", lambda link: answers)
    with pytest.raises(kind, match=said):
        find_camera(AravisSettings(interface="lo", **wanted))
