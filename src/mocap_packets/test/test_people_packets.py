"""Everybody's points in one table, everybody's bodies in one text; the order of stamps."""

import numpy as np
import pytest

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import PeoplePoints, format_bodies, parse_bodies
from mocap_packets.stamp_order import RESTART_AFTER, Order, StampOrder
from stick_figure.body import Body

PERIOD_NS = 20_000_000


def points(seed):
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(15, 3, 3))
    return ReferencePoints(rng.normal(size=(15, 3)), half @ half.transpose(0, 2, 1), rng.random(15) < 0.7)


def with_person(table, person=1.0):
    """The table as it is read from a cloud: rows without a person are the first one's."""
    rows = np.zeros(len(table), PeoplePoints.LAYOUT)
    for name in table.dtype.names:
        rows[name] = table[name]
    if "person" not in table.dtype.names:
        rows["person"] = person
    return rows


@pytest.mark.parametrize("persons", [(1,), (1, 2), (1, 3, 4)])
def test_everybodys_points_come_back_as_they_are_sent(persons):
    people = PeoplePoints({person: points(person) for person in persons})
    back, sent = PeoplePoints.from_table(with_person(people.to_table())), people.as_sent()
    assert list(back.of) == list(persons)
    for person in persons:
        for ours, theirs in zip(back.of[person], sent.of[person], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_the_first_person_alone_is_the_table_of_one_body():
    table = PeoplePoints({1: points(0)}).to_table()
    assert table.dtype == ReferencePoints.LAYOUT and table.tobytes() == points(0).to_table().tobytes()


@pytest.mark.parametrize("rows", [slice(0), slice(14), slice(15, 30), slice(29)])
def test_points_that_are_not_fifteen_of_each_person_are_refused(rows):
    table = with_person(PeoplePoints({1: points(1), 2: points(2)}).to_table())
    with pytest.raises(InputError, match="15 points of each person"):
        PeoplePoints.from_table(table[rows])


def test_bodies_come_back_from_their_text_by_number():
    bodies = {3: Body.from_stature(1.8), 2: Body.from_stature(1.6)}
    back = parse_bodies(format_bodies(bodies, "test"), "there")
    assert list(back) == [2, 3]
    for person, body in bodies.items():
        np.testing.assert_array_equal(back[person].lengths, body.lengths)


@pytest.mark.parametrize(("text", "words"), [("two: {}", "'two' is no person's number"), ("2: {}", "there: person 2")])
def test_bodies_that_are_none_are_refused(text, words):
    with pytest.raises(InputError, match=words):
        parse_bodies(text, "there")


def orders(*sets):
    order = StampOrder()
    return [order.take(k * PERIOD_NS) for k in sets]


def test_stamps_that_rise_are_in_order_whatever_is_missing():
    assert orders(0, 1, 2, 500) == [Order.NEXT] * 4


def test_single_sets_that_come_again_or_late_are_of_the_past():
    assert orders(0, 5, 5, 4, 6, 3, 7) == [
        *(Order.NEXT, Order.NEXT, Order.PAST, Order.PAST, Order.NEXT, Order.PAST, Order.NEXT)
    ]


def test_stamps_that_leap_back_are_a_new_beginning_at_once():
    assert orders(100, 101, 0, 1, 2) == [Order.NEXT, Order.NEXT, Order.RESTART, Order.NEXT, Order.NEXT]


def test_short_footage_that_starts_again_is_a_new_beginning_after_some_sets():
    back = orders(11, *range(RESTART_AFTER + 1))[1:]
    assert back == [Order.PAST] * (RESTART_AFTER - 1) + [Order.RESTART, Order.NEXT]


def test_order_that_was_reset_takes_any_stamp():
    order = StampOrder()
    order.take(1000)
    order.reset()
    assert order.take(5) is Order.NEXT


def arrivals(*sets):
    """Orders of sets (stamp, arrival), both in periods."""
    order = StampOrder()
    return [order.take(stamp * PERIOD_NS, arrival * PERIOD_NS) for stamp, arrival in sets]


def test_a_set_far_in_the_future_is_left_out_and_those_after_it_are_taken():
    centuries = 10**9
    seen = arrivals((0, 0), (1, 1), (centuries, 1), (2, 2), (centuries, 2), (centuries + 1, 2), (3, 3))
    assert seen == [Order.NEXT] * 2 + [Order.AHEAD, Order.NEXT, Order.AHEAD, Order.AHEAD, Order.NEXT]


def test_a_stray_set_of_long_ago_does_not_begin_anew():
    assert arrivals((1000, 0), (1001, 1), (0, 1), (1002, 2)) == [Order.NEXT, Order.NEXT, Order.PAST, Order.NEXT]


def test_a_pause_is_no_leap_however_long_it_was():
    assert arrivals((0, 0), (1, 1), (100_000, 100_000)) == [Order.NEXT] * 3


def test_stamps_that_go_on_from_a_leap_are_believed_after_three_sets():
    ahead = arrivals((0, 0), *((10**6 + k, 1 + k) for k in range(4)))
    assert ahead == [Order.NEXT, Order.AHEAD, Order.AHEAD, Order.NEXT, Order.NEXT]
    back = arrivals((10**6, 0), *((k, 1 + k) for k in range(4)))
    assert back == [Order.NEXT, Order.PAST, Order.PAST, Order.RESTART, Order.NEXT]


def test_a_first_set_of_another_time_does_not_silence_the_others():
    assert arrivals((10**9, 0), *((k, k) for k in range(1, 5)))[2:] == [Order.PAST, Order.RESTART, Order.NEXT]
