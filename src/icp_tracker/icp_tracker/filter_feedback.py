"""The filter's answer to the previous frame set, awaited for a bounded time."""

from __future__ import annotations

from .mailbox import Mailbox
from .tracker import Predicted

KEPT = 64


class FilterFeedback:
    """Hands the fit of set k the filter's state after set k-1; what comes too late serves as the newest there is."""

    def __init__(self, wait_s: float) -> None:
        self.mailbox: Mailbox[Predicted] = Mailbox(KEPT, wait_s)
        self._asked_ns: int | None = None

    def put(self, prediction: Predicted) -> None:
        """A state arrived (any thread)."""
        self.mailbox.put(prediction.stamp_ns, prediction)

    def asked(self, stamp_ns: int) -> None:
        """The reference points of this set went out: the filter will answer with its stamp."""
        self._asked_ns = stamp_ns

    def after_previous_set(self) -> Predicted | None:
        """The state after the set last asked for, or the newest one when it did not come in time, or None."""
        if self._asked_ns is None:
            return None
        return self.mailbox.take(self._asked_ns) or self.mailbox.newest()
