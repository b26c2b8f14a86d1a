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

BODY_ID = "b0001"
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
def test_forward_kinematics_of_the_urdf_gives_the_figures_points(seed):
    rng = np.random.default_rng(seed)
    body = Body.from_stature(rng.uniform(1.4, 2.0))
    angles, R = rng.uniform(ANGLE_LOW, ANGLE_HIGH), Rotation.random(random_state=seed).as_matrix()
    pose = Pose.from_angles(rng.normal(size=3), R, angles)
    named = dict(zip(ANGLE_NAMES, angles, strict=True))
    placed = urdf_frames(body_urdf(body, BODY_ID), named, homogeneous(R, pose.position_world))
    found = np.array([placed[link_name(BODY_ID, link_of_point(i))][:3, 3] for i in range(15)])
    np.testing.assert_allclose(found, forward(body, pose), atol=1e-6)


def test_joints_of_the_urdf_are_those_of_the_joint_states_and_links_have_shapes():
    robot = ElementTree.fromstring(body_urdf(Body.from_stature(1.75), BODY_ID))
    moving = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    assert sorted(moving) == sorted(ANGLE_NAMES)
    shown = {link.get("name") for link in robot.findall("link") if link.find("visual") is not None}
    assert shown >= {link_name(BODY_ID, stick) for stick in ("torso", "head", "left_forearm", "right_calf")}


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


@pytest.mark.parametrize("which", ["links", "torso", "none"])
def test_body_and_its_links_are_on_tf_where_the_reference_points_are(open_probe, tmp_path, person, taken, which):
    points, got = track(open_probe, tmp_path, person, publish_tf=which, publish_humans=True)
    bodies = [p for p in taken if p.topic == "/tf"]
    assert [len(p.messages) for p in bodies] == ([1] if which == "none" else [1, 1])  # one is that of REP-155
    placed = tree_of([one for publisher in bodies for one in publisher.messages[-1].transforms])
    assert f"body_{BODY_ID}" in placed
    if which == "none":
        return
    assert (link_name(BODY_ID, "left_forearm") in placed) == (which == "links")
    for i in range(15) if which == "links" else [0]:
        assert np.linalg.norm(placed[link_name(BODY_ID, link_of_point(i))][:3, 3] - points[i]) < MM, POINT_NAMES[i]
    stamps = {(t.header.stamp.sec, t.header.stamp.nanosec) for p in bodies for t in p.messages[-1].transforms}
    assert stamps == {(got.header.stamp.sec, got.header.stamp.nanosec)}


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


def test_links_on_tf_are_where_the_reference_points_are_over_the_track_of_a_moving_person(
    open_probe, tmp_path, walked, taken
):
    """Shoulders, hips and neck move against the torso: the URDF cannot follow, the limb is shifted, turned alike."""
    body, fitted = walked
    published = follow(open_probe, tmp_path, body, fitted, skeleton_rate_hz=0.0)
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


def test_robot_description_with_the_published_joint_states_gives_the_published_points(open_probe, tmp_path, person):
    """The topics alone, as rviz and robot_state_publisher have them."""
    described = []
    points, joints = track(open_probe, tmp_path, person, described=described)
    angles = dict(zip(joints.name, joints.position, strict=True))
    torso = np.eye(4)
    torso[:3, :3] = person_rotation(points, described[0], angles)
    placed = urdf_frames(described[0], angles, torso)
    found = np.array([placed[link_name(BODY_ID, link_of_point(i))][:3, 3] for i in range(15)]) + points[0]
    assert np.linalg.norm(found - points, axis=1).max() < MM


def person_rotation(points, text, angles):
    """The torso's rotation by its points: the other points are not used for it."""
    placed = urdf_frames(text, angles, np.eye(4))
    torso = [POINT_NAMES.index(n) for n in ("neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")]
    own = np.array([placed[link_name(BODY_ID, link_of_point(i))][:3, 3] for i in torso])
    return Rotation.align_vectors(points[torso] - points[0], own)[0].as_matrix()


def track(open_probe, tmp_path, person, described=None, **parameters):
    """Let a filter answer one set; returns the published points (15, 3) and joint states."""
    measured = ReferencePoints(person.points(0.5), np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
    published = follow(open_probe, tmp_path, person.body, [measured], **parameters)
    if described is not None:
        described.append(published.described)
    return published.points[0], published.joints[0]


class Published(NamedTuple):
    """What a filter published: points (15, 3), joint states and markers of each set, and the first URDF."""

    points: list[np.ndarray]
    joints: list[JointState]
    markers: list[MarkerArray]
    described: str


def follow(open_probe, tmp_path, body, fitted, **parameters) -> Published:
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


def test_cameras_are_on_tf_static_with_a_body_frame_and_an_optical_one(open_probe, tmp_path, taken):
    rig = ring(3)
    save_rig(rig, tmp_path / "rig.yaml")
    probe = open_probe(NodeProbe, HullNode, {"rig_file": str(tmp_path / "rig.yaml"), "backend": "cpu"})
    assert probe.node.trigger_configure() == SUCCESS
    (publisher,) = taken
    assert (publisher.topic, publisher.qos) == ("/tf_static", LATCHED) and len(publisher.messages) == 1
    placed = tree_of(publisher.messages[0].transforms)
    assert set(placed) == {"map", *rig.names, *(f"{name}_optical" for name in rig.names)}
    for camera in rig.cameras:
        np.testing.assert_allclose(placed[f"{camera.name}_optical"], np.linalg.inv(camera.T_camera_world), atol=1e-9)
        np.testing.assert_allclose(placed[camera.name][:3, 0], camera.T_camera_world[2, :3], atol=1e-9)  # x: forward
        assert placed[camera.name][2, 2] > 0.0 or camera.name == rig.names[-1]  # z: up, but of the one on the ceiling
    assert probe.node.trigger_cleanup() == SUCCESS and publisher.closed


def test_two_graphs_in_one_domain_share_no_frame_and_no_id_of_a_person(open_probe, tmp_path, person, taken):
    """Nor do messages: each names frames of its own graph."""
    save_rig(ring(3), tmp_path / "rig.yaml")
    named = []
    for prefix in ("", "studio_"):
        given = {"rig_file": str(tmp_path / "rig.yaml"), "backend": "cpu", "tf_prefix": prefix}
        hull = open_probe(NodeProbe, HullNode, given)
        assert hull.node.trigger_configure() == SUCCESS
        described, humans = [], {"publish_humans": True, "tf_prefix": prefix}
        track(open_probe, tmp_path, person, described=described, **humans)
        frames_of = {t.header.frame_id for p in taken for m in p.messages for t in m.transforms}
        frames_of |= {t.child_frame_id for p in taken for m in p.messages for t in m.transforms}
        links = {link.get("name") for link in ElementTree.fromstring(described[0]).findall("link")}
        named.append(frames_of | links)
        assert links < frames_of and {f"{prefix}map", f"{prefix}cam01_optical", f"body_{prefix}b0001"} < frames_of
        taken.clear()
    assert not named[0] & named[1]
    assert {name for name in named[1] if not name.startswith(("studio_", "body_studio_"))} == set()


def test_no_camera_frames_without_the_parameter(open_probe, tmp_path, taken):
    save_rig(ring(3), tmp_path / "rig.yaml")
    given = {"rig_file": str(tmp_path / "rig.yaml"), "backend": "cpu", "publish_tf": False}
    assert open_probe(NodeProbe, HullNode, given).node.trigger_configure() == SUCCESS
    assert taken == []


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is None, reason="tf2_msgs is not installed")
def test_frames_are_heard_as_tf2_msgs(open_probe, tmp_path):
    from tf2_msgs.msg import TFMessage as Real

    rig = ring(3)
    save_rig(rig, tmp_path / "rig.yaml")
    probe = open_probe(NodeProbe, HullNode, {"rig_file": str(tmp_path / "rig.yaml"), "backend": "cpu"})
    assert probe.node.trigger_configure() == SUCCESS
    heard = probe.listen(Real, "/tf_static", LATCHED)
    probe.until(lambda: heard)
    assert len(heard[0].transforms) == len(list(camera_frames(rig, "map", 0)))


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
