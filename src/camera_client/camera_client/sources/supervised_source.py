"""A live camera that may go and come back: a source around a factory of sources, which never blocks and never gives up.

Whatever talks to the device (connecting, starting, stopping, closing) can block for seconds once the device is dead, so
each such call is an errand on a thread of its own. read() and all others return within a fraction of a second.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Generic, TypeVar

from capture_rig.errors import InputError

from ..frame_source import (
    Backoff,
    Connection,
    ConnectionState,
    Downtime,
    Frame,
    FrameSource,
    FrameStatistics,
    SourceUnavailable,
)
from ..settings import SupervisionSettings

# --- Calls that may block for seconds, each on a thread of its own: a dead device keeps nobody else waiting.

T = TypeVar("T")


class BackgroundCall(Generic[T]):
    """Runs ``call`` on a daemon thread from now on.

    Whoever loses interest calls :meth:`abandon`: a result that comes nevertheless is handed to ``dispose`` (a camera
    that answered too late is closed again).
    """

    def __init__(self, call: Callable[[], T], dispose: Callable[[T], object] = lambda result: None) -> None:
        self._call, self._dispose = call, dispose
        self._error: Exception | None = None
        self._lock = threading.Lock()
        self._returned = self._abandoned = False
        self._over = threading.Event()
        threading.Thread(target=self._run, name="errand", daemon=True).start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """True once the call has returned or raised (and, when abandoned, its result is disposed of)."""
        return self._over.wait(timeout_s)

    def result(self) -> T:
        """What the call returned; raises what it raised. Waits for it."""
        self._over.wait()
        if self._error is not None:
            raise self._error
        return self._result

    def abandon(self) -> None:
        """Never mind; does not wait."""
        with self._lock:
            if self._abandoned:
                return
            self._abandoned = True
            if not self._returned or self._error is not None:
                return
            self._over.clear()
        threading.Thread(target=self._throw_away, name="errand", daemon=True).start()

    def _run(self) -> None:
        try:
            self._result = self._call()
        except Exception as error:
            self._error = error
        with self._lock:
            self._returned = True
            unwanted = self._abandoned and self._error is None
        if unwanted:
            self._throw_away()
        else:
            self._over.set()

    def _throw_away(self) -> None:
        try:
            self._dispose(self._result)
        finally:
            self._over.set()


CONNECT_WAIT_S = 5.0  # at configure: a camera that is there is set up within this, unless it waits for PTP
START_S = 2.0  # a living camera starts within this
STOP_S = 0.5  # ... stops within this
RELEASE_S = 1.0  # ... and gives its resources back within this
ROUNDING_S = 1e-3
FIRST_RETRY_S = 0.25  # the pause after the first attempt that failed; it doubles


class SupervisedSource(FrameSource):
    """Connects to what ``make`` gives, watches it, and connects anew when it stalls or goes.

    accept : looks at each new connection before its first frame, on the thread that called connect() or read();
        InputError when it cannot be used.
    stall_timeout_s : of a connected source: how long it may be silent; infinite while nothing is expected.
    clock : seconds, monotonic; wait : sleeps so many seconds (a test may give its own).

    A connection that delivered and stopped is made anew at once. An attempt that fails with SourceUnavailable, and a
    connection that never delivered, are followed by another after a quarter of a second, then twice that, and so on to
    ``longest_retry_s``; an attempt that fails with a plain InputError by one at this slowest pace. ``account`` and
    ``counters`` add up over all connections; the counters include reconnects, stalls, control_losses, failed_attempts.
    """

    def __init__(
        self,
        make: Callable[[], FrameSource],
        settings: SupervisionSettings | None = None,
        accept: Callable[[FrameSource], None] = lambda source: None,
        stall_timeout_s: Callable[[FrameSource], float] | None = None,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        settings = settings or SupervisionSettings()
        self._make, self._accept, self._clock = make, accept, clock
        self._stall_timeout_s = stall_timeout_s or (lambda source: settings.stall_timeout_s)
        self._stopping = threading.Event()
        self._wait = wait or self._stopping.wait
        self._lock = threading.Lock()  # of the source and of what former sources have counted
        self._source: FrameSource | None = None
        self._past_account, self._past_counters = FrameStatistics(), Counter[str]()
        self._attempt: BackgroundCall[FrameSource] | None = None
        self._errands: list[BackgroundCall] = []  # that close dead connections
        self._running = False
        self._state, self._reason, self._refused = ConnectionState.CLOSED, "", False
        self._next_try_s = self._heard_s = self._attempted_s = self._silent_s = self._limit_s = 0.0
        self._backoff = Backoff(FIRST_RETRY_S, settings.longest_retry_s)
        self._downtime = Downtime()
        self._arrived, self._delivering = 0, False
        self._ever_connected = False
        self._shape: tuple[int, ...] = ()
        self._description = "camera"
        self._details: dict[str, str] = {}

    # --- the source's contract -----------------------------------------------------------------------------------

    def connect(self) -> None:
        """Try once. A camera that does not answer is tried again while the source runs; InputError is raised."""
        self._launch()
        assert self._attempt is not None
        if not self._attempt.wait(CONNECT_WAIT_S):
            return
        attempt, self._attempt = self._attempt, None
        try:
            self._adopt(attempt.result())
        except SourceUnavailable as error:
            self._back_off(str(error))
        except Exception:
            self.close()
            raise

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
            self._lose(ConnectionState.CONTROL_LOST, "was lost while it was suspended")
        else:
            self._begin_again(source)

    def read(self, timeout_s: float) -> Frame | None:
        if not self._running:
            raise InputError("is not started", where=self.description, remedy="Call start() first.")
        if self._source is None:
            self._seek(timeout_s)
            return None
        return self._read(self._source, timeout_s)

    def stop(self) -> None:
        self._running = False
        self._stopping.set()
        self._abandon_attempt()
        source = self._source
        self._downtime.end(self._clock())
        if source is None or self._state is not ConnectionState.STREAMING:
            return
        stopping = BackgroundCall(source.stop)
        if stopping.wait(STOP_S):
            self._state = ConnectionState.CONNECTED
        else:
            self._retire(after=stopping)
            self._state, self._reason = ConnectionState.WAITING, "did not answer when it was stopped"

    def close(self) -> None:
        """Give the device back; waits no longer than a living one needs. A dead one is closed behind our back."""
        self.stop()
        self._retire()
        self._state, self._reason, self._refused = ConnectionState.CLOSED, "", False
        self._backoff.reset()
        deadline_s = time.monotonic() + RELEASE_S
        for errand in self._errands:
            errand.wait(max(deadline_s - time.monotonic(), 0.0))
        self._errands = [errand for errand in self._errands if not errand.wait(0)]

    @property
    def shape(self) -> tuple[int, ...]:
        """As the camera that answered last said; () while none has."""
        return self._shape

    @property
    def description(self) -> str:
        return self._description

    @property
    def details(self) -> dict[str, str]:
        source = self._source
        return dict(self._details) if source is None else source.details

    @property
    def lost(self) -> bool:
        return self._state.away

    @property
    def account(self) -> FrameStatistics:
        """The frames of all connections so far."""
        with self._lock:
            return self._past_account + (FrameStatistics() if self._source is None else self._source.account)

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
    def link(self) -> Connection:
        now_s, state = self._clock(), self._state
        reason = self._reason if state.away else ""
        next_try_s = max(self._next_try_s - now_s, 0.0) if state is ConnectionState.WAITING else 0.0
        down_s, downtime_s = self._downtime.present_s(now_s), self._downtime.sum_s(now_s)
        return Connection(state, reason, self._refused, next_try_s, down_s, downtime_s, self._downtime.last)

    # --- while it streams ----------------------------------------------------------------------------------------

    def _read(self, source: FrameSource, timeout_s: float) -> Frame | None:
        wait_s, began_s = min(timeout_s, max(self._limit_s - self._silent_s, 0.0)), self._clock()
        try:
            frame = source.read(wait_s)
        except Exception as error:  # the driver's own errors too: no reason to give the camera up
            self._lose(ConnectionState.STALLED, str(error) if isinstance(error, InputError) else repr(error))
            return None
        now_s, arrived = self._clock(), source.account.arrived
        if arrived != self._arrived or frame is not None:  # an incomplete frame is a sign of life too
            self._arrived, self._heard_s, self._delivering, self._silent_s = arrived, now_s, True, 0.0
            self._backoff.reset()
        else:  # time in which this process did not get to run is no silence of the camera
            self._silent_s += min(now_s - began_s, wait_s)
        if frame is not None:
            self._downtime.end(now_s, self._attempted_s)
        if source.lost:
            self._lose(ConnectionState.CONTROL_LOST, "does not answer any more, or another program has taken control")
        elif self._silent_s >= self._limit_s - ROUNDING_S:
            self._lose(ConnectionState.STALLED, f"nothing came for {now_s - self._heard_s:.1f} s")
        return frame

    def _lose(self, state: ConnectionState, reason: str, after: BackgroundCall | None = None) -> None:
        """The connection is no good any more: put it away, and try at once to make another."""
        self.count("control_losses" if state is ConnectionState.CONTROL_LOST else "stalls")
        self._retire(after)
        now_s = self._clock()
        self._downtime.begin(self._heard_s, now_s)
        self._state, self._reason, self._refused = state, reason, False
        self._next_try_s = now_s + (0.0 if self._delivering else self._backoff.next_s())

    def _retire(self, after: BackgroundCall | None = None) -> None:
        """Close the present connection on a thread of its own (once ``after`` is over) and keep its counts."""
        with self._lock:
            source, self._source = self._source, None
            if source is None:
                return
            self._past_account = self._past_account + source.account
            self._past_counters.update(source.counters)
        self._details = {}

        def put_away() -> None:
            if after is not None:
                after.wait()
            source.close()

        self._errands = [errand for errand in self._errands if not errand.wait(0)] + [BackgroundCall(put_away)]

    # --- while it does not ---------------------------------------------------------------------------------------

    def _seek(self, timeout_s: float) -> None:
        """One step towards a connection; takes no longer than ``timeout_s``."""
        pause_s = self._next_try_s - self._clock()
        if self._attempt is None and pause_s > 0:
            self._wait(min(pause_s, timeout_s))
            return
        if self._attempt is None:
            self._launch()
        attempt = self._attempt
        assert attempt is not None
        if not attempt.wait(timeout_s):
            return
        self._attempt = None
        try:
            self._adopt(attempt.result())
        except SourceUnavailable as error:
            self._back_off(str(error))
        except InputError as error:
            self._back_off(str(error), refused=True)
        except Exception as error:  # the driver's own
            self._back_off(repr(error))

    def _launch(self) -> None:
        source = self._make()
        self._description = source.description
        if self._state not in (ConnectionState.STALLED, ConnectionState.CONTROL_LOST):
            self._state = ConnectionState.CONNECTING
        self._attempted_s = self._clock()

        def open_it() -> FrameSource:
            source.connect()
            return source

        self._attempt = BackgroundCall(open_it, dispose=lambda opened: opened.close())

    def _adopt(self, source: FrameSource) -> None:
        """Take a connection that was made into use. Raises InputError, with nothing left open, when that fails."""
        with self._lock:
            self._source = source
        self._shape, self._description, self._details = source.shape, source.description, source.details
        self.warnings = source.warnings
        try:
            self._accept(source)
            if self._running:
                self._begin(source)
        except Exception:
            self._retire()
            raise
        if self._ever_connected:
            self.count("reconnects")
        self._ever_connected, self._delivering, self._arrived = True, False, 0
        self._heard_s, self._silent_s, self._limit_s = self._clock(), 0.0, self._stall_timeout_s(source)
        self._reason, self._refused = "", False
        self._state = ConnectionState.STREAMING if self._running else ConnectionState.CONNECTED

    def _begin(self, source: FrameSource) -> None:
        starting = BackgroundCall(source.start)
        if not starting.wait(START_S):
            self._retire(after=starting)
            raise SourceUnavailable("does not answer when it is started", where=self.description)
        starting.result()

    def _begin_again(self, source: FrameSource) -> None:
        """Start a connection that was suspended, and may have died meanwhile."""
        try:
            self._begin(source)
        except SourceUnavailable as error:
            self._lose(ConnectionState.STALLED, str(error))
        except Exception:
            self._running = False
            raise
        else:
            self._silent_s = 0.0
            self._state = ConnectionState.STREAMING

    def _back_off(self, reason: str, refused: bool = False) -> None:
        self.count("failed_attempts")
        now_s = self._clock()
        if self._running:
            self._downtime.begin(self._heard_s, now_s)
        self._next_try_s = now_s + (self._backoff.slowest_s() if refused else self._backoff.next_s())
        self._state, self._reason, self._refused = ConnectionState.WAITING, reason, refused

    def _abandon_attempt(self) -> None:
        if self._attempt is not None:
            self._attempt.abandon()
            self._errands.append(self._attempt)
            self._attempt = None
