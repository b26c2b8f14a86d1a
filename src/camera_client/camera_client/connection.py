"""The connection to a live camera: its state, its outages, and the pauses between attempts to connect again."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

# Thresholds: judgement, no measurement.
FIRST_RETRY_S = 0.25  # the pause after the first attempt that failed; it doubles


class ConnectionState(Enum):
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
        """Whether nothing comes, and it should."""
        return self not in (ConnectionState.CLOSED, ConnectionState.CONNECTED, ConnectionState.STREAMING)


@dataclass(frozen=True)
class Outage:
    """One outage that is over: seconds from its last frame to the alarm, and to the first frame after it.

    ``restart_s`` runs from the start of the attempt that succeeded to that frame.
    """

    noticed_s: float
    length_s: float
    restart_s: float


@dataclass(frozen=True)
class Connection:
    """The connection at one instant, for a report.

    ``reason`` says why nothing comes; ``refused`` that waiting will not help (the settings do not fit the device);
    ``next_try_s`` until the next attempt. ``down_s`` is how long nothing has come by now, ``downtime_s`` the sum since
    the source was made.
    """

    state: ConnectionState
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
        """Begin an outage: nothing has come since ``since_s``, as is noticed now. One that goes on stays one."""
        if self._since_s is None:
            self._since_s, self._noticed_s = since_s, now_s

    def end(self, now_s: float, attempted_s: float | None = None) -> None:
        """End the outage: a frame came on the connection attempted at ``attempted_s``; None: the source was stopped."""
        if self._since_s is None:
            return
        if attempted_s is not None:
            self.last = Outage(self._noticed_s - self._since_s, now_s - self._since_s, now_s - attempted_s)
        self._sum_s, self._since_s = self.sum_s(now_s), None

    def present_s(self, now_s: float) -> float:
        """Return how long the present outage has lasted; 0 when there is none."""
        return 0.0 if self._since_s is None else now_s - self._since_s

    def sum_s(self, now_s: float) -> float:
        """Return the whole downtime, the present outage included."""
        return self._sum_s + self.present_s(now_s)


class RetryPause:
    """Doubles the pause after each attempt to connect that fails, from FIRST_RETRY_S up to ``longest_s``."""

    def __init__(self, longest_s: float) -> None:
        self._longest_s, self._pause_s = longest_s, 0.0

    def next_s(self, slowest: bool = False) -> float:
        """Return the pause before the next attempt: twice the last one, or the longest from now on."""
        doubled_s = 2 * self._pause_s or FIRST_RETRY_S
        self._pause_s = self._longest_s if slowest else min(doubled_s, self._longest_s)
        return self._pause_s

    def reset(self) -> None:
        """Begin with the shortest pause again: the device delivers."""
        self._pause_s = 0.0
