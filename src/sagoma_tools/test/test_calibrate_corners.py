"""Outer corners given by a person: the file, and the board that is found from them."""

import numpy as np
import pytest
from calibration_room import corner_pixels, on_floor, outer_pixels, picture, three_cameras

from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard
from sagoma_tools.calibration.outer_corners import find_from_corners, read_corners

BOARD = Checkerboard(7, 4, (0.12, 0.12))
CAMERA = three_cameras()["cam01"]
LYING = on_floor(BOARD, 0.4)
OUTER = outer_pixels(CAMERA, BOARD, LYING, 7)


@pytest.fixture(scope="module")
def image():
    return picture(CAMERA, BOARD, LYING)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 3, 0, 1), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_corners_given_in_any_order_are_numbered_by_the_boards_colours(image, order):
    outer = OUTER[list(order)] + [2.0, -1.5]
    detection = find_from_corners(image, BOARD, outer, model=CAMERA, frame_index=0, target="floor")
    expected = corner_pixels(CAMERA, BOARD, LYING)[detection.ids]
    assert len(detection) > 20 and np.abs(detection.pixels - expected).max() < 0.5


def test_corners_file_gives_corners_with_or_without_a_frame(tmp_path):
    path = tmp_path / "corners.yaml"
    path.write_text(f"cam01: {OUTER.tolist()}\ncam02: {{corners: {OUTER.tolist()}, frame: 7}}\n")
    read = read_corners(path)
    assert read["cam02"].frame == 7 and read["cam01"].frame is None
    assert read["cam01"].pixels == pytest.approx(OUTER)


@pytest.mark.parametrize(
    "text, words",
    [
        ("cam01: [[1, 2], [3, 4], [5, 6]]", "is not four"),
        ("cam01: [[1, 2], [3, 4], [5, 6], [7, left]]", "is not four"),
        ("cam01: {corners: [[1, 2], [3, 4], [5, 6], [7, 8]], frame: -1}", "frame = -1"),
        ("cam01: {pixels: [[1, 2], [3, 4], [5, 6], [7, 8]]}", "has the keys"),
    ],
)
def test_corners_file_that_cannot_be_used_is_refused_naming_the_camera(tmp_path, text, words):
    path = tmp_path / "corners.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"corners.yaml: cam01: .*{words}"):
        read_corners(path)
