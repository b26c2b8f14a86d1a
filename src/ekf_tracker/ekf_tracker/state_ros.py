"""The filter's results as ROS messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from capture_rig.rigid import quaternion_of
from mocap_packets.fit import DOUBTFUL, FIRST_PERSON, PART_NAMES, PART_OF_POINT
from mocap_packets.state import BodyState, NoState, Tracking
from sagoma_ros.messages import key_values, to_stamp
from sagoma_ros.poses import motion_message
from stick_figure.body import Body
from stick_figure.kinematics import sticks
from stick_figure.pose import JointMotion

LEVELS = {
    Tracking.ACQUIRING: DiagnosticStatus.WARN,
    Tracking.TRACKING: DiagnosticStatus.OK,
    Tracking.DOUBTFUL: DiagnosticStatus.WARN,
    Tracking.LOST: DiagnosticStatus.ERROR,
}
STICK_WIDTH_M = 0.03
JOINT_DIAMETER_M = 0.06
SIGMAS = 2.0
"""Half axes of the published ellipsoids in standard deviations."""
LIFETIME_S = 1
"""How long a viewer keeps markers that nothing replaces: as long as the filter keeps an unmeasured body."""
_COLOURS = {
    Tracking.TRACKING: ColorRGBA(r=0.2, g=0.8, b=0.3, a=1.0),
    Tracking.DOUBTFUL: ColorRGBA(r=0.95, g=0.7, b=0.1, a=1.0),
    Tracking.LOST: ColorRGBA(r=0.9, g=0.2, b=0.2, a=1.0),
}
PART_OF_STICK = (0, 0, 1, 2, 3, 4, 1, 2, 3, 4)
_ELLIPSOID_COLOUR = ColorRGBA(r=0.4, g=0.6, b=1.0, a=0.3)
_PERSONS = ((0.34, 0.71, 0.91), (0.80, 0.47, 0.65), (0.0, 0.45, 0.70), (0.94, 0.89, 0.26))
"""Sky blue, purple, blue, yellow: told apart by the colour-blind (Okabe and Ito 2008), and from the states' colours."""


@dataclass(frozen=True)
class SkeletonStyle:
    """How a person's markers look: ``prefix`` of their namespaces; ``sticks`` : colour, None for that of the state."""

    frame_id: str
    with_ellipsoids: bool
    prefix: str = ""
    sticks: ColorRGBA | None = None

    @classmethod
    def of_person(cls, person: int, body_id: str, frame_id: str, with_ellipsoids: bool) -> SkeletonStyle:
        """Return the style of one among several: sticks in a colour of their own, joints in that of the state."""
        r, g, b = _PERSONS[(person - 1) % len(_PERSONS)]
        return cls(frame_id, with_ellipsoids, f"{body_id}/", ColorRGBA(r=r, g=g, b=b, a=1.0))


def torso_message(state: BodyState, frame_id: str) -> PoseWithCovarianceStamped:
    """Pose of the torso's frame, with the 6x6 covariance in ROS's order x y z rx ry rz about the fixed axes."""
    message = PoseWithCovarianceStamped(header=_header(state.stamp_ns, frame_id))
    message.pose.pose.position = _point(state.pose.position_world)
    message.pose.pose.orientation = quaternion(state.pose.R_world_torso)
    message.pose.covariance = state.covariance[:6, :6].ravel()
    return message


def rotations_message(state: BodyState, frame_id: str) -> MultiDOFJointState:
    """Return every joint's rotation and angular velocity: without the singularities of angles."""
    motion = JointMotion.of(state.pose, state.velocity)
    return motion_message({FIRST_PERSON: motion}, state.stamp_ns, frame_id)


def state_message(state: BodyState | NoState, node_name: str) -> DiagnosticStatus:
    """Return what the tracker thinks of itself: message = its state; values = why, and the parts' states."""
    values = {"reason": state.reason, "stamp_ns": str(state.stamp_ns)}
    if isinstance(state, BodyState):
        values["points_used"] = str(int(state.accepted.sum()))
        values["normalised_innovation"] = f"{state.normalised_innovation:.3f}"
        values |= dict(zip(PART_NAMES, state.parts, strict=True))
    return DiagnosticStatus(
        level=LEVELS[state.tracking], name=node_name, message=str(state.tracking), values=key_values(values)
    )


def silence_message(tracking: Tracking, reason: str, node_name: str) -> DiagnosticStatus:
    """Return the state between frame sets, so without a stamp: nothing comes any more."""
    values = key_values({"reason": reason})
    return DiagnosticStatus(level=LEVELS[tracking], name=node_name, message=str(tracking), values=values)


def skeleton_markers(state: BodyState, body: Body, style: SkeletonStyle) -> MarkerArray:
    """Sticks as one line list, joints as one sphere list, and if wanted one ellipsoid of covariance a point.

    Doubtful parts of the body have the colour of doubt. Namespaces and ids stay the same from set to set, so a viewer
    replaces what it shows; what is replaced no longer disappears after LIFETIME_S.
    """
    header, colour = _header(state.stamp_ns, style.frame_id), _COLOURS[state.tracking]
    sticks_colour = colour if style.sticks is None or state.tracking == Tracking.LOST else style.sticks
    lines = _marker(header, f"{style.prefix}sticks", 0, Marker.LINE_LIST, sticks_colour)
    lines.scale.x = STICK_WIDTH_M
    lines.points = [_point(end) for end in sticks(body.bent(state.bend), state.pose).reshape(20, 3)]
    lines.colors = [one for one in _colours(state, PART_OF_STICK, sticks_colour) for _ in range(2)]
    joints = _marker(header, f"{style.prefix}joints", 0, Marker.SPHERE_LIST, colour)
    joints.scale.x = joints.scale.y = joints.scale.z = JOINT_DIAMETER_M
    joints.points = [_point(point) for point in state.points_world]
    joints.colors = _colours(state, PART_OF_POINT, colour)
    ellipsoids = _ellipsoids(header, state, f"{style.prefix}covariance") if style.with_ellipsoids else []
    return MarkerArray(markers=[lines, joints, *ellipsoids])


def deleted_markers(shown: Iterable[Marker], stamp_ns: int) -> MarkerArray:
    """Take markers back: those of the same namespaces and ids."""
    return MarkerArray(
        markers=[
            Marker(header=_header(stamp_ns, one.header.frame_id), ns=one.ns, id=one.id, action=Marker.DELETE)
            for one in shown
        ]
    )


def _colours(state: BodyState, part_of: Sequence[int] | np.ndarray, usual: ColorRGBA) -> list[ColorRGBA]:
    """Return a colour for each stick or point: that of doubt where its part of the body is doubtful."""
    of_part = [_COLOURS[Tracking.DOUBTFUL] if part == DOUBTFUL else usual for part in state.parts]
    return [of_part[part] for part in part_of]


def quaternion(R: np.ndarray) -> Quaternion:
    """Rotation matrix to quaternion with w >= 0."""
    x, y, z, w = quaternion_of(R).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _ellipsoids(header: Header, state: BodyState, namespace: str) -> list[Marker]:
    markers = []
    variances, axes = np.linalg.eigh(state.point_covariance)
    for i, (point, variance, axis) in enumerate(zip(state.points_world, variances, axes, strict=True)):
        marker = _marker(header, namespace, i, Marker.SPHERE, _ELLIPSOID_COLOUR)
        marker.pose.position = _point(point)
        marker.pose.orientation = quaternion(axis * [1.0, 1.0, np.linalg.det(axis)])  # eigh may return a reflection
        marker.scale.x, marker.scale.y, marker.scale.z = 2.0 * SIGMAS * np.sqrt(variance)
        markers.append(marker)
    return markers


def _marker(header: Header, namespace: str, number: int, kind: int, colour: ColorRGBA) -> Marker:
    marker = Marker(header=header, ns=namespace, id=number, type=kind, action=Marker.ADD, color=colour)
    marker.lifetime = Duration(sec=LIFETIME_S)
    marker.pose.orientation.w = 1.0
    return marker


def _header(stamp_ns: int, frame_id: str) -> Header:
    return Header(stamp=to_stamp(stamp_ns), frame_id=frame_id)


def _point(xyz: np.ndarray) -> Point:
    x, y, z = xyz.tolist()
    return Point(x=x, y=y, z=z)
