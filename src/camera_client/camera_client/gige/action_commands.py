"""Scheduled action commands to one camera: "expose at this time of your clock". Unicast; nothing is broadcast."""

from __future__ import annotations

import socket

from gige_vision.gvcp import PORT, AcknowledgePacket, Command, MalformedPacket, Status
from gige_vision.gvcp_payloads import Action

MOST_PENDING = 64
LAST_REQUEST_ID = 0xFFFF


class ActionSender:
    """Sends actions to the camera at ``address`` from ``host`` and takes in its acknowledges, without ever waiting.

    ``counts``: actions (acknowledged), actions_late (came after their time), actions_refused (anything else, such as no
    room for another one or no PTP time), actions_unanswered.
    """

    def __init__(self, address: str, host: str, device_key: int, group_key: int, group_mask: int) -> None:
        self._keys = (device_key, group_key, group_mask)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, 0))
            self._socket.connect((address, PORT))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._request_id = 0
        self._pending: dict[int, None] = {}  # request ids, in the order they were sent
        self.counts = {"actions": 0, "actions_late": 0, "actions_refused": 0, "actions_unanswered": 0}

    def send(self, time_ns: int) -> None:
        """Ask for one action at ``time_ns`` of the camera's clock."""
        self.collect()
        self._request_id = self._request_id % LAST_REQUEST_ID + 1
        try:
            self._socket.send(Action(*self._keys, time_ns).command(self._request_id).encode())
        except OSError:  # the camera's host answered that nobody listens there, or the link is down
            self.counts["actions_unanswered"] += 1
            return
        self._pending[self._request_id] = None
        if len(self._pending) > MOST_PENDING:
            del self._pending[next(iter(self._pending))]
            self.counts["actions_unanswered"] += 1

    def collect(self) -> None:
        """Take in the acknowledges that have come."""
        while True:
            try:
                answer = AcknowledgePacket.decode(self._socket.recv(2048))
            except (BlockingIOError, ConnectionError):
                return
            except MalformedPacket:
                continue
            if answer.acknowledge == Command.ACTION.acknowledge and answer.request_id in self._pending:
                del self._pending[answer.request_id]
                self.counts[_RESULTS.get(answer.status, "actions_refused")] += 1

    def close(self) -> None:
        self._socket.close()


_RESULTS = {int(Status.SUCCESS): "actions", int(Status.ACTION_LATE): "actions_late"}
