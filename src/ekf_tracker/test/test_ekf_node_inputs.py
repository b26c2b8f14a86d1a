"""The filter node over real topics: sets it cannot use, stamps that go back, bad parameters."""

import numpy as np
import pytest
from ekf_person import ALL, isotropic, stamp
from node_probe import FAILURE

from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from sagoma_ros.packets import tables_message


@pytest.mark.parametrize(
    "spoil",
    [
        lambda message: message.data.__setitem__(40, np.nan),
        lambda message: setattr(message.layout.dim[1], "label", "points: x y z"),
        lambda message: setattr(message.layout.dim[1], "size", 14),
        lambda message: setattr(message.layout.dim[0], "label", "odom"),
        lambda message: setattr(message, "data", message.data[:-3]),
    ],
    ids=["nan", "label", "count", "frame", "size"],
)
def test_message_that_cannot_be_read_is_counted_and_the_next_set_is_tracked(bench, person, spoil):
    b = bench().start()
    b.fit(stamp(0), person.points(0.0))
    people = PeoplePoints({1: ReferencePoints(person.points(1 / 60), isotropic(0.01), ALL)})
    message = tables_message(FittedPeople(stamp(1), people, {1: person.body}), "map")
    spoil(message)
    b.people.publish(message)
    b.until(lambda: b.node.health.counter("bad_points") == 1)
    assert not b.answers(stamp(1))
    b.fit(stamp(2), person.points(2 / 60))
    assert b.latest("mocap/state").message == "tracking"


def test_covariance_that_is_none_counts_as_a_set_in_which_nothing_was_seen(bench, person):
    b = bench().start()
    b.fit(stamp(0), person.points(0.0))
    spoilt = isotropic(0.01)
    spoilt[5, 2, 2] = -1.0
    b.send_people(stamp(1), {1: ReferencePoints(person.points(1 / 60), spoilt, ALL)})
    b.until(lambda: b.answers(stamp(1)))
    assert b.node.health.counter("bad_points") == 1
    assert b.latest("mocap/state").message == "doubtful" and b.answers(stamp(1))[0].joint_names


def test_stamp_that_goes_back_is_counted_and_left_out(bench, person):
    b = bench().start()
    for k in (0, 1, 2):
        b.fit(stamp(k), person.points(k / 60))
    b.send(stamp(1) + 5, person.points(1 / 60))
    b.fit(stamp(3), person.points(3 / 60))
    assert b.latest("mocap/state").message == "tracking" and not b.answers(stamp(1) + 5)
    assert b.node.health.counter("backward_stamps") == 1


def test_stamps_that_go_back_far_begin_anew_at_once_and_are_logged_once(bench, person, capfd):
    """A bag played twice, footage that starts again, a clock that was set back."""
    b = bench().start()
    b.fit(stamp(1000), person.points(0.0))
    answers = [b.fit(stamp(k), person.points(k / 60)) for k in range(4)]
    assert all(got[-1][1].joint_names for got in answers)
    assert b.latest("mocap/state").message == "tracking"
    assert b.node.health.counter("restarts") == 1
    assert capfd.readouterr().err.count("stamps went back by 16.667 s: a new beginning") == 1


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"filter__lost_after_s": -3.0}, "filter.lost_after_s = -3.0"),
        ({"filter__gate": 3.0}, "unknown key 'filter.gate'"),
        ({"filter__motion_model": "magic"}, "filter.motion_model = 'magic' is not one of"),
        ({"publish_humans": True, "body_id": "1"}, "'1' is no REP-155 id"),
        ({"tf_prefix": "../.."}, "tf_prefix = '../..' is not a name"),
        ({"tf_prefix": "lab/studio"}, "'lab/studiob0001' is no REP-155 id"),
    ],
)
def test_bad_parameter_fails_the_configuration_with_a_clear_error(bench, parameters, words):
    b = bench(**parameters)
    assert b.node.trigger_configure() == FAILURE
    b.until_said(words)
    b.until(lambda: b.node.count_publishers("/ekf/prediction") == 0)
