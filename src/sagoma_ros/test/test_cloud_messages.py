"""Clouds, joint states and predictions: our layouts there and back, what others send, and what is refused."""

from __future__ import annotations

import array
import struct
from collections.abc import Callable

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion, Transform, Twist, Vector3
from numpy.lib.recfunctions import repack_fields
from poses import random_pose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import MultiDOFJointState, PointCloud2, PointField

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.hull import Centerline, ContourRays, VoxelSamples
from mocap_packets.people import AnsweredSet, Predictions
from mocap_packets.state import Prediction
from mocap_packets.table import SetAges
from sagoma_ros.messages import latency_message, read_latency, to_ns
from sagoma_ros.packets import from_cloud, packet_cloud, read_packet, read_reference_points, to_cloud
from sagoma_ros.poses import predictions_message, read_predictions
from stick_figure.kinematics import stick_frames
from stick_figure.pose import JOINT_NAMES, Pose
from stick_figure.skeleton import PARENT

STAMP = 1_700_000_000_123_456_789
TOPIC = "hull/voxels"
CENTERLINE, VOXELS = Centerline.LAYOUT, VoxelSamples.LAYOUT
KINDS = (Centerline, VoxelSamples, ContourRays, ReferencePoints)


def random_points(layout: np.dtype, count: int, **columns: float) -> np.ndarray:
    """Numbers that single precision holds; single columns as given."""
    table = np.random.default_rng(1).normal(size=(count, len(layout.names))).astype(np.float32).astype(np.float64)
    points = table.view(layout).reshape(-1)
    for name, value in columns.items():
        points[name] = value
    return points


def foreign_cloud(rows: list[tuple], pattern: str, fields: list[tuple[str, int, int]]) -> PointCloud2:
    """A cloud as another program may pack it: ``pattern`` of struct, fields (name, offset, datatype)."""
    step = struct.calcsize(pattern)
    cloud = PointCloud2(height=1, width=len(rows), point_step=step, row_step=step * len(rows))
    cloud.is_bigendian = pattern.startswith(">")
    cloud.fields = [PointField(name=n, offset=o, datatype=d, count=1) for n, o, d in fields]
    cloud.data = array.array("B", b"".join(struct.pack(pattern, *row) for row in rows))
    return cloud


def floats(*names: str) -> list[tuple[str, int, int]]:
    return [(name, 4 * index, PointField.FLOAT32) for index, name in enumerate(names)]


MIXED = [
    ("surface", 0, PointField.UINT8),
    ("z", 4, PointField.FLOAT32),
    ("rgb", 8, PointField.UINT32),
    ("y", 12, PointField.INT16),
    ("x", 16, PointField.FLOAT64),
]


@pytest.mark.parametrize(
    ("cloud", "expected"),
    [
        pytest.param(
            foreign_cloud([(1, 0.5, 7, -3, 0.25), (0, 1.5, 7, 4, 1e3)], "<BxxxfIhxxd", MIXED),
            [(0.25, -3.0, 0.5, 1.0, 0.0), (1000.0, 4.0, 1.5, 0.0, 0.0)],
            id="other order, types, padding, extra field",
        ),
        pytest.param(
            foreign_cloud([(1.0, -2.0, 3.5, 1.0)], ">4f", floats("x", "y", "z", "surface")),
            [(1.0, -2.0, 3.5, 1.0, 0.0)],
            id="big endian",
        ),
        pytest.param(
            foreign_cloud([(1, 2, 3, 1, np.nan)], "<5f", floats("x", "y", "z", "surface", "normal")),
            [(1, 2, 3, 1, 0)],
            id="NaN in a field that is not ours",
        ),
    ],
)
def test_cloud_of_another_program_is_read(cloud: PointCloud2, expected: list[tuple]) -> None:
    points = from_cloud(cloud, VOXELS, TOPIC)
    assert points.dtype == VOXELS and points.tolist() == expected


def test_organised_cloud_with_padded_rows_is_read() -> None:
    points = random_points(VOXELS, 6)
    cloud = to_cloud(points, STAMP, "map")
    data = bytes(cloud.data)
    rows = [data[: len(data) // 2] + b"\xff" * 8, data[len(data) // 2 :] + b"\xff" * 8]
    cloud.height, cloud.width, cloud.row_step, cloud.data = 2, 3, len(rows[0]), array.array("B", b"".join(rows))
    assert np.array_equal(from_cloud(cloud, VOXELS, TOPIC), points)


def spoilt(fields: str = "xyzsb", z: dict[str, int] | None = None, **changes: object) -> PointCloud2:
    """A cloud of three voxels with some of its fields, by first letter; a changed field z; changed members."""
    cloud = to_cloud(random_points(VOXELS, 3), STAMP, "map")
    cloud.fields = [field for field in cloud.fields if field.name[0] in fields]
    for holder, values in ((cloud.fields[2], z or {}), (cloud, changes)):
        for name, value in values.items():
            setattr(holder, name, value)
    return cloud


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (PointCloud2(), "no field 'x'"),
        (spoilt(fields="xyzb"), "no field 'surface' (it has: x, y, z, body)"),
        (spoilt(data=spoilt().data[:-1]), "59 bytes do not fit"),
        (spoilt(height=3, width=2, row_step=20), "60 bytes do not fit"),
        (spoilt(z={"offset": 18}), "do not fit"),
        (spoilt(z={"datatype": 9}), "do not fit"),
        (to_cloud(random_points(VOXELS, 4, y=np.inf), STAMP, "map"), "not finite"),
    ],
)
def test_cloud_that_cannot_be_read_is_refused_with_topic_cause_and_remedy(cloud: PointCloud2, said: str) -> None:
    with pytest.raises(InputError) as caught:
        from_cloud(cloud, VOXELS, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ") and caught.value.remedy
    assert said in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_packet_comes_back_with_the_same_table_in_double_precision(kind) -> None:
    table = random_points(kind.LAYOUT, 15)
    for name in {"axis", "body", "camera", "surface", "visible", "doubtful", "moved"} & set(table.dtype.names):
        table[name] = np.arange(15) % 2
    cloud = packet_cloud(kind.from_table(table), STAMP, "map")
    assert (to_ns(cloud.header.stamp), cloud.header.frame_id) == (STAMP, "map")
    packet = read_packet(cloud, kind, TOPIC)
    assert packet.points_world.dtype == np.float64
    assert packet.points_world[1].tolist() == [table["x"][1], table["y"][1], table["z"][1]]
    assert np.array_equal(packet.to_table(), table)
    if kind is not ReferencePoints:
        assert len(read_packet(packet_cloud(kind.from_table(table[:0]), STAMP, "map"), kind, TOPIC)) == 0


def test_another_number_of_reference_points_is_refused() -> None:
    with pytest.raises(InputError, match="14 points"):
        read_reference_points(to_cloud(random_points(ReferencePoints.LAYOUT, 14), STAMP, "map"), TOPIC)


@pytest.mark.parametrize(("layout", "name"), [(CENTERLINE, "body"), (ReferencePoints.LAYOUT, "doubtful")])
def test_cloud_of_a_former_version_is_of_one_body_and_nothing_in_it_is_doubtful(layout: np.dtype, name: str) -> None:
    points = random_points(layout, 15, **{name: 1.0})
    former = repack_fields(points[[each for each in layout.names if each != name]])
    assert (from_cloud(to_cloud(points, STAMP, "map"), layout, TOPIC)[name] == 1.0).all()
    read = from_cloud(to_cloud(former, STAMP, "map"), layout, TOPIC)
    assert (read[name] == 0.0).all() and np.array_equal(read["z"], points["z"])


# --- joint states, predictions, latencies ----------------------------------------------------------------------------

PREDICTION_TOPIC = "ekf/prediction"


def pose_of(seed: int) -> Pose:
    """Clear of the ranges' ends, where two triples of angles describe one rotation."""
    return random_pose(np.random.default_rng(seed), margin=0.05)


def message_of(prediction: Prediction) -> MultiDOFJointState:
    return predictions_message(Predictions(STAMP, {1: prediction}))


def test_everybodys_prediction_comes_back_as_the_same_pose_and_velocity() -> None:
    poses = {person: pose_of(person) for person in (1, 3, 4, 7)}
    velocities = {person: np.random.default_rng(person).normal(size=24) for person in poses}
    sent = {person: Prediction.of(STAMP, pose, velocities[person]) for person, pose in poses.items()}
    message = predictions_message(Predictions(STAMP, sent))
    assert message.joint_names[10] == "person_3/torso"
    found = read_predictions(message, PREDICTION_TOPIC).of
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


def twice(rows: list) -> list:
    return [*rows, *rows]


def with_rotation(row: int, **quaternion: float) -> Callable[[list[Transform]], list[Transform]]:
    def change(transforms: list[Transform]) -> list[Transform]:
        transforms[row].rotation = Quaternion(**quaternion)
        return transforms

    return change


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"transforms": with_rotation(7, y=float("inf"))}, "not finite"),
        ({"twist": lambda twists: [Twist(angular=Vector3(x=float("nan"))), *twists[1:]]}, "not finite"),
        ({"transforms": with_rotation(3, w=0.0)}, "length 1"),
        ({"joint_names": lambda names: [*names[:-1], "tail"]}, "names"),
        ({"joint_names": lambda names: names[::-1]}, "names"),
        ({"joint_names": twice, "transforms": twice, "twist": twice}, "names"),
        ({"transforms": lambda rows: rows[:9]}, "lengths"),
        ({"twist": lambda rows: rows[:9]}, "lengths"),
        ({"transforms": lambda rows: [], "twist": lambda rows: []}, "lengths"),
    ],
    ids=["infinite", "nan", "no rotation", "other joint", "other order", "twice", "short", "few twists", "empty"],
)
def test_prediction_that_cannot_be_read_is_refused(changes, says: str) -> None:
    message = message_of(Prediction.of(STAMP, pose_of(0), np.arange(24) / 10))
    for name, change in changes.items():
        setattr(message, name, change(getattr(message, name)))
    with pytest.raises(InputError, match=f"^{PREDICTION_TOPIC}: .*{says}") as caught:
        read_predictions(message, PREDICTION_TOPIC)
    assert caught.value.remedy


def test_latency_comes_back_to_a_microsecond_or_is_unknown() -> None:
    answered = AnsweredSet(STAMP, SetAges(9_000_000, 15_501_000, 17_000_000, 18_250_000))
    for each in (answered, AnsweredSet(STAMP)):
        assert read_latency(latency_message(each), TOPIC) == each
    message = latency_message(answered)
    message.status[0].values.pop()
    with pytest.raises(InputError, match=f"^{TOPIC}: is no latency of a frame set"):
        read_latency(message, TOPIC)
