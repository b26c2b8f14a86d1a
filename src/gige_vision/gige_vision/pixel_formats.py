"""Pixel formats: their names and codes (EMVA Pixel Format Naming Convention) and how many bytes an image has.

Bits 16 to 23 of a code are the bits that a pixel occupies. The ``p`` formats are one long number, the first pixel in
its lowest bits. The ``Packed`` formats are those of GigE Vision: two pixels in three bytes, the first byte the upper
eight bits of the first pixel, the third those of the second, the one between the lower bits of both (the first pixel's
in its lower half).
"""

from __future__ import annotations

from enum import IntEnum


class PixelFormat(IntEnum):
    """Codes by their standard names."""

    Mono8 = 0x01080001
    Mono10 = 0x01100003
    Mono10p = 0x010A0046
    Mono10Packed = 0x010C0004
    Mono12 = 0x01100005
    Mono12p = 0x010C0047
    Mono12Packed = 0x010C0006
    BayerGR8 = 0x01080008
    BayerRG8 = 0x01080009
    BayerGB8 = 0x0108000A
    BayerBG8 = 0x0108000B
    RGB8 = 0x02180014
    BGR8 = 0x02180015
    YUV422_8_UYVY = 0x0210001F
    YUV422_8 = 0x02100032

    @property
    def bits_per_pixel(self) -> int:
        """Bits that a pixel occupies on the wire."""
        return self >> 16 & 0xFF

    @property
    def depth(self) -> int:
        """Bits of a grey level or colour channel."""
        return 10 if self.name.startswith("Mono10") else 12 if self.name.startswith("Mono12") else 8

    @property
    def is_colour(self) -> bool:
        return not self.name.startswith("Mono")

    @property
    def is_bayer(self) -> bool:
        return self.name.startswith("Bayer")

    @property
    def is_packed(self) -> bool:
        return self.name.endswith("Packed")

    def image_bytes(self, width: int, height: int) -> int:
        """Bytes of an image of so many pixels; a last odd pixel of a packed format takes two bytes."""
        return -(-self.bits_per_pixel * width * height // 8)
