"""``sagoma smooth`` on a recorded take: the same topics, quieter and nearer, and never over another bag."""

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from mocap_packets.fit import ReferencePoints
from sagoma_ros.packets import packet_cloud
from sagoma_tools.cli import main
from sagoma_tools.evaluation.track import track_from_bag
from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.recording.smoothing import SMOOTHED
from sagoma_tools.recording.writer import BagWriter
from stick_figure.body import Body
from stick_figure.body_file import format_body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

FPS, SETS, GAP, NOISE_M = 60, 60, range(30, 36), 0.01
FIRST_NS = 1_700_000_000_000_000_000


def stamp_ns(k):
    return FIRST_NS + round(k * 1e9 / FPS)


def points_of(body, k):
    angles = T_POSE_ANGLES.copy()
    angles[[8, 9]] = -0.6 - 0.5 * np.sin(2 * np.pi * k / FPS)
    return forward(body, Pose.from_angles(np.array([0.01 * k, 0.0, 1.0]), np.eye(3), angles))


@pytest.fixture
def bag(tmp_path):
    """Fits of a walker whose elbows bend, with noise; six sets in which nothing is seen."""
    body, rng, folder = Body.from_stature(1.75), np.random.default_rng(4), tmp_path / "take"
    with BagWriter(folder) as writer:
        writer.add_topic("/icp/body", "std_msgs/msg/String")
        writer.add_topic("/icp/reference_points", "sensor_msgs/msg/PointCloud2")
        writer.write("/icp/body", FIRST_NS, serialize_message(String(data=format_body(body))))
        for k in range(SETS):
            measured = points_of(body, k) + NOISE_M * rng.standard_normal((15, 3))
            points = ReferencePoints(measured, np.tile(NOISE_M**2 * np.eye(3), (15, 1, 1)), np.full(15, k not in GAP))
            cloud: PointCloud2 = packet_cloud(points, stamp_ns(k), "map")
            writer.write("/icp/reference_points", stamp_ns(k), serialize_message(cloud))
    return folder, np.array([points_of(body, k) for k in range(SETS)])


def test_take_is_smoothed_into_a_new_bag_with_a_state_at_every_set(bag, capsys):
    folder, truth = bag
    rigid = ["ekf_tracker.filter.measurement_bias.share=0.0", "ekf_tracker.filter.bend=0.0"]  # as the points are made
    assert main(["smooth", str(folder), "--set", rigid[0], "--set", rigid[1]]) == 0
    assert f"smoothed {SETS} of {SETS} frame sets" in capsys.readouterr().out
    smoothed = folder.with_name("take_smoothed")
    assert set(SMOOTHED) | {"/icp/body", "/icp/reference_points"} == set(bag_topics(smoothed))
    assert sum(message.topic == "/mocap/joint_covariance" for message in read_messages(smoothed)) == SETS
    track = track_from_bag(smoothed, lambda ns: round((ns - FIRST_NS) * FPS / 1e9))
    errors = np.linalg.norm(track.points_world - truth, axis=2)
    assert errors.mean() < 0.5 * NOISE_M * np.sqrt(8 / np.pi)  # mean length of the noise
    assert errors[GAP.start : GAP.stop].max() < 0.05


def test_no_bag_is_replaced_and_one_without_fits_is_refused(bag, tmp_path, capsys):
    folder, _ = bag
    assert main(["smooth", str(folder), str(folder)]) == 2
    assert "exists already" in capsys.readouterr().err
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic("/icp/body", "std_msgs/msg/String")
    assert main(["smooth", str(tmp_path / "other")]) == 2
    assert "/icp/reference_points" in capsys.readouterr().err
    assert not (tmp_path / "other_smoothed").exists()
