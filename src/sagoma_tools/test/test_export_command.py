"""``sagoma export`` on bags as the graph records them."""

import csv

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation

from mocap_packets.fit import ReferencePoints
from sagoma_ros.messages import to_stamp
from sagoma_ros.packets import joint_state_message, packet_cloud
from sagoma_tools.cli import main
from sagoma_tools.recording.recorded_motion import recorded_motions
from sagoma_tools.recording.writer import BagWriter
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES

EPOCH_NS, FRAMES = 1_000_000_000_000_000_000, 20
TYPES = {
    "reference_points": "sensor_msgs/msg/PointCloud2",
    "joint_states": "sensor_msgs/msg/JointState",
    "torso": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def write_take(folder, prefixes=("/mocap",), left_out=()):
    """A bag of a person in the T-pose who moves along y by 1 cm a frame (the second one stands a metre ahead)."""
    body = Body.from_stature(1.7)
    with BagWriter(folder) as bag:
        for kind, msgtype in TYPES.items():
            for prefix in prefixes:
                bag.add_topic(f"{prefix}/{kind}", msgtype)
        for frame in range(FRAMES):
            stamp = EPOCH_NS + frame * 20_000_000
            for ahead, prefix in enumerate(prefixes):
                if frame in left_out:
                    continue
                pose = Pose.from_angles(np.array([ahead, 0.01 * frame, 1.1]), np.eye(3), T_POSE_ANGLES)
                points = ReferencePoints(forward(body, pose), np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
                cloud = packet_cloud(points, stamp, "map")
                angles = joint_state_message(ANGLE_NAMES, T_POSE_ANGLES, np.zeros(18), stamp)
                for kind, message in zip(TYPES, (cloud, angles, torso(pose, stamp)), strict=True):
                    bag.write(f"{prefix}/{kind}", stamp, serialize_message(message))
    return folder


def torso(pose, stamp_ns):
    message = PoseWithCovarianceStamped()
    message.header.stamp = to_stamp(stamp_ns)
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, place.z = pose.position_world
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(pose.R_world_torso).as_quat()
    return message


def test_every_format_is_written_beside_the_take(tmp_path, capsys):
    take = write_take(tmp_path / "first")
    assert main(["export", str(take)]) == 0
    names = {path.name for path in (take / "export").iterdir()}
    assert names == {f"first.{kind}" for kind in ("bvh", "glb", "c3d", "trc", "osim", "mot", "csv")}
    assert "b0001: 20 frames at 50 Hz, no gaps" in capsys.readouterr().out


def test_numbers_of_the_bag_arrive(tmp_path):
    take = write_take(tmp_path / "first", left_out=(7, 8))
    assert main(["export", str(take), "--format", "csv", "--output", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "first.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows].count("") == 2 and rows[7]["state"] == ""
    assert float(rows[19]["torso_y_m"]) - float(rows[0]["torso_y_m"]) == pytest.approx(0.19, abs=1e-6)


def test_several_persons_get_a_file_each(tmp_path):
    take = write_take(tmp_path / "two", prefixes=("/mocap", "/mocap/bodies/b0002"))
    motions = recorded_motions(take)
    assert sorted(motions) == ["b0001", "b0002"]
    assert motions["b0002"].points_world[0, 0, 0] - motions["b0001"].points_world[0, 0, 0] == pytest.approx(1.0)
    assert main(["export", str(take), "--format", "bvh", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "two_b0001.bvh").exists() and (tmp_path / "two_b0002.bvh").exists()


def test_files_that_exist_are_not_overwritten(tmp_path, capsys):
    take = write_take(tmp_path / "first")
    arguments = ["export", str(take), "--format", "trc", "bvh"]
    assert main(arguments) == 0
    (take / "export" / "first.trc").write_text("mine")
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (take / "export" / "first.trc").read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert (take / "export" / "first.trc").read_text() != "mine"


def test_a_bag_without_a_person_is_refused(tmp_path, capsys):
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/mocap/reference_points", TYPES["reference_points"])
    assert main(["export", str(tmp_path / "empty")]) == 2
    assert "holds no tracked person" in capsys.readouterr().err
