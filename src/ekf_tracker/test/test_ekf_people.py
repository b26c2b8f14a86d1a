"""One filter a person: made with the first measurement, dropped with the first set without one."""

from dataclasses import replace

import numpy as np
import pytest
from ekf_person import ALL, isotropic, stamp
from poses import pose_with

from capture_rig.errors import InputError
from ekf_tracker.filter import PeopleFilter
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_packets.state import BodyState
from stick_figure.body import Body
from stick_figure.kinematics import forward

BODIES = {1: Body.from_stature(1.8), 2: Body.from_stature(1.6)}


def measured(person, x=0.0):
    """The person's points in a T-pose, standing at x."""
    return ReferencePoints(forward(BODIES[person], pose_with(at=(x, person, 1.2))), isotropic(0.01), ALL)


def fitted(k, people):
    return FittedPeople(stamp(k), PeoplePoints(people), {person: BODIES[person] for person in people})


def test_person_who_is_not_measured_goes_and_begins_anew_when_measured_again():
    people = PeopleFilter()
    people.step(fitted(1, {1: measured(1), 2: measured(2)}))
    assert list(people.step(fitted(2, {1: measured(1)}))) == [1]
    back = people.step(fitted(3, {1: measured(1), 2: measured(2, 3.0)}))
    np.testing.assert_allclose(back[2].points_world, measured(2, 3.0).points_world, atol=0.01)


def test_points_of_one_that_cannot_be_used_move_nobodys_filter():
    people, spoilt = PeopleFilter(), replace(measured(2), covariance=-isotropic(1.0))
    with pytest.raises(InputError):
        people.step(fitted(1, {1: measured(1), 2: spoilt}))
    assert isinstance(people.step(fitted(1, {1: measured(1), 2: measured(2)}))[1], BodyState)
