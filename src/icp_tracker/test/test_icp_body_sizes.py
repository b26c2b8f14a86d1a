"""Sizes of a body from its T-pose, against the bodies that the hulls were carved from, and from its stature; what they
add to the covariance of its points."""

import numpy as np
from t_pose_studio import person, standing, studio

from icp_tracker.initialization import body_sizes
from icp_tracker.initialization.body_sizes import covariance_of_sizes
from icp_tracker.initialization.hull_source import HullSource, TPoseSettings
from icp_tracker.initialization.t_pose_sizes import with_t_pose
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import VolumetricBody


def estimate_of(body, build=1.0, heading=0.4, **angles):
    """What a T-pose before six cameras says of a body's sizes."""
    parts = person(body, standing(body, both_sides(hip_x=0.1, **angles), heading), build)
    return HullSource(TPoseSettings(hold_sets=1), None).find_pose(studio().render(parts)).estimate


def test_sizes_of_people_of_other_proportions_are_within_what_is_claimed():
    rng = np.random.default_rng(7)
    errors, claims, blind = [], [], []
    for _ in range(10):
        stature = rng.uniform(1.45, 1.95)
        truth = body_sizes.MEAN_OVER_STATURE * stature * rng.uniform(0.95, 1.05, len(body_sizes.SIZES))
        body = body_sizes.body_of_sizes(truth)
        estimate = estimate_of(
            body, rng.uniform(0.85, 1.2), rng.uniform(-3, 3), shoulder_x=rng.uniform(-0.2, 0.2), elbow=-0.1
        )
        truth[body_sizes.SIZES.index("ankle_height")] = VolumetricBody(body).ankle_height
        errors.append(estimate.sizes - truth)
        claims.append(estimate.sd)
        blind.append(body_sizes.prior_sizes(1.70).sizes - truth)
    rms_mm, blind_mm = (1e3 * np.sqrt(np.mean(np.square(e), axis=0)) for e in (errors, blind))
    assert rms_mm.max() < 22 and rms_mm.mean() < 12
    assert rms_mm.mean() < 0.6 * blind_mm.mean()  # than an average adult of 1.70 m
    assert 0.3 < np.sqrt(np.mean(np.square(np.array(errors) / np.array(claims)))) < 1.3


def test_claimed_uncertainty_shrinks_where_the_hull_speaks_and_not_where_it_is_silent():
    prior, estimate = body_sizes.prior_sizes(1.75), estimate_of(Body.from_stature(1.75))
    ratio = dict(zip(body_sizes.SIZES, estimate.sd / prior.sd, strict=True))
    assert ratio["forearm"] < 0.95 and ratio["half_shoulder_width"] < 0.75 and ratio["half_hip_width"] < 0.85
    assert ratio["ankle_height"] > 0.9
    # a sum that is seen is better known than its parts
    arm = np.array([name in ("upper_arm", "forearm", "half_shoulder_width") for name in body_sizes.SIZES], float)
    assert np.sqrt(arm @ estimate.covariance @ arm) < estimate.sd[body_sizes.SIZES.index("upper_arm")] * 1.2
    assert (np.linalg.eigvalsh(estimate.covariance) > 0.0).all()


def test_limbs_that_the_hull_lacks_leave_the_sizes_as_they_are_known():
    body, pitch = Body.from_stature(1.75), 0.02
    parts = person(body, standing(body, both_sides(hip_x=0.1)), 1.0)
    voxels, points = studio().render(parts).voxels.points_world, forward(body, standing(body, both_sides(hip_x=0.1)))
    known = body_sizes.prior_sizes(1.75)
    whole = with_t_pose(known, points, voxels, pitch)
    without_legs = with_t_pose(known, points, voxels[voxels[:, 2] > 1.0], pitch)
    nothing = with_t_pose(known, points, voxels[:0], pitch)
    assert np.linalg.det(1e4 * whole.covariance) < np.linalg.det(1e4 * known.covariance)
    for lacking in (without_legs, nothing):
        np.testing.assert_array_equal(lacking.sizes, known.sizes)


def test_of_somebody_of_known_stature_the_sum_is_known_and_the_parts_are_spread_as_peoples_are():
    prior, estimate = body_sizes.prior_sizes(1.75), body_sizes.sizes_of_stature(1.75, 0.015)
    np.testing.assert_allclose(estimate.sizes, prior.sizes, rtol=2e-3)
    standing = np.isin(np.arange(len(body_sizes.SIZES)), [0, 1, 7, 8, 9]).astype(float)
    assert np.sqrt(standing @ estimate.covariance @ standing) < 0.016 < np.sqrt(standing @ prior.covariance @ standing)
    assert (np.abs(estimate.sd / prior.sd - 1.0) < 0.2).all() and (np.linalg.eigvalsh(estimate.covariance) > 0.0).all()


def test_a_size_moves_its_own_point_along_its_own_stick():
    hand, foot, pose = 11, 13, Pose.from_angles(np.array([0.0, 0.0, 1.2]), np.eye(3), T_POSE_ANGLES)
    sds = body_sizes.prior_sizes(1.75).sd
    added = covariance_of_sizes(pose, sds)
    assert np.isclose(added[hand, 1, 1], sds[body_sizes.FOREARM] ** 2)
    assert np.isclose(added[foot, 2, 2], sds[body_sizes.CALF] ** 2)
    assert np.abs(added[[hand, foot], 0, 0]).max() < 1e-12
