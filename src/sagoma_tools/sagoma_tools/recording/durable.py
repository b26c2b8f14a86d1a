"""The mcap file of a bag that is being written: every chunk has a checksum, and is on the disk soon after its messages.

Builds on the storage of rosbags (its module ``storage_mcap``); what is added is what that leaves out: checksums, chunks
closed by time and not only by size, fsync, and a file that can still be finished when a chunk could not be written.
"""

from __future__ import annotations

import io
import os
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any
from zlib import crc32

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import Channel, McapWriter, PendingChunk, write_channel, write_string

from capture_rig.files import sync_folder

CRC_OFFSET = 9 + 24  # of a chunk's checksum in the file: behind opcode, length, first and last time, and size
RESERVE = ".reserve"
RESERVE_BYTES = 8 << 20  # index and metadata of eight hours at a chunk a second; released to write them on a full disk


class WholeFile(io.FileIO):
    """A file without a buffer that writes all of what it is given, or raises OSError."""

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written = 0
        while written < len(view):
            written += super().write(view[written:]) or 0
        return written


class DurableMcap(McapWriter):
    """The mcap file; what could not be written of a chunk is taken out of file, index and counts again."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.bio.close()
        self.bio: Any = WholeFile(str(self.path), "r+b")
        self.bio.seek(0, os.SEEK_END)
        self._ended_ns = 0

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Announce a channel, with the hash of its type as rosbag2 writes it (REP-2011), which rosbags leaves out."""
        metadata = io.BytesIO()
        for text in ("offered_qos_profiles", offered_qos_profiles, "topic_type_hash", connection.digest):
            write_string(metadata, text)
        encoding = getattr(connection.ext, "serialization_format", "cdr")
        channel = Channel(connection.id, connection.msgtype, connection.topic, encoding, metadata.getvalue())
        self.channels.append(channel)
        self.channel_stats[connection.id] = 0
        write_channel(self.chunk.bio, channel, self.schemas)

    def close_chunk(self) -> None:
        """Write the chunk that is pending. Raises OSError; the file then ends with the chunk before."""
        start, closed, pending = self.bio.tell(), len(self.chunks), self.chunk
        try:
            checksum = crc32(pending.bio.getbuffer())
            super().close_chunk()
            end = self.bio.tell()
            self.bio.seek(start + CRC_OFFSET)
            self.bio.write(struct.pack("<I", checksum))
            self.bio.seek(end)
            self._ended_ns = self.message_end_time
        except OSError:
            self.bio.truncate(start)
            self.bio.seek(start)
            del self.chunks[closed:]
            for channel, messages in pending.msgs.items():
                self.channel_stats[channel] -= len(messages)
            self.message_end_time = self._ended_ns
            self.chunk = PendingChunk(2**63 - 1, 0, io.BytesIO(), defaultdict(list))
            raise

    def close_pending_chunk(self) -> None:
        """Write the chunk if there is anything in it."""
        if self.chunk.bio.tell():
            self.close_chunk()

    def close(self, version: int, metadata: str) -> None:
        """Write the index, and wait until the disk has it all."""
        super().close(version, metadata)
        with self.path.open("rb") as file:
            os.fsync(file.fileno())


class DurableWriter(Writer):
    """rosbags' writer of a folder, with :class:`DurableMcap` in it and room on the disk to finish it."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: DurableMcap}  # noqa: RUF012

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, version=9, storage_plugin=StoragePlugin.MCAP)

    def open(self) -> None:
        """Make the folder and its files. Raises OSError."""
        super().open()
        try:
            with (self.path / RESERVE).open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE_BYTES)
            self.sync()
            sync_folder(self.path)
            sync_folder(self.path.parent)
        except OSError:
            self.abort()
            raise

    @property
    def mcap(self) -> DurableMcap:
        """The open file."""
        assert isinstance(self.storage, DurableMcap)
        return self.storage

    def sync(self) -> None:
        """Wait until the disk has what was written so far. Raises OSError."""
        if self.storage is not None:
            os.fsync(self.mcap.bio.fileno())

    def close(self) -> None:
        """Write what is pending, the index and metadata.yaml, and wait until the disk has them. Raises OSError."""
        mcap = self.mcap
        (self.path / RESERVE).unlink(missing_ok=True)
        self.counts = {connection: mcap.channel_stats[connection] for connection in self.counts}
        self.max_timestamp = mcap.message_end_time
        super().close()
        with self.metapath.open("rb") as file:
            os.fsync(file.fileno())
        sync_folder(self.path)
