"""A client of simulated cameras: bare GVCP over a socket."""

import socket
import threading
import time

from gige_vision import gvcp as gvcp_payloads
from gige_vision.gvcp import PORT, AcknowledgePacket, Command, CommandPacket

PATIENCE_S = 30.0  # only ever used up by a failing test
CONTROL_PRIVILEGE, CONTROL = 0x0A00, 2


def eventually(condition, what="the condition"):
    """Wait for what another thread brings about."""
    deadline, waiting = time.monotonic() + PATIENCE_S, threading.Event()
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not come about"
        waiting.wait(0.005)
    return value


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
