"""Frames as ROS people expect them: cameras on /tf_static, bodies on /tf, a URDF that the joint states move.

tf2_msgs is in every ROS installation, not in the wheels: where it is not, a stand-in takes what would be published.
"""

import importlib.util
from dataclasses import replace
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from ekf_person import Person
from geometry_msgs.msg import TransformStamped
from node_probe import SUCCESS, NodeProbe
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from capture_rig import save_rig
from capture_rig.session import footage_stamp_ns, load_session, load_truth
from ekf_tracker.ekf_node import EkfNode
from ekf_tracker.rep155 import HRI_JOINT_NAMES, hri_angles, hri_rates, human_urdf
from ekf_tracker.urdf import body_urdf, link_name, link_of_point, same_sizes
from hull_server.hull_node import HullNode
from hull_server.hull_ros import camera_frames
from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from sagoma_ros import frames
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import FITTED_PEOPLE, read_reference_points, tables_message
from sagoma_ros.qos import LATCHED, RESULT
from sagoma_tools.cli import main
from sagoma_tools.evaluation.in_process import exact_silhouettes
from stick_figure.body import Body, save_body
from stick_figure.body_surface import BodySurface, segment_inertias
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES, L_THIGH, POINT_NAMES, STICK_NAMES
from virtual_studio.rig import ring

BODY_ID, RIG = "b0001", ring(3)
MM = 1e-3
START_NS, FPS = 5_000_000_000, 30.0
LIMBS = {
    "neck": ["head"],
    **{
        f"{side}_{upper}": [f"{side}_{one}" for one in lower]
        for side in ("left", "right")
        for upper, lower in (("shoulder", ("elbow", "hand")), ("hip", ("knee", "foot")))
    },
}
LIMB_STARTS = [POINT_NAMES.index(start) for start, ends in LIMBS.items() for _ in ends]
LIMB_ENDS = [POINT_NAMES.index(end) for ends in LIMBS.values() for end in ends]


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
    body = Body.from_stature(rng.uniform(1.4, 2.0))
    angles, R = rng.uniform(ANGLE_LOW, ANGLE_HIGH), Rotation.random(random_state=seed).as_matrix()
    pose, text = Pose.from_angles(rng.normal(size=3), R, angles), body_urdf(body, BODY_ID)
    joints = ElementTree.fromstring(text).findall("joint")
    assert sorted(joint.get("name") for joint in joints if joint.get("type") != "fixed") == sorted(ANGLE_NAMES)
    placed = urdf_frames(text, dict(zip(ANGLE_NAMES, angles, strict=True)), homogeneous(R, pose.position_world))
    found = np.array([placed[link_name(BODY_ID, link_of_point(i))][:3, 3] for i in range(15)])
    np.testing.assert_allclose(found, forward(body, pose), atol=1e-6)


@pytest.mark.parametrize("urdf", [body_urdf, human_urdf])
def test_links_have_shapes_masses_that_sum_to_the_persons_and_possible_inertias(urdf):
    body = Body.from_stature(1.75)
    robot = ElementTree.fromstring(urdf(body, BODY_ID, 70.0))
    solid = [link for link in robot.findall("link") if link.find("inertial") is not None]
    assert len(solid) == len(STICK_NAMES)
    masses = [float(link.find("inertial/mass").get("value")) for link in solid]
    assert sum(masses) == pytest.approx(70.0) and max(masses) / 70.0 == pytest.approx(0.43, abs=0.01)  # the trunk
    for link in solid:
        values = {key: float(value) for key, value in link.find("inertial/inertia").attrib.items()}
        inertia = np.array([[values[f"i{min(a, b)}{max(a, b)}"] for b in "xyz"] for a in "xyz"])
        small, middle, large = np.linalg.eigvalsh(inertia)
        assert 0.0 < small <= middle <= large < small + middle  # of a body, not of any matrix
        geometries = [[one.find("geometry")[0] for one in link.findall(use)] for use in ("visual", "collision")]
        shapes = [[(one.tag, one.attrib) for one in every] for every in geometries]
        assert shapes[0] == shapes[1] and len(shapes[0]) % 3 == 0


def test_a_segments_inertia_is_that_of_points_spread_over_its_capsules():
    body, rng = Body.from_stature(1.75), np.random.default_rng(0)
    surface, found = BodySurface.of(body), segment_inertias(body, 70.0)[L_THIGH]
    (k,) = np.flatnonzero(surface.stick == L_THIGH)
    P, Q, (r0, r1) = surface.start[k], surface.end[k], surface.radii[k]
    points = rng.uniform(np.minimum(P, Q) - 0.2, np.maximum(P, Q) + 0.2, (400_000, 3))
    u = np.clip((points - P) @ (Q - P) / ((Q - P) @ (Q - P)), 0, 1)
    points = points[np.linalg.norm(points - P - u[:, None] * (Q - P), axis=1) < r0 + u * (r1 - r0)]
    offsets = points - points.mean(axis=0)
    spread = found.mass * offsets.T @ offsets / len(points)
    np.testing.assert_allclose(found.centre, points.mean(axis=0), atol=2e-3)
    np.testing.assert_allclose(found.inertia, np.trace(spread) * np.eye(3) - spread, atol=0.02 * np.trace(spread))


@pytest.mark.parametrize("name", ["walk_ring5top", "zombie_he3", "charleston2_ring5top_drift"])
def test_limits_of_both_urdfs_contain_the_poses_of_the_truth(shared_data, name):
    truth = load_truth(shared_data("sessions", name, "truth.csv"))
    points = truth.stick_figure_points()
    body, angles, hri, within = Body.from_points(points), None, None, []
    limits = [limits_of(urdf(body, BODY_ID)) for urdf in (body_urdf, human_urdf)]
    assert len(limits[0]) == len(ANGLE_NAMES) - 2 and len(limits[1]) == 10
    for place in points[::4]:
        pose = inverse(body, place)
        angles, hri = pose.angles(angles), hri_angles(pose, hri)
        named = dict(zip(ANGLE_NAMES, angles, strict=True))
        of_humans = {f"{joint}_{BODY_ID}": angle for joint, angle in zip(HRI_JOINT_NAMES, hri, strict=True)}
        for own, every in zip(limits, (named, of_humans), strict=True):
            within += [low <= every[joint] <= high for joint, (low, high) in own.items()]
    assert all(within)


def limits_of(text):
    """Lower and upper limit of each joint of a URDF that has them, rad."""
    found = {joint.get("name"): joint.find("limit") for joint in ElementTree.fromstring(text).findall("joint")}
    return {name: (float(one.get("lower")), float(one.get("upper"))) for name, one in found.items() if one is not None}


@pytest.mark.parametrize("growth_m", [0.0, 1e-4, 5e-4])
def test_urdf_is_told_again_when_somebody_could_see_the_change(growth_m):
    body = Body.from_stature(1.75)
    longer = replace(body, half_lengths=body.half_lengths + 0.5 * growth_m)
    assert same_sizes(longer, body) == (growth_m < 2e-4) and not same_sizes(body, None)


class Taken:
    """A stand-in of the publisher of tf2_msgs/TFMessage: its list of transforms, checked as rclpy would."""

    def __init__(self, node, kind, topic, qos):
        self.topic, self.qos = topic, qos
        self.is_wanted, self.closed = True, False
        PUBLISHERS.append(self)
        self.messages = []

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
    monkeypatch.setattr(frames, "TFMessage", TFMessage)
    monkeypatch.setattr(frames, "LazyPublisher", Taken)
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
    published = answered(open_probe, person, publish_tf=which, publish_humans=True)
    bodies = [p for p in taken if p.topic == "/tf"]
    assert [len(p.messages) for p in bodies] == ([1] if which == "none" else [1, 1])  # one is that of REP-155
    transforms = [one for publisher in bodies for one in publisher.messages[-1].transforms]
    placed, torso = tree_of(transforms), link_name(BODY_ID, "torso")
    assert f"body_{BODY_ID}" in placed and link_name(BODY_ID, "left_forearm") not in placed
    assert (torso in placed) == (which == "torso")
    assert which == "none" or np.linalg.norm(placed[torso][:3, 3] - published.points[0][0]) < MM
    assert {to_ns(one.header.stamp) for one in transforms} == {to_ns(published.joints[0].header.stamp)}


@pytest.fixture(scope="module")
def walked(three_cameras) -> tuple[Body, list[ReferencePoints]]:
    """Of a rendered person who moves: the measured body, and the fitted points of every set since it is known."""
    session = load_session(three_cameras)
    settings = {"hull_server.backend": "cpu", "icp_tracker.initial_pose.source": "t_pose"}
    pipeline, fitted = MocapPipeline(session.rig, Configuration.of(settings)), []
    for frame, masks in enumerate(exact_silhouettes(session)):
        step = pipeline.step_masks(footage_stamp_ns(START_NS, frame, session.fps), masks)
        fitted += [step.fit.reference_points] if step.state is not None else []
    assert len(fitted) > 30
    return pipeline.body.tracker.body_of(FIRST_PERSON), fitted


def test_links_on_tf_are_where_the_reference_points_are_over_the_track_of_a_moving_person(open_probe, walked, taken):
    """Shoulders, hips and neck move against the torso: the URDF cannot follow, the limb is shifted, turned alike."""
    body, fitted = walked
    published = follow(open_probe, body, fitted, skeleton_rate_hz=0.0)
    (publisher,) = (p for p in taken if p.topic == "/tf")
    assert len(publisher.messages) == len(published.points) == len(fitted)
    off_rigid = []
    sets = zip(published.points, published.joints, published.markers, publisher.messages, strict=True)
    for points, joints, markers, transforms in sets:
        ends = np.array([[end.x, end.y, end.z] for end in markers.markers[0].points[1::2]])  # of the ten sticks
        np.testing.assert_allclose(ends[1:], points[[1, *range(7, 15)]], atol=MM)
        placed = tree_of(transforms.transforms)
        linked = {i: placed[link_name(BODY_ID, link_of_point(i))] for i in range(15)}
        for i, place in linked.items():
            assert np.linalg.norm(place[:3, 3] - points[i]) < MM, POINT_NAMES[i]
        torso = placed[link_name(BODY_ID, "torso")]
        rigid = urdf_frames(published.described, dict(zip(joints.name, joints.position, strict=True)), torso)
        for name, place in rigid.items():
            np.testing.assert_allclose(place[:3, :3], placed[name][:3, :3], atol=1e-6)
        shifts = np.array([rigid[link_name(BODY_ID, link_of_point(i))] - linked[i] for i in range(15)])[:, :3, 3]
        np.testing.assert_allclose(shifts[LIMB_ENDS], shifts[LIMB_STARTS], atol=1e-6)
        off_rigid.append(np.linalg.norm(shifts, axis=1).max())
    assert 2 * MM < np.median(off_rigid) < 40 * MM  # 12 to 25 mm at the shoulders of other tracks: docs/ros.md


def answered(open_probe, person, **parameters) -> "Published":
    """Let a filter answer one set."""
    measured = ReferencePoints(person.points(0.5), np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
    return follow(open_probe, person.body, [measured], **parameters)


class Published(NamedTuple):
    """What a filter published: points (15, 3), joint states and markers of each set, and its URDF."""

    points: list[np.ndarray]
    joints: list[JointState]
    markers: list[MarkerArray]
    described: str


def follow(open_probe, body, fitted, **parameters) -> Published:
    """Let a filter answer one set of fitted points after the other, however long each takes on a busy machine."""
    probe = open_probe(NodeProbe, EkfNode, {"stale_after_s": 0.0, **parameters})
    sender = probe.peer.create_publisher(FITTED_PEOPLE.kind, FITTED_PEOPLE.name, RESULT)
    clouds = probe.listen(PointCloud2, "mocap/reference_points")
    joints = probe.listen(JointState, "mocap/joint_states")
    markers = probe.listen(MarkerArray, "mocap/skeleton")
    texts = probe.listen(String, "mocap/robot_description", LATCHED)
    probe.start()
    link = f'"{probe.node.tf_prefix}{probe.node.settings.body_id}_'

    def own() -> list[str]:  # latched texts of a filter before this one may be heard, too
        return [text.data for text in texts if link in text.data]

    probe.until(sender.get_subscription_count)
    probe.until(lambda: all(probe.node.count_subscribers(topic) for topic in probe.heard))
    for number, measured in enumerate(fitted):
        stamp_ns = START_NS + round(number * 1e9 / FPS)
        people, frame_id = FittedPeople(stamp_ns, PeoplePoints({1: measured}), {1: body}), probe.node.settings.frame_id
        sender.publish(tables_message(people, frame_id))
        probe.until(lambda: min(len(clouds), len(joints), len(markers)) > number and own())  # noqa: B023
    points = [read_reference_points(cloud, "test").points_world for cloud in clouds]
    published = Published(points, list(joints), list(markers), own()[0])
    assert probe.node.trigger_deactivate() == probe.node.trigger_cleanup() == SUCCESS  # a second filter is alone
    return published


@pytest.fixture
def hull(open_probe, tmp_path):
    """``hull(**parameters)``: a configured hull server of three cameras."""
    save_rig(RIG, tmp_path / "rig.yaml")

    def configured(**parameters) -> NodeProbe:
        probe = open_probe(
            NodeProbe, HullNode, {"rig_file": str(tmp_path / "rig.yaml"), "backend": "cpu", **parameters}
        )
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
        published = answered(open_probe, person, publish_humans=True, tf_prefix=prefix)
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


def test_rep155_angles_go_on_and_their_rates_are_those_of_the_angles():
    angles, velocity = T_POSE_ANGLES.copy(), np.zeros(24)
    angles[[8, 9, 14]] = -0.6, -0.4, 0.5
    velocity[3:] = np.random.default_rng(1).normal(size=21)
    pose, before = Pose.from_angles(np.zeros(3), np.eye(3), angles), None
    for _ in range(400):
        found = hri_angles(pose, before)
        if before is not None:
            rates = hri_rates(pose, velocity, found)
            assert np.isfinite(rates).all()
            still = np.abs(rates) < 20.0  # elsewhere an angle swings through its gimbal lock
            np.testing.assert_allclose((found - before)[still], 0.01 * rates[still], atol=0.12)
            turns = [HRI_JOINT_NAMES.index(name) for name in ("l_elbow", "r_elbow", "l_knee", "r_knee", "waist")]
            assert np.abs((found - before)[turns]).max() < 0.1
        before, pose = found, pose.retract(0.01 * velocity)


def test_urdf_command_prints_the_body_of_a_file_and_replaces_nothing(tmp_path, capsys):
    body = Body.from_stature(1.63)
    save_body(body, tmp_path / "body.yaml")
    assert main(["urdf", "--body", str(tmp_path / "body.yaml"), "--id", "anna"]) == 0
    assert capsys.readouterr().out == body_urdf(body, "anna")
    out = tmp_path / "body.urdf"
    assert main(["urdf", "--stature", "1.9", "--output", str(out)]) == 0
    assert out.read_text() == body_urdf(Body.from_stature(1.9), BODY_ID)
    assert main(["urdf", "--output", str(out)]) == 2
    assert "A file has that name: choose another" in capsys.readouterr().err
    assert main(["urdf", "--body", "b.yaml", "--stature", "1.9"]) == 2
