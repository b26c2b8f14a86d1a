"""The solver's projection against OpenCV's, and its derivatives against differences."""

import numpy as np
import pytest
from bundle_studio import rotation

from rig_calibration.bundle.adjustment import FreeUnknowns, information_of_each, normal_equations, reduce
from rig_calibration.bundle.state import Layout, Observations, State, linearise, residuals_px

RATIONAL = np.array([-0.25, 0.08, 1e-3, -2e-3, 0.01, 0.05, -0.02, 0.004])


def state_and_observations(rng: np.random.Generator, fisheye: bool = False) -> tuple[State, Observations]:
    """Two cameras, three poses of two targets, four detections."""
    lens = np.array([[600, 605, 320, 240, *RATIONAL], [500, 498, 300, 250, -0.1, *np.zeros(7)]])
    state = State(
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
    import cv2

    state, seen = state_and_observations(np.random.default_rng(0))
    residual = residuals_px(state, seen)
    for row in range(4):
        camera, pose = seen.camera[row], seen.pose[row]
        target = seen.target[row]
        scaled = (seen.points[row] + np.outer(seen.bend[row] @ state.board_warp[target], [0, 0, 1])) * state.scale[
            target
        ]
        x = scaled @ state.R_pose[pose].T + state.position[pose] - state.centre[camera]
        K = np.array(
            [
                [state.lens[camera, 0], 0, state.lens[camera, 2]],
                [0, state.lens[camera, 1], state.lens[camera, 3]],
                [0, 0, 1],
            ]
        )
        rvec = cv2.Rodrigues(state.R_camera[camera])[0]
        pixels, _ = cv2.projectPoints(x.reshape(-1, 1, 3), rvec, np.zeros(3), K, state.lens[camera, 4:])
        np.testing.assert_allclose(seen.pixels[row] - residual[row], pixels.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("fisheye", [False, True])
def test_derivatives_match_central_differences(fisheye):
    """With a fisheye beside another lens, too."""
    state, seen = state_and_observations(np.random.default_rng(1), fisheye)
    layout = Layout(2, 2, with_lens=True)
    linear = linearise(state, seen, with_lens=True)
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


def test_information_of_each_detection_adds_up_where_no_pose_is_seen_twice():
    state, seen = state_and_observations(np.random.default_rng(3))
    layout, alone = Layout(2, 2, with_lens=True), seen.only(np.array([0, 2, 3]))  # three poses, once each
    linear = linearise(state, alone, with_lens=True)
    information, gradient = information_of_each(linear)
    total, sum_of_gradients = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    for columns, one, score in zip(layout.columns(alone.camera, alone.target), information, gradient, strict=True):
        total[np.ix_(columns, columns)] += one
        sum_of_gradients[columns] += score
    free = FreeUnknowns(np.ones(layout.size, bool), np.ones(3, bool))
    reduced = reduce(normal_equations(linear, alone, layout, 3), free)
    np.testing.assert_allclose(total, reduced.S, atol=1e-9 * np.abs(reduced.S).max())
    np.testing.assert_allclose(sum_of_gradients, reduced.b, atol=1e-9 * np.abs(reduced.b).max())
