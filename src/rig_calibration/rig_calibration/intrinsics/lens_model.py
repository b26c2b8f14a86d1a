"""The parameters of a lens and of the board's warp, their prior, and the uncertainty of the rays.

They are fx fy cx cy, the distortion coefficients in OpenCV's order, and two of the board: the offset of its middle by
bending along its x and its y axis (a bent board would otherwise be taken for lens distortion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig import lens
from capture_rig.camera import CameraModel
from capture_rig.lens import COEFFICIENTS, Array

from ..bundle.adjustment import Prior
from ..bundle.problem import LENS
from ..bundle.state import Ints, Layout, lens_of

SIMPLE, FISHEYE = MODELS = "plumb_bob", "equidistant"
"""Lens models that are fitted, the simpler one first; other programs' rational ones are read, too."""
LAYOUT = Layout(cameras=1, targets=1)
REFERENCE_WIDTH_PX = 640  # of images, for which limits in pixels are given

# Thresholds: judgement, and outweighed by views (decisions); measured by python bench/calibration.py.
# Standard deviations of what lenses and boards are like: views that tell outweigh them by far; where no view reaches,
# the lens goes on as lenses do, instead of as a polynomial does
ASPECT_PRIOR = 0.02  # of fx / fy around 1
CENTRE_PRIOR = 0.1  # of the image's longer side, around the middle
# coefficient -> by how much its term moves the image's corner, as a share of the distance from the centre; and the
# power of the corner's normalised radius that its term grows with
DISTORTION_PRIOR = {
    SIMPLE: {"k1": (0.5, 2), "k2": (0.2, 4), "p1": (0.01, 1), "p2": (0.01, 1), "k3": (0.03, 6)},
    FISHEYE: {"k1": (0.5, 2), "k2": (0.5, 4), "k3": (0.5, 6), "k4": (0.5, 8)},
}
WARP_PRIOR = 0.003  # of the board's diagonal: a millimetre on a sheet of A4


@dataclass(frozen=True)
class LensModel:
    """Which parameters there are. ``name``, ROS's, is one of MODELS."""

    name: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lens's own parameters, in order."""
        return ("fx", "fy", "cx", "cy", *DISTORTION_PRIOR[self.name])

    @property
    def columns(self) -> Ints:
        """Where the lens's parameters and the board's warp lie among the solver's shared unknowns."""
        return np.r_[np.arange(LAYOUT.size)[LAYOUT.lens(0)][: len(self.names)], LAYOUT.warps[0]]

    def camera(self, name: str, focal_px: float, image_size: tuple[int, int]) -> CameraModel:
        """Return a lens without distortion, the principal point in the middle."""
        (width, height), none = image_size, np.zeros(COEFFICIENTS[self.name])
        K = np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
        return CameraModel(name, width, height, K, self.name, none, np.eye(4))

    def prior(self, focal_px: float, image_size: tuple[int, int], board_diagonal_m: float) -> Prior:
        """Return the prior of a lens whose focal length is roughly ``focal_px``."""
        start, count = LAYOUT.lens(0).start, len(self.names)
        mean, information = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
        mean[start : start + LENS] = lens_of(self.camera("", focal_px, image_size))
        radius = np.hypot(*image_size) / 2 / focal_px  # a long lens sees small radii only
        distortion = [share / radius**power for share, power in DISTORTION_PRIOR[self.name].values()]
        warp = WARP_PRIOR * board_diagonal_m
        sd = np.array([focal_px] * 2 + [CENTRE_PRIOR * max(image_size)] * 2 + distortion)
        information[self.columns, self.columns] = np.r_[0.5, 0.5, np.ones(count)] * np.r_[sd, warp, warp] ** -2.0
        information[start : start + 2, start : start + 2] += (
            np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_PRIOR * focal_px) ** 2
        )
        return Prior(mean, information)


# --- Uncertainty of the rays of a calibrated lens, and the radius up to which it has rays.


def edge_sd_px(camera: CameraModel, covariance: Array) -> float:
    """Return the uncertainty, px, of the outermost rays, the worst of the four corners: of where a ray is seen, apart
    from a common rotation of the camera, which extrinsics take up; the larger axis of the error ellipse.

    ``covariance`` : of the lens's parameters, in order."""
    ideal, focal = camera.ideal_points(outermost_pixels(camera)), camera.K.diagonal()[:2, None]
    distorted, by_ideal, by_coefficients = lens.derivatives(ideal, camera.D)
    x, y = ideal.T
    turned = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x]]).transpose(2, 0, 1)  # by a rotation vector
    by_focal, by_centre = distorted[..., None] * np.eye(2), np.broadcast_to(np.eye(2), by_ideal.shape)
    by_lens = np.concatenate([by_focal, by_centre, focal * by_coefficients], axis=-1)[..., : len(covariance)]
    by_rotation, by_lens = (each.reshape(2 * len(x), -1) for each in (focal * by_ideal @ turned, by_lens))
    by_lens = by_lens - by_rotation @ np.linalg.lstsq(by_rotation, by_lens, rcond=None)[0]
    blocks = by_lens.reshape(len(x), 2, -1)
    ellipses = blocks @ covariance @ blocks.transpose(0, 2, 1)
    return float(np.sqrt(np.linalg.eigvalsh(ellipses).max(initial=0.0)))


def outermost_pixels(camera: CameraModel) -> Array:
    """Return (4, 2) the image's corners; where the lens model does not reach one, the last pixel on the way there from
    the principal point for which it has a ray."""
    centre = camera.K[:2, 2]
    corners = np.array([[x, y] for y in (0, camera.height - 1) for x in (0, camera.width - 1)], float)
    along = centre + np.linspace(0.0, 1.0, max(camera.width, camera.height))[:, None, None] * (corners - centre)
    reached = np.isfinite(camera.ideal_points(along.reshape(-1, 2))).all(axis=1, keepdims=True).reshape(len(along), -1)
    last = len(along) - 1 - np.argmax(reached[::-1], axis=0)
    return along[last, np.arange(len(corners))]
