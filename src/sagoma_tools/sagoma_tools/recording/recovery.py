"""Recovers bags whose writer was killed, whose disk was full, or whose bytes were damaged.

Such a bag has no index, or a wrong one: its mcap file is read record by record and copied into a new bag, up to where
it breaks off (mcap.dev/spec: one byte opcode, 64-bit length, body; chunks hold records). A chunk that is cut, or whose
checksum does not fit its bytes, is left out whole; which of its messages are damaged cannot be told. Chunks may be
compressed (zstd, lz4), as by `ros2 bag record --storage-preset-profile zstd_fast`.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import UnsupportedCompressionError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from rosbags.typesys import TypesysError

from capture_rig.errors import InputError
from capture_rig.files import copy_file

from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG, read_messages
from .writer import BagWriter

HEAD = struct.Struct("<BQ")  # of a record: opcode, length
READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read}
COMPRESSIONS = ("", "zstd", "lz4")
MOST_CHUNK_BYTES = 1 << 28  # uncompressed: rosbag2 closes a chunk at a MiB, behind one message that may be larger


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
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise InputError("is no mcap file", where=str(files[0]), remedy="Nothing can be recovered from it.")
        with BagWriter(target) as writer:
            topics = _add_topics(_records(file, files[0], Recovery()), writer)
            for record in _records(file, files[0], recovery):
                if isinstance(record, Message) and record.channel_id in topics:
                    writer.write(topics[record.channel_id], record.log_time, record.data)
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


def _add_topics(records: Iterator[McapRecord], writer: BagWriter) -> dict[int, str]:
    """Announce the topics that the file describes anywhere; return them by channel."""
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for record in records:
        if isinstance(record, Schema):
            types[record.id] = record.name
        elif isinstance(record, Channel) and record.schema_id in types:
            try:
                writer.add_topic(record.topic, types[record.schema_id])
            except (TypesysError, KeyError):
                continue  # of a damaged record; those behind it are read all the same
            topics[record.id] = record.topic
    return topics


def _records(file: BinaryIO, where: Path, recovery: Recovery) -> Iterator[McapRecord]:
    """Yield the schemas, channels and messages of the file, those inside chunks included, up to where it breaks off.

    Raises InputError for chunks with a compression that mcap does not know.
    """
    size = os.fstat(file.fileno()).st_size
    file.seek(len(MCAP0_MAGIC))
    while len(head := file.read(HEAD.size)) == HEAD.size:
        opcode, length = HEAD.unpack(head)
        if length > size - file.tell():
            recovery.unread_bytes = size - file.tell()
            return
        try:
            yield from _parsed(opcode, file.read(length))
        except UnsupportedCompressionError as error:
            remedy = "Use the mcap command line's `mcap recover` for this bag."
            raise InputError(str(error), where=str(where), remedy=remedy) from None
        except Exception:  # zstd and lz4 have errors of their own, damaged numbers and texts raise others
            recovery.damaged_chunks += opcode == Opcode.CHUNK


def _parsed(opcode: int, body: bytes) -> list[McapRecord]:
    """Return what is of use of a record: of a chunk, the records in it."""
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(stream)
        if chunk.compression not in COMPRESSIONS:
            raise UnsupportedCompressionError(repr(chunk.compression))
        if chunk.uncompressed_size > MOST_CHUNK_BYTES:
            raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
        return breakup_chunk(chunk, validate_crc=True)
    if opcode in READERS:
        return [READERS[opcode](stream)]
    return [Message.read(stream, len(body))] if opcode == Opcode.MESSAGE else []
