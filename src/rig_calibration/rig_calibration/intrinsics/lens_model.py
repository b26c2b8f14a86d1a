"""The parameters of a lens and of the board it is seen with, what is known about them before any view is taken, and how
uncertain they leave the rays.

They are fx fy cx cy, the distortion coefficients in OpenCV's order, and two of the board: how far its middle stands out
along its x and its y axis (a board that is bent would otherwise be taken for lens distortion).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import minimize_scalar

from capture_rig import lens
from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS, Array

from ..bundle.adjustment import Prior
from ..bundle.problem import LENS
from ..bundle.state import Ints, Layout, lens_of

SIMPLE, RATIONAL = COEFFICIENTS
LAYOUT = Layout(cameras=1, targets=1, with_lens=True)
DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
REFERENCE_WIDTH_PX = 640  # of images, for which limits in pixels are given

# Thresholds: judgement, and outweighed by views (decisions); measured by python bench/calibration.py.
# Standard deviations of what lenses and boards are like: views that tell outweigh them by far; where no view reaches,
# the lens goes on as lenses do, instead of as a polynomial does
FOCAL_PRIOR = 1.0  # of the focal length itself
ASPECT_PRIOR = 0.02  # of fx / fy around 1
CENTRE_PRIOR = 0.1  # of the image's longer side, around the middle
# coefficient -> by how much its term moves the image's corner, as a share of the distance from the centre; and the
# power of the corner's normalised radius that its term grows with
DISTORTION_PRIOR = {
    "k1": (0.5, 2),
    "k2": (0.2, 4),
    "p1": (0.01, 1),
    "p2": (0.01, 1),
    "k3": (0.03, 6),
    "k4": (0.5, 2),
    "k5": (0.5, 4),
    "k6": (0.25, 6),
}
WARP_PRIOR = 0.003  # of the board's diagonal: a millimetre on a sheet of A4


@dataclass(frozen=True)
class LensModel:
    """Which parameters there are. ``name`` is ROS's: plumb_bob or rational_polynomial."""

    name: str

    def __post_init__(self) -> None:
        if self.name not in COEFFICIENTS:
            raise InputError(f"'{self.name}' is not a lens model", remedy=f"Use one of {', '.join(COEFFICIENTS)}.")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lens's own parameters, in order."""
        return ("fx", "fy", "cx", "cy", *DISTORTION_NAMES[: COEFFICIENTS[self.name]])

    @property
    def columns(self) -> Ints:
        """Where the lens's parameters and the board's warp lie among the solver's shared unknowns."""
        return np.r_[np.arange(LAYOUT.size)[LAYOUT.lens(0)][: len(self.names)], LAYOUT.warps[0]]

    def camera(self, name: str, focal_px: float, image_size: tuple[int, int]) -> CameraModel:
        """Return a lens without distortion, the principal point in the middle."""
        (width, height), none = image_size, np.zeros(COEFFICIENTS[self.name])
        K = np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
        return CameraModel(name, width, height, K, self.name, none, np.eye(4))

    def prior(
        self,
        focal_px: float,
        image_size: tuple[int, int],
        board_diagonal_m: float,
        radial: tuple[Array, Array] | None = None,
    ) -> Prior:
        """Return what is known of a lens whose focal length is roughly ``focal_px``.

        ``radial`` : mean and information of the distortion coefficients, where more is known of them."""
        start, count = LAYOUT.lens(0).start, len(self.names)
        mean, information = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
        mean[start : start + LENS] = lens_of(self.camera("", focal_px, image_size))
        distortion = self.distortion_prior_sd(focal_px, image_size)
        warp = WARP_PRIOR * board_diagonal_m
        sd = np.array([FOCAL_PRIOR * focal_px] * 2 + [CENTRE_PRIOR * max(image_size)] * 2 + [*distortion.values()])
        information[self.columns, self.columns] = np.r_[0.5, 0.5, np.ones(count)] * np.r_[sd, warp, warp] ** -2.0
        information[start : start + 2, start : start + 2] += (
            np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_PRIOR * focal_px) ** 2
        )
        if radial is not None:
            coefficients = slice(start + 4, start + 4 + len(radial[0]))
            mean[coefficients] = radial[0]
            information[coefficients, coefficients] += radial[1]
        return Prior(mean, information)

    def distortion_prior_sd(self, focal_px: float, image_size: tuple[int, int]) -> dict[str, float]:
        """Return the prior sd of each coefficient: a long lens sees small radii only, and may have large ones."""
        radius = np.hypot(*image_size) / 2 / focal_px
        prior = {name: DISTORTION_PRIOR[name] for name in self.names[4:]}
        return {name: float(share / radius**power) for name, (share, power) in prior.items()}


# --- How uncertain a calibrated lens leaves the rays of its pixels, and how far out it has rays at all.


def edge_sd_px(camera: CameraModel, covariance: Array) -> float:
    """Return the uncertainty, px, of the outermost rays, the worst of the four corners: of where a ray is seen, apart
    from a common rotation of the camera, which extrinsics take up; the larger axis of the error ellipse.

    ``covariance`` : of the lens's parameters, in order."""
    ideal = camera.ideal_points(outermost_pixels(camera))
    rays = np.column_stack([ideal, np.ones(len(ideal))])
    _, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.D)
    by_rotation, by_lens = jacobian[:, :3], jacobian[:, 6 : 6 + len(covariance)]
    by_lens = by_lens - by_rotation @ np.linalg.lstsq(by_rotation, by_lens, rcond=None)[0]
    blocks = by_lens.reshape(len(rays), 2, -1)
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


# --- How wide lenses go on where no board was seen: like the lens that opticians design, not like a polynomial.
#
# The classical projections (rectilinear, stereographic, equidistant, equisolid, orthographic) are one family with a
# single parameter k, the radius in the image over the focal length at the angle a off the axis being
#
#     tan(k a) / k  for k > 0 (1: rectilinear, 1/2: stereographic),   a  for k = 0 (equidistant),
#     sin(k a) / k  for k < 0 (-1/2: equisolid, -1: orthographic)
#
# (Bettonvil 2005, "Fisheye lenses", WGN 33:1). k comes from the part of the image where boards were seen; real lenses
# depart from their member by about a per cent. As a prior of the rational model that leaves it free where it is
# measured, and keeps its eight coefficients, which a board in the middle does not tell apart, from folding in the
# corners.

K_RANGE = (-1.2, 1.3)  # orthographic and a little beyond, to a pincushion lens
LARGEST_ANGLE_RAD = np.deg2rad(80.0)  # as far as a lens model in tan(a) can go
SAMPLES = 24
# sd of a real lens about its member, as a share of the radius: below it no maker's lens table we know of stays, and
# views outweigh it by far (0.1 px of noise are a fiftieth of it)
DEPARTURE = 0.01


def family_radius(angle: Array, k: float) -> Array:
    """Return the distorted radius, in focal lengths, at angles off the axis, rad."""
    if abs(k) < 1e-6:
        return np.asarray(angle, float)
    turned = np.minimum(np.abs(k) * angle, np.deg2rad(89.0))
    return np.asarray((np.tan(turned) if k > 0 else np.sin(turned)) / abs(k))


def family_angle(radius: float, k: float) -> float:
    """Return the inverse of :func:`family_radius`, at most LARGEST_ANGLE_RAD."""
    if abs(k) < 1e-6:
        return min(radius, float(LARGEST_ANGLE_RAD))
    found = np.arctan(k * radius) / k if k > 0 else np.arcsin(min(-k * radius, 1.0)) / -k
    return float(min(found, LARGEST_ANGLE_RAD))


def nearest_member(camera: CameraModel, radius_px: float) -> float:
    """Return the k of the member that is most like the lens of ``camera`` within ``radius_px`` of its principal
    point."""
    radius = np.linspace(0.0, radius_px / camera.K.diagonal()[:2].mean(), SAMPLES + 1)[1:]
    D = np.where(np.isin(np.arange(len(camera.D)), (2, 3)), 0.0, camera.D)  # the radial part
    angle = np.arctan(lens.undistort(np.column_stack([radius, 0.0 * radius]), D)[:, 0])
    known = np.isfinite(angle)
    if not known.any():
        return 0.0

    def misfit(k: float) -> float:
        return float(np.square(family_radius(angle[known], k) - radius[known]).sum())

    return float(minimize_scalar(misfit, bounds=K_RANGE, method="bounded").x)


def rational_prior(k: float, radius: float) -> tuple[Array, Array]:
    """Return the mean (8,) of k1 k2 p1 p2 k3 k4 k5 k6 and their information (8, 8), by what the member ``k`` says of
    the radial function up to the distorted ``radius``, in focal lengths."""
    angle = np.linspace(0.0, family_angle(radius, k), SAMPLES + 1)[1:]
    ideal, distorted = np.tan(angle), family_radius(angle, k)
    q = ideal**2
    powers = np.column_stack([q, q**2, q**3])
    # ideal (1 + k1 q + ...) = distorted (1 + k4 q + ...), linear in the coefficients; the smallest that fit
    rows = np.hstack([ideal[:, None] * powers, -distorted[:, None] * powers]) / distorted[:, None]
    scale = np.abs(rows).max(axis=0)
    radial = np.linalg.lstsq(rows / scale, 1.0 - ideal / distorted, rcond=1e-6)[0] / scale
    mean = np.array([radial[0], radial[1], 0.0, 0.0, *radial[2:]])
    by_coefficients = lens.derivatives(np.column_stack([ideal, 0.0 * ideal]), mean)[2][:, 0]
    by_coefficients[:, 2:4] = 0.0  # tangential: nothing is said
    weighted = by_coefficients / (DEPARTURE * distorted[:, None])
    return mean, weighted.T @ weighted / SAMPLES
