"""REP-155 angles and URDF: walking the URDF with the angles must lead to the stick figure's own points."""

from xml.etree import ElementTree

import numpy as np
import pytest
from ekf_person import Person
from poses import pose_with, random_pose
from scipy.spatial.transform import Rotation

from ekf_tracker.rep155 import HRI_JOINT_NAMES, body_frame, body_id_of, hri_angles, human_urdf
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES

SIDES = ("left", "right")
PARTS = {"shoulder": "shoulder", "elbow": "elbow", "hand": "wrist", "hip": "hip", "knee": "knee", "foot": "ankle"}
LINK_OF_POINT = {"neck": "torso", "head": "head"}
LINK_OF_POINT |= {f"{side}_{point}": f"{side[0]}_{link}" for side in SIDES for point, link in PARTS.items()}


def walk(urdf, angles, origin, R):
    """World position (3,) and rotation (3, 3) of every link: the URDF's own forward kinematics."""
    robot = ElementTree.fromstring(urdf)
    frames = {"body": (np.asarray(origin), np.asarray(R))}
    for joint in robot.findall("joint"):
        name, parent, child = (
            text.removesuffix("_b7")
            for text in (joint.get("name"), joint.find("parent").get("link"), joint.find("child").get("link"))
        )
        t_parent, R_parent = frames[parent]
        offset = np.array(joint.find("origin").get("xyz").split(), float)
        assert joint.find("origin").get("rpy") == "0 0 0"
        turn = np.eye(3)
        if joint.get("type") != "fixed":
            axis = np.array(joint.find("axis").get("xyz").split(), float)
            turn = Rotation.from_rotvec(axis * angles[HRI_JOINT_NAMES.index(name)]).as_matrix()
        frames[child] = (t_parent + R_parent @ offset, R_parent @ turn)
    return frames


def largest_error(body, pose, angles):
    frames = walk(human_urdf(body, "b7"), angles, *body_frame(pose, body.half_lengths[0]))
    points = forward(body, pose)
    return max(np.linalg.norm(frames[link][0] - points[POINT_NAMES.index(p)]) for p, link in LINK_OF_POINT.items())


def test_urdf_walked_with_the_angles_ends_at_the_reference_points(body):
    rng = np.random.default_rng(0)
    for _ in range(40):
        pose = random_pose(rng)
        assert largest_error(body, pose, hri_angles(pose)) < 1e-6
        assert largest_error(body, pose, hri_angles(pose, rng.uniform(-3, 3, 20))) < 1e-6


def test_limb_directions_follow_from_the_angles_with_the_axes_of_rep_155(body):
    """Left arm: -z turned by y about -z, p about +x, r about +z; right arm mirrored; legs y -z, p +-x, r -y."""
    rng = np.random.default_rng(1)
    points = {name: i for i, name in enumerate(POINT_NAMES)}
    limbs = (
        (4, ("left_shoulder", "left_elbow", "left_hand"), ([0, 0, -1], [1, 0, 0], [0, 0, 1])),
        (8, ("right_shoulder", "right_elbow", "right_hand"), ([0, 0, 1], [-1, 0, 0], [0, 0, -1])),
        (12, ("left_hip", "left_knee", "left_foot"), ([0, 0, -1], [1, 0, 0], [0, -1, 0])),
        (16, ("right_hip", "right_knee", "right_foot"), ([0, 0, -1], [-1, 0, 0], [0, -1, 0])),
    )
    for _ in range(20):
        pose = random_pose(rng)
        angles, p = hri_angles(pose), forward(body, pose)
        for first, (start, middle, end), axes in limbs:
            R = pose.R_world_torso
            for axis, angle in zip(axes, angles[first : first + 3], strict=True):
                R = R @ Rotation.from_rotvec(np.array(axis) * angle).as_matrix()
            lower = R @ Rotation.from_rotvec(np.array([0, -1, 0]) * angles[first + 3]).as_matrix()
            for rotation, a, b in ((R, start, middle), (lower, middle, end)):
                direction = p[points[b]] - p[points[a]]
                np.testing.assert_allclose(rotation @ [0, 0, -1], direction / np.linalg.norm(direction), atol=1e-9)


def test_zero_pose_is_a_person_who_stands_with_hanging_arms():
    hanging = pose_with(left_shoulder_x=-np.pi / 2, right_shoulder_x=1.5 * np.pi)
    np.testing.assert_allclose(hri_angles(hanging), 0.0, atol=1e-12)


def test_angles_stay_continuous_while_an_arm_swings_through_hanging(body):
    previous, largest = None, 0.0
    for swing in np.linspace(-0.3, 0.3, 31):  # left arm from behind the body to in front of it
        R_arm = Rotation.from_rotvec([0, -swing, 0]).as_matrix() @ Rotation.from_rotvec([-np.pi / 2, 0, 0]).as_matrix()
        base = Person(body).pose(0.0)
        pose = Pose(base.position_world, base.R_world_torso, [base.R_joints[0], R_arm, *base.R_joints[2:]], base.hinges)
        angles = hri_angles(pose, previous)
        if previous is not None:
            largest = max(largest, np.abs(angles - previous)[4:7].max())
        previous = angles
        assert largest_error(body, pose, angles) < 1e-6
    assert largest < 0.08


@pytest.mark.parametrize(
    ("first", "ids"),
    [("b0001", ["b0001", "b0002", "b0004"]), ("anna", ["anna", "anna_2", "anna_4"]), ("p9", ["p9", "p10", "p12"])],
)
def test_ids_of_others_count_on_from_the_first_persons(first, ids):
    assert [body_id_of(first, person) for person in (1, 2, 4)] == ids
