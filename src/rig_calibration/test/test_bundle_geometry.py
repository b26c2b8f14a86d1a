"""The solver's projection against OpenCV's, its derivatives against differences; one picture's poses."""

import cv2
import numpy as np
import pytest
from bundle_studio import BOARD, SIZE, camera_at, carried, project, rotation

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rigid import transform
from rig_calibration.boards.board import TargetDetection
from rig_calibration.bundle.initial_poses import require_connected
from rig_calibration.bundle.problem import DetectionPoses, TargetShape, poses_of, target_shape
from rig_calibration.bundle.state import BundleState, Layout, Observations, linearise, residuals_px

RATIONAL = np.array([-0.25, 0.08, 1e-3, -2e-3, 0.01, 0.05, -0.02, 0.004])


def state_and_observations(rng: np.random.Generator, fisheye: bool = False) -> tuple[BundleState, Observations]:
    """Two cameras, three poses of two targets, four detections."""
    lens = np.array([[600, 605, 320, 240, *RATIONAL], [500, 498, 300, 250, -0.1, *np.zeros(7)]])
    state = BundleState(
        rotation([0.1, -0.2, 0.05])[None] @ np.stack([np.eye(3), rotation([0, 0.3, 0])]),
        np.array([[0, 0, -2.0], [0.8, 0.1, -1.9]]),
        lens,
        np.stack([rotation(rng.normal(size=3) * 0.4) for _ in range(3)]),
        rng.normal(size=(3, 3)) * 0.2,
        np.array([1.0, 1.1]),
        np.array([[0.01, -0.02], [0.0, 0.03]]),
        np.array([False, fisheye]),
    )
    points = rng.uniform(-0.3, 0.3, size=(4, 7, 3))
    seen = Observations(
        np.array([0, 1, 0, 1]),
        np.array([0, 0, 1, 2]),
        np.array([0, 0, 1, 1]),
        points,
        rng.uniform(0, 1, size=(4, 7, 2)),
        rng.uniform(100, 400, size=(4, 7, 2)),
        rng.uniform(0.5, 4, size=(4, 7)),
    )
    return state, seen


def test_corners_fall_where_opencv_projects_them():
    state, seen = state_and_observations(np.random.default_rng(0))
    residual = residuals_px(state, seen)
    for row, (camera, pose, target) in enumerate(zip(seen.camera, seen.pose, seen.target, strict=True)):
        bent = seen.points[row] + np.outer(seen.bend[row] @ state.board_warp[target], [0, 0, 1])
        x = state.scale[target] * bent @ state.R_pose[pose].T + state.position[pose] - state.centre[camera]
        fx, fy, cx, cy, *D = state.lens[camera]
        K, turn = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), cv2.Rodrigues(state.R_camera[camera])[0]
        pixels, _ = cv2.projectPoints(x.reshape(-1, 1, 3), turn, np.zeros(3), K, np.array(D))
        np.testing.assert_allclose(seen.pixels[row] - residual[row], pixels.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("fisheye", [False, True])
def test_derivatives_match_central_differences(fisheye):
    """With a fisheye beside another lens, too."""
    state, seen = state_and_observations(np.random.default_rng(1), fisheye)
    layout = Layout(2, 2)
    linear = linearise(state, seen)
    columns = layout.columns(seen.camera, seen.target)
    weight = np.repeat(seen.weight, 2, axis=1)

    def difference(shared: np.ndarray, poses: np.ndarray) -> np.ndarray:
        ahead, behind = (residuals_px(state.moved(sign * shared, sign * poses), seen) for sign in (1, -1))
        return -(ahead - behind).reshape(4, -1) / 2e-6 * weight

    for column in range(layout.size):
        shared = np.zeros(layout.size)
        shared[column] = 1e-6
        analytic = np.where(columns[:, None] == column, linear.by_shared, 0).sum(axis=2)
        np.testing.assert_allclose(analytic, difference(shared, np.zeros((3, 6))), atol=2e-4, rtol=1e-6)
    for pose in range(3):
        for axis in range(6):
            poses = np.zeros((3, 6))
            poses[pose, axis] = 1e-6
            analytic = np.where((seen.pose == pose)[:, None], linear.by_pose[:, :, axis], 0)
            np.testing.assert_allclose(analytic, difference(np.zeros(layout.size), poses), atol=2e-4, rtol=1e-6)


# --- poses of one picture ---------------------------------------------------------------------------------------------


def detection_poses(detection: TargetDetection, camera: CameraModel, shape: TargetShape) -> DetectionPoses | None:
    return poses_of(detection.ids, camera.ideal_points(detection.pixels), camera, shape)


def seen_once(T_world_target: np.ndarray, points: np.ndarray, ids: np.ndarray | None = None) -> TargetDetection:
    ids = np.arange(len(points)) if ids is None else ids
    pixels = project(camera_at("cam01", (3, 0, 2)), T_world_target, points[ids])
    return TargetDetection("cam01", 0, ids, pixels, SIZE)


def test_first_pose_is_the_true_one_when_corners_are_exact():
    camera, points = camera_at("cam01", (3, 0, 2)), BOARD.corners_board
    for T in carried(np.random.default_rng(0), 10).values():
        shape = target_shape("", points)
        poses = detection_poses(seen_once(T, points), camera, shape)
        assert poses is not None
        expected = camera.T_camera_world @ T @ transform(np.eye(3), shape.centroid)
        np.testing.assert_allclose(transform(poses.R[0], poses.t[0]), expected, atol=1e-5)


def test_both_mirror_poses_are_kept_when_the_board_is_small_and_far():
    far, near = camera_at("cam01", (8, 0, 2)), camera_at("cam01", (3, 0, 2))
    T = transform(rotation([0, np.radians(60), 0]), np.zeros(3))
    points = BOARD.corners_board / 2
    pixels = project(far, T, points) + 0.3 * np.random.default_rng(0).normal(size=(30, 2))
    ambiguous = detection_poses(TargetDetection("", 0, np.arange(30), pixels, SIZE), far, target_shape("", points))
    shown = seen_once(T @ transform(np.eye(3), np.array([1.0, 0, 1])), BOARD.corners_board)
    clear = detection_poses(shown, near, target_shape("", BOARD.corners_board))
    assert ambiguous is not None and len(ambiguous.t) == 2 and ambiguous.weight[1] > 0.5
    assert clear is not None and (clear.weight[1:] < 0.01).all()


@pytest.mark.parametrize("ids", [[0, 1, 2], [0, 1, 2, 3, 4, 5]])
def test_no_pose_from_three_corners_or_a_row_of_them(ids: list[int]):
    detection = seen_once(carried(np.random.default_rng(1), 1)[0], BOARD.corners_board, np.array(ids))
    assert detection_poses(detection, camera_at("cam01", (3, 0, 2)), target_shape("", BOARD.corners_board)) is None


def test_cameras_without_common_view_are_named_by_group():
    shown = [
        TargetDetection(camera, frame_index, np.arange(30), np.zeros((30, 2)), SIZE)
        for camera, frame_index in (("cam01", 0), ("cam02", 0), ("cam03", 1), ("cam04", 1))
    ]
    with pytest.raises(InputError, match=r"cam01, cam02 \| cam03, cam04.*Show the board where cameras of both groups"):
        require_connected(["cam04", "cam03", "cam02", "cam01"], shown)
    with pytest.raises(InputError, match=r"cam05: no picture"):
        require_connected(["cam01", "cam02", "cam05"], shown[:2])
