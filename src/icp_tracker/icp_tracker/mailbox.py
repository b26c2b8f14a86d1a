"""Messages by capture stamp, put by one thread and awaited by another for a bounded time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the last ``keep`` items by stamp."""

    def __init__(self, keep: int) -> None:
        self._keep = keep
        self._items: OrderedDict[int, T] = OrderedDict()
        self._changed = threading.Condition()
        self._open = True

    def put(self, stamp_ns: int, item: T) -> None:
        """Store an item; the oldest one beyond the capacity is forgotten."""
        with self._changed:
            self._items.pop(stamp_ns, None)
            self._items[stamp_ns] = item
            while len(self._items) > self._keep:
                self._items.popitem(last=False)
            self._changed.notify_all()

    def wait(self, stamp_ns: int, timeout_s: float) -> T | None:
        """The item of exactly this stamp, as soon as it is there; None after ``timeout_s`` or when closed."""
        with self._changed:
            self._changed.wait_for(lambda: stamp_ns in self._items or not self._open, timeout_s)
            return self._items.get(stamp_ns)

    def newest(self) -> T | None:
        """The item with the largest stamp."""
        with self._changed:
            return self._items[max(self._items)] if self._items else None

    def clear(self) -> None:
        """Forget all items."""
        with self._changed:
            self._items.clear()

    def close(self) -> None:
        """Release whoever waits."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
