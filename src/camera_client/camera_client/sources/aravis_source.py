"""A GigE Vision camera through Aravis. The only file that imports gi.

Nothing is broadcast unless a serial number or name is searched for, and then only on the interface that was named:
Aravis's own ways to open a camera fall back to a broadcast on every interface when they find nothing, so that the
device is constructed here from the two addresses of the link instead.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.stamps import CaptureClock
from gige_vision import bootstrap
from gige_vision.gvsp import PixelFormat

from ..frame_source import Frame, FrameSource, FrameStatistics, Image, SourceUnavailable
from ..gige.camera_setup import CameraSetup, set_up_camera
from ..gige.capture_time import CameraTime, ClockReading, FrameTimes, after_last, choose_time_source, read_clock
from ..gige.discovery import FoundCamera, described, find_camera
from ..gige.features import AravisFeatures, DeviceRefusal, DeviceSilence, Features, device_errors
from ..gige.pixel_formats import to_image
from ..gige.triggers import (
    ACTION_COUNTERS,
    ActionSender,
    TriggerSchedule,
    TriggerThread,
    await_ptp,
    ptp_status,
    synchronise,
)
from ..settings import AravisSettings

INSTALL = "Install it: sudo apt install python3-gi gir1.2-aravis-0.8 (in a venv made with --system-site-packages)."
TRIGGER_COUNTERS = ("triggers", "triggers_missed", "triggers_refused")
US_TO_NS = 1000
# Thresholds: measured by python bench/camera.py --loss 0 0.0005 0.005.
FIRST_PACKET_TIMEOUT_US = 1000  # a missing packet is asked for after this
PACKET_TIMEOUT_US = 5000  # ... and again after this


def import_aravis() -> tuple[Any, Any, Any]:
    """Return the modules Aravis, Gio and GLib. Raises InputError with the remedy where they are not installed."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, Gio, GLib
    except (ImportError, ValueError) as error:
        raise InputError(f"Aravis is not available ({error})", where="source: aravis", remedy=INSTALL) from None
    return Aravis, Gio, GLib


class AravisSource(FrameSource):
    """Frames of one GigE Vision camera that this process controls; see :class:`FrameSource`.

    Of a camera that is dead, every access waits for its time-out (2.5 s with Aravis 0.8): stop() and close() may take
    so long, without holding the GIL, and are best called on a thread of their own then. A camera whose control was lost
    is not spoken to any more.

    ``counters``: stamp_jumps, wrong_format, the stream's packets, triggers and actions.
    """

    def __init__(self, settings: AravisSettings, channels: str = "auto", halve_mosaics: bool = False) -> None:
        """``halve_mosaics``: of Bayer cameras, images are made at half of the size."""
        super().__init__()
        self._settings, self._channels, self._halve_mosaics = settings, channels, halve_mosaics
        self.description = described(settings)
        self._clock = CaptureClock(settings.clock_speed)
        self._camera: Any = None
        self._device: Any = None
        self._features: Features | None = None
        self._stream: AravisStream | None = None
        self._trigger: TriggerThread | None = None
        self._actions: ActionSender | None = None
        self._schedule: TriggerSchedule | None = None
        self._time: CameraTime | None = None
        self._streaming = False
        self._lost = False
        self._last_stamp_ns = 0
        self._details: dict[str, str] = {}
        own = {"software": TRIGGER_COUNTERS, "action": (*ACTION_COUNTERS, "triggers_missed")}.get(settings.sync, ())
        self._counters |= dict.fromkeys((*AravisStream.COUNTERS, "stamp_jumps", *own), 0)

    # --- the source's contract -----------------------------------------------------------------------------------

    def connect(self) -> None:
        self._Aravis, self._Gio, self._GLib = import_aravis()
        try:
            found = find_camera(self._settings)
            with self._device_errors("while it was set up"):
                features = self._features = self._open(found)
                setup = set_up_camera(features, self._settings, self._channels, self._halve_mosaics)
                self.shape, self.halved = setup.shape, setup.halved
                self._time = self._prepare_time_and_triggers(features, found)
                self._stream = AravisStream(self._Aravis, self._camera, self._settings, setup, self.statistics)
                self._details = self._read_details(features, found, setup, self._time)
        except BaseException:
            self.close()
            raise
        self.warnings = (*features.warnings, *self._stream.warnings)

    def start(self) -> None:
        if self._streaming:
            return
        assert self._stream is not None and self._features is not None
        with self._device_errors("when it was started"):
            reading = read_clock(self._features.access, self._clock.now_ns)
            self._time, self._last_stamp_ns = self._time_source(self._features, reading), 0
            self._stream.restart()
            self._camera.start_acquisition()
        self._streaming = True
        self._start_triggers(reading)

    def read(self, timeout_s: float) -> Frame | None:
        assert self._stream is not None and self._time is not None
        grabbed = self._stream.grab(timeout_s)
        if grabbed is None:
            return None
        image, frame_id, times = grabbed
        stamp = self._time.stamp(times._replace(arrival_ns=self._clock.at_utc(times.arrival_ns)))
        self._counters["stamp_jumps"] = self._time.jumps
        self._last_stamp_ns = after_last(stamp.ns, self._last_stamp_ns)
        return Frame(image, self._last_stamp_ns, frame_id, stamp.clock, stamp.uncertainty_ns)

    def stop(self) -> None:
        if not self._streaming:
            return
        self._streaming = False
        trigger, self._trigger = self._trigger, None
        if trigger is not None:
            trigger.stop()
        if not self.lost:
            try:
                with contextlib.suppress(DeviceRefusal), device_errors(self._Aravis, self._GLib):
                    self._camera.stop_acquisition()
            except DeviceSilence:  # the camera is dead; nothing else is sent to it then
                self._lost = True
        self._counters |= self.counters  # what is known once the stream is closed

    def close(self) -> None:
        self.stop()
        if self._actions is not None:
            self._actions.close()
        gone, device, self._device = self.lost, self._device, None
        self._actions = self._stream = self._camera = self._features = None
        if device is not None and not gone and device.is_controller():
            with contextlib.suppress(self._GLib.Error):
                device.leave_control()

    @property
    def counters(self) -> dict[str, int]:
        stream, schedule = self._stream, self._schedule
        missed = {} if schedule is None else {"triggers_missed": schedule.missed}
        return self._counters | ({} if stream is None else stream.counts()) | missed

    @property
    def details(self) -> dict[str, str]:
        return dict(self._details)

    @property
    def lost(self) -> bool:
        # polled, not signalled: a handler of control-lost runs on Aravis's heartbeat thread and may come to hold the
        # last reference to the device, whose end then waits for that very thread
        device = self._device
        if device is not None and self._features is not None and not device.is_controller():
            self._lost = True
        return self._lost

    # --- connecting ----------------------------------------------------------------------------------------------

    def _open(self, found: FoundCamera) -> Features:
        address = self._Gio.InetAddress.new_from_string
        self._device = self._Aravis.GvDevice.new(address(found.host), address(found.device.address))
        access = AravisFeatures(self._device, self._Aravis, self._GLib)
        if not self._device.is_controller():
            raise SourceUnavailable(
                "is controlled by another program",
                where=self.description,
                remedy="Stop that program, or wait until it lets go (sagoma doctor tells where it runs).",
            )
        self._lost = False
        self._camera = self._Aravis.Camera.new_with_device(self._device)
        return Features(access, self.description)

    def _prepare_time_and_triggers(self, features: Features, found: FoundCamera) -> CameraTime:
        """PTP first, for everything else counts on the clock; then the triggers; then whose time stamps frames."""
        s = self._settings
        if s.sync in ("ptp", "action") or s.stamp_source == "ptp":
            await_ptp(features, s)
        reading = read_clock(features.access, self._clock.now_ns)
        if s.sync in ("ptp", "action") and reading is None:
            raise self._error(f"has no clock that can be read; sync {s.sync} needs one", "Choose another aravis.sync.")
        offset_ns = 0 if reading is None else reading.offset_ns
        synchronise(features, s, lambda: self._clock.now_ns() - offset_ns)
        if s.sync == "action":
            if not features.access.read_register(bootstrap.GVCP_CAPABILITY) & bootstrap.Capability.SCHEDULED_ACTION:
                raise self._error(
                    "takes no scheduled action commands, which sync action needs",
                    "Set aravis.sync to ptp, line or software.",
                )
            self._actions = ActionSender(found.device.address, found.host, s.action_device_key, self._counters)
        return self._time_source(features, reading)

    def _time_source(self, features: Features, reading: ClockReading | None) -> CameraTime:
        s = self._settings
        status = ptp_status(features) if s.stamp_source in ("auto", "ptp") else None
        source, warning = choose_time_source(s, reading, status, self.description)
        features.warn(warning)
        return source

    def _read_details(
        self, features: Features, found: FoundCamera, setup: CameraSetup, time_source: CameraTime
    ) -> dict[str, str]:
        device = found.device
        details = {
            "camera_serial": device.serial,
            "camera_user_id": device.user_id,
            "camera_address": device.address,
            "camera_model": f"{device.manufacturer} {device.model}".strip(),
            "pixel_format": setup.pixel_format,
            "exposure_us": setup.exposure_us,
            "frame_rate": setup.frame_rate,
            "gain": features.number("Gain"),
            "temperature_c": features.number("DeviceTemperature"),
            "sync": self._settings.sync,
            "stamps": time_source.name,
            "packet_size": str(self._device.get_packet_size()),
        }
        texts = {name: f"{value:g}" if isinstance(value, float) else value for name, value in details.items()}
        return {name: text for name, text in texts.items() if text}

    # --- while it runs -------------------------------------------------------------------------------------------

    def _start_triggers(self, reading: ClockReading | None) -> None:
        s = self._settings
        if s.sync == "software":
            self._schedule = TriggerSchedule(s.frame_rate)
            self._trigger = TriggerThread(self._schedule, self._clock.now_ns, self._software_trigger)
        elif s.sync == "action":
            assert self._actions is not None and reading is not None
            self._schedule = TriggerSchedule(s.frame_rate, lead_ns=round(s.action_lead_ms * 1e6))
            ahead_ns = -reading.offset_ns
            self._trigger = TriggerThread(self._schedule, lambda: self._clock.now_ns() + ahead_ns, self._actions.send)

    def _software_trigger(self, instant_ns: int) -> None:
        camera = self._camera
        if camera is None or self.lost:
            return
        try:
            camera.software_trigger()
            self._counters["triggers"] += 1
        except self._GLib.Error:
            self._counters["triggers_refused"] += 1

    def _error(self, what: str, remedy: str) -> InputError:
        return InputError(what, where=self.description, remedy=remedy)

    @contextlib.contextmanager
    def _device_errors(self, when: str) -> Iterator[None]:
        """What the device or Aravis answers as an error that names the camera."""
        remedy = "Power-cycle the camera if this stays."
        try:
            with device_errors(self._Aravis, self._GLib):
                yield
        except DeviceSilence as silence:
            self._lost = True  # so that close() does not wait for it either
            raise SourceUnavailable(f"went silent {when} ({silence})", where=self.description, remedy=remedy) from None
        except DeviceRefusal as refusal:
            kind = SourceUnavailable if self._features is None else InputError
            raise kind(f"refuses {when} ({refusal})", where=self.description, remedy=remedy) from None


# --- the stream: its packets and socket, its buffers, and what becomes of every frame


class AravisStream:
    """Takes frames from ``camera`` (an Aravis.Camera that we control) into buffers of our own memory.

    statistics : counts every frame, whole or not. ``warnings`` of the set-up.
    """

    INFOS = ("resend_requests", "resent_packets", "missing_packets", "underruns", "error_packets")  # Aravis: "n_..."
    COUNTERS = (*INFOS, "wrong_format")

    def __init__(
        self, Aravis: Any, camera: Any, settings: AravisSettings, setup: CameraSetup, statistics: FrameStatistics
    ) -> None:
        self._Aravis, self._setup, self._statistics = Aravis, setup, statistics
        self._agreed = (camera.get_pixel_format(), setup.width, setup.height, 0)
        self._exposure_ns = round((setup.exposure_us or 0.0) * US_TO_NS)
        self._image_bytes = PixelFormat[setup.pixel_format].image_bytes(setup.width, setup.height)
        self._wrong_format, self._last_id, self._has_run = 0, 0, False
        adjustment, resend = Aravis.GvPacketSizeAdjustment, Aravis.GvStreamPacketResend
        camera.gv_set_packet_size_adjustment(adjustment.NEVER if settings.packet_size else adjustment.ALWAYS)
        # packet sockets deliver in blocks of 5 ms and need CAP_NET_RAW
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        self._stream = camera.create_stream(None, None)
        capabilities = camera.get_device().read_register(bootstrap.GVCP_CAPABILITY)
        able = bool(capabilities & bootstrap.Capability.PACKET_RESEND)
        self.warnings = () if able else ("the camera cannot send lost packets again: every lost packet costs a frame",)
        properties = {
            "packet-resend": resend.ALWAYS if able else resend.NEVER,
            "packet-request-ratio": 1.0,  # all of a frame's packets may be asked for again
            "initial-packet-timeout": FIRST_PACKET_TIMEOUT_US,
            "packet-timeout": PACKET_TIMEOUT_US,
            "frame-retention": round(settings.frame_retention_ms * 1000 / settings.clock_speed),
            "socket-buffer": Aravis.GvStreamSocketBuffer.FIXED,
            "socket-buffer-size": settings.socket_buffer_bytes,
        }
        for name, value in properties.items():
            self._stream.set_property(name, value)
        payload = max(camera.get_payload(), self._image_bytes)
        for _ in range(settings.buffers):
            memory = np.empty(payload, np.uint8)
            buffer = Aravis.Buffer.new_full(payload, memory.ctypes.data, None, None)
            buffer.memory = memory  # which PyGObject keeps as long as the buffer lives
            self._stream.push_buffer(buffer)

    def restart(self) -> None:
        """Forget what a former run left behind; the next frame is the first of a new run."""
        if self._has_run:  # Aravis would take the ids of a new run, which begin at 1 again, for late packets
            self._stream.stop_thread(False)
            while (buffer := self._stream.try_pop_buffer()) is not None:
                self._return_buffer(buffer)
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
            return self._unpack(buffer)
        finally:
            self._return_buffer(buffer)

    def counts(self) -> dict[str, int]:
        """Return :data:`COUNTERS` of this instant."""
        counted = {name: self._stream.get_info_uint64_by_name(f"n_{name}") for name in self.INFOS}
        return {**counted, "wrong_format": self._wrong_format}

    def _unpack(self, buffer: Any) -> tuple[Image, int, FrameTimes] | None:
        # without its leader packet a frame has no id, and is the one after the last
        self._last_id = buffer.get_frame_id() or self._last_id + 1
        whole = buffer.get_status() == self._Aravis.BufferStatus.SUCCESS
        agreed = whole and self._is_as_agreed(buffer)
        self._wrong_format += whole and not agreed
        self._statistics.add(self._last_id, complete=agreed)
        if not agreed:
            return None
        setup, raw = self._setup, buffer.memory[: self._image_bytes]
        image = to_image(raw, setup.pixel_format, setup.width, setup.height, setup.halved)
        arrival_ns = buffer.get_system_timestamp() or time.time_ns()
        return image, self._last_id, FrameTimes(buffer.get_timestamp(), arrival_ns, self._exposure_ns)

    def _is_as_agreed(self, buffer: Any) -> bool:
        if buffer.get_payload_type() != self._Aravis.BufferPayloadType.IMAGE:
            return False
        padding = buffer.get_image_padding()
        came = buffer.get_image_pixel_format(), buffer.get_image_width(), buffer.get_image_height(), padding[0]
        return came == self._agreed

    def _return_buffer(self, buffer: Any) -> None:
        buffer.set_frame_id(0)  # or a frame without leader would keep the id of the last one in this buffer
        self._stream.push_buffer(buffer)
