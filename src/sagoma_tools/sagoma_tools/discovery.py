"""Finding out who is in a ROS graph: discovery has no end, so this looks until nobody new has joined for a while."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rclpy.node import Node

SETTLED_S, LOOK_S = 1.0, 0.1


def settled(look: Callable[[], set[str]], expect: int, wait_s: float) -> list[str]:
    """What ``look`` finds, sorted, once it is ``expect`` or more and has not changed for a second; after ``wait_s``
    whatever it has found."""
    start_s = changed_s = time.monotonic()
    found: set[str] = set()
    while time.monotonic() - start_s < wait_s:
        seen = look()
        if seen != found:
            found, changed_s = seen, time.monotonic()
        if len(found) >= expect and time.monotonic() - changed_s > SETTLED_S:
            break
        threading.Event().wait(LOOK_S)
    return sorted(found)


def owners_of(node: Node, service: str, kind: str) -> set[str]:
    """Full names of the nodes that offer ``~/SERVICE`` of type ``kind`` ("std_srvs/srv/Trigger")."""
    suffix = f"/{service}"
    offered = node.get_service_names_and_types()
    return {name.removesuffix(suffix) for name, kinds in offered if name.endswith(suffix) and kind in kinds}
