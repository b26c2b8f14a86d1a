"""Recovers bags whose writer was killed, whose disk was full, or whose bytes were damaged.

Such a bag has no index, or a wrong one: its mcap file is read record by record and copied into a new bag, up to where
it breaks off. A chunk that is cut, or whose checksum does not fit its bytes, is left out whole; which of its messages
are damaged cannot be told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.typesys import TypesysError

from capture_rig.errors import InputError
from capture_rig.files import copy_file

from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG
from .writer import BagWriter


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

    Raises InputError for what is no mcap bag.
    """
    files = sorted(Path(bag).glob("*.mcap"))
    if len(files) != 1:
        what = f"holds {len(files) or 'no'} .mcap files" if Path(bag).is_dir() else "there is no such folder"
        raise InputError(what, where=str(bag), remedy="Give the folder that holds one .mcap file.")
    recovery = Recovery()
    with BagWriter(target) as writer:
        topics = _add_topics(_records(files[0], Recovery()), writer)
        for record in _records(files[0], recovery):
            if isinstance(record, Message) and record.channel_id in topics:
                writer.write(topics[record.channel_id], record.log_time, record.data)
    recovery.counts = dict(writer.counts)
    for sidecar in (SIDECAR_RIG, SIDECAR_PROVENANCE):
        if (Path(bag) / sidecar).exists():
            copy_file(Path(bag) / sidecar, Path(target) / sidecar)
    return recovery


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


def _records(path: Path, recovery: Recovery) -> Iterator[McapRecord]:
    """Yield the file's records, those inside chunks included, up to where it breaks off."""
    size, whole = path.stat().st_size, 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                whole = file.tell()
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    records = breakup_chunk(record, validate_crc=True)
                except Exception:  # zstd and lz4 have errors of their own, damaged numbers and texts raise others
                    recovery.damaged_chunks += 1
                else:
                    yield from records
        except Exception:  # cut, or damaged where a record is described
            recovery.unread_bytes = size - whole
