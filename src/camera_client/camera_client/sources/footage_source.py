"""Plays footage as if it were a camera: at a rate, or as fast as the consumers keep up."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

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
_END = object()
_SKIP = object()


class FootageSource(FrameSource):
    """Plays footage; the stamp of frame k is ``epoch + k / fps`` whatever the playing rate.

    With rate r > 0 frame k leaves at begin + (k / fps) / r of the system clock, by the `SharedClock` of all cameras:
    frames whose time has passed are left out, so that all show the same moment however late one starts. The beginning
    is the epoch, or where that is past, as after a pause, a second from now; with ``keep_up`` always the epoch.
    With rate 0 frame k leaves when consumers have acknowledged frame k - window.

    Stopping pauses; starting goes on with the next frame, and begins anew after the end (with a fresh epoch when
    ``epoch_ns`` is 0, otherwise with frame numbers, and so stamps, that go on counting). Time is injected for tests.
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
        self._settings, self._channels, self._now_ns = settings, channels, now_ns
        self._shared = shared or SharedClock()
        self._make_pace = pace or self._pace_of_settings
        self._reader: FootageReader | None = None
        self._decoder: _Decoder | None = None
        self._frame, self._clock = 0, FootageClock(0, 0)
        self._ended = self._started = False

    def connect(self) -> None:
        self._reader = open_footage(self._settings.path, self._channels)
        try:
            self._shape = self._reader.probe()
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
        if self._decoder is None or self._ended:
            self._begin_playing()
        self._started = True
        self._clock = self._next_clock()
        self._pace.begin(self._clock, self._frame)
        self._follow_shared_clock()

    def read(self, timeout_s: float) -> Frame | None:
        if self._decoder is None or not self._started:
            raise InputError("is not started", where=self._settings.path, remedy="Call start() first.")
        if self._ended:
            raise EndOfFootage
        deadline_s = time.monotonic() + timeout_s
        item = self._decoder.peek(timeout_s)
        if item is None:
            return None
        if item is _END:
            self._ended = True
            raise EndOfFootage
        if isinstance(item, InputError):
            self._ended = True
            raise item
        if item is _SKIP:
            self.count("undecodable")
            self.statistics.add(self._frame, complete=False)
            self._pass_frame()
            return None
        self._follow_shared_clock()
        if self._pace.has_missed(self._frame):
            self.count("left_out")
            self._pass_frame()
            return None
        if not self._pace.wait(self._frame, max(deadline_s - time.monotonic(), 0.0)):
            return None
        stamp_ns = footage_stamp_ns(self._clock.epoch_ns, self._frame, self.fps)
        frame = Frame(item, stamp_ns, self._frame, CLOCK)  # type: ignore[arg-type]
        self.counters["pace_timeouts"] = self._pace.timeouts
        self.statistics.add(frame.frame_id)
        self._pass_frame()
        return frame

    def stop(self) -> None:
        self._started = False
        self._shared.forget()

    def close(self) -> None:
        self.stop()
        if self._decoder is not None:
            self._decoder.close()
            self._decoder = None
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def acknowledge(self, stamp_ns: int) -> None:
        if self._reader is not None:
            self._pace.acknowledge(stamp_ns)

    @property
    def shape(self) -> tuple[int, ...]:
        return self._shape

    @property
    def description(self) -> str:
        return f"footage {self._settings.path}"

    @property
    def epoch_ns(self) -> int:
        """The stamp of frame 0, settled at start(), or by a camera that had started before."""
        return self._clock.epoch_ns

    @property
    def frame_count(self) -> int:
        """Number of frames according to the file's header."""
        return 0 if self._reader is None else self._reader.frame_count

    def _begin_playing(self) -> None:
        assert self._reader is not None
        if self._decoder is not None:
            self._decoder.close()
            self._reader.rewind()
        if self._settings.epoch_ns == 0:
            self._frame = 0
        epoch_ns = choose_epoch_ns(self._settings.epoch_ns, self._now_ns())
        self._clock = FootageClock(epoch_ns, epoch_ns)
        self._ended = False
        self._decoder = _Decoder(self._reader, self._settings.loop)

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

    def _pass_frame(self) -> None:
        assert self._decoder is not None
        self._decoder.drop()
        self._frame += 1

    def _pace_of_settings(self, fps: float) -> Pace:
        s = self._settings
        if s.rate > 0:
            return WallClockPace(fps, s.rate)
        return AcknowledgedPace(fps, WINDOW, PATIENCE_S)


class _Decoder:
    """Decodes a few images ahead in a thread of its own, so that a slow one does not delay its frame."""

    def __init__(self, reader: FootageReader, loop: bool) -> None:
        self._reader, self._loop = reader, loop
        self._images: queue.Queue[object] = queue.Queue(maxsize=READ_AHEAD - 1)  # one more waits in peek()
        self._head: object | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="footage decoder", daemon=True)
        self._thread.start()

    def peek(self, timeout_s: float) -> Image | object | None:
        """The next image; _SKIP for a broken one, _END after the last, an error; None when none is ready in time."""
        if self._head is None:
            try:
                self._head = self._images.get(timeout=max(timeout_s, 0.0))
            except queue.Empty:
                return None
        return self._head

    def drop(self) -> None:
        """Pass to the next image."""
        self._head = None

    def close(self) -> None:
        self._closing.set()
        while self._thread.is_alive():
            try:
                self._images.get_nowait()  # makes room for a decoder that waits to put
            except queue.Empty:
                self._thread.join(0.01)

    def _run(self) -> None:
        decoded = 0
        while not self._closing.is_set():
            try:
                image = self._reader.read()
                decoded += image is not None
            except UndecodableFrame:
                self._images.put(_SKIP)
                continue
            if image is not None:
                self._images.put(image)
            elif self._loop and decoded:
                try:
                    self._reader.rewind()
                except InputError as error:  # the file went away meanwhile
                    self._images.put(error)
                    return
            else:
                self._images.put(_END)
                return
