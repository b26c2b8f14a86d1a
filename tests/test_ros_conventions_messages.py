"""Messages that ROS people read without a manual: stamps to pair by, one unit a field."""

from collections import defaultdict

import numpy as np
import pytest
from ekf_person import Person
from node_probe import NodeProbe
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2

from ekf_tracker.ekf_node import EkfNode
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import FITTED_PEOPLE, tables_message
from sagoma_ros.qos import RESULT
from stick_figure.body import Body
from stick_figure.kinematics import stick_frames
from stick_figure.pose import JOINT_NAMES, Pose
from stick_figure.skeleton import ANGLE_NAMES, PARENT, TANGENT_NAMES

EPOCH_NS, PERIOD_NS = 5_000_000_000, 16_666_667
TOPICS = {
    "mocap/joint_states": JointState,
    "mocap/joint_covariance": PointCloud2,
    "mocap/joint_rotations": MultiDOFJointState,
    "ekf/prediction": MultiDOFJointState,
}


@pytest.fixture
def heard(open_probe):
    """Everything of the topics above, by stamp, of four sets that the filter answered."""
    person = Person(Body.from_stature(1.75))
    probe = open_probe(NodeProbe, EkfNode)
    people = probe.peer.create_publisher(FITTED_PEOPLE.kind, FITTED_PEOPLE.name, RESULT)
    found = {topic: probe.listen(kind, topic) for topic, kind in TOPICS.items()}
    probe.start()
    probe.until(people.get_subscription_count)
    probe.until(lambda: all(probe.node.count_subscribers(topic) for topic in TOPICS))
    for k in range(4):
        measured = ReferencePoints(person.points(k / 60), np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
        fitted = FittedPeople(EPOCH_NS + k * PERIOD_NS, PeoplePoints({1: measured}), {1: person.body})
        people.publish(tables_message(fitted, "map"))
        probe.until(lambda wanted=k + 1: all(len(messages) == wanted for messages in found.values()))
    by_stamp = defaultdict(dict)
    for topic, messages in found.items():
        for message in messages:
            by_stamp[to_ns(message.header.stamp)][topic] = message
    return list(by_stamp.values())


def test_covariance_and_rotations_pair_with_the_joint_states_by_stamp(heard):
    assert len(heard) == 4 and all(set(together) == set(TOPICS) for together in heard)
    for together in heard:
        cloud = together["mocap/joint_covariance"]
        columns = [field.name for field in cloud.fields]
        matrix = np.frombuffer(cloud.data, "<f8").reshape(len(columns), len(columns))
        assert columns == list(TANGENT_NAMES) and set(together["mocap/joint_states"].name) <= set(columns)
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
        assert np.linalg.eigvalsh(matrix).min() > 0


def test_rotations_say_the_same_as_the_angles(heard):
    for together in heard:
        angles = dict(zip(together["mocap/joint_states"].name, together["mocap/joint_states"].position, strict=True))
        message = together["mocap/joint_rotations"]
        torso = Rotation.from_quat(quaternion(message.transforms[0]))
        frames = stick_frames(Pose.from_angles(np.zeros(3), torso.as_matrix(), [angles[n] for n in ANGLE_NAMES]))
        assert tuple(message.joint_names) == JOINT_NAMES
        for k, transform in enumerate(message.transforms[1:], 1):
            relative = frames[PARENT[k]].T @ frames[k]
            np.testing.assert_allclose(Rotation.from_quat(quaternion(transform)).as_matrix(), relative, atol=1e-6)


def quaternion(transform):
    q = transform.rotation
    return [q.x, q.y, q.z, q.w]
