"""Sizes of a body from its T-pose, against the bodies that the hulls were carved from."""

import numpy as np
import pytest
from t_pose_studio import person, standing, studio

from icp_tracker.acquisition.body_sizes import MEAN_OVER_STATURE, SIZES, body_of_sizes, estimate_body, prior_sizes
from icp_tracker.acquisition.t_pose_measures import measure_t_pose
from stick_figure.body import Body
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import VolumetricBody

SIX, THREE = (5, True), (3, False)


def measured(rig, body, build=1.0, heading=0.4, **angles):
    parts = person(body, standing(body, both_sides(hip_x=0.1, **angles), heading), build)
    return measure_t_pose(studio(*rig).render(parts).voxels.points_world)


@pytest.mark.parametrize("rig", [SIX, pytest.param(THREE, marks=pytest.mark.slow)])
def test_sizes_of_people_of_other_proportions_are_within_what_is_claimed(rig):
    rng = np.random.default_rng(7)
    errors, claims, blind = [], [], []
    for _ in range(10):
        stature = rng.uniform(1.45, 1.95)
        truth = MEAN_OVER_STATURE * stature * rng.uniform(0.95, 1.05, len(SIZES))
        body = body_of_sizes(truth)
        t_pose = measured(
            rig, body, rng.uniform(0.85, 1.2), rng.uniform(-3, 3), shoulder_x=rng.uniform(-0.2, 0.2), elbow=-0.1
        )
        estimate = estimate_body([t_pose])
        truth[SIZES.index("ankle_height")] = VolumetricBody(body).ankle_height
        errors.append(estimate.sizes - truth)
        claims.append(estimate.sd)
        blind.append(prior_sizes(1.70).sizes - truth)
    rms_mm, blind_mm = (1e3 * np.sqrt(np.mean(np.square(e), axis=0)) for e in (errors, blind))
    assert rms_mm.max() < 22 and rms_mm.mean() < 12
    assert rms_mm.mean() < 0.6 * blind_mm.mean()  # than an average adult of 1.70 m
    assert 0.3 < np.sqrt(np.mean(np.square(np.array(errors) / np.array(claims)))) < 1.3


def test_claimed_uncertainty_shrinks_where_the_hull_speaks_and_not_where_it_is_silent():
    prior, estimate = prior_sizes(1.75), estimate_body([measured(SIX, Body.from_stature(1.75))])
    ratio = dict(zip(SIZES, estimate.sd / prior.sd, strict=True))
    assert ratio["forearm"] < 0.95 and ratio["half_shoulder_width"] < 0.75 and ratio["half_hip_width"] < 0.85
    assert ratio["ankle_height"] > 0.9
    # a sum that is seen is better known than its parts
    arm = np.array([name in ("upper_arm", "forearm", "half_shoulder_width") for name in SIZES], float)
    assert np.sqrt(arm @ estimate.covariance @ arm) < estimate.sd[SIZES.index("upper_arm")] * 1.2
    assert (np.linalg.eigvalsh(estimate.covariance) > 0.0).all()
