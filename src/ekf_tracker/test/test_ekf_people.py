"""One filter a person: made with the first measurement, dropped with the first set without one."""

import numpy as np

from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.people import PeopleFilter
from mocap_packets.fit import ReferencePoints
from mocap_packets.state import BodyState, NoState
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


def following(*persons):
    people = PeopleFilter()
    for person in persons:
        people.follow(person, BODIES[person])
    return people


def test_every_person_is_filtered_as_alone():
    people, alone = following(1, 2), ArticulatedEkf(BODIES[2])
    for k in range(1, 6):
        both = people.step(k * FRAME_NS, {1: measured(1), 2: measured(2, 0.01 * k)})
        one = alone.step(k * FRAME_NS, *measured(2, 0.01 * k))
        np.testing.assert_array_equal(both[2].points_world, one.points_world)
    assert isinstance(both[1], BodyState)


def test_person_who_is_not_measured_goes_and_begins_anew_when_measured_again():
    people = following(1, 2)
    people.step(FRAME_NS, {1: measured(1), 2: measured(2)})
    assert list(people.step(2 * FRAME_NS, {1: measured(1)})) == [1]
    people.follow(2, BODIES[2])
    back = people.step(3 * FRAME_NS, {1: measured(1), 2: measured(2, 3.0)})
    np.testing.assert_allclose(back[2].points_world, measured(2, 3.0).points_world, atol=0.01)


def test_first_person_is_answered_for_without_a_body():
    answer = PeopleFilter().step(FRAME_NS, {1: measured(1)})[1]
    assert isinstance(answer, NoState)
