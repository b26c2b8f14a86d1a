"""Everybody's points and bodies in one packet; everybody's bodies in one text."""

import numpy as np
import pytest

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints, body_numbers, format_bodies, parse_bodies
from mocap_packets.table import SetAges
from stick_figure.body import Body


def points(seed):
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(15, 3, 3))
    covariance = half @ half.transpose(0, 2, 1)
    covariance = np.triu(covariance) + np.triu(covariance, 1).transpose(0, 2, 1)
    return ReferencePoints(rng.normal(size=(15, 3)), covariance, rng.random(15) < 0.7)


@pytest.mark.parametrize("persons", [(1,), (1, 2), (1, 3, 4)])
def test_everybody_comes_back_from_tables_without_any_loss(persons):
    body = Body(0.1 + np.random.default_rng(4).random(10), 0.2, 0.81, 0.71, np.arange(14) / 7)
    people = PeoplePoints({person: points(person) for person in persons})
    sent = FittedPeople(5, people, {persons[-1]: body.bent(np.full(7, 0.01))}, SetAges(9_000_001, 15_000_000))
    back = FittedPeople.from_tables(5, sent.to_tables())
    assert back.ages == sent.ages and list(back.bodies) == [persons[-1]]
    assert body_numbers(back.bodies[persons[-1]]) == body_numbers(body)
    assert list(back.points.of) == list(persons)
    for person in persons:
        for ours, theirs in zip(back.points.of[person], people.of[person], strict=True):
            assert ours.tobytes() == theirs.tobytes()


def test_the_first_person_alone_is_the_table_of_one_body():
    table = PeoplePoints({1: points(0)}).to_table()
    assert table.dtype == ReferencePoints.LAYOUT and table.tobytes() == points(0).to_table().tobytes()


@pytest.mark.parametrize("rows", [slice(0), slice(14), slice(15, 30), slice(29)])
def test_points_that_are_not_fifteen_of_each_person_are_refused(rows):
    table = PeoplePoints({1: points(1), 2: points(2)}).to_table()
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
