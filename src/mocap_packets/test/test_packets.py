"""Packets: tables there and back without any loss, rows of one body, everybody's points and bodies."""

from dataclasses import replace

import numpy as np
import pytest

from capture_rig.errors import InputError
from mocap_packets.fit import Fit, ReferencePoints
from mocap_packets.hull import Centerline, ContourRays, HullProducts, VoxelSamples
from mocap_packets.people import FittedPeople, PeoplePoints, body_numbers, format_bodies, parse_bodies
from mocap_packets.table import SetAges
from stick_figure.body import Body

ROWS = 12
RNG = np.random.default_rng(0)
BODY = np.arange(ROWS, dtype=np.int32) % 3 - 1


def products():
    """Rows of bodies 0 and 1, and of none."""
    points, unit = RNG.normal(size=(3, ROWS, 3)), np.eye(3)[np.arange(ROWS) % 3]
    line = Centerline(points[0], *RNG.random((1, ROWS)), BODY.astype(np.uint8) % 3, *RNG.random((3, ROWS)), BODY)
    rays = ContourRays(points[2], unit, np.roll(unit, 1, axis=1), *RNG.random((2, ROWS)), BODY + 1, BODY)
    return HullProducts(5, line, VoxelSamples(points[1], RNG.random(ROWS) < 0.5, BODY), rays)


def parts(hull):
    return hull.centerline, hull.voxels, hull.contour_rays


def test_tables_give_back_every_byte():
    made = replace(products(), ages=SetAges(9_000_001, 15_000_000))
    back = HullProducts.from_tables(5, made.to_tables())
    assert (back.stamp_ns, back.ages) == (made.stamp_ns, made.ages)
    for packet, again in zip(parts(made), parts(back), strict=True):
        for name, values in vars(packet).items():
            mine = getattr(again, name)
            assert mine.dtype == values.dtype and mine.tobytes() == values.tobytes(), name


def test_rows_of_one_body_leave_out_all_others():
    one = products().of_body(1)
    assert one.stamp_ns == 5
    for part in parts(one):
        assert len(part) == np.count_nonzero(BODY == 1) and (part.body == 1).all()


def test_covariances_of_a_fit_leave_it_exactly_symmetric_as_six_numbers_are():
    root = RNG.normal(size=(15, 3, 3))
    covariance = root @ root.transpose(0, 2, 1)
    covariance[:, 2, 0] += 1e-17
    fit = Fit(1, "tracking", "own", "", 0, RNG.normal(size=(15, 3)), covariance, np.arange(15) % 2 == 0, None, None)
    points = fit.reference_points
    np.testing.assert_array_equal(points.covariance, points.covariance.transpose(0, 2, 1))
    np.testing.assert_array_equal(points.covariance[:, 0], covariance[:, 0])
    for mine, again in zip(points, type(points).from_table(points.to_table()), strict=True):
        assert mine.dtype == again.dtype and mine.tobytes() == again.tobytes()


@pytest.mark.parametrize("count", [0, 5, 100])
def test_thinned_rays_are_evenly_spread_and_never_more_than_asked_for(count):
    rays = products().contour_rays
    thin = rays.thinned(count)
    assert len(thin) == min(count, ROWS)
    assert set(thin.sigma) <= set(rays.sigma)


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
