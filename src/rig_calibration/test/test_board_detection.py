"""Corners of boards in rendered pictures: how exact, how many, whose; found by themselves or from outer corners."""

import re
from functools import cache

import cv2
import numpy as np
import pytest
from rendered_boards import camera, looking_at_board, render, true_corners

from capture_rig.errors import InputError
from rig_calibration.boards.board import read_board
from rig_calibration.boards.detector import diagnose_board, find_board, find_from_outer_corners

BOARD = read_board("checkerboard 9x6 25mm")
CHARUCO = read_board("charuco 8x6 30mm 22mm DICT_5X5_100")
LENS = camera(D=(-0.2, 0.08, 0.001, -0.001, 0.0))


def seen(
    board, distance=0.6, tilt=20, eye=LENS, *, thorough=False, roll=5, turn=0, offset=(0.0, 0.0), oversample=3, **optics
):
    """The detection and its errors (n, 2) in px against the projection of the board's corners."""
    T = looking_at_board(board, distance, tilt, roll, turn, offset)
    image = render(eye, board, T, oversample=oversample, **optics)
    detection = find_board(image, board, thorough=thorough)
    errors = None if detection is None else detection.pixels - true_corners(eye, board, T)[detection.ids]
    return image, detection, errors


@pytest.mark.parametrize(("tilt", "blur"), [(0, 1.0), (40, 0.5), (65, 1.0)])
def test_corners_are_exact_to_hundredths_of_a_pixel_and_sigma_says_so(tilt, blur):
    _, detection, errors = seen(BOARD, tilt=tilt, blur=blur, noise=2.5, oversample=6)
    rms = np.sqrt(np.mean(errors**2))
    assert len(detection) == 54
    assert rms < 0.03
    assert np.all(np.abs(errors.mean(axis=0)) < 0.01)
    assert 0.4 * rms < detection.sigma_px < 3 * rms


@pytest.mark.parametrize("text", ["checkerboard 9x6 25mm", "checkerboard 4x3 60x40mm"])
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_ids_follow_the_board_s_colours_whichever_way_round_it_is_seen(text, turn):
    board = read_board(text)
    _, detection, errors = seen(board, turn=turn, tilt=25)
    assert len(detection) == len(board.corners_board) and np.abs(errors).max() < 0.2


@pytest.mark.parametrize("turn", [0, 180])
def test_rows_run_to_the_right_where_the_half_turn_is_not_visible(turn):
    board = read_board("checkerboard 7x5 30mm")
    _, detection, _ = seen(board, turn=turn)
    assert not board.half_turn_is_visible
    first, end_of_row = detection.pixels[0], detection.pixels[6]
    assert end_of_row[0] - first[0] > 50


@pytest.mark.parametrize(("tilt", "width_px"), [(70, 8), (75, 12), (80, 24)])
def test_board_on_the_floor_is_found_at_a_grazing_angle_when_looked_for_thoroughly(tilt, width_px):
    board = read_board("checkerboard 6x5 100mm")
    _, detection, errors = seen(board, 600 * 0.1 / width_px, tilt, thorough=True, roll=3, turn=15, noise=2.0)
    assert len(detection) >= 0.9 * 30
    assert np.sqrt(np.mean(errors**2)) < 0.15


def test_part_of_a_charuco_board_is_enough():
    _, detection, errors = seen(CHARUCO, distance=0.35, tilt=15, offset=(0.15, 0.03))
    assert 8 <= len(detection) < 35
    assert np.sqrt(np.mean(errors**2)) < 0.05


def test_charuco_whose_markers_cannot_be_read_is_found_by_its_fields():
    board = read_board("charuco 8x7 30mm 22mm DICT_5X5_100")
    _, detection, errors = seen(board, distance=1.5, tilt=30, blur=1.2)
    assert not board.columns % 2 and board.rows % 2 and len(detection) >= 35
    assert np.abs(errors).max() < 0.5


def test_hand_over_some_corners_leaves_the_others():
    T = looking_at_board(BOARD, 0.6, 15)
    image, truth = render(LENS, BOARD, T, oversample=4), true_corners(LENS, BOARD, T)
    middle = truth[3 * 9 + 4]
    cv2.ellipse(image, tuple(int(v) for v in middle), (30, 22), 20, 0, 360, 160, -1)
    detection = find_board(image, BOARD)
    assert 40 <= len(detection) < 54
    assert np.abs(detection.pixels - truth[detection.ids]).max() < 0.5
    assert 3 * 9 + 4 not in detection.ids


def test_jpeg_colour_and_uneven_light_do_no_harm():
    T = looking_at_board(BOARD, 0.7, 30, roll_deg=20)
    grey = render(LENS, BOARD, T, oversample=4, shade=0.8, noise=3.0)
    code = cv2.imencode(".jpg", cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 40])[1]
    detection = find_board(cv2.imdecode(code, cv2.IMREAD_COLOR), BOARD)
    errors = detection.pixels - true_corners(LENS, BOARD, T)[detection.ids]
    assert len(detection) == 54 and np.sqrt(np.mean(errors**2)) < 0.1


def test_image_without_a_board_gives_nothing():
    noise = np.random.default_rng(3).integers(0, 256, (240, 320)).astype(np.uint8)
    assert find_board(cv2.GaussianBlur(noise, (0, 0), 2), BOARD) is None
    assert find_board(np.full((240, 320), 90, np.uint8), BOARD, thorough=True) is None


@pytest.mark.parametrize(
    ("board", "optics", "blur_px"),
    [
        (BOARD, {"blur": 0.5}, 0.5),
        (BOARD, {"blur": 2.0}, 2.0),
        (BOARD, {"blur": 0.6, "shutter_px": (6.0, 0.0)}, 1.83),
        (CHARUCO, {"blur": 1.0}, 1.0),
    ],
    ids=["sharp", "out of focus", "the direction of motion counts", "beside markers"],
)
def test_blur_is_measured(board, optics, blur_px):
    detection = seen(board, distance=0.5, tilt=0, roll=0, **optics)[1]
    assert detection.blur_px == pytest.approx(blur_px, rel=0.25)


# --- what is seen instead of a board ----------------------------------------------------------------------------------

SMALL = camera(400, 300, 375.0, LENS.D)  # five dictionaries are tried: pixels cost time


@pytest.mark.parametrize(
    ("shown", "offset", "asked", "says"),
    [
        (
            BOARD,
            0.0,
            "checkerboard 8x5 25mm",
            "54 corners of a checkerboard of 9 x 6 .* instead of checkerboard 8x5 25mm",
        ),
        (BOARD, 0.2, "checkerboard 9x6 25mm", "partly hidden or outside the image"),
        (CHARUCO, 0.0, "charuco 8x6 30mm 22mm DICT_4X4_50", "markers of DICT_5X5 were seen, not as on charuco"),
        (BOARD, 0.0, "checkerboard 9x6 25mm", None),
    ],
    ids=["another size", "partly outside", "another dictionary", "found"],
)
def test_what_is_seen_instead_of_the_board_is_named(shown, offset, asked, says):
    image = render(SMALL, shown, looking_at_board(shown, 0.4, 8, offset=(offset, 0.0)), oversample=3)
    said = diagnose_board(image, read_board(asked))
    assert said == says or re.search(says, said)


# --- outer corners that a user gives ----------------------------------------------------------------------------------

FLOOR_BOARD = read_board("checkerboard 6x5 100mm")
FLOOR_LENS = camera(D=(-0.25, 0.1, 0.001, -0.001, 0.0))
OUTER = [0, 5, 29, 24]


@cache
def scene(distance, tilt, board=FLOOR_BOARD):
    T = looking_at_board(board, distance, tilt, 3, 10)
    return render(FLOOR_LENS, board, T, blur=0.6, oversample=4), true_corners(FLOOR_LENS, board, T)


@pytest.mark.parametrize(("distance", "tilt", "error_px"), [(1.5, 20, 6.0), (3.0, 75, 2.0), (3.5, 79, 1.2)])
def test_roughly_given_corners_lead_to_all_exact_ones(distance, tilt, error_px):
    image, truth = scene(distance, tilt)
    rough = truth[OUTER] + np.random.default_rng(1).uniform(-error_px, error_px, (4, 2))
    detection = find_from_outer_corners(image, FLOOR_BOARD, rough, camera="cam", frame_index=3)
    assert (detection.camera, detection.frame_index) == ("cam", 3)
    assert len(detection) >= 27
    assert np.sqrt(np.mean((detection.pixels - truth[detection.ids]) ** 2)) < 0.15


@pytest.mark.parametrize("order", [(2, 3, 0, 1), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_corners_given_in_any_order_are_numbered_by_the_boards_colours(order):
    image, truth = scene(1.5, 30)
    detection = find_from_outer_corners(image, FLOOR_BOARD, truth[OUTER][list(order)] + [2.0, -1.5])
    assert len(detection) > 20 and np.abs(detection.pixels - truth[detection.ids]).max() < 0.3


def test_order_given_counts_where_colours_do_not_tell():
    board = read_board("checkerboard 7x5 100mm")
    image, truth = scene(1.6, 30, board)
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
    board = read_board("checkerboard 6x4 100mm")  # its colours do not tell
    image, truth = scene(3.0, 20)
    with pytest.raises(InputError, match=f"cam2.*{says}"):
        find_from_outer_corners(image, board, outer if np.ndim(outer) > 1 else truth[outer], camera="cam2")
