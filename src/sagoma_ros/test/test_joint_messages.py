"""Joint states, the EKF's prediction and covariances as messages."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from capture_rig.errors import InputError
from mocap_packets.state import Prediction
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import covariance_message, joint_state_message, prediction_message, read_prediction
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES, TANGENT_NAMES

STAMP = 1_700_000_000_123_456_789
TOPIC = "ekf/prediction"


def random_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    margin = 0.05  # clear of the ranges' ends, where two triples of angles describe one rotation
    angles = rng.uniform(ANGLE_LOW + margin, ANGLE_HIGH - margin)
    return Pose.from_angles(rng.normal(size=3), Rotation.from_quat(rng.normal(size=4)).as_matrix(), angles)


def good_message() -> JointState:
    return prediction_message(Prediction(STAMP, random_pose(0), np.arange(24) / 10))


def refusal(message: JointState) -> str:
    with pytest.raises(InputError) as caught:
        read_prediction(message, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ")
    assert caught.value.remedy
    return str(caught.value)


def test_joint_state_has_names_angles_and_rates() -> None:
    angles, rates = np.linspace(-1, 1, 18), np.linspace(2, 3, 18)
    message = joint_state_message(ANGLE_NAMES, angles, rates, STAMP)
    assert tuple(message.name) == ANGLE_NAMES
    assert list(message.position) == angles.tolist() and list(message.velocity) == rates.tolist()
    assert to_ns(message.header.stamp) == STAMP


@pytest.mark.parametrize("seed", range(20))
def test_prediction_comes_back_as_the_same_pose_and_velocity(seed: int) -> None:
    pose, velocity = random_pose(seed), np.random.default_rng(seed).normal(size=24)
    prediction = read_prediction(prediction_message(Prediction(STAMP, pose, velocity)), TOPIC)
    assert prediction.stamp_ns == STAMP
    assert prediction.pose is not None
    assert np.abs(prediction.pose.position_world - pose.position_world).max() < 1e-12
    assert np.abs(prediction.pose.R_world_torso - pose.R_world_torso).max() < 1e-9
    assert np.abs(prediction.pose.R_joints - pose.R_joints).max() < 1e-9
    assert np.abs(prediction.pose.hinges - pose.hinges).max() < 1e-9
    assert np.array_equal(prediction.velocity, velocity)


def test_prediction_message_names_the_24_tangent_slots_in_the_map_frame() -> None:
    message = good_message()
    assert tuple(message.name) == TANGENT_NAMES
    assert message.header.frame_id == "map"
    assert len(message.position) == len(message.velocity) == 24


def test_filter_without_a_state_says_so_with_its_stamp() -> None:
    message = prediction_message(Prediction(STAMP, None, np.zeros(24)))
    assert (len(message.name), len(message.position), len(message.velocity)) == (0, 0, 0)
    prediction = read_prediction(message, TOPIC)
    assert (prediction.stamp_ns, prediction.pose) == (STAMP, None)
    assert prediction.velocity.tolist() == [0] * 24


@pytest.mark.parametrize("field", ["position", "velocity"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_prediction_with_a_number_that_is_not_finite_is_refused(field: str, bad: float) -> None:
    message = good_message()
    getattr(message, field)[7] = bad
    assert "not finite" in refusal(message)


def test_prediction_of_other_joints_is_refused() -> None:
    message = good_message()
    message.name = [*TANGENT_NAMES[:-1], "tail"]
    assert "names" in refusal(message)


def test_prediction_in_another_order_is_refused() -> None:
    message = good_message()
    message.name = list(reversed(TANGENT_NAMES))
    assert "names" in refusal(message)


@pytest.mark.parametrize(("positions", "velocities"), [(23, 24), (24, 23), (24, 0), (0, 24), (23, 23), (0, 0)])
def test_prediction_with_numbers_missing_is_refused(positions: int, velocities: int) -> None:
    message = good_message()
    message.position, message.velocity = [0.0] * positions, [0.0] * velocities
    assert "lengths" in refusal(message)


def test_covariance_is_labelled_row_by_row() -> None:
    covariance = np.random.default_rng(3).normal(size=(24, 24))
    message = covariance_message(TANGENT_NAMES, covariance)
    rows, columns = message.layout.dim
    assert (rows.size, rows.stride, columns.size, columns.stride) == (24, 576, 24, 24)
    assert tuple(rows.label.split(",")) == tuple(columns.label.split(",")) == TANGENT_NAMES
    assert message.data[5 * columns.stride + 7] == covariance[5, 7]
