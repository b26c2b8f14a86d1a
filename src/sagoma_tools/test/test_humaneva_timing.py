"""The common clock of cameras and motion capture, from their offsets alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sagoma_tools.importers.humaneva.ofs import Offset
from sagoma_tools.importers.humaneva.timing import common_time

IMAGE, MOCAP = st.floats(1, 400), st.floats(-200, 800)


def test_common_frame_one_is_the_first_image_of_the_camera_that_starts_latest():
    # image 1 at mocap frame 13, 9, 21
    time = common_time({"C1": Offset(10, 31, 2), "C2": Offset(7, 21, 2), "BW1": Offset(6, 31, 2)})
    assert dict(time.first_image) == {"C1": 5, "C2": 7, "BW1": 1}
    assert time.mocap(np.array([1, 6])).tolist() == [21.0, 31.0]
    assert time.image("C1", 6) == 10 and time.image("BW1", 6) == 6


def test_motion_capture_that_starts_after_the_cameras_is_common_frame_one():
    time = common_time({"C1": Offset(51, 1, 2), "C2": Offset(61, 1, 2)})
    assert dict(time.first_image) == {"C1": 51, "C2": 61}
    assert time.mocap(np.array([1, 2])).tolist() == [1.0, 3.0]


def test_half_a_frame_is_rounded_up():
    time = common_time({"C1": Offset(1, 10, 2), "C2": Offset(1, 9, 2)})
    assert dict(time.first_image) == {"C1": 1, "C2": 2}


@given(st.lists(st.tuples(IMAGE, MOCAP), min_size=1, max_size=7), st.floats(1.99, 2.01), st.integers(1, 1000))
def test_every_image_is_within_half_a_frame_of_the_common_instant(pairs, rate, frame):
    offsets = {f"C{k}": Offset(image, mocap, rate) for k, (image, mocap) in enumerate(pairs)}
    time = common_time(offsets)
    instant = float(time.mocap(np.array([frame]))[0])
    assert time.first_mocap >= 1.0 - 1e-9 and min(time.first_image.values()) >= 1
    for name, offset in offsets.items():
        taken_at = offset.mocap + (time.image(name, frame) - offset.image) * rate  # what the .ofs file says
        assert abs(taken_at - instant) <= 0.5 * rate + 1e-6


def test_the_rate_is_the_mean_of_all_cameras():
    time = common_time({"C1": Offset(1, 1, 1.9), "C2": Offset(1, 1, 2.1)})
    assert time.mocap_per_frame == pytest.approx(2.0)
