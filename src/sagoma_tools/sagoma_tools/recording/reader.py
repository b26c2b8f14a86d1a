"""Reads rosbag2 bags (mcap or sqlite3, from sagoma or ``ros2 bag record``), message bytes unchanged.

To compare messages byte for byte their padding is set to zero: CDR aligns every number to its size, and the sender
leaves undefined bytes in the gaps.
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import Stores, get_typestore

from capture_rig.errors import InputError, shortened
from capture_rig.yaml_file import read_mapping
from ekf_tracker.rep155 import body_id_of
from icp_tracker.settings import MOST_PERSONS
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.frame_set import FrameSet, FrameSetCollector

from ..graph.topics import (
    CAMERA_INFO_SUFFIX,
    OUTPUT_TOPICS,
    SILHOUETTE_SUFFIX,
    camera_topics,
    cameras_in,
    first_body_id,
    person_topics,
    persons_in,
    type_of,
)

TYPES = get_typestore(Stores.ROS2_JAZZY)
METADATA = "metadata.yaml"
RECOVER = "Bring it back from a copy, or save what is left of it: `sagoma recover`."
SIDECAR_RIG, SIDECAR_PROVENANCE = "rig.yaml", "sagoma.yaml"
NEVER_NS = 2**62
UNPAIRED_SETS = 64
DEFAULT_TOLERANCE_NS = 8_000_000
T = TypeVar("T")


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag; ``data`` is the serialized (CDR) message, unchanged."""

    topic: str
    msgtype: str
    log_ns: int
    data: bytes
    bag: str = ""

    @property
    def stamp_ns(self) -> int:
        """``header.stamp`` in ns; only for messages whose first field is a std_msgs/Header. Raises InputError."""
        try:
            return header_stamp_ns(self.data)
        except (struct.error, IndexError):
            raise self.damaged(f"has {len(self.data)} bytes") from None

    def decode(self, kind: type[T]) -> T:
        """Return the message as an object of ``kind``, a message class. Raises InputError when it is damaged."""
        try:
            return deserialize_message(self.data, kind)
        except Exception as error:  # whatever the middleware raises for bytes that are no such message
            raise self.damaged(f"is no {self.msgtype}: {error}") from None

    def damaged(self, how: str) -> InputError:
        """Return the error with the message's place and its damage (``how``)."""
        what = f"the message logged at {self.log_ns} ns {shortened(how)}: it was cut or damaged"
        return InputError(what, where=f"{self.bag}: {self.topic}", remedy=RECOVER)


@dataclass(frozen=True)
class TopicDigest:
    """SHA-256 over the messages of a topic, in bag order, each preceded by its length."""

    count: int
    sha256: str


def header_stamp_ns(data: bytes) -> int:
    """Stamp of a serialized message that starts with a Header: CDR puts sec, nanosec behind 4 lead-in bytes."""
    order = "<" if data[1] & 1 else ">"
    sec, nanosec = struct.unpack_from(order + "iI", data, 4)
    return sec * 1_000_000_000 + nanosec


@contextmanager
def open_bag(bag: str | Path) -> Iterator[Reader]:
    """Open a bag folder (or a single .mcap/.db3 file). Raises InputError for a bag that cannot be read."""
    bag = Path(bag)
    if not os.path.exists(bag):  # also of a path that is too long
        raise InputError("there is no such bag", where=str(bag), remedy="Give the folder that holds metadata.yaml.")
    if bag.is_dir() and not (bag / METADATA).exists():
        remedy = f"Give a bag's folder; where its writer was killed, run `sagoma recover {bag}`."
        raise InputError("has no metadata.yaml", where=str(bag), remedy=remedy)
    try:
        reader = Reader(bag)
        reader.open()
    except Exception as error:  # a damaged index makes the reader raise anything
        raise _unreadable(bag, error) from error
    try:
        _check_types(reader, bag)
        yield reader
    finally:
        reader.close()


def _unreadable(bag: str | Path, error: Exception) -> InputError:
    known = isinstance(error, ReaderError | OSError)
    reason = str(error) if known else f"its bytes are damaged: {type(error).__name__} {error}".rstrip()
    return InputError(f"cannot be read as a rosbag2 bag ({shortened(reason)})", where=str(bag), remedy=RECOVER)


def _check_types(reader: Reader, bag: Path) -> None:
    """Raises InputError for a topic of the graph that has another type than the graph's."""
    for connection in reader.connections:
        expected = type_of(connection.topic) or connection.msgtype
        if connection.msgtype != expected:
            what = f"{connection.topic} holds messages of type {connection.msgtype}, not {expected}"
            remedy = "Record it again, or give the topic another name when recording."
            raise InputError(what, where=str(bag), remedy=remedy)


def bag_topics(bag: str | Path) -> dict[str, str]:
    """Topic name -> message type."""
    with open_bag(bag) as reader:
        return {connection.topic: connection.msgtype for connection in reader.connections}


def read_messages(bag: str | Path, wanted: Callable[[str], bool] = lambda topic: True) -> Iterator[BagMessage]:
    """Yield the messages of the wanted topics in log order."""
    with open_bag(bag) as reader:
        connections = [c for c in reader.connections if wanted(c.topic)]
        if not connections:
            return
        try:
            for connection, log_ns, data in reader.messages(connections):
                yield BagMessage(connection.topic, connection.msgtype, log_ns, bytes(data), str(bag))
        except Exception as error:
            raise _unreadable(bag, error) from error


def read_provenance(bag: str | Path) -> Mapping[str, Any]:
    """What made the bag (``sagoma.yaml``): software, graph, session, session clock; empty where the file is absent."""
    sidecar = Path(bag) / SIDECAR_PROVENANCE
    return read_mapping(sidecar, "Delete it, or restore what sagoma recorded.") if sidecar.is_file() else {}


def rig_in(bag: str | Path) -> Path | None:
    """Return the rig file that lies in the bag's folder; None without one."""
    path = Path(bag) / SIDECAR_RIG
    return path if path.is_file() else None


def bag_persons(bag: str | Path) -> dict[str, int]:
    """Return the ids of the bodies that have topics of their own in a bag -> the persons' numbers, in their order.

    Ids that do not derive from the first person's, as recorded, are numbered after all that do.
    """
    nodes = read_provenance(bag).get("graph", {}).values()
    first_id = first_body_id(node for node in nodes if isinstance(node, Mapping))
    number_of = {body_id_of(first_id, person): person for person in range(FIRST_PERSON, MOST_PERSONS + 1)}
    named = persons_in(bag_topics(bag))
    others = [body_id for body_id in named if body_id not in number_of]
    numbers = {body_id: number for body_id, number in number_of.items() if body_id in named}
    return numbers | {body_id: number for number, body_id in enumerate(others, MOST_PERSONS + 1)}


def bag_cameras(bag: str | Path) -> tuple[str, ...]:
    """Return the cameras whose silhouettes a bag holds, in name order; InputError when it holds none."""
    cameras = cameras_in(bag_topics(bag))
    if not cameras:
        remedy = "Record the cameras' topics too, as `sagoma record` does; images alone: `sagoma import bag`."
        raise InputError("holds no topic /CAMERA/silhouette/compressed", where=str(bag), remedy=remedy)
    return cameras


def input_topics(bag: str | Path) -> tuple[str, ...]:
    """Return the input topics (camera_info and silhouettes) that the bag holds, in camera order."""
    present = bag_topics(bag)
    names = (topic.name for camera in bag_cameras(bag) for topic in camera_topics(camera))
    return tuple(name for name in names if name in present)


def frame_tolerance_ns(bag: str | Path) -> int:
    """Half the bag's frame period: the largest distance of two stamps of one frame set. From the median interval."""
    silhouettes = {f"/{camera}{SILHOUETTE_SUFFIX}" for camera in bag_cameras(bag)}
    stamps: dict[str, list[int]] = {topic: [] for topic in silhouettes}
    for message in read_messages(bag, silhouettes.__contains__):
        stamps[message.topic].append(message.stamp_ns)
    intervals = [b - a for series in stamps.values() for a, b in pairwise(series) if b > a]
    return int(median(intervals)) // 2 if intervals else DEFAULT_TOLERANCE_NS


def read_frame_sets(bag: str | Path, tolerance_ns: int) -> Iterator[FrameSet[list[BagMessage]]]:
    """Yield the input messages sorted into frame sets, as the hull server sorts them; one list of messages a camera.

    A frame's messages are its camera_info (when the bag has one of the same stamp), then its silhouette. The two may
    have been logged in either order, so camera_info is read ahead of the silhouettes.
    """
    cameras = bag_cameras(bag)
    collector: FrameSetCollector[list[BagMessage]] = FrameSetCollector(
        cameras, tolerance_ns=tolerance_ns, deadline_ns=NEVER_NS, max_open=UNPAIRED_SETS
    )
    info_camera = {f"/{camera}{CAMERA_INFO_SUFFIX}": camera for camera in cameras}
    silhouette_camera = {f"/{camera}{SILHOUETTE_SUFFIX}": camera for camera in cameras}
    infos = {(info_camera[m.topic], m.stamp_ns): m for m in read_messages(bag, info_camera.__contains__)}
    for message in read_messages(bag, silhouette_camera.__contains__):
        camera, stamp_ns = silhouette_camera[message.topic], message.stamp_ns
        info = infos.pop((camera, stamp_ns), None)
        yield from collector.add(camera, stamp_ns, [message] if info is None else [info, message], arrival_ns=0)
    yield from collector.flush()


def bag_digest(bag: str | Path, topics: Iterable[str] | None = None) -> dict[str, TopicDigest]:
    """SHA-256 of each topic's messages in order; by default of the output topics that replay to the same bytes.

    Undefined bytes between fields count as zero (:func:`canonical_bytes`).
    """
    names = default_comparison(bag) if topics is None else tuple(topics)
    hashes = {name: hashlib.sha256() for name in names}
    counts = dict.fromkeys(names, 0)
    for message in read_messages(bag, hashes.__contains__):
        content = canonical_bytes(message.data, message.msgtype)
        hashes[message.topic].update(struct.pack("<Q", len(content)) + content)
        counts[message.topic] += 1
    return {name: TopicDigest(counts[name], hashes[name].hexdigest()) for name in names}


def default_comparison(bag: str | Path) -> tuple[str, ...]:
    """Return the repeatable output topics that the bag has."""
    present = bag_topics(bag)
    of_persons = [topic for body_id in persons_in(present) for topic in person_topics(body_id)]
    return tuple(topic.name for topic in (*OUTPUT_TOPICS, *of_persons) if topic.repeatable and topic.name in present)


def first_difference(bag_a: str | Path, bag_b: str | Path, topic: str) -> str:
    """Return the first difference of two bags on a topic, undefined bytes apart: message and byte; "" for none."""
    pairs = zip_longest(*(read_messages(bag, topic.__eq__) for bag in (bag_a, bag_b)))
    for number, (a, b) in enumerate(pairs):
        if a is None or b is None:
            return f"{topic}: {bag_a if a is None else bag_b} ends after {number} messages, which all agree"
        data_a, data_b = (canonical_bytes(message.data, message.msgtype) for message in (a, b))
        if data_a != data_b:
            byte = next((k for k, (x, y) in enumerate(zip(data_a, data_b, strict=False)) if x != y), "the end")
            return f"{topic}: message {number} differs first, from byte {byte} on"
    return ""


def canonical_bytes(data: bytes, msgtype: str) -> bytes:
    """Return the message with zeros in its padding; unchanged when its type is unknown or it does not parse."""
    for end in (len(data), len(data) - 4):  # rclpy aligns the end of a message whose last array is empty
        with suppress(Exception):  # of damaged bytes, whatever the parser raises
            return bytes(TYPES.serialize_cdr(TYPES.deserialize_cdr(data[:end], msgtype), msgtype))
    return data
