"""Whether a frame set comes in order, too late, or begins anew: its stamp against those that came before."""

from __future__ import annotations

from enum import Enum

from .frame_set import LEAP_NS

RESTART_AFTER = 10  # sets in a row that are of the past, if not far: by then nobody repeats or delays single ones


class Order(Enum):
    """Where a set's stamp stands."""

    NEXT = "next"
    """later than all before"""
    PAST = "past"
    """not later than the last one: one to leave out"""
    RESTART = "restart"
    """the stamps themselves went back: a bag or footage started again, or a clock was set back"""


class StampOrder:
    """Remembers the last stamp taken, and says of each new one where it stands.

    Sets come in the order in which they are sent. A stamp that goes back by more than a quarter of a second, as far as
    the frame sets' own vote demands (`mocap_packets.frame_set`), is a new beginning at once; a shorter way back, of
    footage shorter than that, is one after ten sets.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all stamps."""
        self.last_ns: int | None = None
        self._past = 0

    def take(self, stamp_ns: int) -> Order:
        """Return where a set's stamp stands; later ones are compared with it unless it is of the past."""
        back_ns = 0 if self.last_ns is None else self.last_ns - stamp_ns
        late = self.last_ns is not None and back_ns >= 0
        self._past = self._past + 1 if late else 0
        if late and back_ns < LEAP_NS and self._past < RESTART_AFTER:
            return Order.PAST
        self.last_ns, self._past = stamp_ns, 0
        return Order.RESTART if late else Order.NEXT
