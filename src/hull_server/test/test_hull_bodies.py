"""Separate bodies: how many, how large, where, which parts are theirs, and who is who over time."""

import numpy as np
import pytest

from hull_server.grid import BrickVolume, VoxelGrid
from hull_server.settings import BodySettings
from hull_server.slicing.bodies import NOBODY, BodyTracker
from hull_server.slicing.skeletonisation import slice_hull
from hull_server.slicing.voxel_runs import sample_runs

VOXEL = 0.04
MS = 1_000_000


def boxes(*corners: tuple[tuple[int, int, int], tuple[int, int, int]]) -> BrickVolume:
    """A volume of 4 x 4 x 2.4 m with boxes (low, high) of voxels of 40 mm."""
    dense = np.zeros((100, 100, 60), bool)
    for low, high in corners:
        dense[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return BrickVolume.from_dense(VoxelGrid(np.array([-2.0, -2.0, 0.0]), VOXEL, dense.shape), dense)


def person(x: int, y: int, width: int = 8) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """82 litres at a width of 8 voxels."""
    return (x, y, 0), (x + width, y + 4, 40)


def step(tracker: BodyTracker, volume: BrickVolume, at_ms: int = 0):
    return tracker.step(at_ms * MS, slice_hull(volume)[1], volume.grid)


def test_bodies_are_counted_measured_and_ordered_by_volume():
    volume = boxes(person(10, 10), person(60, 50, width=12))
    bodies = step(BodyTracker(BodySettings()), volume)
    assert bodies.litres == pytest.approx([12 * 4 * 40 * 0.064, 8 * 4 * 40 * 0.064])
    assert bodies.number.tolist() == [0, 1]
    np.testing.assert_allclose(bodies.low_world[0], [0.4, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(bodies.high_world[0], [0.88, 0.16, 1.6], atol=1e-12)
    np.testing.assert_allclose(bodies.centroid_world[0], [0.64, 0.08, 0.8], atol=1e-12)


def test_small_parts_belong_to_the_nearest_body():
    hand, ghost = ((74, 51, 20), (76, 53, 24)), ((10, 20, 0), (13, 23, 4))
    volume = boxes(person(10, 10), person(60, 50, width=12), hand, ghost)
    runs = slice_hull(volume)[1]
    bodies = BodyTracker(BodySettings()).step(0, runs, volume.grid)
    samples = sample_runs(runs, volume.grid, 10**6)
    assert len(bodies) == 2 and len(bodies.number_of_part) == 4
    near_second = samples.points_world[:, 0] > 0.2
    assert np.array_equal(bodies.number_of_part[samples.body], np.where(near_second, 0, 1))


def test_parts_of_a_torn_person_are_one_body():
    legs, trunk = ((20, 20, 0), (28, 24, 16)), ((24, 23, 18), (32, 27, 42))  # a belt is missing, and he leans
    bodies = step(BodyTracker(BodySettings()), boxes(legs, trunk, person(60, 50)))
    assert len(bodies) == 2 and bodies.number_of_part.tolist() == [1, 0, 1]
    torn = int(np.argmin(bodies.centroid_world[:, 0]))
    np.testing.assert_allclose(bodies.high_world[torn] - bodies.low_world[torn], [0.48, 0.28, 1.68])
    assert bodies.litres[torn] == pytest.approx((8 * 4 * 16 + 8 * 4 * 24) * 0.064)


def test_people_side_by_side_and_behind_each_other_are_not_joined():
    tracker = BodyTracker(BodySettings())
    assert len(step(tracker, boxes(person(20, 10), person(29, 10)))) == 2  # 0.36 m from middle to middle
    assert len(step(tracker, boxes(person(20, 10, 12), person(20, 17, 12)))) == 2  # 0.28 m: chest to back
    assert len(step(tracker, boxes(((20, 10, 0), (28, 12, 40)), ((20, 13, 0), (28, 15, 40))))) == 1  # a slit


def test_nobody_is_there_when_all_parts_are_small_or_the_hull_is_empty():
    small = step(BodyTracker(BodySettings()), boxes(((5, 5, 5), (9, 9, 9))))
    assert len(small) == 0 and small.number_of_part.tolist() == [NOBODY]
    empty = step(BodyTracker(BodySettings()), boxes())
    assert len(empty) == 0 and len(empty.number_of_part) == 0


def test_bodies_keep_their_numbers_while_they_walk_and_change_rank():
    tracker = BodyTracker(BodySettings())
    for frame in range(20):  # one walks past the other, growing from smaller to larger
        volume = boxes(person(20 + 2 * frame, 10, width=6 + frame // 3), person(40, 40, width=8))
        bodies = step(tracker, volume, 100 * frame)
        walker = np.argmin(bodies.centroid_world[:, 1])
        assert bodies.number[walker] == 1 and walker == (1 if frame < 6 else 0 if frame > 8 else walker)


def test_body_gets_its_number_back_when_it_returns_in_time_and_a_new_one_when_late():
    tracker = BodyTracker(BodySettings())
    both, one = boxes(person(10, 10, 10), person(60, 50)), boxes(person(60, 50))
    assert step(tracker, both).number.tolist() == [0, 1]
    assert step(tracker, one, 100).number.tolist() == [1]
    assert step(tracker, both, 900).number.tolist() == [0, 1]
    assert step(tracker, one, 1000).number.tolist() == [1]
    assert step(tracker, one, 2000).number.tolist() == [1]
    moved = boxes(person(10, 80, 10), person(60, 50))
    assert step(tracker, moved, 2100).number.tolist() == [0, 1]  # forgotten: the lowest free number


def test_body_that_jumps_is_somebody_else():
    tracker = BodyTracker(BodySettings())
    assert step(tracker, boxes(person(10, 10))).number.tolist() == [0]
    assert step(tracker, boxes(person(16, 10)), 100).number.tolist() == [0]  # 0.24 m
    assert step(tracker, boxes(person(60, 50)), 200).number.tolist() == [1]


def test_two_who_touch_are_one_body_and_have_their_numbers_again_afterwards():
    tracker = BodyTracker(BodySettings())
    apart = boxes(person(20, 10), person(36, 10))
    touching = boxes(person(24, 10), person(32, 10))
    assert step(tracker, apart).number.tolist() == [0, 1]
    assert len(step(tracker, touching, 100)) == 1
    again = step(tracker, apart, 200)
    by_x = again.number[np.argsort(again.centroid_world[:, 0])]
    assert sorted(by_x.tolist()) == [0, 1]


def test_tracker_starts_afresh_when_time_runs_backwards():
    tracker = BodyTracker(BodySettings())
    two, one = boxes(person(10, 10, 10), person(60, 50)), boxes(person(60, 50))
    step(tracker, two, 500)
    assert step(tracker, one, 400).number.tolist() == [0]
