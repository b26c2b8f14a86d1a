"""Boards in the studio's room: where their corners are in the picture, how bright they are, what hides them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture_rig.rigid import transform
from rig_calibration.boards.board import CharucoBoard, Checkerboard
from stick_figure.body import Body
from virtual_studio.boards import FACING, PosedBoard, carry, hands, on_floor, person_with, print_of
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.board_camera import BoardCamera, exposure_poses
from virtual_studio.rendering.camera import WHITE
from virtual_studio.rig import ring

RIG = ring(2, ceiling=True)
CAMERA = RIG.cameras[0]
EYE = BoardCamera(CAMERA)
HAND = print_of(Checkerboard(9, 6, (0.04, 0.04)))
FLOOR = print_of(Checkerboard(7, 4, (0.12, 0.12)))


def shown(distance_m, tilt_rad=0.0, about=(1.0, 0.0, 0.0), aside=(0.0, 0.0), board=HAND, camera=CAMERA):
    """T_world_board of a board before a camera; ``aside``: of its middle, in tangents of the viewing angle."""
    R = cv2.Rodrigues(tilt_rad * np.array(about, float))[0] @ FACING
    T_camera_middle = transform(R, distance_m * np.array([*aside, 1.0]))
    return np.linalg.inv(camera.T_camera_world) @ T_camera_middle @ transform(np.eye(3), -board.middle_board)


def held(T, board=HAND):
    return PosedBoard(board, T[None])


def picture(light):
    return np.clip(np.rint(light * WHITE), 0, 255).astype(np.uint8)


def among_corners(T):
    """The pixels that hold the hand board's corners: (rows, columns)."""
    x, y = CAMERA.project(held(T).corners_world).T
    return np.s_[int(y.min()) : int(y.max()), int(x.min()) : int(x.max())]


def found_corners(image, start, window_px):
    """OpenCV's own refinement, from the right places: (n, 2)."""
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-5)
    corners = np.ascontiguousarray(start, np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, corners, (window_px, window_px), (-1, -1), stop).reshape(-1, 2)


@pytest.mark.parametrize(
    ("distance_m", "tilt_rad", "about", "aside", "window_px"),
    [
        (0.6, 0.4, (0.6, 0.8, 0), (0.1, -0.1), 8),
        (0.9, 0.7, (0.8, -0.6, 0), (-0.35, 0.25), 4),
        (1.3, 0.3, (0.5, 0.5, 0.6), (0.4, 0.3), 4),
    ],
)
def test_corners_lie_where_the_lens_projects_them(distance_m, tilt_rad, about, aside, window_px):
    board = held(shown(distance_m, tilt_rad, about, aside))
    truth = CAMERA.project(board.corners_world)
    errors = found_corners(picture(EYE.render(board)), truth, window_px) - truth
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    assert np.sqrt((errors**2).mean()) < 0.06  # of which OpenCV's refinement itself makes most


@pytest.mark.parametrize("camera", [RIG.cameras[0], RIG.cameras[-1]], ids=["ring", "ceiling"])
def test_grazing_floor_board_has_unbiased_corners(camera):
    board = PosedBoard(FLOOR, on_floor(FLOOR)[None])
    truth = camera.project(board.corners_world)
    errors = found_corners(picture(BoardCamera(camera).render(board)), truth, 2) - truth
    assert np.abs(errors.mean(axis=0)).max() < 0.03
    assert np.abs(errors).max() < 0.25


def test_back_of_a_board_shows_no_fields():
    turned = transform(np.diag([-1.0, 1.0, -1.0]), 2.0 * HAND.middle_board * [1.0, 0.0, 0.0])
    T = shown(0.8) @ turned
    patch = picture(EYE.render(held(T)))[among_corners(T)]
    assert patch.size > 10_000 and np.ptp(patch) == 0


@pytest.mark.parametrize(("side", "contrast_seen"), [(1.0, True), (-1.0, False)], ids=["in front", "behind"])
def test_board_is_seen_before_the_person_who_carries_it_and_hidden_behind(side, contrast_seen):
    body, T = VolumetricBody(Body.from_stature(1.75)), carry(FLOOR, 20.0, 1)(0.0)
    ahead = T[:3, 2] * [1, 1, 0] / np.linalg.norm(T[:2, 2])
    middle = T[:3, :3] @ FLOOR.middle_board + T[:3, 3]
    looking = -side * ahead
    R = np.array([np.cross(looking, [0, 0, 1.0]), [0, 0, -1.0], looking])
    camera = replace(CAMERA, T_camera_world=transform(R, -R @ (middle + side * 2.4 * ahead)))
    image = picture(BoardCamera(camera).render(held(T, FLOOR), person_with(body, FLOOR, T)))
    x, y = np.rint(camera.project(middle)).astype(int)
    assert (np.ptp(image[y - 20 : y + 20, x - 20 : x + 20]) > 60) == contrast_seen


def test_thumbs_cover_the_margin_and_no_field():
    T = shown(0.6)
    inside = among_corners(T)
    bare, grasped = EYE.render(held(T)), EYE.render(held(T), hands(HAND, T))
    np.testing.assert_array_equal(bare[inside], grasped[inside])
    assert (np.abs(bare - grasped) > 0.1).sum() > 500


def test_board_is_drawn_where_it_is_ahead_of_the_camera_and_not_behind():
    np.testing.assert_array_equal(EYE.render(held(shown(-0.7)), blur_px=0.0), EYE.empty_room())
    light = EYE.render(held(shown(0.12, 1.4, (0, 1, 0))), blur_px=0.0)  # through the camera's plane
    assert np.isfinite(light).all() and (light != EYE.empty_room()).sum() > 1000


def test_moving_board_is_smeared_as_the_mean_of_its_places_as_many_as_the_motion_asks_for():
    def moving(speed):
        return lambda t: shown(0.8, aside=(speed * (t - 1.0), 0.0))

    assert len(exposure_poses(CAMERA, HAND, moving(0.01), 1.0)) == 1
    places = exposure_poses(CAMERA, HAND, moving(1.0), 1.0)  # 3.7 px
    assert len(places) == 5
    np.testing.assert_allclose(places[2], moving(1.0)(1.0), atol=1e-12)
    smeared = EYE.render(PosedBoard(HAND, places), blur_px=0.0, samples=700)
    mean = np.mean([EYE.render(held(T), blur_px=0.0, samples=140) for T in places], axis=0)
    assert np.abs(smeared - mean).mean() < 1e-3
    assert np.abs(smeared - EYE.render(held(places[2]), blur_px=0.0)).max() > 0.2


def test_charuco_s_markers_are_read_in_the_picture():
    board = CharucoBoard(8, 6, 0.05, 0.037, "DICT_5X5_100")
    T = shown(0.7, 0.3, (0.7, 0.7, 0), board=print_of(board))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    _, ids, _ = detector.detectMarkers(picture(EYE.render(held(T, print_of(board)))))
    assert sorted(np.ravel(ids)) == list(range(24))
