"""Several persons before the studio's cameras: standing apart, touching, leaving, coming back."""

from dataclasses import replace

import numpy as np
import pytest
import t_pose_studio

from capture_rig.visibility import RigVisibility
from icp_tracker.people.association import UNCLEAR_SD_M, Expected, associate_parts, associate_rows
from icp_tracker.people.people_tracker import GONE_AFTER_S, PeopleTracker, make_people_tracker
from icp_tracker.settings import IcpNodeSettings
from icp_tracker.tracker import make_tracker
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES
from virtual_studio.motions.everyday import STANDING
from virtual_studio.people import VolumetricBody, person_of

FRAME_NS = 16_666_667
TALL, SHORT = VolumetricBody(person_of(1.80)), VolumetricBody(person_of(1.62), 0.95)
SETTINGS = IcpNodeSettings()
FOUND_SETS = 25
"""Sets after which two persons in a T-pose have been found."""


def standing(person, x, heading=0.0, angles=T_POSE_ANGLES):
    """A pose with the feet on the floor."""
    return t_pose_studio.standing(person.body, angles, heading, (x, 0.0))


TALL_AT, SHORT_AT = standing(TALL, -0.7), standing(SHORT, 0.7, np.pi)
CLOSE = standing(TALL, -0.18, 0.0, STANDING), standing(SHORT, 0.18, np.pi, STANDING)


@pytest.fixture(scope="module")
def hulls():
    """Hull products by scene, carved once."""
    studio, tall, short = t_pose_studio.studio(), TALL.place(TALL_AT), SHORT.place(SHORT_AT)
    return {
        "both": studio.render(tall, short),
        "tall": studio.render(tall),
        "short": studio.render(short),
        "close": studio.render(TALL.place(CLOSE[0]), SHORT.place(CLOSE[1])),
        "rig": studio.rig,
    }


class Play:
    """Hands a tracker one set after another."""

    def __init__(self, hulls):
        self.hulls, self.stamp_ns = hulls, 0
        self.tracker: PeopleTracker = make_people_tracker(SETTINGS, hulls["rig"])

    def __call__(self, scene, sets, every_ns=FRAME_NS):
        """The fits of the last of some sets of a scene, by person."""
        for _ in range(sets):
            self.stamp_ns += every_ns
            fits = self.tracker.step(replace(self.hulls[scene], stamp_ns=self.stamp_ns), {})
        return {fit.person: fit for fit in fits}


def off_mm(fit, person, pose):
    return 1e3 * float(np.linalg.norm(fit.reference_points_world - forward(person.body, pose), axis=1).mean())


def number_of(fits, person, pose):
    """The number of whoever is followed there."""
    (number,) = [number for number, fit in fits.items() if off_mm(fit, person, pose) < 60.0]
    return number


def test_one_person_alone_is_followed_as_by_the_tracker_of_one_body_to_the_last_bit(hulls):
    people = make_people_tracker(SETTINGS, hulls["rig"])
    alone = make_tracker(SETTINGS, RigVisibility(hulls["rig"]))
    for k in range(1, 16):
        seen = replace(hulls["tall"], stamp_ns=k * FRAME_NS)
        (of_people,), of_one = people.step(seen, {}), alone.step(seen)
        assert of_people.person == 1
        assert (of_people.state, of_people.reason) == (of_one.state, of_one.reason)
        np.testing.assert_array_equal(of_people.reference_points_world, of_one.reference_points_world)
        np.testing.assert_array_equal(of_people.covariance, of_one.covariance)
    assert of_one.state == "tracking"


def test_two_persons_in_a_t_pose_are_found_and_numbered_one_and_two(hulls):
    play = Play(hulls)
    assert list(play("both", 1)) == [1]  # the first person is answered for from the first set on
    fits = play("both", FOUND_SETS)
    assert sorted(fits) == [1, 2]
    assert {number_of(fits, TALL, TALL_AT), number_of(fits, SHORT, SHORT_AT)} == {1, 2}
    assert play.tracker.acquiring == ()


@pytest.mark.slow
def test_newcomer_whose_part_of_the_hull_is_missing_now_and_then_is_found(hulls):
    play = Play(hulls)
    play("tall", 15)
    for _ in range(FOUND_SETS):  # the second person's part is there for less time than it takes to find it
        fits = play("both", 4)
        play("tall", 1)
    assert number_of(fits, SHORT, SHORT_AT) == 2


def test_second_person_who_enters_later_leaves_and_comes_back_keeps_the_number(hulls):
    play = Play(hulls)
    assert sorted(play("tall", 15)) == [1]
    fits = play("both", FOUND_SETS)
    assert number_of(fits, TALL, TALL_AT) == 1
    assert number_of(fits, SHORT, SHORT_AT) == 2
    fits = play("tall", 4)
    assert fits[2].state == "lost"
    away = play("tall", 5, round(GONE_AFTER_S * 1e9))
    assert sorted(away) == [1]
    assert away[1].state == "tracking"
    assert number_of(play("both", FOUND_SETS), SHORT, SHORT_AT) == 2


def test_first_person_who_leaves_keeps_the_number_and_the_second_stays_the_second(hulls):
    play = Play(hulls)
    play("tall", 15)
    play("both", FOUND_SETS)
    fits = play("short", 5, round(GONE_AFTER_S * 1e9))
    assert fits[1].state == "lost"
    assert fits[2].state == "tracking"
    assert off_mm(fits[2], SHORT, SHORT_AT) < 60.0
    assert number_of(play("both", FOUND_SETS), TALL, TALL_AT) == 1


EXPECTED_CLOSE = [Expected(1, TALL.body, CLOSE[0]), Expected(2, SHORT.body, CLOSE[1])]


def rows_of(seen):
    """Each person's rows of a set in which both are one part."""
    return associate_rows(seen, associate_parts(seen, seen.numbers(), EXPECTED_CLOSE), EXPECTED_CLOSE)


def test_part_of_two_persons_who_touch_belongs_to_both_and_its_rows_to_who_explains_them(hulls):
    seen = hulls["close"]
    (part,) = seen.numbers()
    association = associate_parts(seen, [part], EXPECTED_CLOSE)
    assert association.shared == {part: (1, 2)} and association.sharers(1) == (2,)
    rows = rows_of(seen)
    for person, side in ((1, -1.0), (2, 1.0)):  # they stand on either side of x = 0, 0.36 m apart
        own = rows[person]
        assert len(own.contour_rays) > 0.3 * len(seen.contour_rays)
        assert np.mean(side * own.centerline.points_world[:, 0] > 0.0) > 0.9
        assert np.mean(side * own.voxels.points_world[own.voxels.surface][:, 0] > -0.05) > 0.9
        assert len(own.voxels) == len(seen.voxels)  # sticks lie in the common hull


def test_rays_that_both_explain_are_less_certain_than_those_of_one(hulls):
    seen = hulls["close"]
    rows = rows_of(seen)
    measured, of_1, of_2 = (sigma_of_rays(hull) for hull in (seen, rows[1], rows[2]))
    both, alone = of_1.keys() & of_2.keys(), of_1.keys() ^ of_2.keys()
    assert len(both) > 10 and len(alone) > 100
    assert all((of_1 | of_2)[ray] == measured[ray] for ray in alone)
    added = np.sqrt([max(of_1[ray] ** 2 - measured[ray] ** 2, 0.0) for ray in both])
    assert np.isclose(added.max(), UNCLEAR_SD_M, rtol=1e-4)


def sigma_of_rays(hull):
    rays = hull.contour_rays
    return {tuple(point): sigma for point, sigma in zip(rays.points_world, rays.sigma, strict=True)}


def test_ray_that_nobody_explains_is_left_to_both(hulls):
    seen = hulls["close"]
    rays = seen.contour_rays
    lost = replace(rays, points_world=rays.points_world + np.array([0.0, 0.6, 0.0]))  # as far from either
    assert sum(len(own.contour_rays) for own in rows_of(replace(seen, contour_rays=lost)).values()) > 1.4 * len(rays)
