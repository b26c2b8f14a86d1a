"""When to trigger: at whole multiples of the period of a common clock, so that nobody has to coordinate."""

from __future__ import annotations

import threading
from collections.abc import Callable
from fractions import Fraction

SECOND = 1_000_000_000
FINEST_RATE = 10**6  # the rate is taken as a fraction with at most this denominator: 59.94 is 2997/50
JOIN_TIMEOUT_S = 3.0


class TriggerSchedule:
    """The instants k / rate of a clock that counts from its epoch (ns), each due ``lead_ns`` before it comes.

    Every computer that knows the rate finds the same instants, to the nanosecond. An instant that is over by half a
    period before anybody asked is skipped and counted in ``missed``.
    """

    def __init__(self, rate_hz: float, lead_ns: int = 0) -> None:
        self._rate = Fraction(rate_hz).limit_denominator(FINEST_RATE)
        self._lead_ns = lead_ns
        self._next: int | None = None
        self.missed = 0

    def instant_ns(self, index: int) -> int:
        """Instant number ``index`` since the clock's epoch."""
        return index * SECOND * self._rate.denominator // self._rate.numerator

    def first_after(self, now_ns: int) -> int:
        """Number of the first instant that is not over at ``now_ns``."""
        index = -(-now_ns * self._rate.numerator // (SECOND * self._rate.denominator))
        return index if self.instant_ns(index) >= now_ns else index + 1

    def due(self, now_ns: int) -> list[int]:
        """Instants (ns) to act on now, each given once; the first call begins with the first one still ahead."""
        if self._next is None:
            self._next = self.first_after(now_ns + self._lead_ns)
        self._skip_past(now_ns)
        instants = []
        while self.instant_ns(self._next) - self._lead_ns <= now_ns:
            instants.append(self.instant_ns(self._next))
            self._next += 1
        return instants

    def wait_ns(self, now_ns: int) -> int:
        """Time until the next instant is due."""
        index = self.first_after(now_ns + self._lead_ns) if self._next is None else self._next
        return max(self.instant_ns(index) - self._lead_ns - now_ns, 0)

    def _skip_past(self, now_ns: int) -> None:
        assert self._next is not None
        half_ns = self.instant_ns(1) // 2
        if self.instant_ns(self._next) + half_ns < now_ns:
            ahead = self.first_after(now_ns)
            self.missed += ahead - self._next
            self._next = ahead
        elif self.instant_ns(self._next) - self._lead_ns - now_ns > SECOND:  # the clock was set back
            self._next = self.first_after(now_ns + self._lead_ns)


class TriggerThread:
    """Calls ``fire(instant_ns)`` for every instant of a schedule when it is due, on a thread of its own.

    clock : ns, of the clock that the schedule counts on.
    """

    def __init__(self, schedule: TriggerSchedule, clock: Callable[[], int], fire: Callable[[int], None]) -> None:
        self._schedule, self._clock, self._fire = schedule, clock, fire
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="trigger", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread; waits for a trigger that is on its way."""
        self._stopping.set()
        self._thread.join(JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while not self._stopping.wait(self._schedule.wait_ns(self._clock()) / SECOND):
            for instant_ns in self._schedule.due(self._clock()):
                self._fire(instant_ns)
