"""Clients of simulated cameras: Aravis, as a user's program would use it, and bare GVCP over a socket."""

import contextlib
import gc
import os
import socket
import stat
import threading
import time

import numpy as np

from gige_vision import gvcp as gvcp_payloads
from gige_vision.gvcp import PORT, AcknowledgePacket, Command, CommandPacket

HOST = "127.0.0.1"
PATIENCE_S = 30.0  # only ever used up by a failing test
RECEIVE_BUFFER_BYTES = 4 << 20
CONTROL_PRIVILEGE, CONTROL = 0x0A00, 2


def import_aravis():
    """Aravis, Gio and GLib, or None."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, Gio, GLib
    except (ImportError, ValueError):
        return None
    return Aravis, Gio, GLib


def eventually(condition, what="the condition"):
    """Wait for what another thread brings about."""
    deadline, waiting = time.monotonic() + PATIENCE_S, threading.Event()
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not come about"
        waiting.wait(0.005)
    return value


class AravisClient:
    """One camera opened through Aravis, never by discovery (which would broadcast on every interface)."""

    def __init__(self, aravis, address):
        self.Aravis, Gio, self.GLib = aravis
        inet = Gio.InetAddress.new_from_string
        self.device = self.Aravis.GvDevice.new(inet(HOST), inet(address))
        self.camera = self.Aravis.Camera.new_with_device(self.device)
        self.stream = None

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        if self.stream is not None:
            with contextlib.suppress(self.GLib.Error):  # switched off by the test
                self.camera.stop_acquisition()
        self.close()

    def close(self):
        """Give control back: Aravis does when its objects die."""
        self.stream = self.camera = self.device = None
        gc.collect()

    def start(self):
        """Open the stream and begin to receive."""
        Aravis, camera = self.Aravis, self.camera
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        camera.gv_set_packet_size(9000)
        self.stream = camera.create_stream(None, None)
        self.stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        self.stream.set_property("socket-buffer-size", RECEIVE_BUFFER_BYTES)
        self.stream.set_property("packet-resend", Aravis.GvStreamPacketResend.ALWAYS)
        self.stream.set_property("packet-timeout", 10_000)
        self.stream.set_property("frame-retention", 2_000_000)  # a busy machine may let a frame wait
        enlarge_receive_buffer(self.stream.get_port())
        for _ in range(16):
            self.stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
        camera.start_acquisition()
        return self

    def buffer(self):
        """The next buffer; incomplete ones are passed over. It goes back to the pool when the next one is asked for."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            assert time.monotonic() < deadline, "no frame came"
            buffer = self.stream.timeout_pop_buffer(1_000_000)
            if buffer is None:
                continue
            self.stream.push_buffer(buffer)  # with a pool of many it is not filled again before it has been read
            if buffer.get_status() == self.Aravis.BufferStatus.SUCCESS:
                return buffer

    def buffers(self, count):
        """(block id, camera stamp, bytes) of so many whole frames."""
        frames = []
        for _ in range(count):
            buffer = self.buffer()
            frames.append((buffer.get_frame_id(), buffer.get_timestamp(), bytes(buffer.get_data())))
        return frames

    def bytes(self):
        return np.frombuffer(self.buffer().get_data(), np.uint8).copy()


def enlarge_receive_buffer(port):
    """Give the process's UDP socket on ``port`` room: Aravis does so only after the first packet."""
    for name in os.listdir("/proc/self/fd"):
        try:
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            candidate = socket.socket(fileno=os.dup(int(name)))
        except OSError:
            continue
        with candidate:
            is_udp = candidate.family == socket.AF_INET and candidate.type == socket.SOCK_DGRAM
            if is_udp and candidate.getsockname()[1] == port:
                candidate.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


class GvcpClient:
    """Bare GVCP over a socket of its own."""

    def __init__(self, address):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(PATIENCE_S)
        self._peer = (address, PORT)
        self._request_id = 0

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self._socket.close()

    def ask(self, command, payload=b"", flags=1):
        """Send a command; the first packet that comes back for it."""
        self.send(command, payload, flags)
        return self.receive()

    def send(self, command, payload=b"", flags=1):
        self._request_id += 1
        self._socket.sendto(CommandPacket(command, payload, self._request_id, flags).encode(), self._peer)

    def send_packet(self, packet):
        self._socket.sendto(packet.encode(), self._peer)

    def receive(self, timeout_s=PATIENCE_S):
        self._socket.settimeout(timeout_s)
        return AcknowledgePacket.decode(self._socket.recv(2048))

    def is_silent(self, timeout_s=0.3):
        try:
            self.receive(timeout_s)
        except TimeoutError:
            return True
        return False

    def write(self, address, value):
        """The status of a register's write."""
        return self.ask(Command.WRITE_REGISTER, gvcp_payloads.encode_words([address, value])).status

    def read(self, address):
        """The value of a register."""
        answer = self.ask(Command.READ_REGISTER, gvcp_payloads.encode_words([address]))
        assert answer.status == 0, hex(answer.status)
        return gvcp_payloads.decode_words(answer.payload)[0]

    def take_control(self):
        return self.write(CONTROL_PRIVILEGE, CONTROL)
