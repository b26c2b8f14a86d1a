"""Keeps a live camera connected: a source around a factory of sources, which never blocks and never gives up.

Whatever talks to the device (connecting, starting, stopping, closing) can block for seconds once the device is dead, so
each such call runs on a thread of its own. read() and all others return within a fraction of a second.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any

from capture_rig.errors import InputError

from ..frame_source import (
    RELEASE_S,
    Connection,
    ConnectionState,
    Downtime,
    Frame,
    FrameSource,
    FrameStatistics,
    SourceUnavailable,
)

# Thresholds: judgement, no measurement.
CONNECT_WAIT_S = 5.0  # at configure: a camera that is there is set up within this, unless it waits for PTP
START_S = 2 * RELEASE_S  # a living camera starts within this: more is asked of it than when it stops
RETRY_S = 1.0  # after an attempt that failed


class SupervisedSource(FrameSource):
    """Connects to what ``make`` gives, watches it, and connects anew when it stalls or goes.

    accept : looks at each new connection before its first frame, on the thread that called connect() or read();
        InputError when it cannot be used.
    stall_timeout_s : of a connected source: how long it may be silent; infinite while nothing is expected.
    clock : seconds, monotonic; pause : sleeps so many seconds (a test may give its own).

    A connection that stopped is made anew at once, an attempt that failed is followed by another after RETRY_S.
    ``statistics`` and ``counters`` add up over all connections; the counters include reconnects, stalls,
    control_losses, failed_attempts.
    """

    def __init__(
        self,
        make: Callable[[], FrameSource],
        accept: Callable[[FrameSource], None],
        stall_timeout_s: Callable[[FrameSource], float],
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], object] | None = None,
    ) -> None:
        self._make, self._accept, self._clock, self._stall_timeout_s = make, accept, clock, stall_timeout_s
        self._stopping = threading.Event()
        self._pause = pause or self._stopping.wait
        self._lock = threading.Lock()  # of the source and of what former sources have counted
        self._source: FrameSource | None = None
        self._past_statistics, self._past_counters = FrameStatistics(), Counter[str]()
        self._attempt: tuple[FrameSource, Future] | None = None  # a source that connects
        self._closing: list[Future] = []  # calls that close former connections
        self._running = False
        self._state, self._reason, self._refused = ConnectionState.CLOSED, "", False
        self._next_try_s = self._heard_s = self._silent_s = self._limit_s = 0.0
        self._downtime = Downtime()
        self._arrived, self._ever_connected = 0, False

    # --- the source's contract -----------------------------------------------------------------------------------

    def connect(self) -> None:
        """Try once. A camera that does not answer is tried again while the source runs; InputError is raised."""
        error = self._try(CONNECT_WAIT_S)
        if error is not None and not isinstance(error, SourceUnavailable):
            self.close()
            raise error

    def start(self) -> None:
        if self._running:
            return
        self._running = True
        self._stopping.clear()
        self._heard_s = self._clock()
        source = self._source
        if source is None:
            self._next_try_s = self._clock()
        elif source.lost:
            self._disconnect(ConnectionState.CONTROL_LOST, "was lost while it was suspended")
        else:
            try:
                self._start(source)
            except SourceUnavailable as error:
                self._disconnect(ConnectionState.STALLED, str(error))
            except Exception:
                self._running = False
                raise
            else:
                self._silent_s, self._state = 0.0, ConnectionState.STREAMING

    def read(self, timeout_s: float) -> Frame | None:
        if self._source is not None:
            return self._read(self._source, timeout_s)
        pause_s = self._next_try_s - self._clock()
        if self._attempt is None and pause_s > 0:
            self._pause(min(pause_s, timeout_s))
        else:
            self._try(timeout_s)
        return None

    def stop(self) -> None:
        self._running = False
        self._stopping.set()
        if self._attempt is not None:
            connecting, call = self._attempt
            self._closing.append(in_background(connecting.close, after=call))
            self._attempt = None
        source = self._source
        self._downtime.end(self._clock(), delivered=False)
        if source is None or self._state is not ConnectionState.STREAMING:
            return
        stopping = in_background(source.stop)
        if _is_over(stopping, RELEASE_S):
            self._state = ConnectionState.CONNECTED
        else:
            self._release(after=stopping)
            self._state, self._reason = ConnectionState.WAITING, "did not answer when it was stopped"

    def close(self) -> None:
        """Give the device back; waits no longer than a living one needs. A dead one is closed on its own thread."""
        self.stop()
        self._release()
        self._state, self._reason, self._refused = ConnectionState.CLOSED, "", False
        wait(self._closing, RELEASE_S)
        self._closing = [call for call in self._closing if not call.done()]

    @property
    def details(self) -> dict[str, str]:
        source = self._source
        return {} if source is None else source.details

    @property
    def lost(self) -> bool:
        return self.connection.state.away

    @property
    def statistics(self) -> FrameStatistics:
        """The frames of all connections so far."""
        with self._lock:
            return self._past_statistics + (FrameStatistics() if self._source is None else self._source.statistics)

    @property
    def counters(self) -> dict[str, int]:
        """What all connections so far have counted, and what happened to them."""
        with self._lock:
            total = Counter(self._past_counters)
            total.update({} if self._source is None else self._source.counters)
            return dict(total)

    def count(self, name: str, by: int = 1) -> None:
        with self._lock:
            self._past_counters[name] += by

    @property
    def connection(self) -> Connection:
        now_s, state = self._clock(), self._state
        if self._attempt is not None and state in (ConnectionState.CLOSED, ConnectionState.WAITING):
            state = ConnectionState.CONNECTING
        reason = self._reason if state.away else ""
        next_try_s = max(self._next_try_s - now_s, 0.0) if state is ConnectionState.WAITING else 0.0
        down_s, downtime_s = self._downtime.present_s(now_s), self._downtime.sum_s(now_s)
        return Connection(state, reason, self._refused, next_try_s, down_s, downtime_s, self._downtime.last_outage_s)

    # --- while it streams ----------------------------------------------------------------------------------------

    def _read(self, source: FrameSource, timeout_s: float) -> Frame | None:
        wait_s, began_s = min(timeout_s, max(self._limit_s - self._silent_s, 0.0)), self._clock()
        try:
            frame = source.read(wait_s)
        except Exception as error:  # the driver's own errors too: no reason to give the camera up
            self._disconnect(ConnectionState.STALLED, _text_of(error))
            return None
        now_s, arrived = self._clock(), source.statistics.arrived
        if arrived != self._arrived or frame is not None:  # an incomplete frame is a sign of life too
            self._arrived, self._heard_s, self._silent_s = arrived, now_s, 0.0
        else:  # time in which this process did not get to run is no silence of the camera
            self._silent_s += min(now_s - began_s, wait_s)
        if frame is not None:
            self._downtime.end(now_s, delivered=True)
        if source.lost:
            reason = "does not answer any more, or another program has taken control"
            self._disconnect(ConnectionState.CONTROL_LOST, reason)
        elif self._silent_s >= self._limit_s or math.isclose(self._silent_s, self._limit_s):
            self._disconnect(ConnectionState.STALLED, f"nothing came for {now_s - self._heard_s:.1f} s")
        return frame

    def _disconnect(self, state: ConnectionState, reason: str) -> None:
        """Release a connection that is of no use any more, and try at once to make another."""
        self.count("control_losses" if state is ConnectionState.CONTROL_LOST else "stalls")
        self._release()
        self._downtime.begin(self._heard_s)
        self._state, self._reason, self._refused = state, reason, False
        self._next_try_s = self._clock()

    def _release(self, after: Future | None = None) -> None:
        """Close the present connection on a thread of its own (once ``after`` is over) and keep its counts."""
        with self._lock:
            source, self._source = self._source, None
            if source is None:
                return
            self._past_statistics = self._past_statistics + source.statistics
            self._past_counters.update(source.counters)
        self._closing = [call for call in self._closing if not call.done()] + [in_background(source.close, after)]

    # --- while it does not ---------------------------------------------------------------------------------------

    def _try(self, timeout_s: float) -> Exception | None:
        """Begin an attempt to connect, or go on with it, for so long; return why it failed, if it did by now."""
        if self._attempt is None:
            source = self._make()
            self.description = source.description
            self._attempt = source, in_background(source.connect)
        source, connecting = self._attempt
        if not _is_over(connecting, timeout_s):
            return None
        self._attempt = None
        try:
            connecting.result()
            self._use(source)
        except Exception as error:
            self.count("failed_attempts")
            if self._running:
                self._downtime.begin(self._heard_s)
            self._next_try_s = self._clock() + RETRY_S
            self._state, self._reason = ConnectionState.WAITING, _text_of(error)
            self._refused = isinstance(error, InputError) and not isinstance(error, SourceUnavailable)
            return error
        return None

    def _use(self, source: FrameSource) -> None:
        """Take a new connection into use. Raises InputError, with nothing left open, when that fails."""
        with self._lock:
            self._source = source
        self.shape, self.description, self.warnings = source.shape, source.description, source.warnings
        try:
            self._accept(source)
            if self._running:
                self._start(source)
        except Exception:
            self._release()
            raise
        if self._ever_connected:
            self.count("reconnects")
        self._ever_connected, self._arrived = True, 0
        self._heard_s, self._silent_s, self._limit_s = self._clock(), 0.0, self._stall_timeout_s(source)
        self._reason, self._refused = "", False
        self._state = ConnectionState.STREAMING if self._running else ConnectionState.CONNECTED

    def _start(self, source: FrameSource) -> None:
        starting = in_background(source.start)
        if not _is_over(starting, START_S):
            self._release(after=starting)
            raise SourceUnavailable("does not answer when it is started", where=self.description)
        starting.result()


def _text_of(error: Exception) -> str:
    return str(error) if isinstance(error, InputError) else repr(error)  # a driver's own


# --- calls that may block for seconds


def in_background(call: Callable[[], Any], after: Future | None = None) -> Future:
    """Run ``call``, once ``after`` is over, on a daemon thread of its own: unlike an executor's, the process ends
    without waiting for it."""
    over = Future[Any]()

    def run() -> None:
        wait([] if after is None else [after])
        try:
            over.set_result(call())
        except Exception as error:
            over.set_exception(error)

    threading.Thread(target=run, name="device call", daemon=True).start()
    return over


def _is_over(call: Future, timeout_s: float) -> bool:
    """Return whether ``call`` has returned or raised, within ``timeout_s`` from now."""
    return not wait([call], timeout_s).not_done
