"""A node under test and a peer that plays the rest of the graph, spun together until something has happened.

Packages derive a probe of their node from `NodeProbe` and add what their tests send and ask. The fixture ``open_probe``
of the root conftest.py opens and closes probes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from sagoma_ros.process import make_executor
from sagoma_ros.qos import RESULT

PATIENCE_S = 20.0  # only ever reached by a failing test
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def values_of(message: DiagnosticArray) -> dict[str, str]:
    """Keys and values of the first status of a diagnostics message."""
    return {pair.key: pair.value for pair in message.status[0].values}


class Spinner:
    """Nodes of one context on one executor, spun by the test's own thread."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.executor = make_executor(context)
        self._nodes: list[Node] = []

    def add(self, node: Node) -> Node:
        """Spin this node too; it is destroyed by `close`."""
        self._nodes.append(node)
        self.executor.add_node(node)
        node.executor = self.executor
        return node

    def until(self, happened: Callable[[], object], what: str = "the awaited event") -> None:
        """Spin until ``happened()``; fails after PATIENCE_S."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not happened():
            assert time.monotonic() < deadline_s, f"{what} did not come within {PATIENCE_S:g} s"
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        """Destroy the nodes; may be called twice."""
        for node in self._nodes:
            self.executor.remove_node(node)
            node.destroy_node()
        self._nodes = []
        self.executor.shutdown()


class NodeProbe(Spinner):
    """One of our lifecycle nodes and its peer.

    heard : the messages of every topic listened to, in the order of their arrival.
    diagnostics : what the node says of itself on /diagnostics.
    """

    def __init__(
        self,
        context: Context,
        make_node: Callable[..., Any],
        parameters: Mapping[str, Any] | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(context)
        overrides = [Parameter(key, value=value) for key, value in (parameters or {}).items()]
        self.node = self.add(make_node(context=context, namespace=namespace, parameter_overrides=overrides))
        self.peer = self.add(rclpy.create_node("peer", context=context, namespace=namespace))
        self.heard: dict[str, list[Any]] = {}
        self.diagnostics: list[DiagnosticArray] = []
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RESULT)

    def listen(self, kind: type, topic: str, qos: object = RESULT) -> list[Any]:
        """Collect the messages of a topic."""
        messages = self.heard[topic] = []
        self.peer.create_subscription(kind, topic, messages.append, qos)
        return messages

    def start(self) -> NodeProbe:
        """Configure and activate the node."""
        assert self.node.trigger_configure() == SUCCESS
        assert self.node.trigger_activate() == SUCCESS
        return self

    def call(self, kind: type, service: str, request: object = None) -> Future:
        """Call a service as soon as it is there; the future of its response."""
        client = self.peer.create_client(kind, service)
        self.until(client.service_is_ready, service)
        return client.call_async(kind.Request() if request is None else request)

    def ask(self, kind: type, service: str, request: object = None) -> Any:
        """Call a service and wait for its response."""
        response = self.call(kind, service, request)
        self.until(response.done, f"the response of {service}")
        return response.result()

    def values(self) -> dict[str, str]:
        """Keys and values of diagnostics that are surely newer than this call."""
        count = len(self.diagnostics)
        self.until(lambda: len(self.diagnostics) > count + 1, "diagnostics")
        return values_of(self.diagnostics[-1])

    def until_values(self, **wanted: str) -> DiagnosticStatus:
        """The node's status, as soon as it shows these values."""
        self.until(
            lambda: self.diagnostics and wanted.items() <= values_of(self.diagnostics[-1]).items(), f"status {wanted}"
        )
        return self.diagnostics[-1].status[0]

    def until_said(self, text: str) -> None:
        """Wait until the node's status message has this text."""
        self.until(lambda: self.diagnostics and text in self.diagnostics[-1].status[0].message, f"'{text}'")

    def close(self) -> None:
        """Close the node, then destroy both; may be called twice."""
        if self._nodes:
            self.node.close()
        super().close()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if message.status[0].name == self.node.get_fully_qualified_name():
            self.diagnostics.append(message)
