"""How wide lenses go on where no board was seen: like the lens that opticians design, not like a polynomial.

The classical projections (rectilinear, stereographic, equidistant, equisolid, orthographic) are one family with a
single parameter k, the radius in the image over the focal length at the angle a off the axis being

    tan(k a) / k  for k > 0 (1: rectilinear, 1/2: stereographic),   a  for k = 0 (equidistant),
    sin(k a) / k  for k < 0 (-1/2: equisolid, -1: orthographic)

(Bettonvil 2005, "Fisheye lenses", WGN 33:1). k comes from the part of the image where boards were seen; real lenses
depart from their member by about a per cent. As a prior of the rational model that leaves it free where it is measured,
and keeps its eight coefficients, which a board in the middle does not tell apart, from folding in the corners.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from capture_rig import lens
from capture_rig.camera import CameraModel

from .lens_model import Array

# Thresholds: from the classical projections (rectilinear to orthographic); judgement.
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
    radius = np.linspace(0.0, radius_px / _focal_px(camera), SAMPLES + 1)[1:]
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


def _focal_px(camera: CameraModel) -> float:
    return float(camera.K.diagonal()[:2].mean())
