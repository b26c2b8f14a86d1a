"""A GigE Vision camera through Aravis, opened by its IP address. The only file that imports gi.

Nothing is broadcast: Aravis's own ways to open a camera fall back to a broadcast discovery on every interface when
they find nothing, so that the device is constructed here from the two addresses of the link instead.
"""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from typing import Any

from capture_rig.errors import InputError

from .camera_clock import CameraClock
from .frame_source import Frame, FrameSource
from .gige_network import enlarge_receive_buffer, host_address_for
from .pixel_formats import PREFERENCE, choose_format, image_shape, to_image
from .settings import AravisSettings

AUTO_FEATURES = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
SETTLED = 0.02  # a float feature may come back rounded to the sensor's lines or steps by so much
INSTALL = "Install it: sudo apt install python3-gi gir1.2-aravis-0.8 (in a venv made with --system-site-packages)."


def import_aravis() -> tuple[Any, Any, Any]:
    """The modules Aravis, Gio and GLib. Raises InputError with the remedy where they are not installed."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, Gio, GLib
    except (ImportError, ValueError) as error:
        raise InputError(f"Aravis is not available ({error})", where="source: aravis", remedy=INSTALL) from None
    return Aravis, Gio, GLib


class AravisSource(FrameSource):
    """Frames of one GigE Vision camera that this process controls; see :class:`FrameSource`."""

    def __init__(self, settings: AravisSettings, channels: str = "auto") -> None:
        super().__init__()
        self._settings, self._channels = settings, channels
        self._camera: Any = None
        self._stream: Any = None
        self._streaming = False
        self._control_lost = threading.Event()
        self._details: dict[str, str] = {}

    def connect(self) -> None:
        self._Aravis, self._Gio, self._GLib = import_aravis()
        try:
            self._camera = self._open()
            self._configure()
            self._stream = self._open_stream()
        except self._GLib.Error as error:
            self.close()
            raise self._error(f"refuses ({error.message})", "Power-cycle it if this stays.") from None
        except InputError:
            self.close()
            raise

    def start(self) -> None:
        if self._camera is None or self._stream is None:
            raise self._error("is not connected", "Call connect() first.")
        if self._streaming:
            return
        self._clock = CameraClock()
        self._drain()
        try:
            self._camera.start_acquisition()
        except self._GLib.Error as error:
            raise self._error(f"does not start ({error.message})", "Power-cycle it if this stays.") from None
        self._streaming = True

    def read(self, timeout_s: float) -> Frame | None:
        if not self._streaming:
            raise self._error("is not started", "Call start() first.")
        buffer = self._stream.timeout_pop_buffer(int(timeout_s * 1e6))
        if buffer is None:
            return None
        try:
            return self._frame(buffer)
        finally:
            self._stream.push_buffer(buffer)

    def stop(self) -> None:
        if self._streaming:
            self._streaming = False
            with contextlib.suppress(self._GLib.Error):  # a dead camera cannot be told
                self._camera.stop_acquisition()

    def close(self) -> None:
        self.stop()
        # control goes back to the camera when its device object dies, so nothing may hold on to it
        self._stream = None
        self._camera = None
        gc.collect()

    @property
    def shape(self) -> tuple[int, ...]:
        return image_shape(self._format, self._width, self._height)

    @property
    def description(self) -> str:
        return f"camera {self._settings.address}"

    @property
    def details(self) -> dict[str, str]:
        return dict(self._details)

    @property
    def lost(self) -> bool:
        return self._control_lost.is_set()

    def _error(self, what: str, remedy: str) -> InputError:
        return InputError(what, where=f"camera {self._settings.address}", remedy=remedy)

    def _open(self) -> Any:
        host = host_address_for(self._settings.address)
        address = self._Gio.InetAddress.new_from_string
        device = self._Aravis.GvDevice.new(address(host), address(self._settings.address))
        if not device.is_controller():
            raise self._error("is controlled by another program", "Stop that program, or wait until it lets go.")
        lost = self._control_lost = threading.Event()
        device.connect("control-lost", lambda _: lost.set())
        return self._Aravis.Camera.new_with_device(device)

    def _configure(self) -> None:
        camera, s = self._camera, self._settings
        camera.set_acquisition_mode(self._Aravis.AcquisitionMode.CONTINUOUS)
        for feature in AUTO_FEATURES:
            if camera.is_feature_available(feature):
                camera.set_string(feature, "Off")
        self._set_pixel_format()
        self._set_float("exposure_us", s.exposure_us, camera.set_exposure_time, camera.get_exposure_time)
        self._set_float("gain", s.gain, camera.set_gain, camera.get_gain)
        self._set_float("frame_rate", s.frame_rate, camera.set_frame_rate, camera.get_frame_rate)
        if s.packet_size:
            camera.gv_set_packet_size(s.packet_size)
        _, _, self._width, self._height = camera.get_region()
        self._details = self._read_details()

    def _set_pixel_format(self) -> None:
        available = list(self._camera.dup_available_pixel_formats_as_strings())
        wanted = self._settings.pixel_format
        chosen = choose_format(available, self._channels) if wanted == "auto" else wanted
        if chosen is None or chosen not in available:
            raise self._error(f"does not offer pixel format {wanted!r} but {', '.join(available)}",
                              f"aravis.pixel_format can be {', '.join(PREFERENCE)}.")  # fmt: skip
        self._camera.set_pixel_format_from_string(chosen)
        self._format = self._camera.get_pixel_format_as_string()
        if self._format != chosen:
            raise self._error(f"took pixel format {self._format} instead of {chosen}", "Choose another pixel_format.")

    def _set_float(self, key: str, wanted: float, write: Any, read: Any) -> None:
        if wanted < 0:
            return
        write(wanted)
        got = read()
        if abs(got - wanted) > SETTLED * max(abs(wanted), 1.0):
            raise self._error(f"took {key} = {got:g} instead of {wanted:g}",
                              f"Set aravis.{key} to a value that the camera can keep.")  # fmt: skip

    def _read_details(self) -> dict[str, str]:
        details = {}
        readers = {
            "camera_serial": self._camera.get_device_serial_number,
            "exposure_us": lambda: f"{self._camera.get_exposure_time():g}",
        }
        for key, read in readers.items():
            with contextlib.suppress(self._GLib.Error):  # not every camera tells
                details[key] = read() or ""
        return details

    def _open_stream(self) -> Any:
        Aravis, s = self._Aravis, self._settings
        # packet sockets deliver in blocks of 5 ms and need CAP_NET_RAW
        self._camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        stream = self._camera.create_stream(None, None)
        stream.set_property("packet-resend", Aravis.GvStreamPacketResend.ALWAYS)
        stream.set_property("packet-timeout", round(s.packet_timeout_ms * 1000))
        stream.set_property("frame-retention", round(s.frame_retention_ms * 1000))
        # FIXED, or Aravis would shrink the buffer that we enlarge here to one frame when the first one comes
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", s.socket_buffer_bytes)
        warning = enlarge_receive_buffer(stream.get_port(), s.socket_buffer_bytes)
        self.warnings = (warning,) if warning else ()
        payload = self._camera.get_payload()
        for _ in range(s.buffers):
            stream.push_buffer(Aravis.Buffer.new_allocate(payload))
        return stream

    def _drain(self) -> None:
        """Give buffers that were filled before a pause back to the pool."""
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _frame(self, buffer: Any) -> Frame | None:
        if buffer.get_status() != self._Aravis.BufferStatus.SUCCESS:
            self.count("incomplete")
            return None
        try:
            image = to_image(buffer.get_data(), self._format, self._width, self._height)
        except ValueError:
            self.count("incomplete")
            return None
        arrival_ns = buffer.get_system_timestamp() or time.time_ns()
        if self._settings.stamp_source == "arrival":
            return Frame(image, arrival_ns, buffer.get_frame_id(), "host, at arrival")
        stamp_ns = self._clock.to_host_ns(buffer.get_timestamp(), arrival_ns)
        return Frame(image, stamp_ns, buffer.get_frame_id(), "camera, mapped onto the host")
