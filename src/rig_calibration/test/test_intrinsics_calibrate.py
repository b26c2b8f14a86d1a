"""A lens from corners of a board: against the lens that the corners were projected with, and against OpenCV; views that
are wrong are left out and named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from intrinsics_views import BOARD, errors_in_sds, found, lens, lens_errors, said, shown, with_pixels

from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard
from rig_calibration.intrinsics.picture import draw
from rig_calibration.intrinsics.result import report_of


def test_lens_is_found_within_its_own_standard_deviations():
    noise_px = 0.3
    camera = lens()
    result = found(shown(camera, 40, noise_px, seed=1))
    error = lens_errors(result, camera)
    assert np.abs(error[:2] / camera.K[0, 0]).max() < 0.002 and np.abs(error[2:4]).max() < 1.0
    assert np.abs(errors_in_sds(result, camera)).max() < 3.0
    assert result.rms_px == pytest.approx(noise_px * np.sqrt(2), rel=0.1)
    assert result.sigma_px == pytest.approx(noise_px, rel=0.1)
    assert result.verdict.grade == "good", str(result.verdict)
    assert np.array_equal(result.camera.T_camera_world, np.eye(4)) and result.camera.name == "cam01"
    assert result.camera.unused_share == 0.0 and "is not used" not in str(result.verdict)


@pytest.mark.parametrize(
    "camera",
    [
        lens((-0.22, 0.06, -2e-4, 2e-4, 0.0), focal=330.0),
        lens((0.1, -0.3, 0, 0, 0), focal=2500.0),
        lens((-0.02, 0.01, -0.004, 0.0006), "equidistant"),
    ],
    ids=["wide", "long", "fisheye"],
)
def test_corners_without_noise_give_the_lens_back(camera):
    result = found(shown(camera, 20, 0.0, seed=2), model=camera.distortion_model)
    assert result.rms_px < 1e-3
    assert pytest.approx(camera.K, rel=1e-4) == result.camera.K
    assert result.camera.project([[0.3, 0.2, 1.0]]) == pytest.approx(camera.project([[0.3, 0.2, 1.0]]), abs=0.01)


def test_values_and_deviations_agree_with_opencv_where_its_assumptions_hold():
    camera = lens()
    detections = shown(camera, 25, 0.2, seed=3)
    ours = found(detections)
    points = [BOARD.corners_board.astype(np.float32)] * len(detections)
    pixels = [detection.pixels.astype(np.float32) for detection in detections]
    rms, K, D, _, _, sd, _, _ = cv2.calibrateCameraExtended(points, pixels, (640, 480), None, None)
    theirs = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(D)[:5]])
    difference = (np.array(list(ours.values.values())) - theirs) / np.ravel(sd)[:9]
    assert np.abs(difference).max() < 0.7  # ours estimates the board's bending, too
    assert ours.rms_px == pytest.approx(rms, rel=0.01)
    ratio = np.array(list(ours.sd.values())) / ours.sd_enlarged_by / np.ravel(sd)[:9]
    assert (ratio > 0.95).all() and (ratio < 1.4).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", "correlated"])
def test_errors_lie_where_the_standard_deviations_say(kind):
    """25 calibrations each; correlated: all corners of a view err together, as in a view that is blurred by motion."""
    camera, off = lens(), []
    for seed in range(25):
        detections = shown(camera, 20, 0.2, seed=100 + seed)
        if kind == "correlated":
            rng = np.random.default_rng(seed)
            detections = [with_pixels(s, s.pixels + _bend(s.pixels) @ rng.normal(0, 1.5, (2, 2))) for s in detections]
        result = found(detections)
        assert kind == "white" or result.sd_enlarged_by > 1.15
        off.append(errors_in_sds(result, camera))
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    # what views share enlarges all deviations alike: those of coefficients that it touches less are then too large
    lowest, highest = (0.65, 1.35) if kind == "white" else (0.45, 1.5)
    assert spread.min() > lowest and spread.max() < highest, spread
    assert np.abs(off).max() < 4.0


def _bend(pixels):
    """(n, 2) smooth over the board."""
    return ((pixels - pixels.mean(axis=0)) / np.ptp(pixels)) ** 2


def test_bent_board_is_measured_and_does_not_spoil_the_lens():
    camera = lens()
    detections = shown(camera, 15, 0.1, seed=6, bow_m=0.002)
    result = found(detections)
    assert result.warp_m[0] == pytest.approx(0.002, abs=3e-4) and abs(result.warp_m[1]) < 2e-4
    assert np.abs(errors_in_sds(result, camera)).max() < 3.5
    assert said(result, "bent along its rows")


def test_same_detections_in_any_order_give_the_same_bytes():
    detections = shown(lens(), 8, 0.2, seed=9)
    one, other = found(detections), found(detections[::-1])
    assert one.camera.K.tobytes() == other.camera.K.tobytes()
    assert one.camera.D.tobytes() == other.camera.D.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_auto_keeps_the_simple_model_for_a_lens_that_it_describes():
    plain = found(shown(lens(), 12, 0.2, seed=10), model="auto")
    assert plain.camera.distortion_model == "plumb_bob" and "no better, so the simpler one" in plain.choice


# --- views that are wrong ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("view", "wrong", "off", "left_out"), [(7, range(27), (6.0, -4.0), [7]), (3, (10, 40), (8.0, 8.0), [])]
)
def test_view_is_left_out_for_half_of_its_board_and_kept_for_two_wrong_corners(view, wrong, off, left_out):
    """Half of a board is off as if it had moved while the rows were read."""
    camera = lens()
    detections = shown(camera, 20, 0.2, seed=view)
    pixels = detections[view].pixels.copy()
    pixels[list(wrong)] += off
    detections[view] = with_pixels(detections[view], pixels)
    result = found(detections)
    assert [entry.detection.frame_index for entry in result.left_out] == left_out
    assert not left_out or "do not fit the target's shape" in result.left_out[0].reason
    assert np.abs(errors_in_sds(result, camera)).max() < 3.5


def test_few_views_of_another_board_are_left_out():
    camera = lens()
    other = shown(camera, 4, 0.2, seed=5, board=Checkerboard(9, 6, (0.025, 0.030)))
    detections = shown(camera, 16, 0.2, seed=6) + [replace(s, frame_index=16 + s.frame_index) for s in other]
    result = found(detections)
    assert {entry.detection.frame_index for entry in result.left_out} == {16, 17, 18, 19}
    assert np.abs(errors_in_sds(result, camera)).max() < 3.5


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_views_are_refused(count):
    with pytest.raises(InputError, match=f"{count} views of the board can be used, 3 are the least.*20 or more"):
        found(shown(lens(), count, 0.2, seed=8))


# --- what is said of a calibration ------------------------------------------------------------------------------------

TILTS, CORNERS = "tilted by 30 to 45 degrees", "bring the board into all four corners of the image"


@pytest.mark.parametrize(
    ("count", "noise_px", "how", "what", "grade", "remedy"),
    [
        (20, 0.2, {"tilt_deg": 2.0}, "the focal length is known to", "redo", TILTS),
        (4, 0.2, {}, "the focal length is known to", "usable", TILTS),
        (25, 0.2, {"reach": 0.3, "sizes": (0.25, 0.35)}, "in the image's corners rays are uncertain", "redo", CORNERS),
    ],
    ids=["never tilted", "four views", "corners never reached"],
)
def test_views_that_say_too_little_are_named_with_grade_and_remedy(count, noise_px, how, what, grade, remedy):
    finding = said(found(shown(lens(), count, noise_px, seed=1, **how)), what)[0]
    assert finding.grade == grade and remedy in finding.remedy


def test_corners_that_are_much_less_exact_than_sharp_are_suspicious():
    detections, rng = shown(lens(), 12, 0.05, seed=5), np.random.default_rng(5)
    shaken = [with_pixels(s, s.pixels + rng.normal(0, 1.0, s.pixels.shape)) for s in detections]
    assert "board not flat" in said(found(shaken), "corners miss their places by")[0].remedy


@pytest.fixture(scope="module")
def result():
    detections = shown(lens(), 15, 0.2, seed=1)
    detections[4] = with_pixels(detections[4], detections[4].pixels + np.random.default_rng(0).normal(0, 9, (54, 2)))
    return found(detections)


def test_report_reads_back_with_values_deviations_and_what_was_left_out(result):
    report = yaml.safe_load(yaml.safe_dump(report_of(result, {"board": "checkerboard 9x6 25mm"})))
    assert report["board"] == "checkerboard 9x6 25mm" and report["camera"] == "cam01"
    assert report["parameters"]["fx"]["value"] == result.camera.K[0, 0]
    assert report["parameters"]["fx"]["sd"] == pytest.approx(result.sd["fx"], rel=1e-3)
    assert report["left_out"][0]["frame"] == 4 and len(report["views"]) == 14
    distances = [view["distance_m"] for view in report["views"]]
    assert all(0.2 < distance < 1.2 for distance in distances)
    assert report["verdict"] == result.verdict.grade
    assert len(report["findings"]) == len(result.verdict.findings)


def test_picture_shows_every_view_and_names_the_camera(result):
    figure = draw(result)
    residuals, by_view = figure.axes
    assert "cam01" in figure.get_suptitle()
    assert len(by_view.patches) == len(result.views)
    assert {patch.get_height() for patch in by_view.patches} == {view.rms_px for view in result.views}
    assert "times larger" in residuals.get_title()
