"""The common main of our nodes: one node in a process or several, one executor, and an end in order on a signal."""

from __future__ import annotations

import gc
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from capture_rig.errors import InputError

from .middleware import bound_memory
from .node import CommonSettings, SagomaNode, read_declared

try:  # is told what has come, where the other asks every entity of every node for each message
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before Kilted
    EventsExecutor = SingleThreadedExecutor

RCLError = rclpy_implementation.RCLError
SIGNALS = (signal.SIGINT, signal.SIGTERM)
SIGNAL_LATENCY_S = 0.2  # Python sees a signal only when the wait for the next event returns
BLOCKED_S = 1.0  # after which a callback is interrupted
COLLECT_AFTER = (700, 10, 1)  # Python's own, but for a full collection each 14 000 objects: 0.03 ms, 2000 are alive


def make_executor(context: Context | None = None) -> Executor:
    """Return the cheapest executor that this rclpy has; callbacks run on the thread that spins it."""
    return EventsExecutor(context=context)


def run_node(factory: Callable[[], SagomaNode], args: list[str] | None = None) -> int:
    """Main of a node: as :func:`run_nodes` with it alone."""
    return run_nodes([factory], args)


def run_nodes(factories: Sequence[Callable[[], SagomaNode]], args: list[str] | None = None) -> int:
    """Spin nodes in one process until SIGINT or SIGTERM, then release everything.

    Those with the parameter ``autostart`` configure in the order given and activate in the opposite one: a node is
    active before the one that sends to it. Returns the exit status: 0 after a signal, 1 when autostart failed, 2 when a
    node could not be made at all.
    """
    bound_memory()
    ending = _Ending()
    status = 0
    nodes: list[SagomaNode] = []
    # a client that has gone gets no reply: its own affair, and nothing that our user could mend
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        nodes.extend(factory() for factory in factories)
        for node in nodes:
            node.on_active = freeze_garbage_collector
        if autostart(nodes):
            _spin(nodes, ending)
        else:
            status = 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (InputError, RCLError) as error:  # RCLError: a parameter file or --ros-args that cannot be read
        print(error, file=sys.stderr)
        status = 2
    finally:
        ending.ignore()
        for node in nodes:
            node.close()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def autostart(nodes: Sequence[SagomaNode]) -> bool:
    """Activate the nodes with the parameter ``autostart``, as :func:`run_nodes` does; False: it failed."""
    starting = [node for node in nodes if read_declared(node, CommonSettings).autostart]
    steps = [node.trigger_configure for node in starting] + [node.trigger_activate for node in reversed(starting)]
    return all(step() == TransitionCallbackReturn.SUCCESS for step in steps)


def freeze_garbage_collector() -> None:
    """Collect garbage now, and exclude the objects in use from later collections (``gc.freeze``).

    Modules and compiled kernels are some 400 000 objects: a full collection of them takes 0.15 s and more, while frame
    sets wait. The other objects are few, and collected often: Python's default would wait until those of the middle
    generation are a quarter of all, as it counts the frozen ones among these.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
    gc.collect()  # resets Python's count of long-lived objects to those not frozen
    gc.set_threshold(*COLLECT_AFTER)


class _Ending:
    """Handles SIGINT and SIGTERM; rclpy's own handlers would end the context before a node could release anything.

    A signal raises KeyboardInterrupt, except while the executor spins, which loses track of its entities when it is
    interrupted. There a flag is set, and the interrupt raised BLOCKED_S later if a callback blocks.
    """

    def __init__(self) -> None:
        self.asked = self.spinning = False
        for number in SIGNALS:
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGALRM, self._insist)

    def ignore(self) -> None:
        """Ignore further signals: the process ends."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in (*SIGNALS, signal.SIGALRM):
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: object) -> None:
        self.asked = True
        if not self.spinning:
            raise KeyboardInterrupt
        signal.setitimer(signal.ITIMER_REAL, BLOCKED_S)

    def _insist(self, number: int, frame: object) -> None:
        raise KeyboardInterrupt


def _spin(nodes: Sequence[SagomaNode], ending: _Ending) -> None:
    ending.spinning = True
    with _executing(nodes) as executor:
        while rclpy.ok() and not ending.asked:
            try:
                executor.spin_once(timeout_sec=SIGNAL_LATENCY_S)
            except ExternalShutdownException:
                raise
            except Exception as error:  # in a callback: one bad message may not end the process
                if not ending.asked:  # else it is the interrupt, which rclpy's C++ turns into errors of its own
                    nodes[0].report(error)
        ending.ignore()


@contextmanager
def _executing(nodes: Sequence[SagomaNode]) -> Iterator[Executor]:
    """An executor of these nodes, shut down at the end: garbage collection may come after the context's end."""
    executor = make_executor()
    for node in nodes:
        executor.add_node(node)
        node.executor = executor
    try:
        yield executor
    finally:
        for node in nodes:
            executor.remove_node(node)
        executor.shutdown()
