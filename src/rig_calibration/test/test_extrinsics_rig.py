"""From detections to the rig: places against those the corners were projected from, and every verdict's cause."""

from dataclasses import replace

import extrinsics_room as made
import numpy as np
import pytest
from bundle_studio import camera_at, ring

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.verdict import GOOD, REDO, USABLE
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.extrinsics.board_frames import average_still_board
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, RigCalibration, TapeMeasure, Target, calibrate_rig
from rig_calibration.extrinsics.world import WorldChoice

TARGETS = {FLOOR: Target.of(made.FLOOR_BOARD, WorldChoice()), MOVING: Target.of(made.CARRIED_BOARD)}
FLOOR_ONLY = {FLOOR: TARGETS[FLOOR]}
FRAMES = 15


def floor_detections(cameras: dict[str, CameraModel], board: Checkerboard = made.FLOOR_BOARD) -> list[TargetDetection]:
    """Fifteen frames of the board on the floor, averaged."""
    seen = made.see_all(cameras, board, [made.on_floor(board)] * FRAMES, FLOOR)
    return [
        average_still_board([s for s in seen if s.camera == name], board)
        for name in cameras
        if any(s.camera == name for s in seen)
    ]


def carried_detections(cameras: dict[str, CameraModel], count: int = 40) -> list[TargetDetection]:
    return made.see_all(cameras, made.CARRIED_BOARD, made.carried_poses(count), MOVING)


def findings(calibrated: RigCalibration) -> str:
    return "\n".join(f"{f.grade}: {f.what} -> {f.remedy}" for f in calibrated.verdict.findings)


@pytest.fixture(scope="module")
def room() -> dict[str, CameraModel]:
    return ring(4)


@pytest.fixture(scope="module")
def whole(room: dict[str, CameraModel]) -> RigCalibration:
    """Both boards, and a tape measure that agrees."""
    apart = float(np.linalg.norm(room["cam01"].centre_world - room["cam03"].centre_world))
    tape = [TapeMeasure("cam01", "cam03", apart + 0.01)]
    return calibrate_rig(room, floor_detections(room) + carried_detections(room), TARGETS, tape=tape)


def test_cameras_are_placed_within_5_mm_and_a_tenth_of_a_degree(
    room: dict[str, CameraModel], whole: RigCalibration
) -> None:
    for camera in whole.rig.cameras:
        place_mm, turn_deg = made.pose_errors(camera, room[camera.name])
        figures = whole.figures[camera.name]
        assert place_mm < 5.0 and turn_deg < 0.1
        assert place_mm < 3 * np.sqrt(3) * figures.sd_centre_mm and turn_deg < 3 * np.sqrt(3) * figures.sd_rotation_deg
        assert figures.rms_px == pytest.approx(made.NOISE_PX * np.sqrt(2), rel=0.1), "of distances"
        assert figures.height_m == pytest.approx(room[camera.name].centre_world[2], abs=0.005)
        assert figures.mm_per_px == pytest.approx(1e3 * figures.distance_m / 600.3, rel=0.01)
    assert whole.verdict.grade == GOOD, findings(whole)


def test_floor_board_alone_places_all_cameras_within_their_uncertainty(room: dict[str, CameraModel]) -> None:
    calibrated = calibrate_rig(room, floor_detections(room), FLOOR_ONLY)
    for camera in calibrated.rig.cameras:
        place_mm, _ = made.pose_errors(camera, room[camera.name])
        assert place_mm < 3 * np.sqrt(3) * calibrated.figures[camera.name].sd_centre_mm < 60.0


def test_wrong_square_size_of_one_board_shows_as_a_ratio(room: dict[str, CameraModel]) -> None:
    stated = Target.of(Checkerboard(7, 4, (0.126, 0.126)), WorldChoice())  # 5 % too large
    calibrated = calibrate_rig(room, floor_detections(room) + carried_detections(room), TARGETS | {FLOOR: stated})
    ratio, sd = calibrated.solution.scale_of[FLOOR]
    assert ratio == pytest.approx(1 / 1.05, abs=4 * sd) and sd < 0.005
    assert calibrated.verdict.grade == REDO
    assert "board 'floor' is 0.95" in findings(calibrated) and "Measure the fields" in findings(calibrated)


def test_symmetric_floor_board_alone_is_no_calibration_of_several_cameras(room: dict[str, CameraModel]) -> None:
    even = Checkerboard(8, 4, (0.12, 0.12))
    targets = {FLOOR: Target.of(even, WorldChoice())}
    calibrated = calibrate_rig(room, floor_detections(room, even), targets)
    assert calibrated.verdict.grade == REDO
    assert "on which side of the board cam01, cam02, cam03, cam04 stand(s)" in findings(calibrated)


def test_floor_view_that_contradicts_the_rest_is_named_redo(room: dict[str, CameraModel]) -> None:
    """The board was turned by a quarter before cam03 took its picture."""
    seen = [detection for detection in floor_detections(room) if detection.camera != "cam03"]
    lying = made.on_floor(made.FLOOR_BOARD, 0.1, 0.2, 0.7)
    moved = made.see_all({"cam03": room["cam03"]}, made.FLOOR_BOARD, [lying], FLOOR)
    calibrated = calibrate_rig(room, [*seen, *moved, *carried_detections(room)], TARGETS)
    assert made.pose_errors(calibrated.rig.camera("cam03"), room["cam03"])[0] < 8.0, "by the carried board"
    assert calibrated.verdict.grade == REDO
    assert "cam03 sees the floor board otherwise than the rest" in findings(calibrated)


@pytest.mark.parametrize("mirrored", [False, True])
def test_floor_board_that_is_too_small_or_mirrored_is_redo(mirrored: bool) -> None:
    board = made.FLOOR_BOARD if mirrored else Checkerboard(4, 3, (0.05, 0.05))
    places = [np.array([x, -1.0, 5.0]) for x in (-0.5, 0.5)]
    high = {f"cam{i}": camera_at(f"cam{i}", place, np.zeros(3)) for i, place in enumerate(places)}
    cameras = ring(3) if mirrored else high
    seen = floor_detections(cameras, board)
    if mirrored:
        seen = [replace(s, ids=s.ids.reshape(4, 7)[:, ::-1].ravel()) for s in seen]
    said = findings(calibrate_rig(cameras, seen, {FLOOR: Target.of(board, WorldChoice())}))
    assert ("redo: cam01 comes to lie" if mirrored else "redo: the place of cam0 is known to") in said


def test_without_a_floor_distances_are_right_and_the_verdict_says_what_is_missing(room: dict[str, CameraModel]) -> None:
    calibrated = calibrate_rig(room, carried_detections(room), {MOVING: TARGETS[MOVING]})
    one, other = (calibrated.rig.camera(name).centre_world for name in ("cam01", "cam03"))
    truth = np.linalg.norm(room["cam01"].centre_world - room["cam03"].centre_world)
    assert np.linalg.norm(one - other) == pytest.approx(truth, abs=0.005)
    assert calibrated.verdict.grade == USABLE and "heights and the vertical are guesses" in findings(calibrated)


def test_tape_measure_of_an_unknown_camera_or_a_useless_length_is_refused(whole: RigCalibration) -> None:
    with pytest.raises(InputError, match="no camera 'cam09'"):
        TapeMeasure("cam01", "cam09", 3.0).checked(whole.rig)
    with pytest.raises(InputError, match="no length to check with"):
        TapeMeasure("cam01", None, -2.0).checked(whole.rig)


# --- lenses that fold inside the image -------------------------------------------------------------------------------


def folding_cameras():
    K, D = np.array([[418.0, 0.0, 326.8], [0.0, 418.0, 239.4], [0.0, 0.0, 1.0]]), np.array([-0.4, 0.15, 0, 0, -0.03])
    return {name: replace(c, width=644, height=486, K=K, D=D) for name, c in ring(4, 2.2, 1.8).items()}


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_rig_of_folding_lenses_is_placed_and_its_figures_are_numbers():
    rig = folding_cameras()
    result = calibrate_rig(rig, floor_detections(rig) + carried_detections(rig, 60), TARGETS)
    for camera in result.rig.cameras:
        place_mm, turn_deg = made.pose_errors(camera, rig[camera.name])
        assert place_mm < 10.0 and turn_deg < 0.2
    assert result.verdict.grade == "good", str(result.verdict)
    figures = result.figures
    assert result.rms_px == pytest.approx(made.NOISE_PX * np.sqrt(2), rel=0.1)
    assert np.isfinite([[c.rms_px, c.sd_centre_mm, c.sd_rotation_deg] for c in figures.values()]).all()
    assert result.common.floor_m2[2] > 1.0


def test_camera_that_sees_the_board_only_in_a_folded_corner_is_named():
    rig = folding_cameras()
    corner = np.column_stack([np.tile(np.arange(6) + 1.0, 9), np.repeat(np.arange(9) + 1.0, 6)])
    detections = floor_detections(rig) + carried_detections(rig)
    detections = [d if d.camera != "cam04" else replace(d, pixels=corner[: len(d)]) for d in detections]
    with pytest.raises(ValueError, match="cam04"):
        calibrate_rig(rig, detections, TARGETS)
