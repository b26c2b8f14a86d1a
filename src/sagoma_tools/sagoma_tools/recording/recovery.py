"""Recovers bags whose writer was killed, whose disk was full, or whose bytes were damaged.

Such a bag has no index, or a wrong one: its mcap file is read record by record and copied into a new bag, up to where
it breaks off (mcap.dev/spec: one byte opcode, 64-bit length, body; chunks hold records). A chunk whose checksum does
not fit its bytes is left out; which of its messages are damaged cannot be told. Chunks may be compressed (zstd,
lz4), as by `ros2 bag record --storage-preset-profile zstd_fast`: of one that breaks off, the blocks before the break
are read.
"""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from zlib import crc32

from lz4.frame import LZ4FrameDecompressor
from rosbags.typesys import TypesysError

from capture_rig.errors import InputError
from capture_rig.files import copy_file

from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG, read_messages
from .writer import BagWriter

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4  # start, end, uncompressed size, checksum
MOST_CHUNK_BYTES = 1 << 28  # uncompressed: rosbag2 closes a chunk at a MiB, behind one message that may be larger
MESSAGE_HEAD_BYTES = 2 + 4 + 8 + 8  # channel, sequence, time logged, time sent
DECOMPRESSORS: dict[str, Any] = {"zstd": ZstdDecompressor, "lz4": LZ4FrameDecompressor}

Record = tuple[int, memoryview]


@dataclass
class Recovery:
    """What came of it: messages by topic; chunks left out because they are damaged; bytes behind the break, unread."""

    counts: dict[str, int] = field(default_factory=dict)
    damaged_chunks: int = 0
    unread_bytes: int = 0

    def __str__(self) -> str:
        """Return it in a sentence."""
        notes = [f"{self.damaged_chunks} damaged chunks (a second or less each) left out"] * (self.damaged_chunks > 0)
        notes += [f"{self.unread_bytes} bytes at the end cannot be read"] * (self.unread_bytes > 0)
        return "; ".join([f"{sum(self.counts.values())} messages recovered", *notes])


def recover_bag(bag: str | Path, target: str | Path) -> Recovery:
    """Copy every message that can still be read from ``bag`` into the new bag ``target``.

    Raises InputError for a bag that is whole, and for what is no mcap bag.
    """
    files = sorted(Path(bag).glob("*.mcap"))
    if len(files) != 1:
        what = f"holds {len(files) or 'no'} .mcap files" if Path(bag).is_dir() else "there is no such folder"
        raise InputError(what, where=str(bag), remedy="Give the folder that holds one .mcap file.")
    if _is_readable(bag):
        raise InputError("is complete", where=str(bag), remedy="It needs no recovery: it can be read as it is.")
    recovery = Recovery()
    with files[0].open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError("is no mcap file", where=str(files[0]), remedy="Nothing can be recovered from it.")
        with BagWriter(target) as writer:
            topics = _add_topics(_flat_records(file, str(files[0]), Recovery()), writer)
            _copy_messages(_flat_records(file, str(files[0]), recovery), topics, writer)
    recovery.counts = dict(writer.counts)
    for sidecar in (SIDECAR_RIG, SIDECAR_PROVENANCE):
        if (Path(bag) / sidecar).exists():
            copy_file(Path(bag) / sidecar, Path(target) / sidecar)
    return recovery


def _is_readable(bag: str | Path) -> bool:
    """Return whether every message can be read."""
    try:
        for _ in read_messages(bag):
            pass
    except InputError:
        return False
    return True


def _add_topics(records: Iterator[Record], writer: BagWriter) -> dict[int, str]:
    """Announce the topics that the file describes anywhere; return them by channel."""
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for opcode, body in records:
        try:
            if opcode == SCHEMA:
                types[struct.unpack_from("<H", body)[0]] = _text(body, 2)[0]
            elif opcode == CHANNEL:
                channel, schema = struct.unpack_from("<HH", body)
                writer.add_topic(_text(body, 4)[0], types[schema])
                topics[channel] = _text(body, 4)[0]
        except (struct.error, KeyError, UnicodeDecodeError, TypesysError):
            continue  # a damaged record; those behind it are read all the same
    return topics


def _copy_messages(records: Iterator[Record], topics: dict[int, str], writer: BagWriter) -> None:
    for opcode, body in records:
        if opcode == MESSAGE and len(body) >= MESSAGE_HEAD_BYTES:
            channel, _sequence, log_ns = struct.unpack_from("<HIQ", body)
            if channel in topics:
                writer.write(topics[channel], log_ns, bytes(body[MESSAGE_HEAD_BYTES:]))


def _flat_records(file: BinaryIO, where: str, recovery: Recovery) -> Iterator[Record]:
    """Yield the records of the file, those inside chunks included, up to where it breaks off."""
    size = os.fstat(file.fileno()).st_size
    file.seek(len(MAGIC))
    while len(head := file.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        body = memoryview(file.read(min(length, size - file.tell())))
        whole = len(body) == length
        if opcode == CHUNK:
            yield from _chunk_records(body, whole, where, recovery)
        elif whole:
            yield opcode, body
        if not whole:
            recovery.unread_bytes = len(body) if opcode != CHUNK else 0
            return


def _chunk_records(body: memoryview, whole: bool, where: str, recovery: Recovery) -> Iterator[Record]:
    """Yield the records of a chunk; of one that breaks off, those before the break."""
    try:
        compression, position = _text(body, CHUNK_HEAD_BYTES)
        (size, checksum) = struct.unpack_from("<QI", body, 16)
    except (struct.error, UnicodeDecodeError):
        recovery.damaged_chunks += 1
        return
    position += 8  # the length of what follows
    records = _decompressed(body[position:], compression, size, where)
    if whole and (len(records) != size or (checksum and crc32(records) != checksum)):
        recovery.damaged_chunks += 1
        return
    position = 0
    while position + 9 <= len(records):
        opcode, length = struct.unpack_from("<BQ", records, position)
        if position + 9 + length > len(records):
            return
        yield opcode, records[position + 9 : position + 9 + length]
        position += 9 + length


def _decompressed(data: memoryview, compression: str, size: int, where: str) -> memoryview:
    """Return what a chunk's bytes hold: where they break off, the whole blocks before; nothing where they are damaged.

    ``size`` : what the chunk claims to hold, and the most that is taken out of it. Raises InputError for a compression
    that mcap does not know.
    """
    if not compression:
        return data
    if compression not in DECOMPRESSORS:
        remedy = "Use the mcap command line's `mcap recover` for this bag."
        raise InputError(f"its chunks are compressed ({compression!r})", where=where, remedy=remedy)
    try:
        return memoryview(DECOMPRESSORS[compression]().decompress(bytes(data), min(size, MOST_CHUNK_BYTES)))
    except Exception:  # zstd has an error of its own, lz4 raises RuntimeError
        return memoryview(b"")


def _text(body: memoryview, position: int) -> tuple[str, int]:
    """Return a string with its 32-bit length before it, and the position behind it."""
    (length,) = struct.unpack_from("<I", body, position)
    start = position + 4
    return bytes(body[start : start + length]).decode(), start + length
