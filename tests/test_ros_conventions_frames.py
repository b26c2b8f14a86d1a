"""What ROS people read without a manual: cameras on /tf_static, bodies on /tf, a URDF that the joint states move,
one unit a field.

tf2_msgs is in every ROS installation, not in the wheels: where it is not, a stand-in takes what would be published.
"""

import importlib.util
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from ekf_person import Person
from ekf_probe import EkfProbe
from geometry_msgs.msg import TransformStamped
from hull_probe import HullProbe
from node_probe import SUCCESS, NodeProbe
from poses import random_pose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from capture_rig import save_rig
from ekf_tracker.urdf import body_urdf, link_name
from hull_server.hull_ros import camera_frames
from sagoma_ros import poses as ros_poses
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import read_reference_points
from sagoma_ros.qos import LATCHED
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES
from virtual_studio.rig import ring

BODY_ID, RIG = "b0001", ring(3)
LINK_OF_POINT = [link_name(BODY_ID, {"head": "head_top"}.get(name, name)) for name in POINT_NAMES]
MM = 1e-3
SHOULDER_OF_ARM = np.isin(np.arange(15), (3, 7, 11))[:, None] * [0.0, 0.0, 1.0]  # the left one, and its arm, up
START_NS, FPS = 5_000_000_000, 30.0


@pytest.fixture
def person() -> Person:
    return Person(Body.from_stature(1.82))


def urdf_frames(text, angles, torso):
    """Every link's transform (4, 4) by the URDF alone: what robot_state_publisher does with joint states."""
    robot = ElementTree.fromstring(text)
    links = [link.get("name") for link in robot.findall("link")]
    assert len(set(links)) == len(links) and links[0] == link_name(BODY_ID, "torso")
    placed = {links[0]: torso}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        local = np.eye(4)
        local[:3, 3] = [float(v) for v in joint.find("origin").get("xyz").split()]
        if joint.get("type") != "fixed":
            axis = np.array([float(v) for v in joint.find("axis").get("xyz").split()])
            local[:3, :3] = Rotation.from_rotvec(angles[joint.get("name")] * axis).as_matrix()
        assert child not in placed
        placed[child] = placed[parent] @ local
    assert set(placed) == set(links)
    return placed


def homogeneous(R, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


@pytest.mark.parametrize("seed", range(5))
def test_forward_kinematics_of_the_urdf_by_the_joint_states_gives_the_figures_points(seed):
    rng = np.random.default_rng(seed)
    body, pose = Body.from_stature(rng.uniform(1.4, 2.0)), random_pose(rng)
    text, torso = body_urdf(body, BODY_ID), homogeneous(pose.R_world_torso, pose.position_world)
    joints = ElementTree.fromstring(text).findall("joint")
    assert sorted(joint.get("name") for joint in joints if joint.get("type") != "fixed") == sorted(ANGLE_NAMES)
    placed = urdf_frames(text, dict(zip(ANGLE_NAMES, pose.angles(), strict=True)), torso)
    found = np.array([placed[LINK_OF_POINT[i]][:3, 3] for i in range(15)])
    np.testing.assert_allclose(found, forward(body, pose), atol=1e-6)


class Taken:
    """A stand-in of the publisher of tf2_msgs/TFMessage: its list of transforms, checked as rclpy would."""

    def __init__(self, node, kind, topic, qos):
        self.topic, self.qos, self.is_wanted, self.closed, self.messages = topic, qos, True, False, []
        PUBLISHERS.append(self)

    def publish(self, make):
        self.messages.append(make())

    def close(self):
        self.closed = True


PUBLISHERS: list[Taken] = []


class TFMessage:
    def __init__(self, transforms):
        assert isinstance(transforms, list) and all(isinstance(one, TransformStamped) for one in transforms)
        self.transforms = transforms


@pytest.fixture
def taken(monkeypatch):
    """What goes to /tf and /tf_static: the publishers, in the order in which they were made."""
    PUBLISHERS.clear()
    monkeypatch.setattr(ros_poses, "TFMessage", TFMessage)
    monkeypatch.setattr(ros_poses, "LazyPublisher", Taken)
    return PUBLISHERS


def tree_of(transforms):
    """Frame -> its transform (4, 4) in map."""
    placed = {"map": np.eye(4)}
    for one in transforms:
        t, q = one.transform.translation, one.transform.rotation
        local = homogeneous(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])
        placed[one.child_frame_id] = placed[one.header.frame_id] @ local
    return placed


@pytest.mark.parametrize("which", ["torso", "none"])
def test_body_is_on_tf_beside_that_of_rep155_without_links_that_nobody_asked_for(open_probe, person, taken, which):
    published = follow(open_probe, person.body, [person.points(0.5)], publish_tf=which, publish_humans=True)
    bodies = [p for p in taken if p.topic == "/tf"]
    assert [len(p.messages) for p in bodies] == ([1] if which == "none" else [1, 1])  # one is that of REP-155
    transforms = [one for publisher in bodies for one in publisher.messages[-1].transforms]
    placed, torso = tree_of(transforms), link_name(BODY_ID, "torso")
    assert f"body_{BODY_ID}" in placed and link_name(BODY_ID, "left_forearm") not in placed
    assert (torso in placed) == (which == "torso")
    assert which == "none" or np.linalg.norm(placed[torso][:3, 3] - published.points[0][0]) < MM
    assert {to_ns(one.header.stamp) for one in transforms} == {to_ns(published.joints[0].header.stamp)}


def test_links_on_tf_are_where_the_reference_points_are_over_the_track_of_a_moving_person(open_probe, person, taken):
    """Shoulders move against the torso: the URDF cannot follow, the limb is shifted, turned alike."""
    shrugs_m = 0.03 * np.sin(np.arange(30) / 3)
    fitted = [person.points(k / FPS) + up_m * SHOULDER_OF_ARM for k, up_m in enumerate(shrugs_m)]
    published = follow(open_probe, person.body, fitted)
    (publisher,) = (p for p in taken if p.topic == "/tf")
    assert len(publisher.messages) == len(published.points) == len(fitted)
    off_rigid = []
    sets = zip(published.points, published.joints, published.markers, publisher.messages, strict=True)
    for points, joints, markers, transforms in sets:
        ends = np.array([[end.x, end.y, end.z] for end in markers.markers[0].points[1::2]])  # of the ten sticks
        np.testing.assert_allclose(ends[1:], points[[1, *range(7, 15)]], atol=MM)
        placed = tree_of(transforms.transforms)
        linked = {i: placed[LINK_OF_POINT[i]] for i in range(15)}
        for i, place in linked.items():
            assert np.linalg.norm(place[:3, 3] - points[i]) < MM, POINT_NAMES[i]
        torso = placed[link_name(BODY_ID, "torso")]
        rigid = urdf_frames(published.described, dict(zip(joints.name, joints.position, strict=True)), torso)
        for name, place in rigid.items():
            np.testing.assert_allclose(place[:3, :3], placed[name][:3, :3], atol=1e-6)
        shifts = np.array([rigid[LINK_OF_POINT[i]] - linked[i] for i in range(15)])[:, :3, 3]
        off_rigid.append(np.linalg.norm(shifts, axis=1).max())
    assert 2 * MM < np.median(off_rigid) < 40 * MM  # 12 to 25 mm at tracked people's shoulders: docs/reference/ros.md


class Published(NamedTuple):
    """What a filter published: points (15, 3), joint states and markers of each set, and its URDF."""

    points: list[np.ndarray]
    joints: list[JointState]
    markers: list[MarkerArray]
    described: str


def follow(open_probe, body, fitted, **parameters) -> Published:
    """Let a filter answer one set of fitted points (15, 3) after the other, however long each takes."""
    probe = open_probe(EkfProbe, body, skeleton_rate_hz=0.0, **parameters)
    probe.listen(String, "mocap/robot_description", LATCHED)
    probe.start()
    for number, points in enumerate(fitted):
        stamp_ns = START_NS + round(number * 1e9 / FPS)
        probe.fit(stamp_ns, points, frame_id=probe.node.settings.frame_id)

    def of(topic: str) -> list:
        return [message for name, message in probe.arrived if name == f"mocap/{topic}"]

    def own() -> list[str]:  # latched texts of a filter before this one may be heard, too
        link = f'"{probe.node.tf_prefix}{probe.node.settings.body_id}_'
        return [text.data for text in of("robot_description") if link in text.data]

    shown = "reference_points", "joint_states", "skeleton"
    probe.until(lambda: own() and all(len(of(topic)) == len(fitted) for topic in shown))
    points = [read_reference_points(cloud, "test").points_world for cloud in of("reference_points")]
    probe.close()  # a second filter is alone
    return Published(points, of("joint_states"), of("skeleton"), own()[0])


@pytest.fixture
def hull(open_probe, tmp_path):
    """``hull(**parameters)``: a configured hull server of three cameras."""
    save_rig(RIG, tmp_path / "rig.yaml")

    def configured(**parameters) -> NodeProbe:
        probe = open_probe(HullProbe, None, rig_file=str(tmp_path / "rig.yaml"), **parameters)
        assert probe.node.trigger_configure() == SUCCESS
        return probe

    return configured


def test_cameras_are_on_tf_static_with_a_body_frame_and_an_optical_one_unless_switched_off(hull, taken):
    probe = hull()
    (publisher,) = taken
    assert (publisher.topic, publisher.qos) == ("/tf_static", LATCHED) and len(publisher.messages) == 1
    placed = tree_of(publisher.messages[0].transforms)
    assert set(placed) == {"map", *RIG.names, *(f"{name}_optical" for name in RIG.names)}
    for camera in RIG.cameras:
        np.testing.assert_allclose(placed[f"{camera.name}_optical"], np.linalg.inv(camera.T_camera_world), atol=1e-9)
        np.testing.assert_allclose(placed[camera.name][:3, 0], camera.T_camera_world[2, :3], atol=1e-9)  # x: forward
        assert placed[camera.name][2, 2] > 0.0 or camera.name == RIG.names[-1]  # z: up, but of the one on the ceiling
    assert probe.node.trigger_cleanup() == SUCCESS and publisher.closed
    taken.clear()
    hull(publish_tf=False)
    assert taken == []


def test_two_graphs_in_one_domain_share_no_frame_and_no_id_of_a_person(open_probe, hull, person, taken):
    """Nor do messages: each names frames of its own graph."""
    named = []
    for prefix in ("", "studio_"):
        hull(tf_prefix=prefix)
        published = follow(open_probe, person.body, [person.points(0.5)], publish_humans=True, tf_prefix=prefix)
        transforms = [one for publisher in taken for message in publisher.messages for one in message.transforms]
        frames_of = {one.header.frame_id for one in transforms} | {one.child_frame_id for one in transforms}
        links = {link.get("name") for link in ElementTree.fromstring(published.described).findall("link")}
        named.append(frames_of | links)
        assert links < frames_of and {f"{prefix}map", f"{prefix}cam01_optical", f"body_{prefix}b0001"} < frames_of
        taken.clear()
    assert not named[0] & named[1]
    assert {name for name in named[1] if not name.startswith(("studio_", "body_studio_"))} == set()


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is None, reason="tf2_msgs is not installed")
def test_frames_are_heard_as_tf2_msgs(hull):
    from tf2_msgs.msg import TFMessage as Real

    probe = hull()
    heard = probe.listen(Real, "/tf_static", LATCHED)
    probe.until(lambda: heard)
    assert len(heard[0].transforms) == len(list(camera_frames(RIG, "map", 0)))
