"""A trigger cable that several cameras share: whatever pulses it, they all see the pulse at the same instant."""

from __future__ import annotations

import time
from collections.abc import Callable
from fractions import Fraction

from .loop import EventLoop, Timer

LATENESS_NS = 250_000_000  # pulses later than this are left out


class TriggerWire:
    """The cameras' input Line1. pulse() is one rising edge; run() is a pulse generator at a steady rate."""

    def __init__(self, loop: EventLoop) -> None:
        self._loop = loop
        self._listeners: list[Callable[[int], None]] = []
        self._timer: Timer | None = None

    def listen(self, callback: Callable[[int], None]) -> None:
        """Call back with the instant (UTC, ns) of each rising edge, from within the loop."""
        self._listeners.append(callback)

    def pulse(self) -> int:
        """One rising edge now; returns its instant (UTC, ns)."""
        return self._loop.call(lambda: self._rise(time.time_ns()))

    def run(self, rate_hz: float) -> None:
        """Pulses at whole multiples of the period of UTC, until stop()."""
        self._loop.call(lambda: self._restart(Fraction(rate_hz).limit_denominator(1000)))

    def stop(self) -> None:
        """No more pulses from the generator."""
        self._loop.call(self._halt)

    def _restart(self, rate: Fraction) -> None:
        self._halt()
        self._schedule(rate)

    def _halt(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _schedule(self, rate: Fraction) -> None:
        period_ns = 1_000_000_000 / rate
        when_ns = int((time.time_ns() // period_ns + 1) * period_ns)
        self._timer = self._loop.call_at(when_ns, lambda: self._tick(when_ns, rate))

    def _tick(self, when_ns: int, rate: Fraction) -> None:
        if time.time_ns() - when_ns < LATENESS_NS:
            self._rise(when_ns)
        self._schedule(rate)

    def _rise(self, instant_ns: int) -> int:
        for listener in self._listeners:
            listener(instant_ns)
        return instant_ns
