"""Plays footage as if it were a camera: at a rate, or as fast as the consumers keep up."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

from capture_rig.errors import InputError
from capture_rig.session import footage_stamp_ns

from ..frame_source import EndOfFootage, Frame, FrameSource, Image, UndecodableFrame
from ..settings import FootageSettings
from .footage_pace import (
    LATE_START_NS,
    LEAD_NS,
    PATIENCE_S,
    WINDOW,
    AcknowledgedPace,
    FootageClock,
    Pace,
    SharedClock,
    WallClockPace,
    choose_epoch_ns,
    playing_ns,
)
from .footage_reader import FootageReader, open_footage

READ_AHEAD = 2  # decoded images in store: 3.1 MB at 544 x 960 in colour
CLOCK = "footage: epoch + frame / fps"


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
        pace: Callable[[float], Pace] | None = None,
        now_ns: Callable[[], int] = time.time_ns,
        shared: SharedClock | None = None,
    ) -> None:
        """``shared`` : the clock that the source shares with other cameras'; by default it has one of its own."""
        super().__init__()
        self.description = f"footage {settings.path}"
        self._settings, self._channels, self._now_ns = settings, channels, now_ns
        self._shared = shared or SharedClock()
        self._make_pace = pace or self._pace_of_settings
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
            if self._settings.epoch_ns:
                choose_epoch_ns(self._settings.epoch_ns, self._now_ns())
        except InputError:
            self.close()
            raise
        self._pace = self._make_pace(self.fps)

    def start(self) -> None:
        if self._reader is None:
            raise InputError("is not connected", where=self._settings.path, remedy="Call connect() first.")
        if self._started:
            return
        if self._ended:
            self._begin_playing(self._reader)
        self._started = True
        self._clock = self._next_clock()
        self._pace.begin(self._clock, self._frame)
        self._follow_shared_clock()

    def read(self, timeout_s: float) -> Frame | None:
        if not self._started:
            raise InputError("is not started", where=self._settings.path, remedy="Call start() first.")
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
        self._follow_shared_clock()
        if self._pace.has_missed(self._frame):
            self.count("left_out")
            self._pass_frame()
            return None
        if not self._pace.wait(self._frame, max(deadline_s - time.monotonic(), 0.0)):
            return None
        stamp_ns = footage_stamp_ns(self._clock.epoch_ns, self._frame, self.fps)
        frame = Frame(image, stamp_ns, self._frame, CLOCK)
        self.counters["pace_timeouts"] = self._pace.timeouts
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
        if self._reader is not None:
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
        epoch_ns = choose_epoch_ns(self._settings.epoch_ns, self._now_ns())
        self._clock = FootageClock(epoch_ns, epoch_ns)
        self._ended = False

    def _next_clock(self) -> FootageClock:
        """Return the clock by which the next frame leaves when it is due by the epoch, or else a second from now."""
        epoch_ns, rate = self._clock.epoch_ns, self._settings.rate
        played_ns = playing_ns(self._frame, self.fps, rate) if rate > 0 else 0
        if self._settings.keep_up or epoch_ns + played_ns >= self._now_ns() - LATE_START_NS:
            return FootageClock(epoch_ns, epoch_ns)
        return FootageClock(self._now_ns() + LEAD_NS - played_ns, epoch_ns)

    def _follow_shared_clock(self) -> None:
        if self._settings.rate == 0:
            return
        clock = self._shared.offer(self._clock)
        if clock != self._clock:
            self._clock = clock
            self._pace.begin(clock, self._frame)

    def _decode_ahead(self) -> None:
        assert self._reader is not None
        while len(self._images) < READ_AHEAD:
            self._images.append(self._decoder.submit(self._reader.read, self._settings.loop))

    def _pass_frame(self) -> None:
        self._images.popleft()
        self._decode_ahead()
        self._frame += 1

    def _pace_of_settings(self, fps: float) -> Pace:
        s = self._settings
        return WallClockPace(fps, s.rate) if s.rate > 0 else AcknowledgedPace(fps, WINDOW, PATIENCE_S)
