"""The worker thread: order, dropping, errors and both ways of closing. Events, not sleeps, order the threads."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from sagoma_ros.worker import Worker

PATIENCE_S = 20.0


class Bench:
    """A worker whose first item blocks until ``go`` is set, and what became of all items."""

    def __init__(self, depth: int, function: Callable[[int], None] = lambda item: None) -> None:
        self.done: list[int] = []
        self.errors: list[Exception] = []
        self.dropped = 0
        self.started, self.go = threading.Event(), threading.Event()
        self._function = function
        self.worker = Worker[int]("bench", self._work, depth, on_drop=self._drop, on_error=self.errors.append)

    def block(self) -> None:
        self.worker.put(0)
        assert self.started.wait(PATIENCE_S)

    def finish(self) -> None:
        self.go.set()
        assert self.worker.close(finish=True, timeout_s=PATIENCE_S)

    def _work(self, item: int) -> None:
        self.started.set()
        assert self.go.wait(PATIENCE_S)
        self._function(item)
        self.done.append(item)

    def _drop(self) -> None:
        self.dropped += 1


def test_items_are_worked_on_in_order() -> None:
    bench = Bench(depth=100)
    for item in range(50):
        bench.worker.put(item)
    bench.finish()
    assert bench.done == list(range(50))
    assert bench.dropped == 0


def test_items_are_worked_on_by_another_thread() -> None:
    seen: list[str] = []
    bench = Bench(depth=1, function=lambda item: seen.append(threading.current_thread().name))
    bench.worker.put(0)
    bench.finish()
    assert seen == ["bench"]


def test_full_queue_drops_the_oldest_and_counts_it() -> None:
    bench = Bench(depth=3)
    bench.block()
    for item in (1, 2, 3, 4, 5):
        bench.worker.put(item)
    assert bench.dropped == 2
    bench.finish()
    assert bench.done == [0, 3, 4, 5]


def test_put_never_waits_for_the_work() -> None:
    bench = Bench(depth=1)
    bench.block()
    for item in range(1, 1000):
        bench.worker.put(item)  # would never return if it waited: the worker stands still until `finish`
    assert bench.done == []
    bench.finish()
    assert bench.done == [0, 999]


def test_error_is_reported_and_the_next_item_worked_on() -> None:
    def fail_on_two(item: int) -> None:
        if item == 2:
            raise ValueError("two")

    bench = Bench(depth=10, function=fail_on_two)
    for item in range(5):
        bench.worker.put(item)
    bench.finish()
    assert bench.done == [0, 1, 3, 4]
    assert [str(error) for error in bench.errors] == ["two"]


def test_close_drops_and_counts_what_waits_but_ends_what_runs() -> None:
    bench = Bench(depth=10)
    bench.block()
    for item in (1, 2, 3):
        bench.worker.put(item)
    assert not bench.worker.close(timeout_s=0)  # item 0 still runs
    bench.go.set()
    assert bench.worker.close(timeout_s=PATIENCE_S)
    assert bench.done == [0]
    assert bench.dropped == 3


def test_item_after_close_is_dropped_and_counted() -> None:
    bench = Bench(depth=10)
    bench.finish()
    bench.worker.put(7)
    assert (bench.done, bench.dropped) == ([], 1)


@pytest.mark.parametrize("finish", [True, False])
def test_idle_worker_closes_and_may_be_closed_again(finish: bool) -> None:
    bench = Bench(depth=1)
    assert bench.worker.close(finish=finish, timeout_s=PATIENCE_S)
    assert bench.worker.close(finish=finish, timeout_s=PATIENCE_S)


def test_worker_can_close_itself() -> None:
    bench = Bench(depth=10, function=lambda item: None)
    closed: list[bool] = []
    bench._function = lambda item: closed.append(bench.worker.close())
    bench.block()
    bench.worker.put(1)
    bench.go.set()
    assert bench.worker.close(timeout_s=PATIENCE_S)
    assert closed[:1] == [True]


def test_patient_put_drops_nothing_and_keeps_to_the_depth() -> None:
    bench = Bench(depth=2)
    bench.block()
    most = 0

    def feed() -> None:
        nonlocal most
        for item in range(1, 30):
            bench.worker.put_blocking(item)
            most = max(most, bench.worker.waiting)

    feeder = threading.Thread(target=feed)
    feeder.start()
    bench.go.set()
    feeder.join(PATIENCE_S)
    bench.finish()
    assert bench.done == list(range(30)) and bench.dropped == 0 and most <= 2


def test_patient_put_does_not_outlast_the_worker() -> None:
    bench = Bench(depth=1)
    bench.block()
    bench.worker.put(1)
    feeder = threading.Thread(target=lambda: bench.worker.put_blocking(2))
    feeder.start()
    closer = threading.Thread(target=bench.worker.close)
    closer.start()
    feeder.join(PATIENCE_S)
    assert not feeder.is_alive() and bench.dropped == 2  # 1 by closing, 2 because it came too late
    bench.go.set()
    closer.join(PATIENCE_S)
    assert bench.done == [0]
