"""The rig that the solver finds, against the one that was projected, OpenCV's stereo calibration and scipy's solver."""

import bundle_studio as studio
import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from rig_calibration.bundle.solve import RigSolution, solve_rig


@pytest.fixture(scope="module")
def noisy() -> RigSolution:
    """Four cameras, a carried board, a board on the floor; corners with 0.2 px of noise."""
    cameras = studio.ring(4)
    return solve_rig(
        cameras,
        studio.carried_and_floor(cameras, np.random.default_rng(1), 60),
        studio.TARGETS,
        reference=studio.ON_FLOOR,
    )


def test_exact_corners_give_the_exact_rig():
    cameras = studio.ring(3)
    detections = studio.carried_and_floor(cameras, np.random.default_rng(0), 8, noise_px=0.0)
    solution = solve_rig(cameras, detections, studio.TARGETS, reference=studio.ON_FLOOR)
    centre_mm, rotation_deg = studio.worst(studio.errors(solution, studio.truth(cameras)))
    assert centre_mm < 1e-3 and rotation_deg < 1e-4
    assert solution.left_out == () and max(solution.rms_px.values()) < 1e-4


def test_noisy_corners_give_centres_within_5_mm_a_tenth_of_a_degree_and_figures_of_their_noise(noisy: RigSolution):
    centre_mm, rotation_deg = studio.worst(studio.errors(noisy, studio.truth(studio.ring(4))))
    assert centre_mm < 5 and rotation_deg < 0.1
    assert all(rms == pytest.approx(0.2 * np.sqrt(2), rel=0.15) for rms in noisy.rms_px.values())
    assert noisy.inflation < 1.5 and noisy.sync_error_m == 0.0


def test_gauge_changes_neither_residuals_nor_relative_poses(noisy: RigSolution):
    cameras = studio.ring(4)
    detections = studio.carried_and_floor(cameras, np.random.default_rng(1), 60)
    other = solve_rig(cameras, detections, studio.TARGETS)
    (root,) = [name for name, covariance in other.covariance.items() if not covariance.any()]
    np.testing.assert_allclose(other.cameras[root].T_camera_world, np.eye(4), atol=1e-12)
    for name, T in studio.seen_from(noisy, root).items():
        np.testing.assert_allclose(other.cameras[name].T_camera_world, T, atol=1e-9)
    for a, b in zip(noisy.residuals_px, other.residuals_px, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def test_same_bytes_in_whatever_order_the_input_comes():
    cameras = studio.ring(3)
    detections = studio.carried_and_floor(cameras, np.random.default_rng(2), 10)
    covariance = {name: np.array([1, 1, 1, 1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3]) for name in cameras}
    first = solve_rig(cameras, detections, studio.TARGETS, intrinsics_sd=covariance)
    shuffled = [detections[i] for i in np.random.default_rng(0).permutation(len(detections))]
    second = solve_rig(
        dict(reversed(cameras.items())),
        shuffled,
        dict(reversed(studio.TARGETS.items())),
        intrinsics_sd=dict(reversed(covariance.items())),
    )
    placed = ({name: camera.T_camera_world for name, camera in of.cameras.items()} for of in (first, second))
    for a, b in (placed, (first.covariance, second.covariance)):
        assert list(a) == list(b) == sorted(cameras)
        assert all(a[name].tobytes() == b[name].tobytes() for name in a)


def test_minimum_is_that_of_scipy_least_squares():
    cameras = studio.ring(3)
    rng = np.random.default_rng(5)
    detections = studio.detections_of(cameras, studio.carried(rng, 7), "moving", rng)
    reference = "moving", detections[0].frame_index
    solution = solve_rig(cameras, detections, {"moving": studio.TARGETS["moving"]}, reference=reference)
    names, keys = sorted(cameras), sorted(solution.T_reference_target.keys() - {reference})

    def residuals(x: np.ndarray) -> np.ndarray:
        camera, target = dict(zip(names, x[: 6 * len(names)].reshape(-1, 6), strict=True)), {}
        target = dict(zip(keys, x[6 * len(names) :].reshape(-1, 6), strict=True))
        rows = []
        for s in detections:
            pose = target.get((s.target, s.frame_index), np.zeros(6))
            points = studio.TARGETS[s.target][s.ids] @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
            w, model = camera[s.camera], cameras[s.camera]
            pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), w[:3], w[3:], model.K, model.D)
            rows.append((pixels.reshape(-1, 2) - s.pixels).ravel() / s.sigma_px)
        return np.concatenate(rows)

    def vector(T: np.ndarray) -> np.ndarray:
        return np.concatenate([cv2.Rodrigues(T[:3, :3])[0].ravel(), T[:3, 3]])

    placed = [solution.cameras[n].T_camera_world for n in names] + [solution.T_reference_target[k] for k in keys]
    x = np.concatenate([vector(T) for T in placed])
    found = least_squares(residuals, x + 1e-3, loss="linear", x_scale="jac")
    assert len(solution.detections) == len(detections)
    assert 2 * found.cost == pytest.approx(float(np.sum(residuals(x) ** 2)), rel=1e-3)
    for row, name in enumerate(names):
        w = found.x[6 * row : 6 * row + 6]
        R, T = cv2.Rodrigues(w[:3])[0], solution.cameras[name].T_camera_world
        assert np.linalg.norm(-R.T @ w[3:] + T[:3, :3].T @ T[:3, 3]) < 5e-4  # Huber's loss moves it a little


def test_rig_is_found_when_each_pair_shares_views_but_nobody_sees_all():
    cameras = studio.ring(6)
    detections = studio.detections_of(
        cameras, studio.carried(np.random.default_rng(6), 40), "moving", np.random.default_rng(0)
    )
    solution = solve_rig(cameras, detections, {"moving": studio.BOARD.corners_board})
    centre_mm, rotation_deg = studio.worst(studio.errors(solution, studio.truth(cameras, "cam01"), "cam01"))
    assert centre_mm < 15 and rotation_deg < 0.2
