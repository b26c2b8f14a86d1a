"""Sizes of a body from its T-pose, against the bodies that the hulls were carved from; what the rig does not show is as
uncertain as the lengths and directions that lead there."""

import numpy as np
from t_pose_studio import person, standing, studio

from capture_rig.rig import Rig, Volume
from capture_rig.visibility import RigVisibility
from icp_tracker.acquisition import body_sizes
from icp_tracker.acquisition.hull_source import HullSource, TPoseSettings
from icp_tracker.acquisition.t_pose_sizes import with_t_pose
from icp_tracker.articulated_fit import UNSEEN_SD
from icp_tracker.body_uncertainty import covariance_of_sizes, widen_hidden
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import VolumetricBody
from virtual_studio.rig import VOLUME, ring


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


# --- what the rig does not show ---------------------------------------------------------------------------------------

BODY = Body.from_stature(1.75)
POSE = Pose.from_angles(np.array([0.0, 0.0, 1.2]), np.eye(3), T_POSE_ANGLES)
POINTS = forward(BODY, POSE)
NARROW = 1e-6 * np.tile(np.eye(3), (15, 1, 1))
SIZE_SDS = np.sqrt(np.diag(body_sizes.prior_sizes(1.75).covariance))
KNEE, FOOT, HAND = 9, 13, 11
SEEN = np.ones(15, bool)


def visibility_without(axis, low):
    """A rig whose volume ends at ``low`` along an axis."""
    far = VOLUME.high.copy()
    far[axis] = low
    return RigVisibility(Rig(ring(4).cameras, Volume(VOLUME.low.copy(), far)))


def test_without_a_rig_or_with_all_in_view_nothing_changes():
    assert widen_hidden(NARROW, POINTS, SEEN, SIZE_SDS, None) is NARROW
    assert widen_hidden(NARROW, POINTS, SEEN, SIZE_SDS, RigVisibility(ring(4))) is NARROW


def test_a_size_moves_its_own_point_along_its_own_stick():
    added = covariance_of_sizes(POSE, SIZE_SDS)
    assert np.isclose(added[HAND, 1, 1], SIZE_SDS[body_sizes.FOREARM] ** 2) and np.isclose(
        added[FOOT, 2, 2], SIZE_SDS[body_sizes.CALF] ** 2
    )
    assert np.abs(added[[HAND, FOOT], 0, 0]).max() < 1e-12


def test_a_hidden_hand_at_an_elbow_that_is_shown_adds_no_other_length():
    elbow, hand = POINTS[7, 1], POINTS[HAND, 1]
    wide = widen_hidden(NARROW, POINTS, SEEN, SIZE_SDS, visibility_without(1, 0.5 * (elbow + hand)))
    assert np.array_equal(wide, NARROW)


def test_lengths_add_up_along_a_leg_that_is_hidden_from_the_hip_on():
    upside_down = POINTS * [1.0, -1.0, -1.0] + [0.0, 0.0, 2.4]
    hips = upside_down[5, 2]
    wide = widen_hidden(NARROW, upside_down, SEEN, SIZE_SDS, visibility_without(2, hips + 0.1)) - NARROW
    assert not wide[KNEE].any()  # the thigh's own
    assert np.isclose(wide[FOOT, 2, 2], SIZE_SDS[body_sizes.THIGH] ** 2, rtol=0.05)


def test_direction_is_unknown_too_where_no_datum_bears_on_a_stick():
    elbow, hand = POINTS[7, 1], POINTS[HAND, 1]
    supported = SEEN.copy()
    supported[HAND] = False
    wide = widen_hidden(NARROW, POINTS, supported, None, visibility_without(1, 0.5 * (elbow + hand))) - NARROW
    assert np.isclose(np.sqrt(wide[HAND, 2, 2]), UNSEEN_SD * (hand - elbow), rtol=0.01)
    assert wide[HAND, 1, 1] < 1e-12  # a body of given sizes
