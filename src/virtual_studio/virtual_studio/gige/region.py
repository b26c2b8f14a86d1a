"""The image's region, binning and size in bytes: features that depend on each other."""

from __future__ import annotations

from gige_vision.gvsp import encode_chunk
from gige_vision.pixel_formats import PixelFormat

from .feature_table import CHUNKS
from .registers import Registers

_AXES = (
    ("SensorWidth", "BinningHorizontal", "WidthMax", "Width", "OffsetX"),
    ("SensorHeight", "BinningVertical", "HeightMax", "Height", "OffsetY"),
)
_STEP = 4
_CHUNK_BYTES = len(encode_chunk(0, bytes(8)))


class Region:
    """Keeps limits and payload size true whenever region, binning, format or chunks change."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self.enabled_chunks: set[str] = set()
        for key in (
            "Width",
            "Height",
            "OffsetX",
            "OffsetY",
            "BinningHorizontal",
            "BinningVertical",
            "PixelFormat",
            "ChunkModeActive",
        ):
            registers.writes[key] = self.refresh
        registers.reads["ChunkEnable"] = lambda: int(registers.label("ChunkSelector") in self.enabled_chunks)
        registers.writes["ChunkEnable"] = self._chunk_written
        self.refresh()

    def reset(self) -> None:
        """As after power-on."""
        self.enabled_chunks.clear()
        self.refresh()

    def refresh(self) -> None:
        """Make the dependent registers anew; a region that binning made too large is cut."""
        r = self._registers
        for sensor, binning, largest, size, offset in _AXES:
            most = r.integer(sensor) // r.integer(binning)
            r[largest] = most
            r[size] = min(r.integer(size), most - most % _STEP)
            r[offset] = min(r.integer(offset), most - r.integer(size))
            r[f"{size}Limit"] = most - r.integer(offset)
            r[f"{offset}Limit"] = most - r.integer(size)
        r["PayloadSize"] = self.image_bytes + self.chunk_bytes

    @property
    def pixel_format(self) -> PixelFormat:
        return PixelFormat(self._registers.integer("PixelFormat"))

    @property
    def image_bytes(self) -> int:
        return self.pixel_format.image_bytes(self._registers.integer("Width"), self._registers.integer("Height"))

    @property
    def chunks(self) -> tuple[str, ...]:
        """The chunks that follow each image."""
        if not self._registers.integer("ChunkModeActive"):
            return ()
        return tuple(name for name in CHUNKS if name in self.enabled_chunks)

    @property
    def chunk_bytes(self) -> int:
        """Bytes behind the image: its own chunk's tail, and the chunks."""
        if not self._registers.integer("ChunkModeActive"):
            return 0
        return len(encode_chunk(0, b"")) + _CHUNK_BYTES * len(self.chunks)

    def _chunk_written(self) -> None:
        name = self._registers.label("ChunkSelector")
        if self._registers.integer("ChunkEnable"):
            self.enabled_chunks.add(name)
        else:
            self.enabled_chunks.discard(name)
        self.refresh()
