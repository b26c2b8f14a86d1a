"""The report and the picture of a calibration."""

import numpy as np
import pytest
import yaml
from intrinsics_views import BOARD, lens, shown, with_pixels

from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.picture import draw
from rig_calibration.intrinsics.result import report_of


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
