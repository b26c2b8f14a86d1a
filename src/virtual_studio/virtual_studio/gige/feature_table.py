"""The features of a simulated camera, by today's names (GenICam SFNC) or those of an older generation."""

from __future__ import annotations

import dataclasses
import ipaddress

from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.bootstrap import Capability
from gige_vision.gvsp import PixelFormat

from .device import OLD, CameraSettings
from .registers import Feature, boolean, choice, command, hidden, integer, placed, real, text

MAX_BINNING = 4
MAX_GAIN_DB = 24.0
RAW_GAINS = 240
"""Steps of the older generation's GainRaw up to MAX_GAIN_DB."""
MONO_FORMATS = ("Mono8", "Mono10", "Mono10p", "Mono10Packed", "Mono12", "Mono12p", "Mono12Packed")
COLOUR_FORMATS = ("BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8", "RGB8", "BGR8", "YUV422_8")
OFF, ON = 0, 1
TICKS_PER_SECOND = 1_000_000_000
PTP_STATES = {
    "Initializing": 1, "Faulty": 2, "Disabled": 3, "Listening": 4, "PreMaster": 5, "Master": 6, "Passive": 7,
    "Uncalibrated": 8, "Slave": 9,
}  # fmt: skip
"""Port states of IEEE 1588-2008, table 8."""
TRIGGER_SOURCES = {"Software": 0, "Line1": 1, "Action1": 2, "PeriodicSignal1": 3}
AUTO = {"Off": 0, "Once": 1, "Continuous": 2}
CHUNKS = {"Timestamp": 0x0A01, "ExposureTime": 0x0A02}
IMAGE_CHUNK = 0x0A00
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

OLD_NAMES = {
    "ExposureTime": "ExposureTimeAbs",
    "Gain": "GainRaw",
    "AcquisitionFrameRate": "AcquisitionFrameRateAbs",
    "ResultingFrameRate": "ResultingFrameRateAbs",
    "TriggerDelay": "TriggerDelayAbs",
    "DeviceTemperature": "TemperatureAbs",
    "DeviceSerialNumber": "DeviceID",
    "PtpEnable": "GevIEEE1588",
    "PtpStatus": "GevIEEE1588Status",
    "PtpDataSetLatch": "GevIEEE1588DataSetLatch",
    "SyncFreeRunTimerTriggerRate": "SyncFreeRunTimerTriggerRateAbs",
}


def feature_table(settings: CameraSettings, address: str, width: int, height: int, colour: bool) -> tuple[Feature, ...]:
    """Lists every feature and register of a camera with a sensor of width x height pixels.

    Raises InputError for a pixel format that such a camera does not offer.
    """
    known = ("auto", *MONO_FORMATS, *(COLOUR_FORMATS if colour else ()))
    if settings.pixel_format not in known:
        problem = f"pixel_format = {settings.pixel_format!r} is not offered"
        raise InputError(problem, where=f"camera {address}", remedy=f"Choose one of {', '.join(known)}.")
    features = [
        *_bootstrap(settings, address),
        *_device(settings),
        *_image(settings, width, height, colour),
        *_acquisition(settings),
        *_triggers(),
        *_analog(settings, colour),
        *_time(),
        *_actions(),
        *_chunks(),
        *_transport(settings),
    ]
    if settings.generation == OLD:
        features = [_older_generation(feature) for feature in features]
    return placed(features)


def _bootstrap(s: CameraSettings, address: str) -> list[Feature]:
    ip = int(ipaddress.IPv4Address(address))
    return [
        hidden("Version", bootstrap.VERSION, bootstrap.VERSION_2_0),
        hidden("DeviceMode", bootstrap.DEVICE_MODE, bootstrap.BIG_ENDIAN_UTF8),
        hidden("MacHigh", bootstrap.MAC_HIGH, 0x0000_0200),  # a locally administered address
        hidden("MacLow", bootstrap.MAC_LOW, ip),
        hidden("IpCapabilities", bootstrap.IP_CAPABILITIES, 0x7),
        hidden("IpConfiguration", bootstrap.IP_CONFIGURATION, 0x1),
        hidden("CurrentIp", bootstrap.CURRENT_IP, ip),
        hidden("CurrentSubnet", bootstrap.CURRENT_SUBNET, 0xFF00_0000),
        hidden("CurrentGateway", bootstrap.CURRENT_GATEWAY, 0),
        hidden("ManufacturerInfo", bootstrap.MANUFACTURER_INFO, "simulated", 48),
        hidden("FirstUrl", bootstrap.FIRST_URL, "", bootstrap.URL_SIZE),
        hidden("SecondUrl", bootstrap.SECOND_URL, "", bootstrap.URL_SIZE),
        hidden("InterfaceCount", bootstrap.INTERFACE_COUNT, 1),
        hidden("MessageChannelCount", bootstrap.MESSAGE_CHANNEL_COUNT, 0),
        hidden("StreamChannelCount", bootstrap.STREAM_CHANNEL_COUNT, 1),
        hidden("ActionSignalCount", bootstrap.ACTION_SIGNAL_COUNT, 1),
        hidden("StreamCapability", bootstrap.STREAM_CAPABILITY, 0),
        hidden("MessageCapability", bootstrap.MESSAGE_CAPABILITY, 0),
        hidden("GvcpCapability", bootstrap.GVCP_CAPABILITY, int(CAPABILITIES)),
        hidden("TickFrequencyHigh", bootstrap.TICK_FREQUENCY_HIGH, 0),
        hidden("TickFrequencyLow", bootstrap.TICK_FREQUENCY_LOW, TICKS_PER_SECOND),
        hidden("TimestampControl", bootstrap.TIMESTAMP_CONTROL, writable=True),
        hidden("TimestampHigh", bootstrap.TIMESTAMP_HIGH),
        hidden("TimestampLow", bootstrap.TIMESTAMP_LOW),
        hidden("GvcpConfiguration", bootstrap.GVCP_CONFIGURATION, writable=True),
        hidden("ControlPrivilege", bootstrap.CONTROL_PRIVILEGE, writable=True),
        hidden("PrimaryPort", bootstrap.PRIMARY_PORT),
        hidden("PrimaryAddress", bootstrap.PRIMARY_ADDRESS),
        hidden("StreamCapabilities", bootstrap.STREAM_CHANNEL_CAPABILITY, 0),
        hidden("PacketSizeWord", bootstrap.STREAM_PACKET_SIZE, min(1500, s.max_packet_size), writable=True),
    ]


def _device(s: CameraSettings) -> list[Feature]:
    where = "DeviceControl"
    return [
        text("DeviceVendorName", where, s.vendor, 32, address=bootstrap.MANUFACTURER_NAME, writable=False),
        text("DeviceModelName", where, s.model, 32, address=bootstrap.MODEL_NAME, writable=False),
        text("DeviceVersion", where, "1.0", 32, address=bootstrap.DEVICE_VERSION, writable=False),
        text("DeviceSerialNumber", where, s.serial, 16, address=bootstrap.SERIAL_NUMBER, writable=False),
        text("DeviceUserID", where, s.user_id, 16, address=bootstrap.USER_NAME),
        real("DeviceTemperature", where, 42.0, writable=False, unit="C"),
    ]


def _image(s: CameraSettings, width: int, height: int, colour: bool) -> list[Feature]:
    where = "ImageFormatControl"
    names = (*COLOUR_FORMATS, *MONO_FORMATS) if colour else MONO_FORMATS
    formats = {name: int(PixelFormat[name]) for name in names}
    default = names[0] if s.pixel_format == "auto" else s.pixel_format
    return [
        integer("SensorWidth", where, width, writable=False),
        integer("SensorHeight", where, height, writable=False),
        integer("WidthMax", where, width, writable=False, volatile=True),
        integer("HeightMax", where, height, writable=False, volatile=True),
        integer("Width", where, width, low=16, high_key="WidthLimit", step=4),
        integer("Height", where, height, low=16, high_key="HeightLimit", step=2),
        integer("OffsetX", where, 0, low=0, high_key="OffsetXLimit", step=4),
        integer("OffsetY", where, 0, low=0, high_key="OffsetYLimit", step=2),
        *(
            integer(f"{key}Limit", "", writable=False, volatile=True)
            for key in ("Width", "Height", "OffsetX", "OffsetY")
        ),
        integer("BinningHorizontal", where, 1, low=1, high=MAX_BINNING),
        integer("BinningVertical", where, 1, low=1, high=MAX_BINNING),
        choice("PixelFormat", where, formats, default),
    ]


def _acquisition(s: CameraSettings) -> list[Feature]:
    where = "AcquisitionControl"
    return [
        choice("AcquisitionMode", where, {"Continuous": 0}),
        command("AcquisitionStart", where),
        command("AcquisitionStop", where),
        boolean("AcquisitionFrameRateEnable", where, 1),
        real("AcquisitionFrameRate", where, s.frame_rate, low=0.1, high=1000.0, unit="Hz"),
        real("ResultingFrameRate", where, s.frame_rate, writable=False, volatile=True, unit="Hz"),
        choice("ExposureMode", where, {"Timed": 1}),
        real("ExposureTime", where, s.exposure_us, low=10.0, high=1e6, unit="us"),
        choice("ExposureAuto", where, AUTO, s.auto_functions),
    ]


def _triggers() -> list[Feature]:
    where = "AcquisitionControl"
    return [
        choice("TriggerSelector", where, {"FrameStart": 0}),
        choice("TriggerMode", where, {"Off": OFF, "On": ON}),
        choice("TriggerSource", where, TRIGGER_SOURCES),
        choice("TriggerActivation", where, {"RisingEdge": 0, "FallingEdge": 1}),
        real("TriggerDelay", where, 0.0, low=0.0, high=1e6, unit="us"),
        command("TriggerSoftware", where),
        boolean("SyncFreeRunTimerEnable", where),
        integer("SyncFreeRunTimerStartTimeLow", where, low=0, high=0xFFFF_FFFF),
        integer("SyncFreeRunTimerStartTimeHigh", where, low=0, high=0xFFFF_FFFF),
        real("SyncFreeRunTimerTriggerRate", where, 30.0, low=0.1, high=1000.0, unit="Hz"),
        command("SyncFreeRunTimerUpdate", where),
        real("BslPeriodicSignalPeriod", where, 33333.0, low=1000.0, high=1e7, unit="us"),
        real("BslPeriodicSignalDelay", where, 0.0, low=0.0, high=1e7, unit="us"),
    ]


def _analog(s: CameraSettings, colour: bool) -> list[Feature]:
    where = "AnalogControl"
    white = [choice("BalanceWhiteAuto", where, AUTO, s.auto_functions)] if colour else []
    return [
        real("Gain", where, 0.0, low=0.0, high=MAX_GAIN_DB, unit="dB"),
        choice("GainAuto", where, AUTO, s.auto_functions),
        *white,
    ]


def _time() -> list[Feature]:
    where = "TransportLayerControl"
    return [
        boolean("PtpEnable", where),
        choice("PtpStatus", where, PTP_STATES, "Disabled", writable=False, volatile=True),
        command("PtpDataSetLatch", where),
    ]


def _actions() -> list[Feature]:
    where = "ActionControl"
    return [
        integer("ActionDeviceKey", where, address=bootstrap.ACTION_DEVICE_KEY, low=0, high=0xFFFF_FFFF),
        integer("ActionSelector", where, 1, low=1, high=1),
        integer("ActionGroupKey", where, address=bootstrap.ACTION_GROUP_KEY, low=0, high=0xFFFF_FFFF),
        integer("ActionGroupMask", where, address=bootstrap.ACTION_GROUP_MASK, low=0, high=0xFFFF_FFFF),
    ]


def _chunks() -> list[Feature]:
    where = "ChunkDataControl"
    return [
        boolean("ChunkModeActive", where),
        choice("ChunkSelector", where, {name: number for number, name in enumerate(CHUNKS)}),
        boolean("ChunkEnable", where, volatile=True),
        integer("ChunkTimestamp", where, length=8, writable=False, chunk=CHUNKS["Timestamp"], unit="ns"),
        real("ChunkExposureTime", where, writable=False, chunk=CHUNKS["ExposureTime"], unit="us"),
    ]


def _transport(s: CameraSettings) -> list[Feature]:
    where, packet_size = "TransportLayerControl", bootstrap.STREAM_PACKET_SIZE
    return [
        integer("PayloadSize", where, 0, writable=False, volatile=True, unit="B"),
        integer("GevSCPSPacketSize", where, bits=(0, 15), low=576, high=s.max_packet_size, step=4, address=packet_size),
        boolean("GevSCPSDoNotFragment", where, bits=(30, 30), address=packet_size),
        command("GevSCPSFireTestPacket", where, bits=(31, 31), address=packet_size),
        integer("GevSCPD", where, address=bootstrap.STREAM_PACKET_DELAY, low=0, high=10_000_000, unit="ticks"),
        integer("GevSCPHostPort", where, address=bootstrap.STREAM_PORT, low=0, high=0xFFFF_FFFF),
        integer("GevSCDA", where, address=bootstrap.STREAM_DESTINATION, low=0, high=0xFFFF_FFFF),
        integer("GevSCSP", where, address=bootstrap.STREAM_SOURCE_PORT, writable=False),
        integer(
            "GevHeartbeatTimeout", where, 3000, address=bootstrap.HEARTBEAT_TIMEOUT_MS, low=300, high=600_000, unit="ms"
        ),
        integer("GevTimestampTickFrequency", where, TICKS_PER_SECOND, length=8, writable=False, unit="Hz"),
    ]


def _older_generation(feature: Feature) -> Feature:
    if feature.key == "Gain":
        return dataclasses.replace(integer("Gain", feature.category, 0, low=0, high=RAW_GAINS), name="GainRaw")
    return dataclasses.replace(feature, name=OLD_NAMES.get(feature.name, feature.name))
