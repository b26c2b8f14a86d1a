"""Connects a tool to a ROS graph: a node spun by a background thread, node discovery, service calls with a deadline.

The main thread waits for events with a timeout; `capture_rig.stop_signals` turns Ctrl-C into one of these events.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace

from capture_rig.errors import InputError
from sagoma_bringup.graph import CAMERA_NODE, SERVER_NODES
from sagoma_ros.middleware import bound_memory

from . import ANSWER_S, LOOK_S, ROUND_S


class RosLink:
    """Owns a context, a node and the thread that spins it; leaves signals to the caller.

    Everything created on :attr:`node` calls back on the background thread.
    """

    def __init__(self, name: str, *, namespace: str = "", domain_id: int | None = None) -> None:
        """``namespace`` : of the graph ("/studio"), in which :attr:`node` resolves names."""
        bound_memory()  # as every node does: it also is found, and finds, at once
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(
            name,
            context=self.context,
            namespace=namespace or None,
            enable_rosout=False,
            start_parameter_services=False,
            use_global_arguments=False,
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._closing = threading.Event()
        self._wake = self.node.create_guard_condition(lambda: None)
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._spin, name=f"{name} spin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop spinning and leave the graph; may be called twice. Raises a callback's exception, if there was one."""
        if not self.context.ok():
            return
        self._closing.set()
        self._wake.trigger()
        self._thread.join(ANSWER_S)
        self._executor.shutdown(timeout_sec=ANSWER_S)
        self.node.destroy_node()
        self.context.try_shutdown()
        if self.error is not None:
            raise self.error

    def __enter__(self) -> RosLink:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _spin(self) -> None:
        try:
            while self.context.ok() and not self._closing.is_set():
                try:  # rclpy's spin_until_future_complete would keep 265 bytes of each message
                    self._executor.spin_once()
                except InvalidHandle:  # another thread destroyed an entity just as rclpy was about to wait for it
                    continue
        except ExternalShutdownException:
            return
        except Exception as error:  # a callback's: the owner learns of it at close()
            self.error = error


# discovery ------------------------------------------------------------------------------------------------------------


def settled(look: Callable[[], set[str]], expect: int, wait_s: float) -> list[str]:
    """Return the sorted results of ``look`` once there are ``expect`` or more and they have not changed for ROUND_S.

    Discovery has no end: after ``wait_s`` the results so far are returned.
    """
    start_s = changed_s = time.monotonic()
    found: set[str] = set()
    while time.monotonic() - start_s < wait_s:
        seen = look()
        if seen != found:
            found, changed_s = seen, time.monotonic()
        if len(found) >= expect and time.monotonic() - changed_s > ROUND_S:
            break
        threading.Event().wait(LOOK_S)
    return sorted(found)


def find_nodes(look: Callable[[], set[str]], what: str, count: int, wait_s: float) -> list[str]:
    """Return the nodes that ``look`` finds, sorted, once there are ``count`` and none has joined for a second.

    Raises InputError when there are fewer after ``wait_s``.
    """
    found = settled(look, count, wait_s)
    if len(found) < count:
        there = f" ({', '.join(found)})" if found else ""
        remedy = "Start them (sagoma up); are they not heard? sagoma doctor --live --host ADDRESS."
        raise InputError(f"found {len(found)} {what}{there}, expected {count}", where="the ROS graph", remedy=remedy)
    return found


def node_names(node: Node) -> list[str]:
    """Fully qualified names of all nodes in the graph; a name that two nodes have stands there twice."""
    return [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]


def is_camera(full_name: str) -> bool:
    """Is this the full name of a camera client?"""
    return full_name.endswith(f"/{CAMERA_NODE}")


def label_of(full_name: str) -> str:
    """Return a node's label: of a camera client its camera, "cam01" of "/cam01/camera_client"."""
    return full_name.strip("/").removesuffix(f"/{CAMERA_NODE}")


def our_nodes(node: Node) -> set[str]:
    """Fully qualified names of the camera clients and of the server's nodes in the graph, of the node's namespace."""
    ours = (CAMERA_NODE, *SERVER_NODES)
    return {name for name in node_names(node) if name.rpartition("/")[2] in ours and is_in_graph(node, name)}


def owners_of(node: Node, service: str, kind: str) -> set[str]:
    """Full names of the nodes of the node's namespace that offer ``~/SERVICE`` of type ``kind``
    ("std_srvs/srv/Trigger")."""
    suffix = f"/{service}"
    offered = [name for name, kinds in node.get_service_names_and_types() if kind in kinds]
    owners = {name.removesuffix(suffix) for name in offered if name.endswith(suffix)}
    return {name for name in owners if is_in_graph(node, name)}


# service calls -------------------------------------------------------------------------------------------------------


class ServiceCalls:
    """Calls of the services NAME + ``suffix`` at once, each as soon as its service is there: a silent node delays none.

    replies : by name, None while there is none. unsent : whose request is to be sent. The node must be spun by another
    thread.
    """

    def __init__(self, node: Node, srv_type: Any, requests: Mapping[str, Any], suffix: str = "") -> None:
        """``requests`` by name."""
        self.replies: dict[str, Any] = dict.fromkeys(requests)
        self._node, self._requests, self.unsent = node, requests, set(requests)
        self._clients = {name: node.create_client(srv_type, name + suffix) for name in requests}
        self._answered = threading.Condition()

    def rounds(self, timeout_s: float, alive: Callable[[str], bool]) -> Iterator[set[str]]:
        """Wait for the replies of those that are ``alive``; every second, yield the names that have not answered.

        A server that has not yet discovered our side of the service drops its reply (the middleware says "failed to
        send response"): the caller may send again, or add a reply that is known by other means.
        """
        waiting, ends_s, round_s = set(self.replies), time.monotonic() + timeout_s, time.monotonic() + ROUND_S
        try:
            while waiting and time.monotonic() < ends_s:
                if time.monotonic() > round_s:
                    if silent := waiting - self.unsent:
                        yield silent
                    round_s = time.monotonic() + ROUND_S
                with self._answered:
                    for name in sorted(self.unsent & waiting):
                        if self._clients[name].service_is_ready():
                            self.unsent.discard(name)
                            future = self._clients[name].call_async(self._requests[name])
                            future.add_done_callback(lambda done, name=name: self.add(name, done.result()))
                    self._answered.wait(LOOK_S)
                    waiting = {name for name in waiting if self.replies[name] is None and alive(name)}
        finally:
            for client in self._clients.values():
                self._node.destroy_client(client)

    def add(self, name: str, reply: Any) -> None:
        """Add a reply, unless there is one."""
        with self._answered:
            if self.replies[name] is None:
                self.replies[name] = reply
            self._answered.notify()


def call_all(
    node: Node,
    srv_type: Any,
    requests: Mapping[str, Any],
    timeout_s: float,
    alive: Callable[[str], bool] = lambda name: True,
    *,
    suffix: str = "",
    repeatable: bool = False,
) -> dict[str, Any]:
    """Call services as :class:`ServiceCalls` does; name -> reply, None where none came within ``timeout_s``.

    The wait for a service ends when its ``alive`` turns false. A ``repeatable`` request is sent again every second.
    """
    calls = ServiceCalls(node, srv_type, requests, suffix)
    for silent in calls.rounds(timeout_s, alive):
        calls.unsent |= silent if repeatable else set()
    return calls.replies


# namespace of the graph -----------------------------------------------------------------------------------------------


SHARED = ("/diagnostics", "/tf", "/tf_static", "/clock", "/rosout", "/parameter_events")
"""Topics that nodes of every namespace name from the root."""


def add_namespace_argument(parser: argparse.ArgumentParser) -> None:
    """--namespace: of the graph; :func:`namespace_argument` reads it."""
    text = "of the graph, as it was launched with (namespace:=studio); default: the graph without one"
    parser.add_argument("--namespace", default="", metavar="NAME", help=text)


def namespace_argument(args: argparse.Namespace) -> str:
    """Return a namespace as ROS writes it, "/studio", and "" for none. Raises InputError for an invalid name."""
    given = str(getattr(args, "namespace", "")).strip("/")
    try:
        validate_namespace(f"/{given}")
    except InvalidNamespaceException as error:
        remedy = "Give letters, digits and underscores, as in the launch file: --namespace studio."
        raise InputError(f"'{given}' is no namespace: {error}", where="--namespace", remedy=remedy) from None
    return f"/{given}" if given else ""


def namespace_of(node: Node) -> str:
    """Return the namespace that a node stands in, "/studio"; "" for none."""
    return str(node.get_namespace()).rstrip("/")


def is_in_graph(node: Node, node_name: str) -> bool:
    """Whether this full name of a node is of the graph of ``node``'s namespace: camera clients are one level below."""
    below = node_name.removeprefix(f"{namespace_of(node)}/")
    return below != node_name and below.count("/") == is_camera(node_name)


def in_graph(node: Node, name: str) -> str:
    """Return the full name of a topic, named as it is in a graph without a namespace."""
    return name if name in SHARED else namespace_of(node) + name


def topics_of(node: Node) -> dict[str, str]:
    """Return the topics of the node's namespace and those that all share, named as without one: name -> type."""
    namespace = namespace_of(node)
    types = {name: msgtype for name, (msgtype, *_) in node.get_topic_names_and_types()}
    shared = {name: msgtype for name, msgtype in types.items() if name in SHARED}
    return shared | {n.removeprefix(namespace): t for n, t in types.items() if n.startswith(f"{namespace}/")}
