"""The topics of each person: mocap/... of the first, mocap/bodies/ID/... of everybody who has been there.

Publishers under mocap/bodies/ID are made when the person appears, and closed when the person has been away for
CLOSED_AFTER_S: whoever listens has heard of the leaving by then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from capture_rig.stamps import NS_PER_S
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.state import BodyState, NoState, Tracking
from sagoma_ros.intra_process import LazyPublisher
from sagoma_ros.packets import covariance_cloud, joint_state_message, packet_cloud
from sagoma_ros.qos import LATCHED, RESULT
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, TANGENT_NAMES

from .motion_model import POSE
from .rep155 import body_id_of
from .settings import EkfNodeSettings
from .state_ros import (
    SkeletonStyle,
    deleted_markers,
    rotations_message,
    silence_message,
    skeleton_markers,
    state_message,
    torso_message,
)
from .urdf import body_urdf, same_sizes

CLOSED_AFTER_S = 10.0  # of the sets' time; long enough to walk round a room and come back
LEFT = "has left"

Answer = BodyState | NoState


def is_tracked(answer: Answer) -> bool:
    """Return whether an answer has a body that is not lost."""
    return isinstance(answer, BodyState) and answer.tracking != Tracking.LOST


class Skeleton:
    """One person's markers on one or two topics: replaced at a bounded rate, red once when lost, deleted when gone."""

    def __init__(self, publishers: tuple[LazyPublisher, ...], style: SkeletonStyle, rate_hz: float) -> None:
        self._publishers, self._style = publishers, style
        self._period_ns = round(NS_PER_S / rate_hz) if rate_hz else 0
        self._next_ns = 0
        self._shown: MarkerArray | None = None
        self._lost = False

    def show(self, state: BodyState, body: Body) -> None:
        """Draw a state when the next drawing is due, or the body was lost with it."""
        was_lost, self._lost = self._lost, state.tracking == Tracking.LOST
        if was_lost if self._lost else state.stamp_ns < self._next_ns:
            return
        self._next_ns = state.stamp_ns + self._period_ns
        heard = [publisher for publisher in self._publishers if publisher.is_wanted]
        if heard:
            self._shown = skeleton_markers(state, body, self._style)
            self._publish(heard, self._shown)

    def clear(self, stamp_ns: int) -> None:
        """Delete what is shown; stamps may begin anew."""
        self._next_ns, self._lost = 0, False
        if self._shown is not None:
            self._publish(self._publishers, deleted_markers(self._shown.markers, stamp_ns))
            self._shown = None

    def _publish(self, publishers: Any, message: MarkerArray) -> None:
        for publisher in publishers:
            publisher.publish(lambda: message)


class PersonTopics:
    """What is published of one person under one prefix."""

    def __init__(
        self,
        node: Node,
        prefix: str,
        body_id: str,
        settings: EkfNodeSettings,
        style: SkeletonStyle,
        all_skeletons: tuple[LazyPublisher, ...] = (),
    ) -> None:
        """``all_skeletons`` : the publisher of everybody's markers, where these are to be among them."""
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
        self._skeleton = Skeleton(
            (publisher(MarkerArray, "skeleton"), *all_skeletons), style, settings.skeleton_rate_hz
        )
        self._state = publisher(DiagnosticStatus, "state")
        self._description = publisher(String, "robot_description", LATCHED)
        self._body_id = body_id
        self._described: Body | None = None
        self.last: Answer | None = None  # of the person's answers

    def publish_body(self, answer: Answer, body: Body | None) -> None:
        """Publish the body of an answer that has one; the lost one is but drawn, once."""
        if not isinstance(answer, BodyState) or body is None:
            self._skeleton.clear(answer.stamp_ns)
            return
        state, frame = answer, self._frame
        if is_tracked(state):
            self._describe(body)
            stamp_ns, angles, rates = state.stamp_ns, state.angles, state.rates
            self._joint_states.publish(joint_state_message, ANGLE_NAMES, angles, rates, stamp_ns, frame)
            self._torso.publish(torso_message, state, frame)
            self._joint_rotations.publish(rotations_message, state, frame)
            covariance = state.covariance[POSE, POSE]
            self._joint_covariance.publish(covariance_cloud, TANGENT_NAMES, covariance, stamp_ns, frame)
            self._reference_points.publish(packet_cloud, state.reference_points, stamp_ns, frame)
        self._skeleton.show(state, body)

    def _describe(self, body: Body) -> None:
        """Publish the body's URDF whenever its sizes have changed."""
        if not same_sizes(body, self._described):
            self._described = body
            self._description.publish(lambda: String(data=body_urdf(body, self._body_id)))

    def publish_state(self, answer: Answer) -> None:
        """Publish how far to trust an answer."""
        self.last = answer
        self._state.publish(state_message, answer, self._name)

    def publish_stale(self, reason: str) -> Tracking:
        """Publish that no sets come any more: the body is lost, its markers go. Returns the person's state."""
        tracking = Tracking.LOST if isinstance(self.last, BodyState) else Tracking.ACQUIRING
        self._skeleton.clear(0 if self.last is None else self.last.stamp_ns)
        self._state.publish(silence_message, tracking, reason, self._name)
        return tracking

    def close(self) -> None:
        """Take the topics back."""
        for publisher in self._opened:
            publisher.close()


class PeopleTopics:
    """Publishes everybody's answers to one frame set after another."""

    def __init__(self, node: Node, settings: EkfNodeSettings, tf_prefix: str, on_closed: Callable[[str], None]) -> None:
        """``on_closed(body_id)`` is called when a person has left for good. InputError for a body_id that is none."""
        self._node, self._settings, self._prefix, self._on_closed = node, settings, tf_prefix, on_closed
        plain = SkeletonStyle(settings.frame_id, settings.skeleton_covariance)
        self._first = PersonTopics(node, "mocap", self.id_of(FIRST_PERSON), settings, plain)
        self._all_skeletons = LazyPublisher(node, MarkerArray, "mocap/skeletons")
        self._names = LazyPublisher(node, String, "mocap/point_names", LATCHED)
        self._names.publish(lambda: String(data=",".join(POINT_NAMES)))
        self._persons: dict[int, PersonTopics] = {}

    def id_of(self, person: int) -> str:
        """Return the person's id in frames, URDFs and /humans; topics of the graph have it without its prefix."""
        return body_id_of(self._prefix + self._settings.body_id, person)

    def publish_bodies(self, answers: Mapping[int, Answer], bodies: Mapping[int, Body]) -> None:
        """Publish the bodies of one set's answers, in order; a person who appears gets topics."""
        for person, answer in answers.items():
            if person == FIRST_PERSON:
                self._first.publish_body(answer, bodies.get(person))
            if person not in self._persons and isinstance(answer, BodyState):
                self._persons[person] = self._topics_of(person)
            if person in self._persons:
                self._persons[person].publish_body(answer, bodies.get(person))

    def publish_states(self, answers: Mapping[int, Answer], stamp_ns: int) -> None:
        """Publish how far to trust each answer; who is not among them has left."""
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

    def clear(self) -> None:
        """Delete everybody's markers: stamps, or the tracking, begin anew."""
        for topics in (self._first, *self._persons.values()):
            if topics.last is not None:
                topics.publish_body(NoState(topics.last.stamp_ns, ""), None)

    def close(self) -> None:
        """Take all topics back."""
        for topics in (self._first, *self._persons.values()):
            topics.close()
        self._all_skeletons.close()
        self._names.close()

    def _topics_of(self, person: int) -> PersonTopics:
        body_id, settings = self.id_of(person), self._settings
        style = SkeletonStyle.of_person(person, body_id, settings.frame_id, settings.skeleton_covariance)
        topics = f"mocap/bodies/{body_id.removeprefix(self._prefix)}"
        return PersonTopics(self._node, topics, body_id, settings, style, (self._all_skeletons,))

    def _away(self, person: int, topics: PersonTopics, stamp_ns: int) -> None:
        """Say once that a person has left; close the topics of one who has been away for long."""
        last = topics.last
        if last is None or last.reason != LEFT:
            gone = NoState(stamp_ns, LEFT, Tracking.LOST)
            topics.publish_body(gone, None)
            topics.publish_state(gone)
        elif not 0 <= stamp_ns - last.stamp_ns < CLOSED_AFTER_S * NS_PER_S:
            topics.close()
            del self._persons[person]
            self._on_closed(self.id_of(person))
