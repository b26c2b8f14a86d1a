"""Are errors as large as their covariance says? Many rigs, errors in standard deviations."""

from dataclasses import replace

import bundle_studio as studio
import numpy as np
import pytest

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import TargetDetection
from rig_calibration.bundle.solve import solve_rig

CAMERAS = studio.ring(3)
LENS_SD = np.array([1.0, 1.0, 1.5, 1.5, 0.002, 0.004, 2e-4, 2e-4, 0.0])


def with_wrong_lenses(rng: np.random.Generator) -> dict[str, CameraModel]:
    wrong = {}
    for name, camera in CAMERAS.items():
        e = rng.normal(size=9) * LENS_SD
        K = camera.K + np.array([[e[0], 0, e[2]], [0, e[1], e[3]], [0, 0, 0]])
        wrong[name] = replace(camera, K=K, D=camera.D + e[4:])
    return wrong


def not_synchronous(rng: np.random.Generator, delay_s: float = 0.005, speed_m_s: float = 0.5) -> list[TargetDetection]:
    """A board carried at that speed in all directions; each camera exposes a little later than the one before."""
    poses = studio.carried(rng, 40)
    ways = rng.normal(size=(len(poses), 3))
    step_m = speed_m_s * delay_s / 2 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    found = studio.detections_of(CAMERAS, {0: studio.T_WORLD_FLOOR}, "floor", rng, max_tilt_deg=85)
    return found + studio.carried_late(CAMERAS, poses, step_m.__getitem__, rng)


def in_sds(runs: int, wrong_lenses: bool = False, delayed: bool = False, **options: object) -> np.ndarray:
    """(runs * cameras, 6) errors over standard deviations."""
    normalised = []
    for run in range(runs):
        rng = np.random.default_rng(run)
        detections = not_synchronous(rng) if delayed else studio.carried_and_floor(CAMERAS, rng, 15)
        cameras = with_wrong_lenses(rng) if wrong_lenses else CAMERAS
        solution = solve_rig(cameras, detections, studio.TARGETS, reference=studio.ON_FLOOR, **options)  # type: ignore[arg-type]
        normalised += [
            error / np.sqrt(np.diag(solution.covariance[name]))
            for name, error in studio.errors(solution, studio.truth(CAMERAS)).items()
        ]
    return np.array(normalised)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [{"delayed": True}, {"wrong_lenses": True, "intrinsics_sd": dict.fromkeys(CAMERAS, LENS_SD)}],
    ids=["delays", "wrong lenses"],
)
def test_normalised_errors_have_unit_variance(case: dict):
    errors_sd = in_sds(30, **case)
    assert 0.7 < np.sqrt(np.mean(errors_sd**2)) < 1.35
    assert np.mean(np.abs(errors_sd) < 3) > 0.97


def test_errors_lie_within_three_standard_deviations():
    errors_sd = in_sds(4)
    assert np.mean(np.abs(errors_sd) < 3) > 0.97 and 0.5 < np.sqrt(np.mean(errors_sd**2)) < 1.6


def test_uncertain_lenses_enlarge_the_covariance():
    detections = studio.carried_and_floor(CAMERAS, np.random.default_rng(0), 15)
    exact = solve_rig(CAMERAS, detections, studio.TARGETS, reference=studio.ON_FLOOR)
    doubted = solve_rig(
        CAMERAS, detections, studio.TARGETS, reference=studio.ON_FLOOR, intrinsics_sd=dict.fromkeys(CAMERAS, LENS_SD)
    )
    for name in CAMERAS:
        more = doubted.covariance[name] - exact.covariance[name]
        assert np.linalg.eigvalsh(more).min() > -1e-12 and np.trace(more) > np.trace(exact.covariance[name])
        np.testing.assert_array_equal(doubted.cameras[name].T_camera_world, exact.cameras[name].T_camera_world)


def test_delays_of_a_moving_board_are_noticed_and_cost_little():
    late = solve_rig(CAMERAS, not_synchronous(np.random.default_rng(1)), studio.TARGETS, reference=studio.ON_FLOOR)
    prompt = solve_rig(
        CAMERAS, not_synchronous(np.random.default_rng(1), delay_s=0.0), studio.TARGETS, reference=studio.ON_FLOOR
    )
    assert prompt.sync_error_m == 0.0
    assert 0.0002 < late.sync_error_m < 0.005  # up to 5 ms at 0.5 m/s
    rms = [
        np.sqrt(np.mean([e[3:] @ e[3:] for e in studio.errors(s, studio.truth(CAMERAS)).values()]))
        for s in (late, prompt)
    ]
    assert rms[0] < rms[1] + 0.004
