"""What is said of a calibration: verdicts with reason and remedy, the report, the picture."""

import numpy as np
import pytest
import yaml
from intrinsics_views import found, lens, said, shown, with_pixels

from rig_calibration.intrinsics.picture import draw
from rig_calibration.intrinsics.result import report_of

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
    detections, rng = shown(lens(), 25, 0.05, seed=5), np.random.default_rng(5)
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
