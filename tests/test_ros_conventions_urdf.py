"""URDFs of bodies, ours and that of REP-155: shapes, masses, limits, angles that go on, the command that writes one."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from poses import pose_with

from capture_rig.session import load_truth
from ekf_tracker.rep155 import HRI_JOINT_NAMES, hri_angles, hri_rates, human_urdf
from ekf_tracker.urdf import body_urdf, same_sizes
from sagoma_tools.cli import main
from stick_figure.body import Body, save_body
from stick_figure.body_surface import BodySurface, segment_inertias
from stick_figure.kinematics import inverse
from stick_figure.skeleton import ANGLE_NAMES, L_THIGH, STICK_NAMES

BODY_ID = "b0001"


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


def test_rates_of_rep155_angles_are_those_at_which_they_go_on():
    velocity = np.concatenate([np.zeros(3), np.random.default_rng(1).normal(size=21)])
    pose = pose_with(left_elbow=-0.6, right_elbow=-0.4, left_knee=0.5)
    before = hri_angles(pose)
    for _ in range(400):
        pose = pose.retract(0.01 * velocity)
        found = hri_angles(pose, before)
        rates = hri_rates(pose, velocity, found)
        assert np.isfinite(rates).all()
        still = np.abs(rates) < 20.0  # elsewhere an angle swings through its gimbal lock
        np.testing.assert_allclose((found - before)[still], 0.01 * rates[still], atol=0.12)
        before = found


def test_urdf_command_prints_the_body_of_a_file_or_of_a_stature(tmp_path, capsys):
    body = Body.from_stature(1.63)
    save_body(body, tmp_path / "body.yaml")
    assert main(["urdf", "--body", str(tmp_path / "body.yaml"), "--id", "anna"]) == 0
    assert capsys.readouterr().out == body_urdf(body, "anna")
    assert main(["urdf", "--stature", "1.9", "--rep155"]) == 0
    assert capsys.readouterr().out == human_urdf(Body.from_stature(1.9), BODY_ID)
