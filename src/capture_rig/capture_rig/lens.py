"""Lens distortion in normalised image coordinates: plumb_bob, rational_polynomial, equidistant; inverse, derivatives.

With r2 = x^2 + y^2 and coefficients in OpenCV's order k1 k2 p1 p2 k3 [k4 k5 k6] (Brown 1966; the rational form is
OpenCV's):  x' = x g + 2 p1 x y + p2 (r2 + 2 x^2),  y' = y g + p1 (r2 + 2 y^2) + 2 p2 x y,
g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3).

Four coefficients k1 k2 k3 k4 are a fisheye's (Kannala and Brandt 2006; OpenCV's cv2.fisheye, ROS's equidistant): with
the angle off the axis t = atan(r),  x' = x h / r,  y' = y h / r,  h = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

COEFFICIENTS = {"plumb_bob": 5, "equidistant": 4, "rational_polynomial": 8}
"""How many each model has, from the simplest to the richest."""
NEWTON_STEPS = 20
# Thresholds: NEGLIGIBLE from rounding, LEAST_SLOPE from the classical projections up to 80 degrees; else judgement.
NEGLIGIBLE = 1e-9  # a share, metres or radians: above what rounding adds up to, far below all that is measured
# d(distorted radius) / d(ideal radius) below which the model counts as folded: there an error of a pixel turns a ray
# by over thirty times what it does in the middle, and tangential terms (below 0.03 in any lens) may fold what is left.
# Real lenses have more up to 80 degrees off the axis (an equidistant one cos^2); from here to the fold it is a tenth of
# a pixel
LEAST_SLOPE = 0.03
# of a fisheye, off the axis: a plane before the camera, on which ideal points lie, goes no farther. Boards are seen
# there; the undistorted canvas ends sooner
LARGEST_ANGLE_RAD = np.deg2rad(88.0)


def distort(points: Array, D: Array) -> Array:
    """Ideal points (..., 2) to where the lens puts them (..., 2); ``D`` (..., 4, 5 or 8), broadcast to the points."""
    return (_distort_fisheye if is_fisheye(D) else _distort)(points, D)[0]


def is_fisheye(D: Array) -> bool:
    """Return whether coefficients (..., n) are those of the equidistant model."""
    return int(np.shape(D)[-1]) == COEFFICIENTS["equidistant"]


def undistort(points: Array, D: Array) -> Array:
    """Return the inverse of :func:`distort`, by Newton's method; NaN where the lens model puts no point."""
    if is_fisheye(D):
        return _undistort_fisheye(points, D)
    if not np.any(D):
        return np.array(points, float)
    ideal = np.array(points, float)
    with np.errstate(all="ignore"):  # points without a solution run off; they are marked below
        for _ in range(NEWTON_STEPS):
            distorted, (a, b, c) = _distort(ideal, D)
            ex, ey = (points - distorted).T
            determinant = a * c - b * b
            step = np.stack([c * ex - b * ey, a * ey - b * ex], axis=1) / determinant[:, None]
            ideal += step
            if not np.abs(step[np.isfinite(step)]).max(initial=0) > NEGLIGIBLE / 10:
                break
        residual = np.abs(distort(ideal, D) - points).max(axis=1)
        solved = (residual < NEGLIGIBLE) & ((ideal**2).sum(axis=1) < reach_radius(D) ** 2)
    ideal[~solved] = np.nan
    return ideal


def reach_radius(D: Array) -> float:
    """Return the ideal radius up to which the model is used, just short of where the radial polynomial runs backwards
    (no light gets there) or has a pole: there the distorted radius grows by less than LEAST_SLOPE of the ideal one.
    Infinite where it always grows. Of a fisheye, LARGEST_ANGLE_RAD at most."""
    if is_fisheye(D):
        return float(np.tan(_largest_angle(D)))
    k1, k2, _, _, k3, k4, k5, k6 = _eight(D)
    top, bottom = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    q = np.poly1d([1.0, 0.0])  # r^2
    slope = (top + 2 * q * top.deriv()) * bottom - 2 * q * top * bottom.deriv()
    roots = np.concatenate([(slope - LEAST_SLOPE * bottom * bottom).roots, bottom.roots])
    ahead = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(np.sqrt(ahead.min(initial=np.inf)))


def derivatives(points: Array, D: Array) -> tuple[Array, Array, Array]:
    """Distorted points (..., 2), their derivatives by the ideal points (..., 2, 2) and by the coefficients (..., 2, 8):
    k1 k2 p1 p2 k3 k4 k5 k6, or a fisheye's four and 0. ``D`` (..., 4, 5 or 8), broadcast to the points."""
    if is_fisheye(D):
        distorted, (a, b, c) = _distort_fisheye(points, D)
        radius, angle = _radius_and_angle(points)
        powers = np.zeros((*radius.shape, COEFFICIENTS["rational_polynomial"]))
        powers[..., : np.shape(D)[-1]] = angle[..., None] ** np.array([3, 5, 7, 9]) / radius[..., None]
        return distorted, _matrix(a, b, b, c), points[..., :, None] * powers[..., None, :]
    distorted, (a, b, c) = _distort(points, D)
    x, y = np.moveaxis(points, -1, 0)
    r2 = x * x + y * y
    top, _, bottom, _ = _polynomials(r2, D)
    g = top / bottom
    powers = np.stack([r2, r2**2, r2**3], axis=-1) / bottom[..., None]
    radial = np.concatenate([powers, -g[..., None] * powers], axis=-1)  # of g by k1 k2 k3 k4 k5 k6
    by_radial = radial[..., None, :] * points[..., :, None]
    tangential = _matrix(2 * x * y, r2 + 2 * x * x, r2 + 2 * y * y, 2 * x * y)
    return distorted, _matrix(a, b, b, c), np.concatenate([by_radial[..., :2], tangential, by_radial[..., 2:]], axis=-1)


def _matrix(a: Array, b: Array, c: Array, d: Array) -> Array:
    return np.stack([np.stack([a, b], axis=-1), np.stack([c, d], axis=-1)], axis=-2)


def _polynomials(r2: Array, D: Array) -> tuple[Array, Array, Array, Array]:
    """Numerator and denominator of g, each with its derivative by r2."""
    k1, k2, _, _, k3, k4, k5, k6 = _eight(D)
    top, d_top = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + r2 * 3 * k3)
    bottom, d_bottom = 1 + r2 * (k4 + r2 * (k5 + r2 * k6)), k4 + r2 * (2 * k5 + r2 * 3 * k6)
    return top, d_top, bottom, d_bottom


def _eight(D: Array) -> Array:
    """Return (8, ...) the coefficients, zero where the model has none."""
    D = np.moveaxis(np.asarray(D, float), -1, 0)
    return np.concatenate([D, np.zeros((8 - len(D), *D.shape[1:]))])


def _distort(points: Array, D: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Distorted points and the three different terms of their symmetric Jacobian: dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    _, _, p1, p2, *_ = _eight(D)
    x, y = np.moveaxis(points, -1, 0)
    r2 = x * x + y * y
    top, d_top, bottom, d_bottom = _polynomials(r2, D)
    g = top / bottom
    d_g = (d_top - g * d_bottom) / bottom
    distorted = np.stack(
        [x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=-1
    )
    jacobian = (
        g + 2 * x * x * d_g + 2 * p1 * y + 6 * p2 * x,
        2 * x * y * d_g + 2 * p1 * x + 2 * p2 * y,
        g + 2 * y * y * d_g + 6 * p1 * y + 2 * p2 * x,
    )
    return distorted, jacobian


# --- fisheyes


def _radius_and_angle(points: Array) -> tuple[Array, Array]:
    """Radius of ideal points, not 0 (below NEGLIGIBLE a fisheye is a pinhole), and their angle off the axis."""
    radius = np.sqrt(np.maximum((points * points).sum(axis=-1), NEGLIGIBLE**2))
    return radius, np.arctan(radius)


def _bend(angle: Array, D: Array) -> tuple[Array, Array]:
    """Distorted radius at angles off the axis, and its derivative."""
    k1, k2, k3, k4 = np.moveaxis(np.asarray(D, float), -1, 0)
    q = angle * angle
    share = 1 + q * (k1 + q * (k2 + q * (k3 + q * k4)))
    return angle * share, 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))


def _largest_angle(D: Array) -> float:
    """Angle off the axis up to which a fisheye is used: LARGEST_ANGLE_RAD, or just short of where it folds."""
    k1, k2, k3, k4 = D
    roots = np.poly1d([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0 - LEAST_SLOPE]).roots
    ahead = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return min(float(LARGEST_ANGLE_RAD), float(np.sqrt(ahead.min(initial=np.inf))))


def _distort_fisheye(points: Array, D: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """As :func:`_distort`. With the unit vector u = (x, y) / r, the Jacobian is h' / (1 + r^2) along it and h / r
    across."""
    radius, angle = _radius_and_angle(points)
    bent, slope = _bend(angle, D)
    across = bent / radius
    more = (slope / (1 + radius * radius) - across) / (radius * radius)
    x, y = np.moveaxis(points, -1, 0)
    return points * across[..., None], (across + more * x * x, more * x * y, across + more * y * y)


def _undistort_fisheye(points: Array, D: Array) -> Array:
    radius = np.sqrt(np.maximum((points * points).sum(axis=-1), NEGLIGIBLE**2))
    last = _largest_angle(D)
    angle = np.minimum(radius, last)
    for _ in range(NEWTON_STEPS):
        bent, slope = _bend(angle, D)
        step = (radius - bent) / slope
        angle = np.clip(angle + step, 0.0, last)
        if np.abs(step).max(initial=0.0) <= NEGLIGIBLE / 10:
            break
    solved = np.abs(_bend(angle, D)[0] - radius) < NEGLIGIBLE
    return np.asarray(np.where(solved, np.tan(angle) / radius, np.nan)[..., None] * points)
