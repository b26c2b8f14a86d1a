"""One service call to many nodes at once, with a deadline, so that one silent node costs nobody else anything."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.client import Client
from rclpy.node import Node

RESEND_S = 1.0
POLL_S = 0.05  # rclpy has no event for "the service has appeared" or for a process's death; answers wake us at once


def call_all(
    node: Node,
    srv_type: Any,
    requests: Mapping[str, Any],
    timeout_s: float,
    alive: Callable[[str], bool] = lambda service: True,
    *,
    repeatable: bool = False,
    inferred: Callable[[set[str]], Mapping[str, Any]] = lambda services: {},
) -> dict[str, Any]:
    """Service name -> reply, None where none came in time; each request is sent as soon as its service is there.

    ``node`` must be spun by another thread. A service for which ``alive`` turns false is waited for no longer.

    A server that has not yet discovered our side of the service drops its reply (the middleware says "failed to send
    response"). So a ``repeatable`` request is sent again every second; for one that must not be, ``inferred`` is asked
    every second which of the silent services are known, by other means, to have done their work, and their replies.
    """
    clients = {service: node.create_client(srv_type, service) for service in requests}
    call = _Round(clients, requests, alive, repeatable, inferred)
    try:
        call.run(time.monotonic() + timeout_s)
    finally:
        for client in clients.values():
            node.destroy_client(client)
    return call.replies


class _Round:
    """One concurrent round of service calls."""

    def __init__(
        self,
        clients: Mapping[str, Client],
        requests: Mapping[str, Any],
        alive: Callable[[str], bool],
        repeatable: bool,
        inferred: Callable[[set[str]], Mapping[str, Any]],
    ) -> None:
        self._clients, self._requests, self._alive = clients, requests, alive
        self._repeatable, self._inferred = repeatable, inferred
        self._answered = threading.Condition()
        self._unsent = set(requests)
        self.replies: dict[str, Any] = dict.fromkeys(requests)

    def run(self, deadline_s: float) -> None:
        waiting, again_s = set(self._requests), time.monotonic() + RESEND_S
        while waiting and time.monotonic() < deadline_s:
            if time.monotonic() > again_s:
                self._help_the_silent(waiting)
                again_s = time.monotonic() + RESEND_S
            with self._answered:
                self._send_ready(waiting)
                self._answered.wait(POLL_S)
                waiting = {name for name in waiting if self.replies[name] is None and self._alive(name)}

    def _help_the_silent(self, waiting: set[str]) -> None:
        if self._repeatable:
            self._unsent |= waiting
        sent = waiting - self._unsent
        for service, reply in (self._inferred(sent) if sent else {}).items():
            self._take(service, reply)

    def _send_ready(self, waiting: set[str]) -> None:
        for service in sorted(self._unsent & waiting):
            if self._clients[service].service_is_ready():
                self._unsent.discard(service)
                future = self._clients[service].call_async(self._requests[service])
                future.add_done_callback(lambda done, service=service: self._take(service, done.result()))

    def _take(self, service: str, reply: Any) -> None:
        with self._answered:
            if self.replies[service] is None:
                self.replies[service] = reply
            self._answered.notify()
