"""Joints that a user's detector finds in the images: what they do to the fit, whose they are, and how they come in."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_people as synthetic
from node_probe import NodeProbe
from pose_file import save_initial_pose
from refinement_rays import grazing_rays
from sensor_msgs.msg import PointCloud2, PointField
from test_icp_track_monitor import FOLDED, STANCE, moved, posed, seen, stamp, walked

from capture_rig.rig import save_rig
from icp_tracker.articulated_fit import ArticulatedSettings, make_data, minimise
from icp_tracker.icp_node import IcpNode
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.monitor.pose_library import LIMBS
from icp_tracker.people.association import Expected, associate_skeletons
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import NO_VOXELS
from mocap_packets.keypoints import NUMBERS, Detections, keypoints_of
from mocap_packets.state import Prediction
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import RESULT
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import RayArrays, match_rays
from stick_figure.least_squares.keypoint_factor import HIP_ASIDE_M, offsets_m
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.skeleton import POINT_NAMES
from virtual_studio.rig import ring

RIG = ring(3, ceiling=False)
OURS = [name for name in POINT_NAMES if name not in ("torso", "head")]
LEFT_HAND = POINT_NAMES.index("left_hand")
SD_PX = 4.0


def detections(body, pose, names=OURS, rng=None, stamp_ns=0):
    """What a detector finds of somebody in each image of the rig, exact but for the noise of ``rng``."""
    points = forward(body, pose)[[POINT_NAMES.index(name) for name in names]]
    found = []
    for camera in RIG.cameras:
        pixels = camera.project(points) + (0.0 if rng is None else SD_PX * rng.normal(size=(len(points), 2)))
        noise = np.tile([SD_PX**2, 0.0, SD_PX**2, 1.0], (len(points), 1))
        found.append(Detections(camera.name, stamp_ns, names, np.column_stack([pixels, noise])[None]))
    return found


def fitted(body, start, keypoints):
    """The pose that detections alone lead to."""
    settings = ArticulatedSettings(prior=10.0, max_iterations=30)
    data = make_data(np.empty((0, 3)), 0.0, NO_VOXELS, settings, keypoints=keypoints)
    return minimise(body, start, data, settings)[0]


@pytest.fixture(scope="module")
def poses(body):
    """A pose, and one near it."""
    pose = posed(STANCE)
    return pose, pose.retract(0.1 * np.random.default_rng(2).normal(size=24))


def shifted(pose, x, y, z=0.0):
    return replace(pose, position_world=pose.position_world + np.array([x, y, z]))


def farthest_m(body, one, other):
    return np.linalg.norm(forward(body, one) - forward(body, other), axis=1)[2:].max()


def test_detections_of_distorted_images_alone_lead_to_the_pose_and_a_wrong_one_changes_little(body, poses):
    pose, near = poses
    assert all(np.abs(camera.D).max() > 0.05 for camera in RIG.cameras) and farthest_m(body, pose, near) > 0.1
    found = detections(body, pose)
    assert farthest_m(body, fitted(body, near, keypoints_of(RIG, found)), pose) < 0.005
    found[1].values[0, OURS.index("right_elbow"), :2] += [150.0, -90.0]
    assert farthest_m(body, fitted(body, near, keypoints_of(RIG, found)), pose) < 0.01


def test_joints_of_coco_have_their_places_and_what_cannot_be_used_is_left_out(body, poses):
    pose, _ = poses
    coco = ["nose", "left_hip", "left_wrist", "left_ankle", "right_knee", "right_elbow"]
    points = forward(body, pose)
    at = dict(zip(POINT_NAMES, points, strict=True))
    wrist = at["left_elbow"] + 0.146 / 0.254 * (at["left_hand"] - at["left_elbow"])
    aside = HIP_ASIDE_M * pose.R_world_torso[:, 1]
    places = [at["head"], at["left_hip"] + aside, wrist, at["left_foot"], at["right_knee"], at["right_elbow"]]
    camera = RIG.cameras[0]
    values = np.column_stack([camera.project(np.array(places)), np.tile([4.0, 1.0, 9.0, 0.5], (6, 1))])
    values[4, 0], values[5, 3] = np.nan, 7.0  # not found; a covariance that is none
    keypoints = keypoints_of(RIG, [Detections(camera.name, 0, coco, values[None])])
    off = offsets_m(keypoints, place(PoseState.of(pose), BodyModel.of(body)))
    assert len(off) == 3 and np.abs(off).max() < 1e-6
    np.testing.assert_allclose(keypoints.score, 0.5)
    fx, fy = camera.K.diagonal()[:2]
    np.testing.assert_allclose(keypoints.covariance, np.tile([4.0 / fx**2, 1.0 / fx / fy, 9.0 / fy**2], (3, 1)))
    assert len(keypoints_of(RIG, []).score) == 0


def test_each_person_has_the_nearest_skeleton_of_an_image_whatever_its_sides_and_far_ones_are_nobodys(body, poses):
    pose, _ = poses
    other, poster = shifted(pose, 0.0, 0.8), shifted(pose, -0.9, -0.6)
    order = [0, *(pair + side for pair in range(1, len(OURS), 2) for side in (1, 0))]  # but the neck, sides exchanged
    images = []
    for mine, others, posters in zip(*(detections(body, one) for one in (pose, other, poster)), strict=True):
        values = np.concatenate([posters.values, others.values, mine.values[:, order]])
        images.append(replace(mine, values=values))
    expected = [Expected(1, body, pose), Expected(2, body, other)]
    owned = associate_skeletons(keypoints_of(RIG, images), expected)
    assert {person: np.unique(own.skeleton % 3).tolist() for person, own in owned.items()} == {1: [2], 2: [1]}
    assert all(len(own.score) == 3 * len(OURS) for own in owned.values())
    assert set(associate_skeletons(keypoints_of(RIG, images), expected[:1])) == {1}


@pytest.fixture(scope="module")
def hidden_arm(body):
    """Somebody whose left arm no contour shows: pose, rays of the rest of the body, samples of the inside."""
    pose = posed(STANCE)
    rays = grazing_rays(body, pose, np.random.default_rng(8))
    arrays = RayArrays.of(rays.points_world, rays.directions, rays.normals, rays.half_lengths, np.ones(len(rays)))
    placed = place(PoseState.of(pose), BodyModel.of(body))
    stick = placed.surface.stick[match_rays(arrays, placed, 0.05).capsule]
    return pose, rays.chosen((stick != LIMBS[0].upper) & (stick != LIMBS[0].lower)), synthetic.voxels(body, pose)


def followed(body, hidden_arm, found, sets=30):
    """How far off (m) the left hand is at the end of half a second that begins with the arm folded; all fits."""
    pose, rays, inside = hidden_arm
    person = SimpleNamespace(rays=replace(rays, body=np.zeros(len(rays), np.int32)), inside=inside)
    people = PeopleTracker(lambda: IcpTracker(KnownPose(pose, body), TrackerSettings(acquire_inliers=0.0)))
    rng, fits = np.random.default_rng(3), []
    for k in range(sets):
        truth = moved(pose, *walked(person, k))
        start = {1: Prediction.of(stamp(k), posed(FOLDED, truth), np.zeros(24))} if k == 1 else {}
        hull = seen(person, k, rng)
        (fit,) = people.step(replace(hull, keypoints=keypoints_of(RIG, found(truth, k))), start)
        fits.append(fit)
    return np.linalg.norm(fits[-1].reference_points_world - forward(body, truth), axis=1)[LEFT_HAND], fits


def test_detections_find_an_arm_that_no_outline_shows_and_those_of_nobody_change_no_bit(body, hidden_arm):
    rng = np.random.default_rng(5)
    without, plain = followed(body, hidden_arm, lambda truth, k: [])
    with_them, _ = followed(body, hidden_arm, lambda truth, k: detections(body, truth, rng=rng))
    assert without > 0.25 and with_them < 0.1
    away = shifted(hidden_arm[0], 0.0, 0.0, 1.0)
    _, same = followed(body, hidden_arm, lambda truth, k: detections(body, away), sets=8)
    for one, other in zip(plain[:8], same, strict=True):
        assert one.reference_points_world.tobytes() == other.reference_points_world.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes() and one.quality == other.quality


def cloud(image, stamp_ns, **changes):
    """The message of an image's detections: a point a skeleton, a field a joint."""
    values = np.ascontiguousarray(image.values, np.float32)
    size = 4 * len(NUMBERS)
    fields = [
        PointField(name=n, offset=size * k, datatype=PointField.FLOAT32, count=6) for k, n in enumerate(image.names)
    ]
    step = size * len(fields)
    message = PointCloud2(height=1, width=len(values), fields=fields, point_step=step, row_step=step * len(values))
    message.header.stamp, message.header.frame_id, message.data = to_stamp(stamp_ns), "cam01_optical", values.tobytes()
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_node_gives_a_set_the_detections_of_its_images_waits_for_those_that_are_behind_and_refuses_others(
    open_probe, body, poses, tmp_path
):
    save_rig(RIG, tmp_path / "rig.yaml")
    save_initial_pose(poses[0], tmp_path / "start.yaml", body)
    start = {"initial_pose.source": "file", "initial_pose.file": str(tmp_path / "start.yaml")}
    given = {**start, "initial_pose.rig_file": str(tmp_path / "rig.yaml"), "keypoints_wait_s": 60.0}
    probe = open_probe(NodeProbe, IcpNode, given)
    senders = [probe.peer.create_publisher(PointCloud2, f"{name}/keypoints", RESULT) for name in RIG.names[:2]]
    probe.start()
    probe.until(lambda: all(sender.get_subscription_count() for sender in senders))
    inputs, (first, second, _) = probe.node._keypoints, detections(body, poses[0])
    assert len(inputs.of_set(stamp(0)).score) == 0  # nobody has published: nothing is waited for
    senders[0].publish(cloud(first, stamp(1)))
    senders[1].publish(cloud(second, stamp(1)))
    probe.until(lambda: all(inputs._found[name] for name in RIG.names[:2]))
    assert np.bincount(inputs.of_set(stamp(1)).camera).tolist() == [len(OURS)] * 2
    senders[0].publish(cloud(first, stamp(2) + 1_000_000))
    probe.until(lambda: len(inputs._found[RIG.names[0]]) == 2)
    assert inputs._is_awaited(stamp(2)) and not inputs._is_awaited(stamp(1))  # the second camera is behind
    with ThreadPoolExecutor() as other:
        waiting = other.submit(inputs.of_set, stamp(2))
        senders[1].publish(cloud(second, stamp(2)))
        probe.until(waiting.done)
    assert np.bincount(waiting.result().camera).tolist() == [len(OURS)] * 2
    senders[0].publish(cloud(first, stamp(3), fields=[]))
    senders[0].publish(cloud(first, stamp(3), width=7))
    probe.until(lambda: probe.node.health.counter("bad_keypoints") == 2)
