"""Wide lenses: what plumb_bob cannot describe in the corners, and lenses whose own polynomial turns back there."""

import numpy as np
import pytest
from intrinsics_views import BOARD, folding_lens, pixel_errors, shown
from wide_lenses import PROJECTIONS, DesignedLens

from rig_calibration.boards.board import CharucoBoard
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.lens_model import family_angle, family_radius, nearest_member
from rig_calibration.intrinsics.picture import draw
from rig_calibration.intrinsics.result import report_of

NOISE_PX = 0.1


def calibrated(camera, seed, model="auto", *, views=20, **how):
    return calibrate_intrinsics(shown(camera, views, NOISE_PX, seed=seed, **how), BOARD, name="cam01", model=model)


def said(result, text):
    return [finding for finding in result.verdict.findings if text in finding.what]


@pytest.mark.parametrize(
    ("across_deg", "projection"),
    [
        (112.0, "between rectilinear and equidistant"),
        (112.0, "equidistant"),
        # as at 112 degrees, where less of it is described; and equisolid lies beside equidistant
        pytest.param(105.0, "between rectilinear and equidistant", marks=pytest.mark.slow),
        pytest.param(105.0, "equidistant", marks=pytest.mark.slow),
        pytest.param(105.0, "equisolid", marks=pytest.mark.slow),
        pytest.param(112.0, "equisolid", marks=pytest.mark.slow),
    ],
)
def test_designed_wide_lens_is_usable_in_the_whole_image_though_plumb_bob_folds(projection, across_deg):
    camera = DesignedLens(PROJECTIONS[projection], across_deg)
    views = 30 if across_deg < 110.0 else 20  # it takes more to tell a milder lens from plumb_bob
    result, plain = (calibrated(camera, 21, model, views=views) for model in ("auto", "plumb_bob"))
    assert result.verdict.grade != "redo" and result.camera.distortion_model == "rational_polynomial"
    assert result.camera.unused_share < 0.1 * plain.camera.unused_share
    assert abs(result.values["fx"] / camera.K[0, 0] - 1) < 1.5e-3
    errors, plain_errors = pixel_errors(result.camera, camera), pixel_errors(plain.camera, camera)
    exact, plainly_exact = ((some < 0.5).mean() for some in (errors, plain_errors))  # NaN is not
    assert exact > 0.93 and exact > plainly_exact + 0.03
    # a checkerboard must be seen whole and does not get into the corners, where the lens is a guess
    assert np.nanmax(errors) < min(15.0, 4.0 * result.edge_sd_px)


def test_partial_board_in_the_corners_leaves_nothing_to_guess():
    board, camera = CharucoBoard(11, 8, 0.03, 0.022, "DICT_5X5_100"), DesignedLens(PROJECTIONS["equidistant"], 110.0)
    views = shown(camera, 20, NOISE_PX, seed=22, board=board, sizes=(0.5, 1.1), partial=True)
    result = calibrate_intrinsics(views, board, name="cam01", model="auto")
    assert result.camera.distortion_model == "rational_polynomial" and result.camera.unused_share < 0.005
    assert np.nanmax(pixel_errors(result.camera, camera)) < 1.0


@pytest.mark.filterwarnings("error")
def test_lens_that_folds_inside_the_image_is_usable_up_to_there():
    camera = folding_lens()
    result = calibrated(camera, 23)
    assert result.camera.distortion_model == "plumb_bob"
    assert result.verdict.grade == "usable", str(result.verdict)
    finding = said(result, "% of the image is not used")[0]
    assert finding.what.startswith("the lens model holds up to 54 degrees: the outer 7.")
    assert "bring a ChArUco board" in finding.remedy
    assert np.isfinite(result.edge_sd_px) and result.reach < 1.02
    assert abs(result.values["fx"] / camera.K[0, 0] - 1) < 1e-3
    errors = pixel_errors(result.camera, camera)
    assert np.nanpercentile(errors, 99) < 0.5
    assert result.camera.unused_share == pytest.approx(camera.unused_share, abs=0.005)
    figures = report_of(result, {})
    assert figures["lens_holds_to_deg"] == pytest.approx(53.6, abs=0.5)
    assert figures["image_unused"] == pytest.approx(0.08, abs=0.01)
    figure = draw(result)  # without a warning
    figure.canvas.draw()
    assert len(figure.axes) == 4


def test_lens_that_folds_far_inside_the_image_must_be_done_again():
    result = calibrated(folding_lens((-0.45, 0.0, 0.0, 0.0, 0.0), 300.0), 25, "plumb_bob", sizes=(0.2, 0.4))
    assert said(result, "% of the image is not used")[0].grade == "redo"


@pytest.mark.parametrize("k", [-1.0, 0.0, 1.2])
def test_member_of_the_family_is_found_from_the_inner_part_of_its_own_lens(k):
    inner = DesignedLens(lambda angle: family_radius(np.minimum(angle, 1.2), k), 70.0)
    fitted = calibrate_intrinsics(
        shown(inner, 20, 0.0, seed=27, sizes=(0.3, 0.5)), BOARD, name="cam01", model="rational_polynomial"
    )
    assert nearest_member(fitted.camera, 300.0) == pytest.approx(k, abs=0.03)
    assert family_radius(family_angle(0.8, k), k) == pytest.approx(0.8)
