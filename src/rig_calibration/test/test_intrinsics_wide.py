"""Wide lenses: as opticians design them, fisheyes, and lenses whose own polynomial turns back in the corners."""

from collections.abc import Callable

import numpy as np
import pytest
from intrinsics_views import folding_lens, found, pixel_errors, said, shown
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import CharucoBoard
from rig_calibration.intrinsics.result import report_of

Array = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 644, 486
WIDEST_RAD = np.deg2rad(85.0)
TABLE = 20_000  # steps of 0.07 mrad: a thousandth of a pixel after linear interpolation


def between_rectilinear_and_equidistant(angle: Array) -> Array:
    return (np.tan(np.minimum(angle, 1.4)) + angle) / 2


def equidistant(angle: Array) -> Array:
    return angle


class DesignedLens:
    """A camera at the origin, ``across_deg`` wide, its principal point some pixels off the middle.

    ``radius_of``: the radius in the image, in focal lengths, at an angle off the axis, rad (Kingslake 1989, ch. 12).
    """

    name, width, height = "cam01", WIDTH_PX, HEIGHT_PX

    def __init__(self, radius_of: Callable[[Array], Array], across_deg: float) -> None:
        self._angles = np.linspace(0.0, WIDEST_RAD, TABLE)
        self._radii = radius_of(self._angles)
        focal = WIDTH_PX / 2 / float(np.interp(np.deg2rad(across_deg / 2), self._angles, self._radii))
        self.K = np.array([[focal, 0.0, 326.8], [0.0, focal, 239.4], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Points (n, 3), m, to pixels (n, 2); NaN beyond WIDEST_RAD."""
        angle, around = np.arctan2(np.hypot(*points[:, :2].T), points[:, 2]), np.arctan2(points[:, 1], points[:, 0])
        radius = self.K[0, 0] * np.interp(angle, self._angles, self._radii, right=np.nan)
        return np.asarray(self.K[:2, 2] + radius[:, None] * np.column_stack([np.cos(around), np.sin(around)]))

    def rays_world(self, pixels: Array) -> Array:
        """Pixels (n, 2) to unit viewing directions (n, 3); NaN where nothing is seen."""
        x, y = ((pixels - self.K[:2, 2]) / self.K[0, 0]).T
        angle, around = np.interp(np.hypot(x, y), self._radii, self._angles, right=np.nan), np.arctan2(y, x)
        return np.column_stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])


NOISE_PX = 0.1


def calibrated(camera, seed, model="auto", **how):
    return found(shown(camera, 20, NOISE_PX, seed=seed, **how), model=model)


def test_designed_wide_lens_is_usable_in_the_whole_image_though_plumb_bob_folds():
    camera = DesignedLens(between_rectilinear_and_equidistant, 112.0)
    result, plain = (calibrated(camera, 21, model) for model in ("auto", "plumb_bob"))
    assert result.verdict.grade != "redo" and result.camera.distortion_model == "equidistant"
    assert result.camera.unused_share < 0.1 * plain.camera.unused_share
    assert abs(result.values["fx"] / camera.K[0, 0] - 1) < 1.5e-3
    errors, plain_errors = pixel_errors(result.camera, camera), pixel_errors(plain.camera, camera)
    exact, plainly_exact = ((some < 0.5).mean() for some in (errors, plain_errors))  # NaN is not
    assert exact > 0.93 and exact > plainly_exact + 0.03
    # a checkerboard must be seen whole and does not get into the corners, where the lens is a guess
    assert np.nanmax(errors) < min(15.0, 4.0 * result.edge_sd_px)


def test_partial_board_in_the_corners_leaves_nothing_to_guess():
    board, camera = CharucoBoard(11, 8, 0.03, 0.022, "DICT_5X5_100"), DesignedLens(equidistant, 110.0)
    views = shown(camera, 20, NOISE_PX, seed=22, board=board, sizes=(0.5, 1.1), partial=True)
    result = found(views, board, "auto")
    assert result.camera.distortion_model == "equidistant" and result.camera.unused_share < 0.005
    assert np.nanmax(pixel_errors(result.camera, camera)) < 1.0


@pytest.mark.filterwarnings("error")
def test_lens_that_folds_inside_the_image_is_usable_up_to_there():
    camera = folding_lens()
    result = calibrated(camera, 23, "plumb_bob")
    assert result.verdict.grade == "usable", str(result.verdict)
    finding = said(result, "% of the image is not used")[0]
    assert finding.what.startswith("the lens model holds up to 54 degrees: the outer 7.")
    assert "bring a ChArUco board" in finding.remedy
    assert np.isfinite(result.edge_sd_px)
    assert abs(result.values["fx"] / camera.K[0, 0] - 1) < 1e-3
    errors = pixel_errors(result.camera, camera)
    assert np.nanpercentile(errors, 99) < 0.5
    assert result.camera.unused_share == pytest.approx(camera.unused_share, abs=0.005)
    figures = report_of(result, {})
    assert figures["lens_holds_to_deg"] == pytest.approx(53.6, abs=0.5)
    assert figures["image_unused"] == pytest.approx(0.08, abs=0.01)


def test_lens_that_folds_far_inside_the_image_must_be_done_again():
    result = calibrated(folding_lens((-0.45, 0.0, 0.0, 0.0, 0.0), 300.0), 25, "plumb_bob", sizes=(0.2, 0.4))
    assert said(result, "% of the image is not used")[0].grade == "redo"


def test_fisheye_of_half_the_world_is_told_from_its_views_and_known_to_a_pixel():
    """180 degrees, departing from the equidistant projection by a per cent, the axis off the middle."""
    K = np.array([[1280 / np.pi, 0.0, 650.0], [0.0, 1281.3 / np.pi, 505.0], [0.0, 0.0, 1.0]])
    camera = CameraModel("cam01", 1280, 1024, K, "equidistant", np.array([-0.02, 0.01, -0.004, 0.0006]), np.eye(4))
    result = calibrated(camera, 3)
    assert result.camera.distortion_model == "equidistant" and result.verdict.grade == "usable", str(result.verdict)
    assert "with plumb_bob" in result.choice
    assert np.nanmax(pixel_errors(result.camera, camera)) < 1.0 and abs(result.values["fx"] / camera.K[0, 0] - 1) < 1e-3
    assert said(result, "the undistorted picture ends at")


def test_wide_lens_goes_on_as_lenses_do_where_no_board_was_seen():
    camera = DesignedLens(between_rectilinear_and_equidistant, 112.0)
    result = calibrated(camera, 21, "equidistant", reach=0.6)
    assert result.camera.unused_share < 0.02 and np.nanmax(pixel_errors(result.camera, camera)) < 15.0
