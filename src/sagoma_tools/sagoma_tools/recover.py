"""Recovers a bag whose writer was killed: its mcap file has no index, and its folder no metadata.yaml.

What had reached the disk (all but the last megabyte or so) is read record by record and written into a new bag.
Format: mcap.dev/spec (a record is one byte opcode, 64-bit length, body; chunks hold records).
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from capture_rig.errors import InputError

from .bag_writer import BagWriter
from .bags import SIDECAR_PROVENANCE, SIDECAR_RIG

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4  # start, end, uncompressed size, checksum

Record = tuple[int, memoryview]


def recover_bag(bag: str | Path, target: str | Path) -> dict[str, int]:
    """Copy every message that can still be read from ``bag`` into the new bag ``target``; messages by topic."""
    files = sorted(Path(bag).glob("*.mcap"))
    if len(files) != 1:
        raise InputError(f"holds {len(files)} mcap files", where=str(bag), remedy="Give the folder of one mcap bag.")
    if (Path(bag) / "metadata.yaml").exists():
        raise InputError("is complete", where=str(bag), remedy="It needs no recovery: metadata.yaml is there.")
    with files[0].open("rb") as file, BagWriter(target) as writer:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError("is no mcap file", where=str(files[0]), remedy="Nothing can be recovered from it.")
        _copy(_flat_records(file, str(files[0])), writer)
    for sidecar in (SIDECAR_RIG, SIDECAR_PROVENANCE):
        if (Path(bag) / sidecar).exists():
            shutil.copyfile(Path(bag) / sidecar, Path(target) / sidecar)
    return dict(writer.counts)


def _copy(records: Iterator[Record], writer: BagWriter) -> None:
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for opcode, body in records:
        if opcode == SCHEMA:
            types[struct.unpack_from("<H", body)[0]] = _text(body, 2)[0]
        elif opcode == CHANNEL:
            channel, schema = struct.unpack_from("<HH", body)
            topics[channel] = _text(body, 4)[0]
            writer.add_topic(topics[channel], types[schema])
        elif opcode == MESSAGE:
            channel, _sequence, log_ns = struct.unpack_from("<HIQ", body)
            writer.write(topics[channel], log_ns, bytes(body[22:]))


def _flat_records(file: BinaryIO, where: str) -> Iterator[Record]:
    """The records of the file, those inside chunks included, up to where it breaks off."""
    while (record := _read_record(file)) is not None:
        if record[0] == CHUNK:
            yield from _chunk_records(record[1], where)
        else:
            yield record


def _read_record(file: BinaryIO) -> Record | None:
    head = file.read(9)
    if len(head) < 9:
        return None
    opcode, length = struct.unpack("<BQ", head)
    body = file.read(length)
    return (opcode, memoryview(body)) if len(body) == length else None


def _chunk_records(body: memoryview, where: str) -> Iterator[Record]:
    compression, position = _text(body, CHUNK_HEAD_BYTES)
    if compression:
        raise InputError(
            f"its chunks are compressed ({compression})",
            where=where,
            remedy="Use the mcap command line's `mcap recover` for this bag.",
        )
    position += 8  # the length of what follows
    while position < len(body):
        opcode, length = struct.unpack_from("<BQ", body, position)
        yield opcode, body[position + 9 : position + 9 + length]
        position += 9 + length


def _text(body: memoryview, position: int) -> tuple[str, int]:
    """A string with its 32-bit length before it, and the position behind it."""
    (length,) = struct.unpack_from("<I", body, position)
    start = position + 4
    return bytes(body[start : start + length]).decode(), start + length
