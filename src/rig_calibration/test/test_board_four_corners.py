import numpy as np
import pytest
from rendered_boards import camera, looking_at_board, render, true_corners

from capture_rig.errors import InputError
from rig_calibration.boards.board import read_board
from rig_calibration.boards.four_corners import find_from_outer_corners

BOARD = read_board("checkerboard 6x5 100mm")
LENS = camera(D=(-0.25, 0.1, 0.001, -0.001, 0.0))
OUTER = [0, 5, 29, 24]


def scene(distance, tilt, board=BOARD, turn=10, blur=0.6):
    T = looking_at_board(board, distance, tilt, 3, turn)
    return render(LENS, board, T, blur=blur, oversample=4), true_corners(LENS, board, T)


@pytest.mark.parametrize("model", [None, LENS])
@pytest.mark.parametrize(("distance", "tilt", "error_px"), [(1.5, 20, 6.0), (3.0, 75, 2.0), (3.5, 79, 1.2)])
def test_roughly_given_corners_lead_to_all_exact_ones(model, distance, tilt, error_px):
    image, truth = scene(distance, tilt)
    rough = truth[OUTER] + np.random.default_rng(1).uniform(-error_px, error_px, (4, 2))
    detection = find_from_outer_corners(image, BOARD, rough, model=model, camera="cam", frame_index=3)
    assert (detection.camera, detection.frame_index) == ("cam", 3)
    assert len(detection) >= 27
    assert np.sqrt(np.mean((detection.pixels - truth[detection.ids]) ** 2)) < 0.15


def test_colours_decide_which_corner_is_first_when_the_board_is_given_from_its_other_end():
    image, truth = scene(1.5, 30)
    detection = find_from_outer_corners(image, BOARD, truth[[29, 24, 0, 5]])
    assert np.abs(detection.pixels - truth[detection.ids]).max() < 0.3


def test_order_given_counts_where_colours_do_not_tell():
    board = read_board("checkerboard 7x5 100mm")
    T = looking_at_board(board, 1.6, 30)
    image, truth = render(LENS, board, T, oversample=4), true_corners(LENS, board, T)
    outer = [0, 6, 34, 28]
    as_given = find_from_outer_corners(image, board, truth[outer])
    turned = find_from_outer_corners(image, board, truth[[34, 28, 0, 6]])
    assert np.abs(as_given.pixels - truth).max() < 0.3
    assert np.abs(turned.pixels - truth[::-1]).max() < 0.3


@pytest.mark.parametrize(
    ("outer", "says"),
    [
        ([0, 24, 29, 5], "the wrong way.*reading order"),
        ([0, 29, 5, 24], "convex.*reading order"),
        ([0, 5], "four corners"),
        ([[10, 10], [90, 12], [88, 60], [12, 58]], "corners are seen"),
    ],
    ids=["anticlockwise", "crossed", "two", "where no board is"],
)
def test_corners_that_cannot_be_those_of_a_board_are_refused(outer, says):
    image, truth = scene(3.0, 20)
    with pytest.raises(InputError, match=f"cam2.*{says}"):
        find_from_outer_corners(image, BOARD, outer if np.ndim(outer) > 1 else truth[outer], camera="cam2")
