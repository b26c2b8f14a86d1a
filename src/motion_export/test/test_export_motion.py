"""Samples become frames of a constant rate; gaps stay gaps until a format needs them filled."""

import numpy as np
import pytest
from export_motions import RATE_HZ, START_NS, swinging

from capture_rig.errors import InputError
from motion_export.motion import fill_linearly, fill_rotations, usual_rate


def test_frames_lie_on_the_rate_of_the_stamps_or_another_one_and_a_gap_is_nan() -> None:
    motion = swinging(gap=(30, 42))
    assert motion.rate_hz == RATE_HZ and len(motion) == 90
    assert motion.gaps == [(30, 42)]
    assert np.isnan(motion.points_world[30:42]).all() and np.isfinite(motion.points_world[42:]).all()
    assert motion.tracked.sum() == 78
    slower = swinging(rate_hz=30.0)
    assert len(slower) == 45 and slower.tracked.all()


def test_stamps_that_jitter_fall_on_the_usual_rate() -> None:
    rng = np.random.default_rng(0)
    stamps = START_NS + (np.arange(200) * 1e9 / 59.97 + rng.normal(0.0, 5e5, 200)).astype(np.int64)
    assert usual_rate(stamps) == 60.0
    assert usual_rate(START_NS + np.arange(10) * 30_000_000) == pytest.approx(33.333, abs=1e-3)


def test_filled_gaps_lie_between_their_ends() -> None:
    whole, gappy = swinging(), swinging(gap=(40, 43))
    filled = fill_linearly(gappy.points_world, gappy.tracked)
    assert np.abs(filled - whole.points_world)[40:43].max() < 0.01  # three frames of a smooth motion
    R = fill_rotations(gappy.R_world_torso, gappy.tracked)
    assert np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-9
    assert np.abs(R - whole.R_world_torso)[40:43].max() < 0.01


def test_too_short_a_take_and_a_rate_that_is_none_are_refused() -> None:
    with pytest.raises(InputError, match="1 tracked frames"):
        swinging(gap=(1, 90))
    with pytest.raises(InputError, match="rate"):
        swinging(rate_hz=-5.0)
