"""The common main of all nodes: spin until a signal, then release everything."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from capture_rig.errors import InputError

from .node import SagomaNode

SIGNAL_LATENCY_S = 0.2  # Python sees a signal only when the wait for the next event returns


def run_node(factory: Callable[[], SagomaNode], args: list[str] | None = None) -> int:
    """Main of every node: spin until SIGINT or SIGTERM, then release everything. Returns the exit status."""
    # our own handlers: rclpy's shut the context down first, and a node could no longer say or release anything
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    status = 0
    node: SagomaNode | None = None
    try:
        node = factory()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        status = 0 if node.autostart() else 1
        if status == 0:
            while rclpy.ok():
                executor.spin_once(timeout_sec=SIGNAL_LATENCY_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(error, file=sys.stderr)
        status = 2
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt
