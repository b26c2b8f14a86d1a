"""Sizes of a body whose stature is known, and what they add to the covariance of its points."""

import numpy as np

from icp_tracker.acquisition import body_sizes
from icp_tracker.body_uncertainty import covariance_of_sizes
from stick_figure.pose import T_POSE_ANGLES, Pose


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
