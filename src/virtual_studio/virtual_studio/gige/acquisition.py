"""Acquisition of a camera: waits for the instant or the trigger, exposes, and hands the block to the stream."""

from __future__ import annotations

import struct
from collections import deque

import numpy as np
from numpy.typing import NDArray

from gige_vision.gvcp import Action, Status
from gige_vision.gvsp import Payload, PixelFormat, encode_chunk, image_leader, image_trailer, next_block_id

from .device import Device
from .feature_table import CHUNKS, IMAGE_CHUNK
from .imaging import ImagingPipeline, pixel_bytes
from .loop import Timer
from .registers import RegisterError, Value
from .scenes import CameraScene
from .stream import StreamChannel
from .timing import LONGEST_BACKLOG_NS, CameraClock, Timing

REMEMBERED = 4096
LOCKED = ("Width", "Height", "BinningHorizontal", "BinningVertical", "PixelFormat", "ChunkModeActive", "ChunkEnable")


class Acquisition:
    """Takes one camera's frames, from AcquisitionStart to AcquisitionStop. Only called from within the loop."""

    def __init__(
        self,
        device: Device,
        scene: CameraScene,
        clock: CameraClock,
        imaging: ImagingPipeline,
        timing: Timing,
        stream: StreamChannel,
    ) -> None:
        self.scene = scene
        self._registers, self._faults, self._counters = device.registers, device.faults, device.counters
        self._loop, self._clock, self._imaging, self._timing, self._stream = device.loop, clock, imaging, timing, stream
        self._now_ns = device.loop.clock.now_ns
        self.running = False
        self.lateness_ns: deque[int] = deque(maxlen=REMEMBERED)
        self._block_id = self._busy_until_ns = 0
        self._timers: list[Timer] = []
        self._registers.writes["AcquisitionStart"] = self.start
        self._registers.writes["AcquisitionStop"] = self.stop
        self._registers.writes["TriggerSoftware"] = lambda: self.trigger("Software", self._now_ns())
        for key in ("TriggerMode", "TriggerSource", "SyncFreeRunTimerEnable"):
            self._registers.writes[key] = self._rearm
        for key in LOCKED:
            self._registers.checks[key] = self._refuse_while_running

    def start(self) -> None:
        """Begins with block 1."""
        if self.running:
            return
        self._stream.discard_blocks()
        self.running, self._block_id = True, 0
        self._busy_until_ns = self._now_ns()
        self._rearm()

    def stop(self) -> None:
        """Stops: no frame leaves any more."""
        self.running = False
        self._cancel()

    def trigger(self, source: str, instant_ns: int) -> bool:
        """Handles a trigger at an instant (of the loop's clock, ns); True when it starts an exposure."""
        if not self.running or self._timing.source != source:
            return False
        start_ns = instant_ns + self._timing.trigger_delay_ns
        if start_ns < self._busy_until_ns:
            self._counters["triggers_missed"] += 1
            return False
        self._counters["triggers"] += 1
        self._expose_at(start_ns)
        return True

    def execute_action(self, action: Action) -> Status | None:
        """Triggers now or at the time of an action command; None when it is meant for other cameras."""
        r = self._registers
        if action.device_key != r.integer("ActionDeviceKey") or action.group_key != r.integer("ActionGroupKey"):
            return None
        if not action.group_mask & r.integer("ActionGroupMask"):
            return None
        self._counters["actions"] += 1
        if action.time_ns is None:
            self.trigger("Action1", self._now_ns())
            return Status.SUCCESS
        if not self._clock.is_synchronised:
            return Status.NO_REFERENCE_TIME
        when_ns = self._clock.utc_of(action.time_ns)
        if when_ns < self._now_ns():
            self._counters["actions_late"] += 1
            return Status.ACTION_LATE
        self._timers.append(self._loop.call_at(when_ns, lambda: self.trigger("Action1", when_ns)))
        return Status.SUCCESS

    def _rearm(self) -> None:
        """Schedules the first exposure of a free-running camera; a triggered one waits."""
        self._cancel()
        if self.running and self._timing.is_periodic:
            self._expose_at(self._timing.next_start(self._now_ns()))

    def _expose_at(self, start_ns: int) -> None:
        exposure_ns = self._imaging.exposure.exposure_ns
        self._busy_until_ns = start_ns + exposure_ns
        self._timers = [timer for timer in self._timers if not timer.done()]
        self._timers.append(self._loop.call_at(start_ns + exposure_ns, lambda: self._read_out(start_ns, exposure_ns)))

    def _read_out(self, start_ns: int, exposure_ns: int) -> None:
        """Sends the frame when its exposure is over, and begins the next one."""
        late_ns = self._now_ns() - start_ns - exposure_ns
        self.lateness_ns.append(late_ns)
        self._counters["frames_exposed"] += 1
        if not self._faults.stall:
            self._send(start_ns, exposure_ns)
        if self._timing.is_periodic:
            after_ns = start_ns
            if late_ns > LONGEST_BACKLOG_NS:
                after_ns = self._now_ns()
                self._counters["late_restarts"] += 1
            self._expose_at(self._timing.next_start(after_ns))

    def _send(self, start_ns: int, exposure_ns: int) -> None:
        picture = self._imaging.capture(self.scene.image(start_ns + exposure_ns // 2))
        region, r = self._imaging.region, self._registers
        self._block_id = next_block_id(self._block_id)
        stamp = self._clock.stamp(start_ns)
        data = pixel_bytes(picture, region.pixel_format)
        chunk_bytes = None
        if r.integer("ChunkModeActive"):
            data = self._with_chunks(data, stamp)
            chunk_bytes = len(data)
        announced = region.pixel_format
        if self._faults.wrong_format:
            announced = PixelFormat.Mono12 if announced is PixelFormat.Mono8 else PixelFormat.Mono8
        size_px, offset_px = (r.integer("Width"), r.integer("Height")), (r.integer("OffsetX"), r.integer("OffsetY"))
        payload = Payload.IMAGE if chunk_bytes is None else Payload.IMAGE_WITH_CHUNKS
        leader = image_leader(stamp, announced, size_px, offset_px, payload)
        self._stream.send(self._block_id, leader, data, image_trailer(size_px[1], chunk_bytes))

    def _with_chunks(self, data: NDArray[np.uint8], stamp: int) -> NDArray[np.uint8]:
        contents = {
            "Timestamp": struct.pack(">q", stamp),
            "ExposureTime": struct.pack(">d", self._imaging.exposure.exposure_us),
        }
        tail = encode_chunk(IMAGE_CHUNK, b"")[:4] + struct.pack(">I", len(data))
        tail += b"".join(encode_chunk(CHUNKS[name], contents[name]) for name in self._imaging.region.chunks)
        return np.concatenate([data, np.frombuffer(tail, np.uint8)])

    def _cancel(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers = []

    def _refuse_while_running(self, value: Value) -> None:
        if self.running:
            raise RegisterError(Status.ACCESS_DENIED)
