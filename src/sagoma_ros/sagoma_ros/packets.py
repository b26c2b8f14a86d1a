"""Packets (`mocap_packets`) to and from messages, one conversion each; silhouettes are in `images`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, TypeVar

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from mocap_packets.people import PeoplePoints, Predictions
from mocap_packets.state import NoState, Prediction
from stick_figure.skeleton import TANGENT_NAMES

from .clouds import from_cloud, only_finite, to_cloud
from .messages import to_ns, to_stamp


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
    """As :func:`read_packet`, without the rows that hold numbers that are not finite, and how many were dropped."""
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


def prediction_message(prediction: Prediction, frame_id: str = "map") -> JointState:
    """Return a prediction as a JointState over the 24 tangent names, without names while there is no pose.

    position = torso position (m), rotation vector of R_world_torso (rad), 18 angles (rad); velocity = tangent rates.
    """
    if prediction.pose is None:
        return joint_state_message([], np.empty(0), np.empty(0), prediction.stamp_ns, frame_id)
    velocity = np.asarray(prediction.velocity)
    return joint_state_message(TANGENT_NAMES, prediction.to_row(), velocity, prediction.stamp_ns, frame_id)


def predictions_message(predictions: Predictions, stamp_ns: int, frame_id: str = "map") -> JointState:
    """Return everybody's predictions as one JointState: the first person's as :func:`prediction_message`, then those of
    the others who have a pose, every name with ``person_N/`` before it."""
    message = prediction_message(predictions.of[FIRST_PERSON], frame_id)
    for person, other in predictions.of.items():
        if person != FIRST_PERSON and other.pose is not None:
            message.name.extend(_names_of(person))
            message.position.extend(other.to_row().tolist())
            message.velocity.extend(np.asarray(other.velocity).tolist())
    return message


def read_predictions(message: JointState, where: str) -> Predictions:
    """Return the inverse of :func:`predictions_message`; InputError when names or lengths are not ours."""
    stamp_ns, size = to_ns(message.header.stamp), len(TANGENT_NAMES)
    predictions = {FIRST_PERSON: NoState(stamp_ns, "").prediction}
    row, velocity = np.array(message.position), np.array(message.velocity)
    if not (np.isfinite(row).all() and np.isfinite(velocity).all()):
        raise InputError("the prediction holds numbers that are not finite", where=where, remedy="Check its publisher.")
    whole = len({len(message.name), len(row), len(velocity)}) == 1 and len(row) % size == 0
    for start in range(0, len(message.name), size):
        names = tuple(message.name[start : start + size])
        person = _person_of(names[0])
        if not whole or names != _names_of(person):
            raise InputError(
                "names or lengths are not those of a prediction",
                where=where,
                remedy=f"Give position and velocity of {', '.join(TANGENT_NAMES)}.",
            )
        own = slice(start, start + size)
        predictions[person] = Prediction.from_row(stamp_ns, row[own], velocity[own])
    return Predictions(stamp_ns, predictions)


def read_prediction(message: JointState, where: str) -> Prediction:
    """Return the first person's prediction; InputError as :func:`read_predictions`."""
    return read_predictions(message, where).of[FIRST_PERSON]


def _names_of(person: int) -> tuple[str, ...]:
    return TANGENT_NAMES if person == FIRST_PERSON else tuple(f"person_{person}/{name}" for name in TANGENT_NAMES)


def _person_of(name: str) -> int:
    head, _, number = name.partition("/")[0].partition("_")
    return int(number) if head == "person" and number.isdigit() else FIRST_PERSON


def covariance_message(names: Sequence[str], covariance: np.ndarray) -> Float64MultiArray:
    """Covariance (n, n); both dimensions are labelled with the n names, comma-separated."""
    n = len(names)
    message = Float64MultiArray(data=np.asarray(covariance, float).reshape(-1).tolist())
    message.layout.dim = [
        MultiArrayDimension(label=",".join(names), size=n, stride=n * n),
        MultiArrayDimension(label=",".join(names), size=n, stride=n),
    ]
    return message
