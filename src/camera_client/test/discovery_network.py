"""Run as root of a network namespace of its own: searches for cameras in it, and prints what came of it.

Two pairs of interfaces: "here" with cameras at its other end "there", "other" without. The cameras are sockets that
answer broadcasts arriving at "there", with whatever address they say they have.
"""

import ipaddress
import pathlib
import socket
import subprocess
import sys
import threading
import time

from camera_client.gige import discovery
from camera_client.gige.discovery import find_camera
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError
from gige_vision.gvcp import PORT, AcknowledgePacket, CommandPacket

ETH_P_IP = 0x0800
PATIENCE_S = 20.0  # only ever used up by a failing test
LISTEN_S = 0.15  # these cameras answer at once, when the machine has time for them
CAMERAS = [
    {"address": "10.1.0.2", "serial": "S2", "mac": b"\2\0\0\0\0\2", "subnet_mask": "255.255.255.0"},
    {"address": "10.1.0.3", "serial": "S3", "mac": b"\2\0\0\0\0\3", "user_id": "left"},
]

discover_once = discovery.discover_on


def discover_on(link):
    """Listen again until every camera of the link has answered: on a busy machine they are late."""
    deadline_s = time.monotonic() + PATIENCE_S
    while len(found := discover_once(link, LISTEN_S)) < (len(CAMERAS) if link.name == "here" else 0):
        if time.monotonic() > deadline_s:
            sys.exit(f"only {len(found)} of {len(CAMERAS)} cameras answered within {PATIENCE_S:g} s")
    return found


discovery.discover_on = discover_on


def discovery_answer(address, serial="", user_id="", mac=bytes(6), subnet_mask="255.0.0.0", request_id=1):
    """The acknowledge of a camera "Maker M" at an address, laid out by hand as the standard says."""
    record = bytearray(0xF8)
    texts = {0x48: "Maker", 0x68: "M", 0xD8: serial, 0xE8: user_id}
    addresses = {0x24: address, 0x34: subnet_mask}
    fields = {place: text.encode() for place, text in texts.items()}
    fields |= {place: ipaddress.IPv4Address(text).packed for place, text in addresses.items()}
    for place, field in {0x0A: mac, **fields}.items():
        record[place : place + len(field)] = field
    return AcknowledgePacket(0x0003, bytes(record), request_id).encode()


def sh(command):
    subprocess.run(command.split(), check=True)


def make_network():
    for here, there, address in (("here", "there", "10.1.0.1/24"), ("other", "beyond", "10.2.0.1/24")):
        sh(f"ip link add {here} type veth peer name {there}")
        sh(f"ip addr add {address} dev {here}")
        for name in (here, there):
            sh(f"ip link set {name} up")
            # both ends are ours: packets come in with a source address of this very machine
            for switch, value in (("accept_local", "1"), ("rp_filter", "0")):
                pathlib.Path(f"/proc/sys/net/ipv4/conf/{name}/{switch}").write_text(value)
        wait_until_running(here)
        wait_until_running(there)
    sh("ip link set lo up")


def wait_until_running(name):
    """The kernel brings a link up a while after it was told to, and drops what is sent until then."""
    deadline_s = time.monotonic() + PATIENCE_S
    while "state UP" not in subprocess.check_output(["ip", "link", "show", name], text=True):
        if time.monotonic() > deadline_s:
            sys.exit(f"the link {name} did not run within {PATIENCE_S:g} s")


def serve_cameras():
    """A broadcast that comes out of "there" is answered by a broadcast into it, as a camera without a route would."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"there\0")
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    listener.bind(("", PORT))

    def serve():
        while True:
            packet, (_, port) = listener.recvfrom(2048)
            command = CommandPacket.decode(packet)
            for camera in CAMERAS:
                answer = discovery_answer(**camera, request_id=command.request_id)
                listener.sendto(answer, ("255.255.255.255", port))

    threading.Thread(target=serve, daemon=True).start()


def outcome(interface="here", **wanted):
    try:
        found = find_camera(AravisSettings(**wanted, interface=interface))
    except InputError as error:
        return f"{type(error).__name__}: {error}"
    return f"{found.device.address} from {found.host}"


def heard(eavesdropper):
    count = 0
    try:
        while eavesdropper.recv(2048):
            count += 1
    except BlockingIOError:
        return count


make_network()
serve_cameras()
eavesdropper = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(ETH_P_IP))
eavesdropper.bind(("beyond", ETH_P_IP))
eavesdropper.setblocking(False)
print("serial", outcome(serial="S2"), sep="\t")
print("user_id", outcome(user_id="left"), sep="\t")
print("other interface", heard(eavesdropper), sep="\t")
print("wrong interface", outcome("other", serial="S2"), sep="\t")
print("other interface when named", heard(eavesdropper), sep="\t")
