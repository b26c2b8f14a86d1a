"""The answer to DISCOVERY: the first 0xF8 bytes of a device's bootstrap registers."""

from __future__ import annotations

import ipaddress
import struct
from dataclasses import dataclass

from . import bootstrap
from .gvcp import MalformedPacket

_TEXTS = {
    "manufacturer": (bootstrap.MANUFACTURER_NAME, 32),
    "model": (bootstrap.MODEL_NAME, 32),
    "device_version": (bootstrap.DEVICE_VERSION, 32),
    "manufacturer_info": (bootstrap.MANUFACTURER_INFO, 48),
    "serial": (bootstrap.SERIAL_NUMBER, 16),
    "user_id": (bootstrap.USER_NAME, 16),
}
_ADDRESSES = {
    "address": bootstrap.CURRENT_IP,
    "subnet_mask": bootstrap.CURRENT_SUBNET,
    "gateway": bootstrap.CURRENT_GATEWAY,
}


@dataclass(frozen=True)
class DeviceRecord:
    """Who a device is. Texts are UTF-8, cut to the room the standard gives (serial and user id: 16 bytes)."""

    address: str
    manufacturer: str = ""
    model: str = ""
    device_version: str = ""
    manufacturer_info: str = ""
    serial: str = ""
    user_id: str = ""
    mac: bytes = bytes(6)
    subnet_mask: str = "255.0.0.0"
    gateway: str = "0.0.0.0"

    def encode(self) -> bytes:
        """The 0xF8 bytes of the acknowledge."""
        record = bytearray(bootstrap.DISCOVERY_SIZE)
        struct.pack_into(">II", record, bootstrap.VERSION, bootstrap.VERSION_2_0, bootstrap.BIG_ENDIAN_UTF8)
        record[bootstrap.MAC_HIGH + 2 : bootstrap.MAC_HIGH + 8] = self.mac
        struct.pack_into(">II", record, bootstrap.IP_CAPABILITIES, 0x7, 0x1)  # persistent, DHCP, link-local; persistent
        for name, offset in _ADDRESSES.items():
            record[offset : offset + 4] = ipaddress.IPv4Address(getattr(self, name)).packed
        for name, (offset, size) in _TEXTS.items():
            record[offset : offset + size] = encode_text(getattr(self, name), size)
        return bytes(record)

    @classmethod
    def decode(cls, record: bytes) -> DeviceRecord:
        """Raises MalformedPacket when the record is too short or its texts are not UTF-8."""
        if len(record) < bootstrap.DISCOVERY_SIZE:
            raise MalformedPacket(f"{len(record)} bytes are no discovery record")
        texts = {name: decode_text(record[offset : offset + size]) for name, (offset, size) in _TEXTS.items()}
        addresses = {
            name: str(ipaddress.IPv4Address(record[offset : offset + 4])) for name, offset in _ADDRESSES.items()
        }
        return cls(**texts, **addresses, mac=bytes(record[bootstrap.MAC_HIGH + 2 : bootstrap.MAC_HIGH + 8]))


def encode_text(text: str, size: int) -> bytes:
    """UTF-8, zero-terminated, padded to ``size`` bytes; cut at a character where it is too long."""
    data = text.encode()
    if len(data) >= size:
        data = data[: size - 1].decode(errors="ignore").encode()
    return data.ljust(size, b"\0")


def decode_text(data: bytes) -> str:
    """The text up to the first zero. Raises MalformedPacket when it is not UTF-8."""
    try:
        return bytes(data).split(b"\0", 1)[0].decode()
    except UnicodeDecodeError as error:
        raise MalformedPacket(f"a text of the device is not UTF-8 ({error})") from None
