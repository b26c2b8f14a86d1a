"""The article's experiment (bench/tracking.py): a chain told that the data are sticks reaches the statistical bound."""

import numpy as np
import pytest
from synthetic.bounds import BOUND_EVERY, SETTLED, bounds
from synthetic.clips import Clip, clouds, studio_clip
from synthetic.trackers import Method, all_joints_alone, chain, chain_for_sticks, track

SEEDS = (0, 1)


@pytest.fixture(scope="module")
def walk() -> Clip:
    return studio_clip("walk", 4.0)


@pytest.fixture(scope="module")
def bound_mm(walk: Clip) -> float:
    return bounds(walk, BOUND_EVERY, SETTLED).mm


def mean_mm(method: Method, clip: Clip) -> float:
    """Mean error of the filtered points, mm, over some draws of the noise."""
    runs = [track(method, clip, clouds(clip, seed), clip.sigma_m) for seed in SEEDS]
    return 1e3 * float(np.mean([run.filtered[SETTLED:].mean() for run in runs]))


@pytest.mark.parametrize("method", [chain_for_sticks(), all_joints_alone()], ids=lambda method: method.name)
def test_a_tracker_told_that_the_data_are_sticks_is_within_5_percent_of_the_bound(method, walk, bound_mm):
    assert mean_mm(method, walk) < 1.05 * bound_mm


def test_the_defaults_for_people_in_hulls_stay_within_a_quarter_of_the_bound(walk, bound_mm):
    assert mean_mm(chain(), walk) < 1.25 * bound_mm
