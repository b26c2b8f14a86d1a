"""A simulated GigE Vision camera on a loopback address, which clients open exactly as hardware."""

from __future__ import annotations

from collections import Counter

import numpy as np

from capture_rig.errors import InputError
from gige_vision.bootstrap import Capability

from .acquisition import SECOND_NS, Acquisition, CameraClock, TriggerWire
from .device import CameraSettings, Device, Faults
from .feature_table import CAPABILITIES, feature_table
from .gvcp_server import GvcpServer
from .imaging import ImagingPipeline
from .loop import EventLoop
from .registers import FILE_SPACE, XML_NAME, Registers, genicam_xml
from .scenes import CameraScene
from .stream import StreamChannel


class SimulatedCamera:
    """Serves a scene as a camera. start() powers it on, close() ends it for good; also a context manager.

    Several cameras of one process share an event loop (one thread) and a trigger wire; without them a camera has its
    own. ``faults`` can be changed while it runs; ``counters`` count events.
    Raises InputError from start() where the address is not free.
    """

    def __init__(
        self,
        address: str,
        scene: CameraScene,
        settings: CameraSettings | None = None,
        *,
        loop: EventLoop | None = None,
        wire: TriggerWire | None = None,
    ) -> None:
        self.address, self.scene, self.settings = address, scene, settings or CameraSettings()
        self.faults, self.counters = Faults(), Counter[str]()
        self._own_loop = loop is None
        self.loop = loop or EventLoop(f"camera {address}")
        self.wire = wire or TriggerWire(self.loop)
        self.wire.listen(self._line_rose)
        self._user_id = self.settings.user_id
        height, width, *channels = scene.shape
        self.features = feature_table(self.settings, address, width, height, bool(channels))
        self._powered: _PoweredCamera | None = None
        self._running = False

    def start(self) -> SimulatedCamera:
        if self._own_loop:
            self.loop.start()
        self._running = True
        try:
            self.power_on()
        except InputError:
            self.close()
            raise
        return self

    def close(self) -> None:
        if self._running:
            self._running = False
            self.power_off()
            if self._own_loop:
                self.loop.stop()

    def power_off(self) -> None:
        """Closes its sockets and loses its state, except for the user-defined name."""
        self.loop.call(self._power_off)

    def power_on(self) -> None:
        """Restarts: registers as after power-on, a new clock, nobody in control."""
        self.loop.call(self._power_on)

    @property
    def powered(self) -> bool:
        return self._powered is not None

    @property
    def registers(self) -> Registers:
        """The register memory. Only while the camera is powered."""
        assert self._powered is not None
        return self._powered.registers

    def status(self) -> dict[str, object]:
        """Returns its state, for people and for programs."""
        return self.loop.call(self._status)

    def __enter__(self) -> SimulatedCamera:
        return self.start()

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _power_on(self) -> None:
        if self._powered is None:
            self._powered = _PoweredCamera(self, self._user_id)

    def _power_off(self) -> None:
        if self._powered is not None:
            self._user_id = str(self._powered.registers["DeviceUserID"])
            self._powered.server.close()
            self._powered.stream.close()
            self._powered = None

    def _line_rose(self, instant_ns: int) -> None:
        if self._powered is not None and not self.faults.unplugged:
            self._powered.acquisition.trigger("Line1", instant_ns)

    def _status(self) -> dict[str, object]:
        status: dict[str, object] = {"address": self.address, "serial": self.settings.serial, "power": self.powered}
        if (powered := self._powered) is not None:
            owner, r, acquisition = powered.server.owner, powered.registers, powered.acquisition
            lateness_us = np.percentile(np.array(acquisition.lateness_ns or [0]) / 1e3, (50, 99, 100)).round(1).tolist()
            status |= {
                "user_id": r["DeviceUserID"],
                "controller": f"{owner[0]}:{owner[1]}" if owner else "",
                "streaming": acquisition.running and r["GevSCPHostPort"] != 0,
                "frame_rate": round(float(SECOND_NS / acquisition.period_ns), 3),
                "trigger": acquisition.source,
                "ptp": r.label("PtpStatus") if r["PtpEnable"] else "off",
                "late_us": dict(zip(("p50", "p99", "max"), lateness_us, strict=True)),
            }
        return status | {"faults": self.faults.active(), "counters": dict(self.counters)}


class _PoweredCamera:
    """The parts of a camera that live from power-on to power-off."""

    def __init__(self, camera: SimulatedCamera, user_id: str) -> None:
        description = genicam_xml(camera.features)
        self.registers = r = Registers(camera.features, description)
        device = Device(camera.address, camera.settings, r, camera.faults, camera.counters, camera.loop)
        r["FirstUrl"] = f"Local:{XML_NAME}.xml;{FILE_SPACE:X};{len(description):X}"
        r["DeviceUserID"] = user_id
        clock = CameraClock(camera.settings, camera.faults, camera.loop.clock)
        self.stream = StreamChannel(device)
        self.acquisition = Acquisition(device, camera.scene, clock, ImagingPipeline(device), self.stream)
        try:
            self.server = GvcpServer(device, self.acquisition, self.stream)
        except InputError:
            self.stream.close()
            raise

        def latch_time() -> None:
            stamp = clock.stamp(camera.loop.clock.now_ns())
            r["TimestampControl"], r["TimestampHigh"], r["TimestampLow"] = 0, stamp >> 32, stamp & 0xFFFF_FFFF

        without = CAPABILITIES & ~Capability.PACKET_RESEND
        r.reads["GvcpCapability"] = lambda: int(without if camera.faults.no_resend else CAPABILITIES)
        r.reads["PtpStatus"] = lambda: clock.ptp_state
        r.writes["PtpEnable"] = lambda: clock.enable_ptp(bool(r["PtpEnable"]))
        r.writes["TimestampControl"] = latch_time
