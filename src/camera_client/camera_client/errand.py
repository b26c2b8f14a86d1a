"""Calls that may block for seconds, each on a thread of its own: a dead device keeps nobody else waiting."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Errand(Generic[T]):
    """Runs ``call`` on a daemon thread from now on.

    Whoever loses interest calls :meth:`abandon`: a result that comes nevertheless is handed to ``dispose`` (a camera
    that answered too late is closed again).
    """

    def __init__(self, call: Callable[[], T], dispose: Callable[[T], object] = lambda result: None) -> None:
        self._call, self._dispose = call, dispose
        self._error: Exception | None = None
        self._lock = threading.Lock()
        self._returned = self._abandoned = False
        self._over = threading.Event()
        threading.Thread(target=self._run, name="errand", daemon=True).start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """True once the call has returned or raised (and, when abandoned, its result is disposed of)."""
        return self._over.wait(timeout_s)

    def result(self) -> T:
        """What the call returned; raises what it raised. Waits for it."""
        self._over.wait()
        if self._error is not None:
            raise self._error
        return self._result

    def abandon(self) -> None:
        """Never mind; does not wait."""
        with self._lock:
            if self._abandoned:
                return
            self._abandoned = True
            if not self._returned or self._error is not None:
                return
            self._over.clear()
        threading.Thread(target=self._throw_away, name="errand", daemon=True).start()

    def _run(self) -> None:
        try:
            self._result = self._call()
        except Exception as error:
            self._error = error
        with self._lock:
            self._returned = True
            unwanted = self._abandoned and self._error is None
        if unwanted:
            self._throw_away()
        else:
            self._over.set()

    def _throw_away(self) -> None:
        try:
            self._dispose(self._result)
        finally:
            self._over.set()
