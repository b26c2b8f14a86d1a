"""One filter a person: made with the first measurement, dropped with the first set without one."""

from dataclasses import replace

import numpy as np
import pytest

from capture_rig.errors import InputError
from ekf_tracker.filter import PeopleFilter
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_packets.state import BodyState
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

BODIES = {1: Body.from_stature(1.8), 2: Body.from_stature(1.6)}
FRAME_NS = 16_666_667


def measured(person, x=0.0):
    """The person's points in a T-pose, standing at x."""
    pose = Pose.from_angles(np.array([x, float(person), 1.2]), np.eye(3), T_POSE_ANGLES)
    points = forward(BODIES[person], pose)
    return ReferencePoints(points, np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))


def fitted(k, people, bodies=BODIES):
    return FittedPeople(k * FRAME_NS, PeoplePoints(people), {p: bodies[p] for p in people if p in bodies})


def test_points_of_one_that_cannot_be_used_move_nobodys_filter():
    people, spoilt = PeopleFilter(), replace(measured(2), covariance=-np.tile(np.eye(3), (15, 1, 1)))
    with pytest.raises(InputError):
        people.step(fitted(1, {1: measured(1), 2: spoilt}))
    assert isinstance(people.step(fitted(1, {1: measured(1), 2: measured(2)}))[1], BodyState)
