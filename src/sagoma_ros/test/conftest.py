"""A ROS context of our own for the tests of this package, and waiting for events instead of sleeping."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

PATIENCE_S = 20.0  # before a test gives up on an event that never comes


class Ros:
    """Makes nodes in one context, and spins them until something has happened."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._executor = SingleThreadedExecutor(context=context)
        self._nodes: list[Node] = []

    def add(self, node: Node) -> Node:
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def spin_until(self, happened: Callable[[], object], what: str) -> None:
        give_up = time.monotonic() + PATIENCE_S
        while not happened():
            assert time.monotonic() < give_up, f"waited {PATIENCE_S} s in vain for {what}"
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        for node in self._nodes:
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()


@pytest.fixture(scope="module")
def ros_context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


@pytest.fixture
def ros(ros_context: Context) -> Iterator[Ros]:
    ros = Ros(ros_context)
    yield ros
    ros.close()
