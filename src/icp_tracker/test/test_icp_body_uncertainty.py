"""What the rig does not show is as uncertain as the lengths and directions that lead there; the rest is left alone."""

import numpy as np

from capture_rig.rig import Rig, Volume
from capture_rig.visibility import RigVisibility
from icp_tracker.acquisition.body_sizes import CALF, FOREARM, THIGH, prior_sizes
from icp_tracker.body_uncertainty import DIRECTION_SD, covariance_of_sizes, widen_hidden
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from virtual_studio.rig import VOLUME, ring

BODY = Body.from_stature(1.75)
POSE = Pose.from_angles(np.array([0.0, 0.0, 1.2]), np.eye(3), T_POSE_ANGLES)
POINTS = forward(BODY, POSE)
NARROW = 1e-6 * np.tile(np.eye(3), (15, 1, 1))
SIZES = np.sqrt(np.diag(prior_sizes(1.75).covariance))
KNEE, FOOT, HAND = 9, 13, 11
SEEN = np.ones(15, bool)


def visibility_without(axis, low):
    """A rig whose volume ends at ``low`` along an axis."""
    far = VOLUME.high.copy()
    far[axis] = low
    return RigVisibility(Rig(ring(4).cameras, Volume(VOLUME.low.copy(), far)))


def test_without_a_rig_or_with_all_in_view_nothing_changes():
    assert widen_hidden(NARROW, POINTS, SEEN, SIZES, None) is NARROW
    assert widen_hidden(NARROW, POINTS, SEEN, SIZES, RigVisibility(ring(4))) is NARROW


def test_a_size_moves_its_own_point_along_its_own_stick():
    added = covariance_of_sizes(POSE, SIZES)
    assert np.isclose(added[HAND, 1, 1], SIZES[FOREARM] ** 2) and np.isclose(added[FOOT, 2, 2], SIZES[CALF] ** 2)
    assert np.abs(added[[HAND, FOOT], 0, 0]).max() < 1e-12


def test_a_hidden_hand_at_an_elbow_that_is_shown_adds_no_other_length():
    elbow, hand = POINTS[7, 1], POINTS[HAND, 1]
    wide = widen_hidden(NARROW, POINTS, SEEN, SIZES, visibility_without(1, 0.5 * (elbow + hand)))
    assert np.array_equal(wide, NARROW)


def test_lengths_add_up_along_a_leg_that_is_hidden_from_the_hip_on():
    upside_down = POINTS * [1.0, -1.0, -1.0] + [0.0, 0.0, 2.4]
    hips = upside_down[5, 2]
    wide = widen_hidden(NARROW, upside_down, SEEN, SIZES, visibility_without(2, hips + 0.1)) - NARROW
    assert not wide[KNEE].any()  # the thigh's own
    assert np.isclose(wide[FOOT, 2, 2], SIZES[THIGH] ** 2, rtol=0.05)


def test_direction_is_unknown_too_where_no_datum_bears_on_a_stick():
    elbow, hand = POINTS[7, 1], POINTS[HAND, 1]
    supported = SEEN.copy()
    supported[HAND] = False
    wide = widen_hidden(NARROW, POINTS, supported, None, visibility_without(1, 0.5 * (elbow + hand))) - NARROW
    assert np.isclose(np.sqrt(wide[HAND, 2, 2]), DIRECTION_SD * (hand - elbow), rtol=0.01)
    assert wide[HAND, 1, 1] < 1e-12  # a body of given sizes
