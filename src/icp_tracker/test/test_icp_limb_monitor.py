"""Other places of limbs: the likeliest one is offered with the whole body, and only for the limb that it is of."""

import numpy as np
from test_icp_track_monitor import FOLDED, LEFT_HAND, data_of, person, posed  # noqa: F401

from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.monitor.evidence import LEFT_ARM, ObservedSet
from icp_tracker.monitor.limb_monitor import LimbMonitor, only
from icp_tracker.monitor.pose_library import LIMBS
from icp_tracker.monitor.track_quality import ALL_PARTS, Hypothesis, contested
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
    assert found.moved == tuple(part == LEFT_ARM for part in range(5)) == only(LIMBS[0])
    points, truth = (forward(person.body, pose) for pose in (found.pose, person.pose))
    assert np.linalg.norm(points[LEFT_HAND] - truth[LEFT_HAND]) < 0.15
    fitted = observed.fitted(found.pose)
    assert np.linalg.norm(forward(person.body, fitted) - truth, axis=1).max() < 0.06


def test_only_another_pose_of_the_whole_body_puts_all_parts_in_doubt(person):  # noqa: F811
    good = TrackQuality(GOOD, "", (GOOD,) * 5, 0.9)
    body = Hypothesis(person.pose, "the body facing the other way", sets=9, seconds=1.0, margin=10.0)
    limb = Hypothesis(person.pose, "left arm elsewhere", only(LIMBS[0]), sets=9, seconds=1.0, margin=10.0)
    assert body.moved == ALL_PARTS
    assert contested(good, body, 2.0).parts == (DOUBTFUL,) * 5
    assert contested(good, limb, 2.0).parts == (GOOD,) * 5
