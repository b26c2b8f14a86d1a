"""A worker thread fed through a bounded queue: callbacks stay short, a slow stage drops the oldest work, counted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Worker(Generic[T]):
    """Calls ``function(item)`` for every item put, in order, on a thread of its own.

    depth : at most this many items wait; one more drops the oldest and calls ``on_drop``, once for each item that
    will never be worked on (those that :meth:`close` leaves, too).
    on_error : gets every exception that ``function`` raises; the worker goes on with the next item.
    """

    def __init__(
        self,
        name: str,
        function: Callable[[T], None],
        depth: int,
        *,
        on_drop: Callable[[], None],
        on_error: Callable[[Exception], None],
    ) -> None:
        self._function, self._on_drop, self._on_error = function, on_drop, on_error
        self._depth = depth
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Items that wait, without the one being worked on."""
        return len(self._items)

    def put(self, item: T) -> None:
        """Queue an item; never blocks. After :meth:`close` it is dropped."""
        with self._changed:
            if self._open:
                self._items.append(item)
            dropping = not self._open or len(self._items) > self._depth
            if self._open and dropping:
                self._items.popleft()
            self._changed.notify_all()
        if dropping:
            self._on_drop()

    def put_blocking(self, item: T) -> None:
        """Queue an item; wait while ``depth`` items wait already: for a stage that must not overtake the next one."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._items) < self._depth or not self._open)
        self.put(item)

    def close(self, *, finish: bool = False, timeout_s: float = 5.0) -> bool:
        """Stop the thread, after the waiting items when ``finish``; True when it ended within ``timeout_s``."""
        with self._changed:
            self._open = False
            left = 0 if finish else len(self._items)
            if not finish:
                self._items.clear()
            self._changed.notify_all()
        for _ in range(left):
            self._on_drop()
        if threading.current_thread() is self._thread:
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items or not self._open)
                if not self._items:
                    return
                item = self._items.popleft()
                self._changed.notify_all()
            try:
                self._function(item)
            except Exception as error:
                self._on_error(error)
