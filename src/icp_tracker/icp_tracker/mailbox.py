"""Messages by capture stamp, put by one thread and awaited by another for a bounded time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the last ``keep`` items by stamp; whoever asks for one that is not there waits up to ``wait_s``.

    A sender that did not deliver in time is not waited for again until it delivers something: a missing sender costs
    one wait, not one for every item. ``timeouts`` counts the waits in vain.
    """

    def __init__(self, keep: int, wait_s: float) -> None:
        self._keep, self._wait_s = keep, wait_s
        self._items: OrderedDict[int, T] = OrderedDict()
        self._changed = threading.Condition()
        self._open, self._silent = True, False
        self.waiting = False
        self.timeouts = 0

    def put(self, stamp_ns: int, item: T) -> None:
        """Store an item; the oldest one beyond the capacity is forgotten."""
        with self._changed:
            self._silent = False
            self._items.pop(stamp_ns, None)
            self._items[stamp_ns] = item
            while len(self._items) > self._keep:
                self._items.popitem(last=False)
            self._changed.notify_all()

    def take(self, stamp_ns: int) -> T | None:
        """The item of exactly this stamp, as soon as it is there; None when it did not come in time."""
        with self._changed:
            self.waiting = True
            patience = 0.0 if self._silent else self._wait_s
            self._changed.wait_for(lambda: stamp_ns in self._items or not self._open, patience)
            self.waiting = False
            item = self._items.get(stamp_ns)
            if item is None and self._open and not self._silent:
                self._silent = True
                self.timeouts += 1
            return item

    def newest(self) -> T | None:
        """The item with the largest stamp."""
        with self._changed:
            return self._items[max(self._items)] if self._items else None

    def close(self) -> None:
        """Release whoever waits."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
