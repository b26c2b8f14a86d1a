"""Where the connection to a camera stands, how long it was away, and how long to wait before the next attempt."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class LinkState(Enum):
    """Where the connection to the device stands."""

    CLOSED = "closed"
    CONNECTED = "connected"
    STREAMING = "streaming"
    CONNECTING = "connecting"
    WAITING = "waiting"
    STALLED = "stalled"
    CONTROL_LOST = "control lost"

    @property
    def away(self) -> bool:
        """Nothing comes, and it should."""
        return self not in (LinkState.CLOSED, LinkState.CONNECTED, LinkState.STREAMING)


@dataclass(frozen=True)
class Outage:
    """One outage that is over: seconds from its last frame to the alarm, and to the first frame after it.

    ``restart_s`` runs from the start of the attempt that succeeded to that frame.
    """

    noticed_s: float
    length_s: float
    restart_s: float


@dataclass(frozen=True)
class Link:
    """The connection at one instant, for a report.

    ``reason`` says why nothing comes; ``refused`` that waiting will not help (the settings do not fit the device);
    ``next_try_s`` until the next attempt. ``down_s`` is how long nothing has come by now, ``downtime_s`` the sum since
    the source was made.
    """

    state: LinkState
    reason: str = ""
    refused: bool = False
    next_try_s: float = 0.0
    down_s: float = 0.0
    downtime_s: float = 0.0
    last_outage: Outage | None = None


class Downtime:
    """Adds up the time in which frames should have come and did not. All times in seconds of one monotonic clock."""

    def __init__(self) -> None:
        self._sum_s = 0.0
        self._since_s: float | None = None
        self._noticed_s = 0.0
        self.last: Outage | None = None

    def begin(self, since_s: float, now_s: float) -> None:
        """Nothing has come since ``since_s``, as is noticed now. An outage that goes on stays one."""
        if self._since_s is None:
            self._since_s, self._noticed_s = since_s, now_s

    def end(self, now_s: float, attempted_s: float | None = None) -> None:
        """A frame came, on a connection that was attempted at ``attempted_s``; None: nobody waits for one any more."""
        if self._since_s is None:
            return
        if attempted_s is not None:
            self.last = Outage(self._noticed_s - self._since_s, now_s - self._since_s, now_s - attempted_s)
        self._sum_s, self._since_s = self.sum_s(now_s), None

    def present_s(self, now_s: float) -> float:
        """How long the present outage has lasted; 0 when there is none."""
        return 0.0 if self._since_s is None else now_s - self._since_s

    def sum_s(self, now_s: float) -> float:
        """All of it, the present outage included."""
        return self._sum_s + self.present_s(now_s)


class Backoff:
    """Pauses between attempts: ``first_s``, then twice the last one, up to ``longest_s``."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._last_s = 0.0

    def next_s(self) -> float:
        """The pause before the next attempt."""
        self._last_s = min(2 * self._last_s or self._first_s, self._longest_s)
        return self._last_s

    def slowest_s(self) -> float:
        """The longest pause, and all that follow stay as long."""
        self._last_s = self._longest_s
        return self._last_s

    def reset(self) -> None:
        """The device is well: begin with the shortest pause next time."""
        self._last_s = 0.0
