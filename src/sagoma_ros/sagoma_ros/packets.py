"""Packets (`mocap_packets`) to and from messages, and the topics on which our nodes exchange them.

Those topics hold several tables in one std_msgs/Float64MultiArray. Its first dimension is labelled with the frame id;
its two numbers are seconds and nanoseconds of the stamp. Each other dimension is a table: label ``NAME: COLUMN ...``,
size the rows, stride the columns. Clouds are for other subscribers. Silhouettes are in `images`, poses in `poses`.
"""

from __future__ import annotations

import array
from collections.abc import Mapping, Sequence
from typing import ClassVar, Protocol, Self, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.hull import HullProducts
from mocap_packets.people import AnsweredSet, FittedPeople, PeoplePoints, Predictions
from mocap_packets.table import fill, layout

from .intra_process import PacketTopic
from .messages import LATENCY_TOPIC, NS_PER_S, latency_message, read_latency, to_ns, to_stamp
from .poses import predictions_message, read_predictions

MOST_SECONDS = 2**31  # of a stamp


class Table(Protocol):
    """A packet with a table: Centerline, VoxelSamples, ContourRays, ReferencePoints."""

    LAYOUT: ClassVar[np.dtype]

    def to_table(self) -> np.ndarray: ...

    @classmethod
    def from_table(cls, table: np.ndarray) -> Self: ...


class Tables(Protocol):
    """A packet of several tables: HullProducts, FittedPeople."""

    LAYOUTS: ClassVar[dict[str, np.dtype]]

    @property
    def stamp_ns(self) -> int: ...

    def to_tables(self) -> dict[str, np.ndarray]: ...

    @classmethod
    def from_tables(cls, stamp_ns: int, tables: Mapping[str, np.ndarray]) -> Self: ...


T = TypeVar("T", bound=Table)
M = TypeVar("M", bound=Tables)

# --- between our nodes


def tables_message(packet: Tables, frame_id: str) -> Float64MultiArray:
    """Return a packet's tables in one message."""
    tables = packet.to_tables()
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension(label=frame_id, size=1, stride=2)]
    for name, table in tables.items():
        stride = len(table.dtype.names or ())
        message.layout.dim.append(MultiArrayDimension(label=_label(name, table.dtype), size=len(table), stride=stride))
    numbers = [np.array(divmod(packet.stamp_ns, NS_PER_S), float), *(t.view(np.float64) for t in tables.values())]
    message.data = array.array("d", np.concatenate(numbers).tobytes())
    return message


def header_of_tables(message: Float64MultiArray) -> tuple[int, str]:
    """Return stamp, ns, and frame id. Raises InputError for a message without."""
    sec, nanosec = message.data[:2] if len(message.data) >= 2 else (-1.0, 0.0)
    if not message.layout.dim or not (0 <= sec < MOST_SECONDS and 0 <= nanosec < NS_PER_S):
        raise InputError("the message has no stamp", remedy="Run the same version of all three server nodes.")
    return int(sec) * NS_PER_S + int(nanosec), message.layout.dim[0].label


def read_tables(message: Float64MultiArray, kind: type[M], where: str) -> M:
    """Return the packet of a message. Raises InputError for other tables, and numbers that are not finite."""
    stamp_ns, _ = header_of_tables(message)
    numbers, sizes = np.frombuffer(message.data)[2:].copy(), [dim.size for dim in message.layout.dim[1:]]
    labels = [_label(name, layout) for name, layout in kind.LAYOUTS.items()]
    counts = [size * len(layout.names or ()) for size, layout in zip(sizes, kind.LAYOUTS.values(), strict=False)]
    try:
        if [dim.label for dim in message.layout.dim[1:]] != labels or sum(counts) != len(numbers):
            raise InputError("does not hold the tables of its labels", remedy="Run the same version of all nodes.")
        if not np.isfinite(numbers).all():
            raise InputError("holds numbers that are not finite", remedy="Check its publisher.")
        parts = np.split(numbers, np.cumsum(counts)[:-1])
        tables = {n: part.view(layout) for (n, layout), part in zip(kind.LAYOUTS.items(), parts, strict=True)}
        return kind.from_tables(stamp_ns, tables)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from None


def _label(name: str, layout: np.dtype) -> str:
    return f"{name}: {' '.join(layout.names or ())}"


def _topic_of_tables(name: str, kind: type[M]) -> PacketTopic[M]:
    def read(message: Float64MultiArray, where: str) -> M:
        return read_tables(message, kind, where)

    return PacketTopic(name, Float64MultiArray, tables_message, header_of_tables, read)


HULL_PRODUCTS = _topic_of_tables("hull/products", HullProducts)
FITTED_PEOPLE = _topic_of_tables("icp/people", FittedPeople)
PREDICTIONS = PacketTopic[Predictions](
    "ekf/prediction",
    MultiDOFJointState,
    predictions_message,
    lambda message: (to_ns(message.header.stamp), message.header.frame_id),
    read_predictions,
)
LATENCY = PacketTopic[AnsweredSet](
    LATENCY_TOPIC,
    DiagnosticArray,
    lambda answered, frame_id: latency_message(answered),
    lambda message: (to_ns(message.header.stamp), message.header.frame_id),
    read_latency,
)

# --- for other subscribers: tables of float64 fields as PointCloud2 in single precision, and back

DEFAULTS = {"body": 0.0, "person": 1.0, "doubtful": 0.0, "moved": 0.0}
"""What a cloud without one of these fields means: all is one body, one person's, nothing is doubtful or elsewhere."""

_NUMPY_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}


def to_cloud(
    points: np.ndarray, stamp_ns: int, frame_id: str, rows: int = 1, datatype: int = PointField.FLOAT32
) -> PointCloud2:
    """Return a table (n,) as a cloud of fields of one type, unordered or organised in rows."""
    names, kind = points.dtype.names or (), np.dtype("<" + _NUMPY_TYPES[datatype])
    numbers = np.ascontiguousarray(points).view(np.float64).astype(kind)
    cloud = PointCloud2(height=rows, width=len(points) // rows, is_bigendian=False, is_dense=True)
    cloud.header.stamp, cloud.header.frame_id = to_stamp(stamp_ns), frame_id
    cloud.fields = [
        PointField(name=name, offset=kind.itemsize * index, datatype=datatype, count=1)
        for index, name in enumerate(names)
    ]
    cloud.point_step = kind.itemsize * len(names)
    cloud.row_step = cloud.point_step * cloud.width
    cloud.data = array.array("B", numbers.tobytes())
    return cloud


def from_cloud(cloud: PointCloud2, layout: np.dtype, where: str) -> np.ndarray:
    """Return the fields of ``layout`` of a cloud as a structured array (n,), whatever order and types they came in.

    A cloud without the field ``body`` is of one body, number 0; without ``person``, of the first person; without
    ``doubtful``, nothing in it is.

    Raises InputError when a field is missing, the size does not fit, or a number is not finite.
    """
    wire, names, there = _wire(cloud, where), layout.names or (), [field.name for field in cloud.fields]
    missing = [name for name in names if name not in DEFAULTS and name not in there]
    if missing:
        what = f"the cloud has no field '{missing[0]}' (it has: {', '.join(there)})"
        raise InputError(what, where=where, remedy=f"Publish the fields {', '.join(names)}.")
    points = np.empty(len(wire), layout)
    for name in names:
        points[name] = wire[name][:, 0] if name in there else DEFAULTS[name]
    if not np.isfinite(points.view(np.float64)).all():
        remedy = "Drop such points before publishing."
        raise InputError("the cloud holds numbers that are not finite", where=where, remedy=remedy)
    return points


def vectors_of_cloud(cloud: PointCloud2, size: int, where: str) -> tuple[list[str], np.ndarray]:
    """Return the names of a cloud's fields, of ``size`` numbers each, and those of every point (n, fields, size).

    Raises InputError when a field has another size, or none is there.
    """
    wire, names = _wire(cloud, where), [field.name for field in cloud.fields]
    if not names or any(field.count != size for field in cloud.fields):
        what, remedy = f"the cloud has not fields of {size} numbers each", "Give each field its name and count."
        raise InputError(what, where=where, remedy=remedy)
    return names, np.stack([wire[name].astype(np.float64) for name in names], axis=1)


def _wire(cloud: PointCloud2, where: str) -> np.ndarray:
    """Return the points (n,) as they lie in the message, each field as (n, count), without the padding that an
    organised cloud may have at the end of each row."""
    order, step = ">" if cloud.is_bigendian else "<", cloud.point_step
    try:
        layout = np.dtype(
            {
                "names": [field.name for field in cloud.fields],
                "formats": [(order + _NUMPY_TYPES[field.datatype], (max(field.count, 1),)) for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": step,
            }
        )
        shape, row = (cloud.height, cloud.width), max(cloud.row_step, cloud.width * step)
        return np.ndarray(shape, layout, cloud.data, strides=(row, step)).reshape(-1)
    except (ValueError, KeyError, TypeError) as error:  # of numpy: fields overlap the step, or there are fewer bytes
        what = f"the cloud's fields, sizes and {len(cloud.data)} bytes do not fit each other ({error})"
        raise InputError(what, where=where, remedy="The message is damaged; check its publisher.") from None


def packet_cloud(packet: Table, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a packet's table as a cloud, one point a row."""
    return to_cloud(packet.to_table(), stamp_ns, frame_id)


def read_packet(cloud: PointCloud2, kind: type[T], where: str) -> T:
    """Return the inverse of :func:`packet_cloud`; InputError when fields are missing or numbers are not finite."""
    return kind.from_table(from_cloud(cloud, kind.LAYOUT, where))


def read_reference_points(cloud: PointCloud2, where: str) -> ReferencePoints:
    """The 15 reference points of a cloud; InputError as :func:`read_packet`, and for another number of points."""
    points = read_packet(cloud, ReferencePoints, where)
    if len(points.visible) != 15:
        raise InputError(f"{len(points.visible)} points", where=where, remedy="Publish the 15 reference points.")
    return points


def people_cloud(people: PeoplePoints, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return everybody's points as a cloud, one row of 15 a person; the first person alone: as :func:`packet_cloud`."""
    return to_cloud(people.to_table(), stamp_ns, frame_id, rows=len(people.of))


def read_people_points(cloud: PointCloud2, where: str) -> PeoplePoints:
    """Return the inverse of :func:`people_cloud`; InputError unless it has 15 points each."""
    table = from_cloud(cloud, PeoplePoints.LAYOUT, where)
    try:
        return PeoplePoints.from_table(table)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from None


def joint_state_message(
    names: Sequence[str], angles: np.ndarray, rates: np.ndarray, stamp_ns: int, frame_id: str = ""
) -> JointState:
    """Angles (n,) rad and rates (n,) rad/s by name."""
    message = JointState(name=list(names), position=angles.tolist(), velocity=rates.tolist())
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), frame_id
    return message


def covariance_cloud(names: Sequence[str], covariance: np.ndarray, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a covariance (n, n) as a cloud of n points, the rows, with n fields, the columns: float64, by name.

    Unlike a Float64MultiArray it has a stamp, by which it is paired with its joint states.
    """
    return to_cloud(fill(layout(*names), covariance), stamp_ns, frame_id, datatype=PointField.FLOAT64)
