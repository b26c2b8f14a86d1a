"""Settings of one simulated camera: who it is, what it can do, how good its clock and its sensor are."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.settings import setting

SFNC, OLD = "sfnc", "old"


@dataclass(frozen=True)
class CameraSettings:
    """A simulated GigE Vision camera. What a client sets by feature is only the value after power-on here."""

    serial: str = setting("SIM00001", "Serial number, 15 bytes at most")
    user_id: str = setting("", "User-defined name at first power-on, 15 bytes at most")
    vendor: str = setting("Sagoma", "Vendor's name")
    model: str = setting("Studio", "Model's name")
    generation: str = setting(
        SFNC,
        "Names of the features: sfnc (today's), or old (ExposureTimeAbs, GainRaw, GevIEEE1588, ...)",
        choices=(SFNC, OLD),
    )
    frame_rate: float = setting(60.0, "Frame rate", unit="Hz", low=0.1, high=1000)
    exposure_us: float = setting(4000.0, "Exposure time", unit="us", low=10, high=1e6)
    nominal_exposure_us: float = setting(
        4000.0, "At this exposure and 0 dB the picture is as bright as the scene gives it", unit="us", low=10, high=1e6
    )
    pixel_format: str = setting("auto", "Pixel format; auto: Mono8, or BayerRG8 where the scene has colour")
    auto_functions: str = setting(
        "Off", "ExposureAuto, GainAuto and BalanceWhiteAuto", choices=("Off", "Once", "Continuous")
    )
    noise: float = setting(
        0.0, "Sensor noise added to every picture (standard deviation)", unit="grey levels", low=0, high=50
    )
    max_packet_size: int = setting(
        16000, "Largest stream packet, IP header included", unit="bytes", low=576, high=65500
    )
    resend_frames: int = setting(8, "Frames kept for resend requests", low=1, high=256)
    drift_ppm: float = setting(
        12.0, "How much faster the free-running clock is than UTC", unit="ppm", low=-1000, high=1000
    )
    ptp_grandmaster: bool = setting(True, "A PTP grandmaster is on the network")
    ptp_settle_s: float = setting(0.4, "Time from PtpEnable to status Slave", unit="s", low=0, high=600)
    ptp_offset_ns: int = setting(80, "Typical offset from the master once in step", unit="ns", low=0, high=10**9)
    tai_minus_utc_s: int = setting(37, "Leap seconds: PTP counts TAI", unit="s", low=0, high=100)
    boot_s: float = setting(0.5, "DeviceReset: time without an answer", unit="s", low=0, high=600)
    broadcast: bool = setting(False, "Also answer discoveries that are broadcast")
    seed: int = setting(1, "Of noise, clock offset and packet loss", low=0)
