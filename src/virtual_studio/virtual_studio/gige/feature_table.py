"""The features and registers of a simulated camera, by category of the GenICam SFNC."""

from __future__ import annotations

import dataclasses
import ipaddress

from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.bootstrap import Capability
from gige_vision.gvsp import PixelFormat

from .device import CameraSettings
from .registers import MODEL, VENDOR, Feature, boolean, choice, command, hidden, integer, placed, real, text

TICKS_PER_SECOND = 1_000_000_000
WORD = 0xFFFF_FFFF
PTP_STATES = {
    "Initializing": 1, "Faulty": 2, "Disabled": 3, "Listening": 4, "PreMaster": 5, "Master": 6, "Passive": 7,
    "Uncalibrated": 8, "Slave": 9,
}  # fmt: skip
"""Port states of IEEE 1588-2008, table 8."""
TRIGGER_SOURCES = {"Software": 0, "Line1": 1, "Action1": 2, "PeriodicSignal1": 3}
AUTO = {"Off": 0, "Once": 1, "Continuous": 2}
CAPABILITIES = (
    Capability.CONCATENATION
    | Capability.WRITE_MEMORY
    | Capability.PACKET_RESEND
    | Capability.ACTION
    | Capability.SCHEDULED_ACTION
    | Capability.PTP
    | Capability.EXTENDED_STATUS
    | Capability.PRIMARY_APPLICATION
    | Capability.SERIAL_NUMBER
    | Capability.USER_NAME
)


def feature_table(settings: CameraSettings, address: str, width: int, height: int, colour: bool) -> tuple[Feature, ...]:
    """List every feature and register of a camera with a sensor of width x height pixels.

    Raises InputError for a pixel format that such a camera does not offer.
    """
    s, ip = settings, int(ipaddress.IPv4Address(address))
    formats = ("BayerRG8", "Mono8") if colour else ("Mono8",)
    if s.pixel_format not in ("auto", *formats):
        remedy = f"Choose one of auto, {', '.join(formats)}."
        raise InputError(f"pixel_format = {s.pixel_format!r} is not offered", where=f"camera {address}", remedy=remedy)
    codes = {name: int(PixelFormat[name]) for name in formats}
    table = {
        "": _bootstrap_registers(s, ip),
        "DeviceControl": [
            text("DeviceVendorName", VENDOR, 32, bootstrap.MANUFACTURER_NAME, writable=False),
            text("DeviceModelName", MODEL, 32, bootstrap.MODEL_NAME, writable=False),
            text("DeviceVersion", "1.0", 32, bootstrap.DEVICE_VERSION, writable=False),
            text("DeviceSerialNumber", s.serial, 16, bootstrap.SERIAL_NUMBER, writable=False),
            text("DeviceUserID", s.user_id, 16, bootstrap.USER_NAME),
            real("DeviceTemperature", 42.0, writable=False, unit="C"),
        ],
        "ImageFormatControl": [
            integer("SensorWidth", width, writable=False),
            integer("SensorHeight", height, writable=False),
            integer("WidthMax", width, writable=False, volatile=True),
            integer("HeightMax", height, writable=False, volatile=True),
            integer("Width", width, low=16, high_of="WidthMax", step=4),
            integer("Height", height, low=16, high_of="HeightMax", step=2),
            integer("OffsetX", low=0, high_of="WidthMax", step=4),
            integer("OffsetY", low=0, high_of="HeightMax", step=2),
            integer("BinningHorizontal", 1, low=1, high=4),
            integer("BinningVertical", 1, low=1, high=4),
            choice("PixelFormat", codes, formats[0] if s.pixel_format == "auto" else s.pixel_format),
        ],
        "AcquisitionControl": [
            choice("AcquisitionMode", {"Continuous": 0}),
            command("AcquisitionStart"),
            command("AcquisitionStop"),
            boolean("AcquisitionFrameRateEnable", 1),
            real("AcquisitionFrameRate", s.frame_rate, low=0.1, high=1000.0, unit="Hz"),
            real("ResultingFrameRate", s.frame_rate, writable=False, volatile=True, unit="Hz"),
            choice("ExposureMode", {"Timed": 1}),
            real("ExposureTime", s.exposure_us, low=10.0, high=1e6, unit="us"),
            choice("ExposureAuto", AUTO),
            choice("TriggerSelector", {"FrameStart": 0}),
            choice("TriggerMode", {"Off": 0, "On": 1}),
            choice("TriggerSource", TRIGGER_SOURCES),
            choice("TriggerActivation", {"RisingEdge": 0, "FallingEdge": 1}),
            real("TriggerDelay", low=0.0, high=1e6, unit="us"),
            command("TriggerSoftware"),
            real("BslPeriodicSignalPeriod", 33333.0, low=1000.0, high=1e7, unit="us"),
        ],
        "AnalogControl": [
            real("Gain", low=0.0, high=24.0, unit="dB"),
            choice("GainAuto", AUTO),
            *([choice("BalanceWhiteAuto", AUTO)] if colour else []),
        ],
        "ActionControl": [
            integer("ActionDeviceKey", address=bootstrap.ACTION_DEVICE_KEY, low=0, high=WORD),
            integer("ActionSelector", 1, low=1, high=1),
            integer("ActionGroupKey", address=bootstrap.ACTION_GROUP_KEY, low=0, high=WORD),
            integer("ActionGroupMask", address=bootstrap.ACTION_GROUP_MASK, low=0, high=WORD),
        ],
        "TransportLayerControl": [
            boolean("PtpEnable"),
            choice("PtpStatus", PTP_STATES, "Disabled", writable=False, volatile=True),
            command("PtpDataSetLatch"),
            integer("PayloadSize", writable=False, volatile=True, unit="B"),
            integer(
                "GevSCPSPacketSize",
                bits=(0, 15),
                low=576,
                high=s.max_packet_size,
                step=4,
                address=bootstrap.STREAM_PACKET_SIZE,
            ),
            boolean("GevSCPSDoNotFragment", bits=(30, 30), address=bootstrap.STREAM_PACKET_SIZE),
            command("GevSCPSFireTestPacket", bits=(31, 31), address=bootstrap.STREAM_PACKET_SIZE),
            integer("GevSCPD", address=bootstrap.STREAM_PACKET_DELAY, low=0, high=10_000_000, unit="ticks"),
            integer("GevSCPHostPort", address=bootstrap.STREAM_PORT, low=0, high=WORD),
            integer("GevSCDA", address=bootstrap.STREAM_DESTINATION, low=0, high=WORD),
            integer("GevSCSP", address=bootstrap.STREAM_SOURCE_PORT, writable=False),
            integer(
                "GevHeartbeatTimeout", 3000, address=bootstrap.HEARTBEAT_TIMEOUT_MS, low=300, high=600_000, unit="ms"
            ),
            integer("GevTimestampTickFrequency", TICKS_PER_SECOND, length=8, writable=False, unit="Hz"),
        ],
    }
    rows = [dataclasses.replace(row, category=category) for category, rows in table.items() for row in rows]
    return placed(rows)


def _bootstrap_registers(settings: CameraSettings, ip: int) -> list[Feature]:
    """List the bootstrap registers of GigE Vision that no feature of the SFNC names."""
    return [
        hidden("Version", bootstrap.VERSION, bootstrap.VERSION_2_0),
        hidden("DeviceMode", bootstrap.DEVICE_MODE, bootstrap.BIG_ENDIAN_UTF8),
        hidden("MacHigh", bootstrap.MAC_HIGH, 0x0000_0200),  # a locally administered address
        hidden("MacLow", bootstrap.MAC_LOW, ip),
        hidden("IpCapabilities", bootstrap.IP_CAPABILITIES, 0x7),
        hidden("IpConfiguration", bootstrap.IP_CONFIGURATION, 0x1),
        hidden("CurrentIp", bootstrap.CURRENT_IP, ip),
        hidden("CurrentSubnet", bootstrap.CURRENT_SUBNET, 0xFF00_0000),
        hidden("FirstUrl", bootstrap.FIRST_URL, "", bootstrap.URL_SIZE),
        hidden("InterfaceCount", bootstrap.INTERFACE_COUNT, 1),
        hidden("StreamChannelCount", bootstrap.STREAM_CHANNEL_COUNT, 1),
        hidden("ActionSignalCount", bootstrap.ACTION_SIGNAL_COUNT, 1),
        hidden("GvcpCapability", bootstrap.GVCP_CAPABILITY, int(CAPABILITIES)),
        hidden("TickFrequencyLow", bootstrap.TICK_FREQUENCY_LOW, TICKS_PER_SECOND),
        hidden("TimestampControl", bootstrap.TIMESTAMP_CONTROL, writable=True),
        hidden("TimestampHigh", bootstrap.TIMESTAMP_HIGH),
        hidden("TimestampLow", bootstrap.TIMESTAMP_LOW),
        hidden("GvcpConfiguration", bootstrap.GVCP_CONFIGURATION, writable=True),
        hidden("ControlPrivilege", bootstrap.CONTROL_PRIVILEGE, writable=True),
        hidden("PrimaryPort", bootstrap.PRIMARY_PORT),
        hidden("PrimaryAddress", bootstrap.PRIMARY_ADDRESS),
        hidden("PacketSizeWord", bootstrap.STREAM_PACKET_SIZE, min(1500, settings.max_packet_size), writable=True),
    ]
