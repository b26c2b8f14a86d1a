"""The stream of a camera through Aravis: its packets and socket, its buffers, and what becomes of every frame."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from gige_vision import bootstrap
from gige_vision.gvsp import PixelFormat

from ..frame_source import FrameStatistics, Image
from ..gige.camera_setup import CameraSetup
from ..gige.capture_time import FrameTimes
from ..gige.pixel_formats import to_image
from ..settings import AravisSettings

US_TO_NS = 1000
# Thresholds: measured by python bench/camera.py --loss 0 0.0005 0.005.
FIRST_PACKET_TIMEOUT_US = 1000  # a missing packet is asked for after this
PACKET_TIMEOUT_US = 5000  # ... and again after this


class AravisStream:
    """Takes frames from ``camera`` (an Aravis.Camera that we control) into buffers of our own memory.

    statistics : counts every frame, whole or not. ``warnings`` of the set-up.
    """

    INFOS = ("resend_requests", "resent_packets", "missing_packets", "underruns", "error_packets")  # Aravis: "n_..."
    COUNTERS = (*INFOS, "wrong_format")

    def __init__(
        self, Aravis: Any, camera: Any, settings: AravisSettings, setup: CameraSetup, statistics: FrameStatistics
    ) -> None:
        self._Aravis, self._camera, self._settings = Aravis, camera, settings
        self._setup, self._statistics = setup, statistics
        self._device = camera.get_device()
        self._format_code = camera.get_pixel_format()
        self._exposure_ns = round((setup.exposure_us or 0.0) * US_TO_NS)
        self._image_bytes = PixelFormat[setup.pixel_format].image_bytes(setup.width, setup.height)
        adjustment = Aravis.GvPacketSizeAdjustment
        camera.gv_set_packet_size_adjustment(adjustment.NEVER if settings.packet_size else adjustment.ALWAYS)
        # packet sockets deliver in blocks of 5 ms and need CAP_NET_RAW
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        self._stream = camera.create_stream(None, None)
        self.warnings = self._set_up()
        self._wrong_format = 0
        self._has_run, self._last_id = False, 0

    def restart(self) -> None:
        """Forget what a former run left behind; the next frame is the first of a new run."""
        if self._has_run:  # Aravis would take the ids of a new run, which begin at 1 again, for late packets
            self._stream.stop_thread(False)
            while (buffer := self._stream.try_pop_buffer()) is not None:
                self._give_back(buffer)
            self._stream.start_thread()
        self._has_run, self._last_id = True, 0
        self._statistics.restart()

    def grab(self, timeout_s: float) -> tuple[Image, int, FrameTimes] | None:
        """Return image, id and times of the next frame; None when it was not whole, or none came in time.

        Of the times the arrival of the first packet is in UTC. Waits without the GIL.
        """
        buffer = self._stream.timeout_pop_buffer(int(timeout_s * 1e6))
        if buffer is None:
            return None
        try:
            return self._take(buffer)
        finally:
            self._give_back(buffer)

    def counts(self) -> dict[str, int]:
        """Return :data:`COUNTERS` of this instant."""
        counted = {name: self._stream.get_info_uint64_by_name(f"n_{name}") for name in self.INFOS}
        return {**counted, "wrong_format": self._wrong_format}

    # --- one frame -----------------------------------------------------------------------------------------------

    def _take(self, buffer: Any) -> tuple[Image, int, FrameTimes] | None:
        frame_id = self._id_of(buffer)
        whole = buffer.get_status() == self._Aravis.BufferStatus.SUCCESS
        agreed = whole and self._is_as_agreed(buffer)
        self._wrong_format += whole and not agreed
        self._statistics.add(frame_id, complete=agreed)
        if not agreed:
            return None
        setup, raw = self._setup, buffer.memory[: self._image_bytes]
        image = to_image(raw, setup.pixel_format, setup.width, setup.height, setup.halved)
        arrival_ns = buffer.get_system_timestamp() or time.time_ns()
        return image, frame_id, FrameTimes(buffer.get_timestamp(), arrival_ns, self._exposure_ns)

    def _id_of(self, buffer: Any) -> int:
        """Return the frame's id; without its leader packet it has none, and then it is the one after the last."""
        self._last_id = buffer.get_frame_id() or self._last_id + 1
        return self._last_id

    def _is_as_agreed(self, buffer: Any) -> bool:
        if buffer.get_payload_type() != self._Aravis.BufferPayloadType.IMAGE:
            return False
        padding = buffer.get_image_padding()
        came = buffer.get_image_pixel_format(), buffer.get_image_width(), buffer.get_image_height(), padding[0]
        return came == (self._format_code, self._setup.width, self._setup.height, 0)

    def _give_back(self, buffer: Any) -> None:
        buffer.set_frame_id(0)  # or a frame without leader would keep the id of the last one in this buffer
        self._stream.push_buffer(buffer)

    # --- setting up ----------------------------------------------------------------------------------------------

    def _set_up(self) -> tuple[str, ...]:
        Aravis, s, stream = self._Aravis, self._settings, self._stream
        able = self._device.read_register(bootstrap.GVCP_CAPABILITY) & bootstrap.Capability.PACKET_RESEND
        resend = Aravis.GvStreamPacketResend
        stream.set_property("packet-resend", resend.ALWAYS if able else resend.NEVER)
        stream.set_property("packet-request-ratio", 1.0)  # all of a frame's packets may be asked for again
        stream.set_property("initial-packet-timeout", FIRST_PACKET_TIMEOUT_US)
        stream.set_property("packet-timeout", PACKET_TIMEOUT_US)
        stream.set_property("frame-retention", round(s.frame_retention_ms * 1000 / s.clock_speed))
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", s.socket_buffer_bytes)
        payload = max(self._camera.get_payload(), self._image_bytes)
        for _ in range(s.buffers):
            stream.push_buffer(self._new_buffer(payload))
        return () if able else ("the camera cannot send lost packets again: every lost packet costs a frame",)

    def _new_buffer(self, size: int) -> Any:
        """A buffer of Aravis over memory of NumPy, which lives as long as the buffer does: PyGObject keeps it."""
        memory = np.empty(size, np.uint8)
        buffer = self._Aravis.Buffer.new_full(size, memory.ctypes.data, None, None)
        buffer.memory = memory
        return buffer
