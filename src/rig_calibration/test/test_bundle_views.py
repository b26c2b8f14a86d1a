"""One picture's poses, hidden turns, and how cameras hang together."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_studio import BOARD, SIZE, TARGETS, camera_at, carried, project, rotation

from capture_rig.errors import InputError
from capture_rig.rigid import transform
from rig_calibration.boards.board import CharucoBoard, Checkerboard, TargetDetection
from rig_calibration.bundle.initial_poses import require_connected
from rig_calibration.bundle.problem import detection_poses, symmetry_order_of, target_shape


def seen_once(T_world_target: np.ndarray, points: np.ndarray, ids: np.ndarray | None = None) -> TargetDetection:
    ids = np.arange(len(points)) if ids is None else ids
    pixels = project(camera_at("cam01", (3, 0, 2)), T_world_target, points[ids])
    return TargetDetection("cam01", 0, ids, pixels, SIZE)


@pytest.mark.parametrize(
    "points", [BOARD.corners_board, np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3))], ids=["board", "not flat"]
)
def test_first_pose_is_the_true_one_when_corners_are_exact(points: np.ndarray):
    camera = camera_at("cam01", (3, 0, 2))
    for T in carried(np.random.default_rng(0), 10).values():
        shape = target_shape("", points)
        poses = detection_poses(seen_once(T, points), camera, shape)
        assert poses is not None
        expected = camera.T_camera_world @ T @ transform(np.eye(3), shape.centroid)
        np.testing.assert_allclose(transform(poses.R[0], poses.t[0]), expected, atol=1e-5)


def test_both_mirror_poses_are_kept_when_the_board_is_small_and_far():
    camera = camera_at("cam01", (8, 0, 2))
    T = np.eye(4)
    T[:3, :3] = rotation([0, np.radians(60), 0])
    points = BOARD.corners_board / 2
    detection = TargetDetection("cam01", 0, np.arange(30), project(camera, T, points), SIZE)
    noisy = replace(detection, pixels=detection.pixels + 0.3 * np.random.default_rng(0).normal(size=(30, 2)))
    poses = detection_poses(noisy, camera, target_shape("", points))
    near = detection_poses(
        seen_once(T @ transform(np.eye(3), np.array([1.0, 0, 1])), BOARD.corners_board),
        camera_at("cam01", (3, 0, 2)),
        target_shape("", BOARD.corners_board),
    )
    assert poses is not None and near is not None
    assert len(poses.t) == 2 and poses.weight[1] > 0.5
    assert (near.weight[1:] < 0.01).all()


@pytest.mark.parametrize("ids", [[0, 1, 2], [0, 1, 2, 3, 4, 5]])
def test_no_pose_from_three_corners_or_a_row_of_them(ids: list[int]):
    detection = seen_once(carried(np.random.default_rng(1), 1)[0], BOARD.corners_board, np.array(ids))
    assert detection_poses(detection, camera_at("cam01", (3, 0, 2)), target_shape("", BOARD.corners_board)) is None


def test_turns_follow_colours_and_markers():
    assert symmetry_order_of(Checkerboard(9, 6, (0.03, 0.03))) == 1
    assert symmetry_order_of(Checkerboard(8, 6, (0.03, 0.03))) == 2
    assert symmetry_order_of(Checkerboard(6, 6, (0.03, 0.03))) == 4
    assert symmetry_order_of(Checkerboard(6, 6, (0.03, 0.02))) == 2
    assert symmetry_order_of(Checkerboard(7, 7, (0.03, 0.03))) == 2  # a quarter turn swaps black and white
    assert symmetry_order_of(CharucoBoard(8, 8, 0.03, 0.02, "DICT_5X5_100")) == 1


def test_turned_points_lie_on_the_points_of_the_permutation():
    for symmetry in target_shape("", Checkerboard(6, 6, (0.1, 0.1)).corners_board, 4).symmetries:
        shape = target_shape("", Checkerboard(6, 6, (0.1, 0.1)).corners_board)
        np.testing.assert_allclose(shape.points @ symmetry.R.T, shape.points[symmetry.permutation], atol=1e-12)
    with pytest.raises(InputError, match="does not look alike"):
        target_shape("charuco", Checkerboard(6, 5, (0.1, 0.1)).corners_board, 4)


def test_cameras_without_common_view_are_named_by_group():
    shown = [
        TargetDetection(camera, frame_index, np.arange(30), np.zeros((30, 2)), SIZE)
        for camera, frame_index in (("cam01", 0), ("cam02", 0), ("cam03", 1), ("cam04", 1))
    ]
    with pytest.raises(InputError, match=r"cam01, cam02 \| cam03, cam04.*Show the board where cameras of both groups"):
        require_connected(["cam04", "cam03", "cam02", "cam01"], shown)
    with pytest.raises(InputError, match=r"cam05: no picture"):
        require_connected(["cam01", "cam02", "cam05"], shown[:2])
    assert len(TARGETS["moving"]) == 30
