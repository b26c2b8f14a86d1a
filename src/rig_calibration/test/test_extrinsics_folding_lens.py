"""A rig of wide cameras whose lens model folds inside the image: boards, wands, corners found in folded parts."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_studio import ring
from extrinsics_room import CARRIED_BOARD, FLOOR_BOARD, carried_poses, on_floor, pose_errors, see_all

from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, Target, calibrate_rig
from rig_calibration.extrinsics.world import WorldChoice

SIZE, NOISE_PX = (644, 486), 0.2
MARKS = (0.0, 0.25, 0.4)
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def cameras():
    K, D = np.array([[418.0, 0.0, 326.8], [0.0, 418.0, 239.4], [0.0, 0.0, 1.0]]), np.array([-0.4, 0.15, 0, 0, -0.03])
    return {name: replace(c, width=644, height=486, K=K, D=D) for name, c in ring(4, 2.2, 1.8).items()}


def of_boards(rig):
    floor = see_all(rig, FLOOR_BOARD, [on_floor(FLOOR_BOARD)], FLOOR)
    return floor + see_all(rig, CARRIED_BOARD, carried_poses(60), MOVING)


def calibrated(rig, detections):
    targets = {FLOOR: Target.of(FLOOR_BOARD, WorldChoice()), MOVING: Target.of(CARRIED_BOARD)}
    return calibrate_rig(rig, detections, targets)


def test_rig_of_folding_lenses_is_placed_and_its_figures_are_numbers():
    rig = cameras()
    result = calibrated(rig, of_boards(rig))
    for camera in result.rig.cameras:
        place_mm, turn_deg = pose_errors(camera, rig[camera.name])
        assert place_mm < 10.0 and turn_deg < 0.2
    assert result.verdict.grade == "good", str(result.verdict)
    figures = result.figures
    assert result.rms_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.1)
    assert np.isfinite([[c.rms_px, c.sd_centre_mm, c.sd_rotation_deg] for c in figures.values()]).all()
    assert result.common.floor_m2[2] > 1.0


def test_corners_found_where_the_lens_has_no_ray_count_for_nothing():
    rig = cameras()
    detections = of_boards(rig)
    spoilt = []
    for detection in detections:
        pixels = detection.pixels.copy()
        if detection.target == MOVING and detection.frame_index % 3 == 0:
            pixels[[0, 5]] = (2.0, 2.0), (640.0, 3.0)
            assert np.isnan(rig[detection.camera].ideal_points(pixels[[0, 5]])).all()
        spoilt.append(replace(detection, pixels=pixels))
    result = calibrated(rig, spoilt)
    assert not result.solution.left_out
    without = [d if np.array_equal(d.pixels, s.pixels) else kept(d) for d, s in zip(detections, spoilt, strict=True)]
    expected = calibrated(rig, without)
    for one, other in zip(result.rig.cameras, expected.rig.cameras, strict=True):
        np.testing.assert_allclose(one.T_camera_world, other.T_camera_world, atol=1e-9)


def kept(detection):
    ids = np.setdiff1d(detection.ids, [0, 5])
    return replace(detection, ids=ids, pixels=detection.pixels[ids])


def test_camera_that_sees_the_board_only_in_a_folded_corner_is_named():
    rig = cameras()
    corner = np.column_stack([np.tile(np.arange(6) + 1.0, 9), np.repeat(np.arange(9) + 1.0, 6)])
    detections = [d if d.camera != "cam04" else replace(d, pixels=corner[: len(d)]) for d in of_boards(rig)]
    with pytest.raises(ValueError, match="cam04"):
        calibrated(rig, detections)
