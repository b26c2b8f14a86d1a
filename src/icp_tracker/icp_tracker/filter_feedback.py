"""The filter's answer to the previous frame set, awaited for a bounded time."""

from __future__ import annotations

from .mailbox import Mailbox
from .tracker import Predicted

KEPT = 64


class FilterFeedback:
    """Hands the fit of set k the filter's state after set k-1.

    The wait ends with the answer. A filter that did not answer in time is not waited for again until it speaks: a
    missing filter costs one wait, not one a set. What arrived late still serves, as the newest state there is.
    """

    def __init__(self, wait_s: float) -> None:
        self._wait_s = wait_s
        self._mailbox: Mailbox[Predicted] = Mailbox(KEPT)
        self._asked_ns: int | None = None
        self._silent = False
        self.timeouts = 0
        self.waiting = False

    def put(self, prediction: Predicted) -> None:
        """A state arrived (any thread)."""
        self._silent = False
        self._mailbox.put(prediction.stamp_ns, prediction)

    def asked(self, stamp_ns: int) -> None:
        """The reference points of this set went out: the filter will answer with its stamp."""
        self._asked_ns = stamp_ns

    def after_previous_set(self) -> Predicted | None:
        """The state after the set last asked for, or the newest one when it did not come in time, or None."""
        if self._asked_ns is None:
            return None
        self.waiting = True
        answer = self._mailbox.wait(self._asked_ns, 0.0 if self._silent else self._wait_s)
        self.waiting = False
        if answer is None and not self._silent:
            self._silent = True
            self.timeouts += 1
        return answer if answer is not None else self._mailbox.newest()

    def forget(self) -> None:
        """Start over: nothing was asked, nothing was answered."""
        self._mailbox.clear()
        self._asked_ns, self._silent = None, False

    def close(self) -> None:
        """Release a waiting fit."""
        self._mailbox.close()
