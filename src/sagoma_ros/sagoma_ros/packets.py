"""Packets (`mocap_packets`) to and from messages, one conversion each; silhouettes are in `images`, poses in
`joint_motion`."""

from __future__ import annotations

import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, TypeVar

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2, PointField
from std_msgs.msg import String

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import PeoplePoints

from .clouds import from_cloud, only_finite, to_cloud
from .messages import to_stamp


class Table(Protocol):
    """A packet with a table of float32 fields: Centerline, VoxelSamples, ContourRays, ReferencePoints."""

    LAYOUT: ClassVar[np.dtype]

    def to_table(self) -> np.ndarray: ...

    @classmethod
    def from_table(cls, table: np.ndarray) -> Self: ...


T = TypeVar("T", bound=Table)


@dataclass(frozen=True)
class Text:
    """A packet that is a document, such as a body's YAML."""

    data: str

    def to_message(self, stamp_ns: int, frame_id: str) -> String:
        """Return it as a message, which has no stamp."""
        return String(data=self.data)


def packet_cloud(packet: Table, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a packet's table as a cloud, one point a row."""
    return to_cloud(packet.to_table(), stamp_ns, frame_id)


def read_packet(cloud: PointCloud2, kind: type[T], where: str) -> T:
    """Return the inverse of :func:`packet_cloud`; InputError when fields are missing or numbers are not finite."""
    return kind.from_table(from_cloud(cloud, kind.LAYOUT, where))


def read_finite(cloud: PointCloud2, kind: type[T], where: str) -> tuple[T, int]:
    """Return the same as :func:`read_packet` without rows that are not finite, and how many were dropped."""
    finite, dropped = only_finite(cloud, kind.LAYOUT.names or ())
    return read_packet(finite, kind, where), dropped


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

    It has a stamp, which a Float64MultiArray has not, so that it can be paired with the joint states that it is of.
    """
    n = len(names)
    cloud = PointCloud2(height=1, width=n, point_step=8 * n, row_step=8 * n * n, is_bigendian=False, is_dense=True)
    cloud.header.stamp, cloud.header.frame_id = to_stamp(stamp_ns), frame_id
    cloud.fields = [PointField(name=m, offset=8 * k, datatype=PointField.FLOAT64, count=1) for k, m in enumerate(names)]
    cloud.data = array.array("B", np.ascontiguousarray(covariance, "<f8").tobytes())
    return cloud
