"""Joint states, the EKF's prediction and covariances as messages."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from poses import random_pose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import MultiDOFJointState

from capture_rig.errors import InputError
from mocap_packets.people import Predictions
from mocap_packets.state import Prediction
from sagoma_ros.joint_motion import predictions_message, read_predictions
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import covariance_cloud, joint_state_message
from stick_figure.kinematics import stick_frames
from stick_figure.pose import JOINT_NAMES, Pose
from stick_figure.skeleton import ANGLE_NAMES, PARENT, TANGENT_NAMES

STAMP = 1_700_000_000_123_456_789
TOPIC = "ekf/prediction"


def pose_of(seed: int) -> Pose:
    """Clear of the ranges' ends, where two triples of angles describe one rotation."""
    return random_pose(np.random.default_rng(seed), margin=0.05)


def message_of(prediction: Prediction) -> MultiDOFJointState:
    return predictions_message(Predictions(STAMP, {1: prediction}))


def good_message() -> MultiDOFJointState:
    return message_of(Prediction.of(STAMP, pose_of(0), np.arange(24) / 10))


def test_joint_state_has_names_angles_and_rates() -> None:
    angles, rates = np.linspace(-1, 1, 18), np.linspace(2, 3, 18)
    message = joint_state_message(ANGLE_NAMES, angles, rates, STAMP)
    assert tuple(message.name) == ANGLE_NAMES
    assert list(message.position) == angles.tolist() and list(message.velocity) == rates.tolist()
    assert to_ns(message.header.stamp) == STAMP


def test_everybodys_prediction_comes_back_as_the_same_pose_and_velocity() -> None:
    poses = {person: pose_of(person) for person in (1, 3, 4, 7)}
    velocities = {person: np.random.default_rng(person).normal(size=24) for person in poses}
    sent = {person: Prediction.of(STAMP, pose, velocities[person]) for person, pose in poses.items()}
    message = predictions_message(Predictions(STAMP, sent))
    assert message.joint_names[10] == "person_3/torso"
    found = read_predictions(message, TOPIC).of
    assert list(found) == list(poses)
    for person, prediction in found.items():
        assert prediction.stamp_ns == STAMP
        assert np.abs(prediction.pose.minus(poses[person])).max() < 1e-12
        assert np.array_equal(prediction.velocity, velocities[person])
        # the same bytes, whether it went over the wire or not
        for there, here in zip(prediction.pose.arrays, sent[person].pose.arrays, strict=True):
            assert np.array_equal(there, here)


def test_prediction_message_holds_each_joint_in_the_axes_of_its_carrier() -> None:
    pose, velocity = pose_of(5), np.random.default_rng(5).normal(size=24)
    message = message_of(Prediction.of(STAMP, pose, velocity))
    assert tuple(message.joint_names) == JOINT_NAMES and message.header.frame_id == "map"
    torso = message.transforms[0].translation
    assert [torso.x, torso.y, torso.z] == pose.position_world.tolist()
    assert all((t.translation.x, t.translation.y, t.translation.z) == (0, 0, 0) for t in message.transforms[1:])
    frames, step_s = stick_frames(pose), 1e-6
    moved = stick_frames(pose.retract(velocity * step_s))
    for k, (transform, twist) in enumerate(zip(message.transforms, message.twist, strict=True)):
        carrier = np.eye(3) if PARENT[k] < 0 else frames[PARENT[k]]
        carrier_moved = np.eye(3) if PARENT[k] < 0 else moved[PARENT[k]]
        q = transform.rotation
        turned = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(carrier @ turned, frames[k], atol=1e-9)
        after = carrier_moved.T @ moved[k]
        rate = Rotation.from_matrix(after @ turned.T).as_rotvec() / step_s
        found = np.array([twist.angular.x, twist.angular.y, twist.angular.z])
        if k != 1:  # the neck's third degree of freedom follows from the other two
            np.testing.assert_allclose(found, rate, atol=1e-4)


def test_filter_without_a_state_says_so_with_its_stamp() -> None:
    message = message_of(Prediction(STAMP))
    assert (len(message.joint_names), len(message.transforms), len(message.twist)) == (0, 0, 0)
    prediction = read_predictions(message, TOPIC).of[1]
    assert (prediction.stamp_ns, prediction.pose) == (STAMP, None)
    assert prediction.velocity.tolist() == [0] * 24


def refusal(message: MultiDOFJointState) -> str:
    with pytest.raises(InputError) as caught:
        read_predictions(message, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ") and caught.value.remedy
    return str(caught.value)


def test_prediction_with_a_number_that_is_not_finite_is_refused() -> None:
    turned, moving = good_message(), good_message()
    turned.transforms[7].rotation.y = moving.twist[0].angular.x = np.inf
    assert "not finite" in refusal(turned) and "not finite" in refusal(moving)


def test_prediction_of_no_rotation_other_joints_or_in_another_order_is_refused() -> None:
    flat, other, turned_round, twice = (good_message() for _ in range(4))
    flat.transforms[3].rotation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
    assert "length 1" in refusal(flat)
    other.joint_names = [*JOINT_NAMES[:-1], "tail"]
    turned_round.joint_names = list(reversed(JOINT_NAMES))
    for field in ("joint_names", "transforms", "twist"):
        setattr(twice, field, [*getattr(twice, field), *getattr(twice, field)])
    for message in (other, turned_round, twice):
        assert "names" in refusal(message)


@pytest.mark.parametrize(("transforms", "twists"), [(9, 10), (10, 9), (0, 0)])
def test_prediction_with_joints_missing_is_refused(transforms: int, twists: int) -> None:
    message = good_message()
    message.transforms, message.twist = message.transforms[:transforms], message.twist[:twists]
    assert "lengths" in refusal(message)


def test_covariance_has_a_stamp_and_named_columns() -> None:
    covariance = np.random.default_rng(3).normal(size=(24, 24))
    message = covariance_cloud(TANGENT_NAMES, covariance, STAMP, "map")
    assert (to_ns(message.header.stamp), message.header.frame_id) == (STAMP, "map")
    assert [field.name for field in message.fields] == list(TANGENT_NAMES)
    layout = np.dtype({"names": TANGENT_NAMES, "formats": ["<f8"] * 24, "offsets": [f.offset for f in message.fields]})
    rows = np.frombuffer(message.data, layout)
    assert (message.height, message.width, message.point_step) == (1, 24, layout.itemsize)
    for column, name in enumerate(TANGENT_NAMES):
        assert np.array_equal(rows[name], covariance[:, column])
