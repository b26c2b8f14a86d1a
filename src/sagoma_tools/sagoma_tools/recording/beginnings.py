"""Counts how often the stamps of a recording begin anew: footage played again, a clock that was set back."""

from __future__ import annotations

from mocap_packets.frame_set import TIME_JUMP_NS


class Beginnings:
    """Counts new beginnings of all topics together: every topic goes back at each one, and it is told but once."""

    def __init__(self) -> None:
        self.count = 1
        self._last_ns: dict[str, int] = {}
        self._of: dict[str, int] = {}

    def take(self, topic: str, stamp_ns: int) -> float | None:
        """Take note of a message's stamp; return by how many seconds stamps went back, None unless that is news."""
        back_ns = self._last_ns.get(topic, stamp_ns) - stamp_ns
        self._last_ns[topic] = stamp_ns
        if back_ns < TIME_JUMP_NS:
            return None
        self._of[topic] = self._of.get(topic, 1) + 1
        if self._of[topic] <= self.count:
            return None
        self.count = self._of[topic]
        return back_ns / 1e9
