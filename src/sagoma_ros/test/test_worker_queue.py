"""The worker thread: order, dropping, errors and both ways of closing. Events, not sleeps, order the threads."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from sagoma_ros.worker import Worker

PATIENCE_S = 20.0


class GatedWorker:
    """A worker whose first item blocks until ``go`` is set, and what became of all items."""

    def __init__(self, depth: int, function: Callable[[int], None] = lambda item: None) -> None:
        self.done: list[int] = []
        self.errors: list[Exception] = []
        self.dropped = 0
        self.started, self.go = threading.Event(), threading.Event()
        self.function = function
        self.worker = Worker[int]("gated", self._work, depth, on_drop=self._drop, on_error=self.errors.append)

    def block(self) -> None:
        self.worker.put(0)
        assert self.started.wait(PATIENCE_S)

    def finish(self) -> None:
        self.go.set()
        assert self.worker.close(finish=True, timeout_s=PATIENCE_S)

    def _work(self, item: int) -> None:
        self.started.set()
        assert self.go.wait(PATIENCE_S)
        self.function(item)
        self.done.append(item)

    def _drop(self) -> None:
        self.dropped += 1


def test_items_are_worked_on_in_order_by_another_thread() -> None:
    threads: list[str] = []
    gated = GatedWorker(depth=100, function=lambda item: threads.append(threading.current_thread().name))
    for item in range(50):
        gated.worker.put(item)
    gated.finish()
    assert gated.done == list(range(50)) and gated.dropped == 0
    assert threads == ["gated"] * 50


def test_full_queue_drops_the_oldest_and_counts_it_and_put_never_waits() -> None:
    gated = GatedWorker(depth=3)
    gated.block()
    for item in range(1, 1000):
        gated.worker.put(item)  # would never return if it waited: the worker stands still until `finish`
    assert gated.done == [] and gated.dropped == 996
    gated.finish()
    assert gated.done == [0, 997, 998, 999]


def test_error_is_reported_and_the_next_item_worked_on() -> None:
    def fail_on_two(item: int) -> None:
        if item == 2:
            raise ValueError("two")

    gated = GatedWorker(depth=10, function=fail_on_two)
    for item in range(5):
        gated.worker.put(item)
    gated.finish()
    assert gated.done == [0, 1, 3, 4]
    assert [str(error) for error in gated.errors] == ["two"]


def test_close_drops_and_counts_what_waits_but_ends_what_runs() -> None:
    gated = GatedWorker(depth=10)
    gated.block()
    for item in (1, 2, 3):
        gated.worker.put(item)
    assert not gated.worker.close(timeout_s=0)  # item 0 still runs
    gated.go.set()
    assert gated.worker.close(timeout_s=PATIENCE_S)
    assert gated.done == [0]
    assert gated.dropped == 3


@pytest.mark.parametrize("finish", [True, False])
def test_idle_worker_may_be_closed_twice_and_drops_and_counts_what_comes_later(finish: bool) -> None:
    gated = GatedWorker(depth=1)
    assert gated.worker.close(finish=finish, timeout_s=PATIENCE_S)
    assert gated.worker.close(finish=finish, timeout_s=PATIENCE_S)
    gated.worker.put(7)
    assert (gated.done, gated.dropped) == ([], 1)


def test_worker_can_close_itself() -> None:
    gated = GatedWorker(depth=10, function=lambda item: None)
    closed: list[bool] = []
    gated.function = lambda item: closed.append(gated.worker.close())
    gated.block()
    gated.worker.put(1)
    gated.go.set()
    assert gated.worker.close(timeout_s=PATIENCE_S)
    assert closed[:1] == [True]


def test_patient_put_drops_nothing_and_keeps_to_the_depth() -> None:
    gated = GatedWorker(depth=2)
    gated.block()
    most = 0

    def feed() -> None:
        nonlocal most
        for item in range(1, 30):
            gated.worker.put_blocking(item)
            most = max(most, gated.worker.waiting)

    feeder = threading.Thread(target=feed)
    feeder.start()
    gated.go.set()
    feeder.join(PATIENCE_S)
    gated.finish()
    assert gated.done == list(range(30)) and gated.dropped == 0 and most <= 2


def test_patient_put_does_not_outlast_the_worker() -> None:
    gated = GatedWorker(depth=1)
    gated.block()
    gated.worker.put(1)
    feeder = threading.Thread(target=lambda: gated.worker.put_blocking(2))
    feeder.start()
    closer = threading.Thread(target=gated.worker.close)
    closer.start()
    feeder.join(PATIENCE_S)
    assert not feeder.is_alive() and gated.dropped == 2  # 1 by closing, 2 because it came too late
    gated.go.set()
    closer.join(PATIENCE_S)
    assert gated.done == [0]
