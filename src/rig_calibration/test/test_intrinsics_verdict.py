"""What is said of a calibration: verdicts with reason and remedy, the report, the picture."""

import numpy as np
import pytest
import yaml
from intrinsics_views import BOARD, lens, shown, with_pixels

from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.picture import draw
from rig_calibration.intrinsics.result import report_of


def verdict(detections, model="plumb_bob"):
    return calibrate_intrinsics(detections, BOARD, name="cam01", model=model).verdict


def said(verdict, text):
    return [finding for finding in verdict.findings if text in finding.what]


def test_board_that_was_never_tilted_must_be_filmed_again():
    judged = verdict(shown(lens(), 20, 0.2, seed=1, tilt_deg=2.0))
    assert judged.grade == "redo"
    assert "tilt the board by 30 to 45 degrees" in said(judged, "are tilted by less than")[0].remedy


def test_focal_length_that_is_not_determined_must_be_measured_again():
    judged = verdict(shown(lens(), 20, 0.3, seed=2, tilt_deg=4.0, sizes=(0.2, 0.25)))
    assert said(judged, "the focal length is known to")[0].grade == "redo"


@pytest.mark.parametrize("count, grade", [(4, "redo"), (9, "usable")])
def test_few_views_are_named(count, grade):
    judged = verdict(shown(lens(), count, 0.2, seed=3))
    assert said(judged, f"only {count} views")[0].grade == grade


def test_distortion_beyond_the_corners_is_called_a_guess():
    judged = verdict(shown(lens(), 25, 0.2, seed=4, reach=0.3, sizes=(0.25, 0.35)))
    finding = said(judged, "% of the way to the image's corners")[0]
    assert "bring the board into the image's corners" in finding.remedy


def test_corners_that_are_much_less_exact_than_sharp_are_suspicious():
    detections, rng = shown(lens(), 25, 0.05, seed=5), np.random.default_rng(5)
    shaken = [with_pixels(s, s.pixels + rng.normal(0, 1.0, s.pixels.shape)) for s in detections]
    finding = said(verdict(shaken), "corners miss their places by")[0]
    assert "board not flat" in finding.remedy


def test_rational_model_that_the_views_do_not_determine_is_refused():
    judged = verdict(shown(lens(), 12, 0.3, seed=6, reach=0.5), "rational_polynomial")
    assert judged.grade == "redo"
    assert "--model plumb_bob" in said(judged, "the views do not determine")[0].remedy


def test_fields_that_are_not_as_given_show_in_the_aspect_ratio():
    camera = lens()
    stretched = [with_pixels(s, s.pixels * [1.0, 1.06]) for s in shown(camera, 30, 0.1, seed=7, reach=0.8)]
    inside = [s for s in stretched if s.pixels[:, 1].max() < 479]
    assert said(verdict(inside), "fx and fy differ by")


def test_principal_point_far_from_the_centre_is_reported():
    camera = lens()
    cut = [with_pixels(s, s.pixels + np.array([90.0, 0.0])) for s in shown(camera, 40, 0.1, seed=8, reach=0.6)]
    inside = [s for s in cut if s.pixels[:, 0].max() < 639]
    assert said(verdict(inside), "the principal point lies 9")


@pytest.fixture(scope="module")
def result():
    detections = shown(lens(), 15, 0.2, seed=1)
    detections[4] = with_pixels(detections[4], detections[4].pixels + np.random.default_rng(0).normal(0, 9, (54, 2)))
    return calibrate_intrinsics(detections, BOARD, name="cam01")


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
    residuals, _, by_view, distortion = figure.axes
    assert "cam01" in figure.get_suptitle()
    assert len(by_view.patches) == len(result.views)
    assert {patch.get_height() for patch in by_view.patches} == {view.rms_px for view in result.views}
    assert "times larger" in residuals.get_title()
    drawn = distortion.lines[2].get_xydata()  # towards the image's corner: barrel distortion draws inwards
    assert drawn[-1, 1] < -5.0 and abs(drawn[0, 1]) < 1e-6
