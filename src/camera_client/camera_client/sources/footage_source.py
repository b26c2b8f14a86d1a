"""Plays footage as if it were a camera: by a clock that all cameras share, or as fast as the consumers keep up."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import NamedTuple

from capture_rig.errors import InputError
from capture_rig.session import footage_stamp_ns

from ..frame_source import EndOfFootage, Frame, FrameSource, Image, UndecodableFrame
from ..settings import FootageSettings
from .footage_reader import FootageReader, open_footage

READ_AHEAD = 2  # decoded images in store: 3.1 MB at 544 x 960 in colour
CLOCK = "footage: epoch + frame / fps"
LEAD_NS = 1_000_000_000  # from a camera's offer of a clock to its first frame: the other cameras hear of it meanwhile
LATE_START_NS = 1_000_000_000
WINDOW = 3  # at rate 0: frames under way before an acknowledgement is awaited
PATIENCE_S = 20.0  # ... and for so long: a machine that starts a graph beside other work is as slow
KEPT_UP_NS = 250_000_000  # a frame this late still joins its set: half of what the hull server waits for footage
MAX_EPOCH_AHEAD_NS = 3600 * 1_000_000_000


class FootageClock(NamedTuple):
    """Frame k is stamped ``epoch_ns + k / fps`` and leaves at ``begin_ns + (k / fps) / rate`` of the system clock."""

    begin_ns: int
    epoch_ns: int


class SharedClock:
    """The clock by which all cameras of a graph play: of those that were offered, the one that began first.

    Each camera offers one when it starts, and hears the others'. Whoever comes late, or goes on after a pause, so finds
    the clock that runs already; cameras that offer at the same time come to the same one, whatever they hear first.
    """

    def __init__(self, announce: Callable[[FootageClock], object] = lambda clock: None) -> None:
        """``announce`` is called with every clock that comes to hold, one after the other."""
        self._announce, self._lock = announce, threading.Lock()
        self._agreed: FootageClock | None = None

    def offer(self, clock: FootageClock) -> FootageClock:
        """Take a clock into account, one's own or another camera's; returns the one that holds."""
        with self._lock:
            if self._agreed is None or clock < self._agreed:
                self._agreed = clock
                self._announce(clock)
            return self._agreed

    def forget(self) -> None:
        """Play no longer by any clock."""
        with self._lock:
            self._agreed = None


class AcknowledgedPace:
    """Frame k leaves once the consumers have acknowledged the stamp of frame k - window: none is ever outrun.

    When no acknowledgement and no frame has moved for ``patience_s``, one frame leaves all the same: ``timeouts``.
    """

    def __init__(self, fps: float, window: int, patience_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._fps, self._window, self._patience_s, self._now_s = fps, window, patience_s, now_s
        self._changed = threading.Condition()
        self._acknowledged_ns = self._epoch_ns = self._first_frame = 0
        self._last_progress_s = now_s()
        self.timeouts = 0

    def begin(self, epoch_ns: int, frame: int) -> None:
        """Begin, or go on, with this frame: at every start or resumption."""
        with self._changed:
            self._epoch_ns, self._first_frame, self._last_progress_s = epoch_ns, frame, self._now_s()
            self._acknowledged_ns = 0  # forget those of an earlier playing, perhaps with another epoch

    def acknowledge(self, stamp_ns: int) -> None:
        """Take note that every frame up to ``stamp_ns`` is processed."""
        with self._changed:
            if stamp_ns > self._acknowledged_ns:
                self._acknowledged_ns, self._last_progress_s = stamp_ns, self._now_s()
                self._changed.notify_all()

    def wait(self, frame: int, timeout_s: float) -> bool:
        """Wait until frame k may leave; False when that did not happen within ``timeout_s``."""
        deadline_s = self._now_s() + timeout_s
        with self._changed:
            while not self._may_leave(frame):
                now_s = self._now_s()
                impatient_s = self._last_progress_s + self._patience_s
                if now_s >= impatient_s:
                    self.timeouts += 1
                    break
                if now_s >= deadline_s:
                    return False
                self._changed.wait(min(deadline_s, impatient_s) - now_s)
            self._last_progress_s = self._now_s()
            return True

    def _may_leave(self, frame: int) -> bool:
        awaited = frame - self._window
        return awaited < self._first_frame or self._acknowledged_ns >= footage_stamp_ns(
            self._epoch_ns, awaited, self._fps
        )


class FootageSource(FrameSource):
    """Plays footage; the stamp of frame k is ``epoch + k / fps`` whatever the playing rate.

    With rate r > 0 frame k leaves at begin + (k / fps) / r of the system clock, by the `SharedClock` of all cameras:
    frames whose time has passed are left out, so that all show the same moment however late one starts. The beginning
    is the epoch, or where that is past, as after a pause, a second from now; with ``keep_up`` always the epoch.
    With rate 0 frame k leaves when consumers have acknowledged frame k - window.

    Stopping pauses; starting goes on with the next frame, and begins anew after the end (with a fresh epoch when
    ``epoch_ns`` is 0, otherwise with frame numbers, and so stamps, that go on counting). Images are decoded ahead, on a
    thread of their own, so that a slow one does not delay its frame. Time is injected for tests.
    """

    def __init__(
        self,
        settings: FootageSettings,
        channels: str = "auto",
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
        shared: SharedClock | None = None,
    ) -> None:
        """``shared`` : the clock that the source shares with other cameras'; by default it has one of its own."""
        super().__init__()
        self.description = f"footage {settings.path}"
        self._settings, self._channels, self._now_ns, self._sleep = settings, channels, now_ns, sleep
        self._shared = shared or SharedClock()
        self._pace: AcknowledgedPace | None = None  # at rate 0
        self._reader: FootageReader | None = None
        self._images: deque[Future[Image | None]] = deque()  # being decoded, or in store; None after the last
        self._frame, self._clock = 0, FootageClock(0, 0)
        self._started, self._ended = False, True

    def connect(self) -> None:
        self._reader = open_footage(self._settings.path, self._channels)
        self._decoder = ThreadPoolExecutor(1, "footage decoder")
        try:
            self.shape = self._reader.probe()
            self.fps = self._settings.fps or self._reader.fps
            if not self.fps:
                raise InputError(
                    "has no frame rate of its own", where=self._settings.path, remedy="Set the parameter footage.fps."
                )
            if self._settings.epoch_ns > self._now_ns() + MAX_EPOCH_AHEAD_NS:
                ahead_s = (self._settings.epoch_ns - self._now_ns()) / 1e9
                raise InputError(
                    f"footage.epoch_ns = {self._settings.epoch_ns} lies {ahead_s:.0f} s ahead of the system clock",
                    remedy="Give nanoseconds since 1970, or 0: the cameras agree on one.",
                )
        except InputError:
            self.close()
            raise
        if self._settings.rate == 0:
            self._pace = AcknowledgedPace(self.fps, WINDOW, PATIENCE_S)

    def start(self) -> None:
        if self._started:
            return
        assert self._reader is not None
        if self._ended:
            self._begin_playing(self._reader)
        self._started = True
        if self._pace is not None:
            self._pace.begin(self._clock.epoch_ns, self._frame)
        else:
            self._clock = self._shared.offer(self._next_clock())

    def read(self, timeout_s: float) -> Frame | None:
        if self._ended:
            raise EndOfFootage
        deadline_s = time.monotonic() + timeout_s
        self._decode_ahead()
        if wait([self._images[0]], max(timeout_s, 0.0)).not_done:
            return None
        try:
            image = self._images[0].result()
        except UndecodableFrame:
            self.count("undecodable")
            self.statistics.add(self._frame, complete=False)
            self._pass_frame()
            return None
        except InputError:  # the file went away meanwhile
            self._ended = True
            raise
        if image is None:
            self._ended = True
            raise EndOfFootage
        left_s = max(deadline_s - time.monotonic(), 0.0)
        if self._pace is not None:
            if not self._pace.wait(self._frame, left_s):
                return None
            self.counters["pace_timeouts"] = self._pace.timeouts
        else:
            self._clock = self._shared.offer(self._clock)
            ahead_ns = self._clock.begin_ns + self._playing_ns() - self._now_ns()
            if ahead_ns < -KEPT_UP_NS:
                self.count("left_out")
                self._pass_frame()
                return None
            self._sleep(min(max(ahead_ns * 1e-9, 0.0), left_s))
            if ahead_ns * 1e-9 > left_s:
                return None
        stamp_ns = footage_stamp_ns(self._clock.epoch_ns, self._frame, self.fps)
        frame = Frame(image, stamp_ns, self._frame, CLOCK)
        self.statistics.add(frame.frame_id)
        self._pass_frame()
        return frame

    def stop(self) -> None:
        self._started = False
        self._shared.forget()

    def close(self) -> None:
        self.stop()
        if self._reader is not None:
            self._decoder.shutdown(cancel_futures=True)
            self._reader.close()
            self._reader = None

    def acknowledge(self, stamp_ns: int) -> None:
        if self._pace is not None:
            self._pace.acknowledge(stamp_ns)

    @property
    def epoch_ns(self) -> int:
        """The stamp of frame 0, settled at start(), or by a camera that had started before."""
        return self._clock.epoch_ns

    def _begin_playing(self, reader: FootageReader) -> None:
        if self._images:  # of an earlier playing
            self._images.clear()
            self._decoder.submit(reader.rewind).result()
        if self._settings.epoch_ns == 0:
            self._frame = 0
        epoch_ns = self._settings.epoch_ns or self._now_ns() + LEAD_NS
        self._clock = FootageClock(epoch_ns, epoch_ns)
        self._ended = False

    def _next_clock(self) -> FootageClock:
        """Return the clock by which the next frame leaves when it is due by the epoch, or else a second from now."""
        epoch_ns, played_ns = self._clock.epoch_ns, self._playing_ns()
        if self._settings.keep_up or epoch_ns + played_ns >= self._now_ns() - LATE_START_NS:
            return FootageClock(epoch_ns, epoch_ns)
        return FootageClock(self._now_ns() + LEAD_NS - played_ns, epoch_ns)

    def _playing_ns(self) -> int:
        """Return how long after frame 0 the present frame leaves, ns of the system clock."""
        return round(self._frame * 1e9 / (self.fps * self._settings.rate))

    def _decode_ahead(self) -> None:
        assert self._reader is not None
        while len(self._images) < READ_AHEAD:
            self._images.append(self._decoder.submit(self._reader.read, self._settings.loop))

    def _pass_frame(self) -> None:
        self._images.popleft()
        self._decode_ahead()
        self._frame += 1
