"""A node of the tool's own, spun by a background thread, so that the main thread can wait for events with a timeout."""

from __future__ import annotations

import threading
from types import TracebackType

import rclpy
from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

SPIN_END_S = 5.0


class RosLink:
    """Context, node and spinning thread in one; leaves signals to the caller.

    Everything created on :attr:`node` calls back on the background thread.
    """

    def __init__(self, name: str, *, domain_id: int | None = None) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(
            name, context=self.context, enable_rosout=False, start_parameter_services=False, use_global_arguments=False
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._closing = Future(executor=self._executor)
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._spin, name=f"{name} spin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop spinning and leave the graph; may be called twice. Raises what a callback had raised, if one had."""
        if not self.context.ok():
            return
        self._closing.set_result(None)  # wakes the executor
        self._thread.join(SPIN_END_S)
        self._executor.shutdown(timeout_sec=SPIN_END_S)
        self.node.destroy_node()
        self.context.try_shutdown()
        if self.error is not None:
            raise self.error

    def __enter__(self) -> RosLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _spin(self) -> None:
        try:
            while not self._closing.done():
                try:
                    self._executor.spin_until_future_complete(self._closing)
                except InvalidHandle:  # another thread destroyed an entity just as rclpy was about to wait for it
                    continue
        except ExternalShutdownException:
            return
        except Exception as error:  # a callback's: the owner learns of it at close()
            self.error = error
