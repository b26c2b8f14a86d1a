"""The common main of all nodes: spin until a signal, then release everything."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from capture_rig.errors import InputError

from .node import RCLError, SagomaNode

SIGNAL_LATENCY_S = 0.2  # Python sees a signal only when the wait for the next event returns


def run_node(factory: Callable[[], SagomaNode], args: list[str] | None = None) -> int:
    """Main of every node: spin until SIGINT or SIGTERM, then release everything.

    Returns the exit status: 0 after a signal, 1 when autostart failed, 2 when the node could not be made at all.
    """
    ending = threading.Event()

    def interrupt(number: int, frame: object) -> None:
        ending.set()
        raise KeyboardInterrupt

    # our own handlers: rclpy's shut the context down first, and a node could no longer say or release anything
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    status = 0
    node: SagomaNode | None = None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = factory()
        if node.autostart():
            _spin(node, ending)
        else:
            status = 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (InputError, RCLError) as error:  # RCLError: a parameter file or --ros-args that cannot be read
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


def _spin(node: SagomaNode, ending: threading.Event) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while rclpy.ok() and not ending.is_set():
        try:
            executor.spin_once(timeout_sec=SIGNAL_LATENCY_S)
        except ExternalShutdownException:
            raise
        except Exception as error:  # in a callback: one bad message may not end the process
            if not ending.is_set():  # else it is the interrupt, which rclpy's C++ turns into errors of its own
                node.report(error)
