"""Whether a frame set comes in order, too late, far ahead, or begins anew: its stamp against those before it."""

from __future__ import annotations

from enum import Enum

from .frame_set import TIME_JUMP_NS

# Thresholds: judgement, no measurement.
RESTART_AFTER = 10  # sets in a row that are of the past, if not far: by then nobody repeats or delays single ones
CONFIRMED_BY = 3  # sets in a row that go on from a leap, before it is believed: a stray message is alone
AHEAD_NS = 1_000_000_000  # a set may be so much later than the last one and the time since: queues, footage played fast


class Order(Enum):
    """Where a set's stamp stands."""

    NEXT = "next"
    """later than all before"""
    PAST = "past"
    """not later than the last one: one to leave out"""
    AHEAD = "ahead"
    """far later than it can be, and no other went on from it yet: one to leave out"""
    RESTART = "restart"
    """the stamps themselves went back: a bag or footage started again, or a clock was set back"""


class StampOrder:
    """Remembers the last stamp taken, and says of each new one where it stands.

    Sets come in the order in which they are sent. A stamp that goes back by more than a quarter of a second, as far as
    the frame sets' own vote demands (`mocap_packets.frame_set`), is a new beginning at once; a shorter way back, of
    footage shorter than that, is one after ten sets. Where arrivals are known, a single stray message begins nothing: a
    stamp that is ahead by more than a second and the time since the last set, or that goes far back, is believed once
    three sets in a row go on from it.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all stamps."""
        self.last_ns: int | None = None
        self._arrived_ns: int | None = None
        self._past = 0
        self._leaps = 0  # sets in a row that went on from the first that leapt, itself counted
        self._leapt: tuple[int, int] = (0, 0)  # stamp and arrival of the last of them

    def take(self, stamp_ns: int, arrival_ns: int | None = None) -> Order:
        """Return where a set's stamp stands; later ones are compared with it unless it is left out.

        arrival_ns : on a clock that only goes forward; None where any time may lie between two sets (lockstep replay).
        """
        if self.last_ns is None:
            return self._taken(stamp_ns, arrival_ns, Order.NEXT)
        back_ns = self.last_ns - stamp_ns
        if arrival_ns is not None and self._arrived_ns is not None:
            ahead = -back_ns > AHEAD_NS + max(arrival_ns - self._arrived_ns, 0)
            if (ahead or back_ns >= TIME_JUMP_NS) and not self._confirmed(stamp_ns, arrival_ns):
                return Order.AHEAD if ahead else Order.PAST
        self._past = self._past + 1 if back_ns >= 0 else 0
        if 0 <= back_ns < TIME_JUMP_NS and self._past < RESTART_AFTER:
            return Order.PAST
        return self._taken(stamp_ns, arrival_ns, Order.RESTART if back_ns >= 0 else Order.NEXT)

    def _confirmed(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Return whether enough sets went on from a leap, of which this is one."""
        last_ns, arrived_ns = self._leapt
        goes_on = self._leaps > 0 and 0 < stamp_ns - last_ns <= AHEAD_NS + arrival_ns - arrived_ns
        self._leaps = self._leaps + 1 if goes_on else 1
        self._leapt = stamp_ns, arrival_ns
        return self._leaps >= CONFIRMED_BY

    def _taken(self, stamp_ns: int, arrival_ns: int | None, order: Order) -> Order:
        self.last_ns, self._arrived_ns, self._past, self._leaps = stamp_ns, arrival_ns, 0, 0
        return order
