"""The topics of each person, and their messages: mocap/... of the first, mocap/bodies/ID/... of everybody.

Publishers under mocap/bodies/ID are made when the person appears, and closed CLOSED_AFTER_S after the person has left,
when subscribers have received the last state. Viewers drop markers that are not replaced.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from capture_rig.rigid import quaternion_of
from capture_rig.stamps import NS_PER_S
from mocap_packets.fit import DOUBTFUL, FIRST_PERSON, PART_NAMES, PART_OF_POINT
from mocap_packets.state import BodyState, NoState, Tracking
from sagoma_ros.intra_process import LazyPublisher
from sagoma_ros.messages import key_values, to_stamp
from sagoma_ros.packets import covariance_cloud, joint_state_message, packet_cloud
from sagoma_ros.poses import motion_message
from sagoma_ros.qos import LATCHED, RESULT
from stick_figure.body import Body
from stick_figure.kinematics import sticks
from stick_figure.pose import JointMotion
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, TANGENT_NAMES

from .motion_model import POSE
from .rep155 import body_id_of
from .settings import EkfNodeSettings
from .urdf import body_urdf, same_sizes

LEVELS = {
    Tracking.ACQUIRING: DiagnosticStatus.WARN,
    Tracking.TRACKING: DiagnosticStatus.OK,
    Tracking.DOUBTFUL: DiagnosticStatus.WARN,
    Tracking.LOST: DiagnosticStatus.ERROR,
}
CLOSED_AFTER_S = 10.0  # of the sets' time; long enough to walk round a room and come back
LEFT = "has left"
STICK_WIDTH_M = 0.03
JOINT_DIAMETER_M = 0.06
LIFETIME_S = 1
"""How long a viewer keeps markers that nothing replaces: as long as the filter keeps an unmeasured body."""
TRACKED_COLOUR, DOUBTFUL_COLOUR = (ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in ((0.2, 0.8, 0.3), (0.95, 0.7, 0.1)))
PART_OF_STICK = (0, 0, 1, 2, 3, 4, 1, 2, 3, 4)
_PERSONS = ((0.34, 0.71, 0.91), (0.80, 0.47, 0.65), (0.0, 0.45, 0.70), (0.94, 0.89, 0.26))
"""Sky blue, purple, blue, yellow: distinct for the colour-blind (Okabe and Ito 2008), and from the states' colours."""

Answer = BodyState | NoState


class PersonTopics:
    """What is published of one person under one prefix; the skeleton at a bounded rate, by the sets' stamps.

    namespace, colour : of the skeleton's markers and its sticks, None for the colour of the state. all_skeletons : the
    publisher of everybody's markers, where these are to be among them.
    """

    def __init__(
        self,
        node: Node,
        prefix: str,
        body_id: str,
        settings: EkfNodeSettings,
        namespace: str = "",
        colour: ColorRGBA | None = None,
        all_skeletons: tuple[LazyPublisher, ...] = (),
    ) -> None:
        opened: list[LazyPublisher] = []

        def publisher(kind: type, topic: str, qos: QoSProfile = RESULT) -> LazyPublisher:
            opened.append(LazyPublisher(node, kind, f"{prefix}/{topic}", qos))
            return opened[-1]

        self._opened, self._frame, self._name = opened, settings.frame_id, node.get_fully_qualified_name()
        self._joint_states = publisher(JointState, "joint_states")
        self._torso = publisher(PoseWithCovarianceStamped, "torso")
        self._joint_covariance = publisher(PointCloud2, "joint_covariance")
        self._joint_rotations = publisher(MultiDOFJointState, "joint_rotations")
        self._reference_points = publisher(PointCloud2, "reference_points")
        self._skeletons = (publisher(MarkerArray, "skeleton"), *all_skeletons)
        self._state = publisher(DiagnosticStatus, "state")
        self._description = publisher(String, "robot_description", LATCHED)
        self._body_id, self._namespace, self._colour = body_id, namespace, colour
        self._period_ns = round(NS_PER_S / settings.skeleton_rate_hz) if settings.skeleton_rate_hz else 0
        self._due_ns = 0
        self._described: Body | None = None
        self.last: Answer | None = None  # of the person's answers

    def publish_body(self, state: BodyState, body: Body) -> None:
        """Publish a body that is tracked."""
        self._describe(body)
        stamp_ns, angles, rates, frame = state.stamp_ns, state.angles, state.rates, self._frame
        self._joint_states.publish(joint_state_message, ANGLE_NAMES, angles, rates, stamp_ns, frame)
        self._torso.publish(torso_message, state, frame)
        self._joint_rotations.publish(rotations_message, state, frame)
        covariance = state.covariance[POSE, POSE]
        self._joint_covariance.publish(covariance_cloud, TANGENT_NAMES, covariance, stamp_ns, frame)
        self._reference_points.publish(packet_cloud, state.reference_points, stamp_ns, frame)
        if not self._due_ns - self._period_ns <= stamp_ns < self._due_ns:  # also when stamps went back
            self._due_ns = stamp_ns + self._period_ns
            drawn = cache(lambda: skeleton_markers(state, body, frame, self._namespace, self._colour))
            for skeletons in self._skeletons:
                skeletons.publish(drawn)

    def _describe(self, body: Body) -> None:
        """Publish the body's URDF whenever its sizes have changed."""
        if not same_sizes(body, self._described):
            self._described = body
            self._description.publish(lambda: String(data=body_urdf(body, self._body_id)))

    def publish_state(self, answer: Answer) -> None:
        """Publish the quality of a person's state."""
        self.last = answer
        self._state.publish(state_message, answer, self._name)

    def publish_stale(self, reason: str) -> Tracking:
        """Publish that no sets come any more: the body is lost. Returns the person's state."""
        tracking = Tracking.LOST if isinstance(self.last, BodyState) else Tracking.ACQUIRING
        self._state.publish(silence_message, tracking, reason, self._name)
        return tracking

    def close(self) -> None:
        """Close the topics."""
        for publisher in self._opened:
            publisher.close()


class PeopleTopics:
    """Publishes everybody's answers to one frame set after another."""

    def __init__(self, node: Node, settings: EkfNodeSettings, tf_prefix: str, on_closed: Callable[[str], None]) -> None:
        """``on_closed(body_id)`` is called when a person has left for good. InputError for an invalid body_id."""
        self._node, self._settings, self._prefix, self._on_closed = node, settings, tf_prefix, on_closed
        self._first = PersonTopics(node, "mocap", self.id_of(FIRST_PERSON), settings)
        self._all_skeletons = LazyPublisher(node, MarkerArray, "mocap/skeletons")
        self._names = LazyPublisher(node, String, "mocap/point_names", LATCHED)
        self._names.publish(lambda: String(data=",".join(POINT_NAMES)))
        self._persons: dict[int, PersonTopics] = {}

    def id_of(self, person: int) -> str:
        """Return the person's id in frames, URDFs and /humans; topics of the graph have it without its prefix."""
        return body_id_of(self._prefix + self._settings.body_id, person)

    def publish_bodies(self, tracked: Mapping[int, tuple[BodyState, Body]]) -> None:
        """Publish the bodies that are tracked in one set, in order; a person who appears gets topics."""
        for person, (state, body) in tracked.items():
            if person == FIRST_PERSON:
                self._first.publish_body(state, body)
            if person not in self._persons:
                self._persons[person] = self._topics_of(person)
            self._persons[person].publish_body(state, body)

    def publish_states(self, answers: Mapping[int, Answer], stamp_ns: int) -> None:
        """Publish the quality of each person's state; persons not among them have left."""
        self._first.publish_state(answers[FIRST_PERSON])
        for person, topics in list(self._persons.items()):
            if person in answers:
                topics.publish_state(answers[person])
            else:
                self._away(person, topics, stamp_ns)

    def publish_stale(self, reason: str) -> Tracking:
        """Publish that no sets come any more; returns the first person's state."""
        states = [topics.publish_stale(reason) for topics in (self._first, *self._persons.values())]
        return states[0]

    def close(self) -> None:
        """Close all topics."""
        for topics in (self._first, *self._persons.values()):
            topics.close()
        self._all_skeletons.close()
        self._names.close()

    def _topics_of(self, person: int) -> PersonTopics:
        body_id, (r, g, b) = self.id_of(person), _PERSONS[(person - 1) % len(_PERSONS)]
        topics, colour = f"mocap/bodies/{body_id.removeprefix(self._prefix)}", ColorRGBA(r=r, g=g, b=b, a=1.0)
        every = (self._all_skeletons,)
        return PersonTopics(self._node, topics, body_id, self._settings, f"{body_id}/", colour, every)

    def _away(self, person: int, topics: PersonTopics, stamp_ns: int) -> None:
        """Publish once that a person has left; close the topics after CLOSED_AFTER_S."""
        last = topics.last
        if last is None or last.reason != LEFT:
            topics.publish_state(NoState(stamp_ns, LEFT, Tracking.LOST))
        elif not 0 <= stamp_ns - last.stamp_ns < CLOSED_AFTER_S * NS_PER_S:
            topics.close()
            del self._persons[person]
            self._on_closed(self.id_of(person))


# --- messages


def torso_message(state: BodyState, frame_id: str) -> PoseWithCovarianceStamped:
    """Pose of the torso's frame, with the 6x6 covariance in ROS's order x y z rx ry rz about the fixed axes."""
    message = PoseWithCovarianceStamped(header=_header(state.stamp_ns, frame_id))
    message.pose.pose.position = _point(state.pose.position_world)
    x, y, z, w = quaternion_of(state.pose.R_world_torso).tolist()
    message.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    message.pose.covariance = state.covariance[:6, :6].ravel()
    return message


def rotations_message(state: BodyState, frame_id: str) -> MultiDOFJointState:
    """Return every joint's rotation and angular velocity: without the singularities of angles."""
    motion = JointMotion.of(state.pose, state.velocity)
    return motion_message({FIRST_PERSON: motion}, state.stamp_ns, frame_id)


def state_message(state: BodyState | NoState, node_name: str) -> DiagnosticStatus:
    """Return the tracker's quality: message = its state; values = why, and the parts' states."""
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


def skeleton_markers(
    state: BodyState, body: Body, frame_id: str, namespace: str = "", colour: ColorRGBA | None = None
) -> MarkerArray:
    """Return sticks as one line list, joints as one sphere list; sticks in ``colour``, None for that of the state.

    Doubtful parts of the body have the colour of doubt. Namespaces and ids stay the same from set to set, so that a
    viewer replaces the markers; the last ones disappear after LIFETIME_S.
    """
    usual = TRACKED_COLOUR if state.tracking == Tracking.TRACKING else DOUBTFUL_COLOUR
    header, of_sticks = _header(state.stamp_ns, frame_id), colour or usual
    lines = _marker(header, f"{namespace}sticks", Marker.LINE_LIST, of_sticks)
    lines.scale.x = STICK_WIDTH_M
    lines.points = [_point(end) for end in sticks(body.bent(state.bend), state.pose).reshape(20, 3)]
    lines.colors = [one for one in _colours(state, PART_OF_STICK, of_sticks) for _ in range(2)]
    joints = _marker(header, f"{namespace}joints", Marker.SPHERE_LIST, usual)
    joints.scale.x = joints.scale.y = joints.scale.z = JOINT_DIAMETER_M
    joints.points = [_point(point) for point in state.points_world]
    joints.colors = _colours(state, PART_OF_POINT, usual)
    return MarkerArray(markers=[lines, joints])


def _colours(state: BodyState, part_of: Sequence[int] | np.ndarray, usual: ColorRGBA) -> list[ColorRGBA]:
    """Return a colour for each stick or point: that of doubt where its part of the body is doubtful."""
    of_part = [DOUBTFUL_COLOUR if part == DOUBTFUL else usual for part in state.parts]
    return [of_part[part] for part in part_of]


def _marker(header: Header, namespace: str, kind: int, colour: ColorRGBA) -> Marker:
    marker = Marker(header=header, ns=namespace, type=kind, action=Marker.ADD, color=colour)
    marker.lifetime = Duration(sec=LIFETIME_S)
    marker.pose.orientation.w = 1.0
    return marker


def _header(stamp_ns: int, frame_id: str) -> Header:
    return Header(stamp=to_stamp(stamp_ns), frame_id=frame_id)


def _point(xyz: np.ndarray) -> Point:
    x, y, z = xyz.tolist()
    return Point(x=x, y=y, z=z)
