"""Other places of limbs: the likeliest one is offered with the whole body, and only for the limb that it is of."""

from dataclasses import replace

import numpy as np
from test_icp_track_monitor import FOLDED, LEFT_HAND, data_of, person, posed  # noqa: F401

from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.monitor.evidence import LEFT_ARM, ObservedSet
from icp_tracker.monitor.limb_monitor import LimbMonitor, limb_elsewhere
from icp_tracker.monitor.pose_library import LIMBS
from icp_tracker.monitor.track_monitor import RecoverySettings, TrackMonitor
from mocap_packets.fit import DOUBTFUL, GOOD, TrackQuality
from stick_figure.kinematics import forward

QUIET, IN_SIGHT = np.zeros(len(LIMBS)), np.zeros(len(LIMBS), bool)
TURNS_OF_ALL = range(40)  # every limb's whole library is looked at in so many


def test_the_likeliest_place_is_that_of_the_arm_that_went_astray(person):  # noqa: F811
    astray = posed(FOLDED, person.pose)
    monitor = LimbMonitor(2.0, 0.05)
    assert monitor.elsewhere(astray) is None  # nothing was looked at yet
    observed = ObservedSet(1 / 60, person.body, data_of(person), ArticulatedSettings())
    monitor.look(observed, astray, TURNS_OF_ALL, QUIET, IN_SIGHT)
    found = monitor.elsewhere(astray)
    assert found.why == "left arm elsewhere"
    assert found.moved == tuple(part == LEFT_ARM for part in range(5))
    points, truth = (forward(person.body, pose) for pose in (found.pose, person.pose))
    assert np.linalg.norm(points[LEFT_HAND] - truth[LEFT_HAND]) < 0.15
    fitted = observed.fitted(found.pose)
    assert np.linalg.norm(forward(person.body, fitted) - truth, axis=1).max() < 0.06


def test_a_limb_that_may_be_elsewhere_leaves_other_doubts_and_their_covariance_alone(person):  # noqa: F811
    outside = TrackQuality(DOUBTFUL, "right leg: 4 of 6 points outside the hull", (GOOD,) * 4 + (DOUBTFUL,), 0.9)
    observed = ObservedSet(1 / 60, person.body, data_of(person), ArticulatedSettings())
    monitor = TrackMonitor(RecoverySettings())
    monitor._hypothesis = replace(limb_elsewhere(LIMBS[0], person.pose), sets=1, seconds=0.01, margin=1.0)
    found = monitor._decide(observed, person.pose, outside)
    assert found.better is None and found.hypothesis is None
    assert found.quality == outside
