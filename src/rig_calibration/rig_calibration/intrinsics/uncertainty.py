"""How well an adjustment knows the camera.

The inverse of the normal matrix assumes that corners err independently. Real ones do not: a view is a little blurred, a
board bends, a shutter rolls, and then all corners of a view err together. So every view is left out in turn, in one
linearised step; the scatter of what remains (the jackknife over views, Tukey 1958) tells by how much the normal matrix
promises too much, and the covariance is enlarged by that.
"""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig import lens

from .adjustment import Fit
from .parameters import CENTRE, FOCAL, Array, LensModel


def jackknife_covariance(fit: Fit) -> tuple[Array, float]:
    """(p, p) of the parameters, and the factor >= 1 by which the jackknife has enlarged standard deviations overall.

    Each parameter's own factor lies between that and what its own scatter says, which is few numbers, and is never
    smaller than the overall one.
    """
    white, changes = np.linalg.inv(fit.precision), leave_one_out(fit)
    scatter, expected = changes.T @ changes, _expected_scatter(fit)
    overall = max(float(np.trace(fit.precision @ scatter) / np.trace(fit.precision @ expected)), 1.0)
    own = np.diag(scatter) / np.diag(expected)
    factors = np.sqrt(np.maximum(overall, (overall + own) / 2))
    return np.asarray(white * np.outer(factors, factors), np.float64), float(np.sqrt(overall))


def leave_one_out(fit: Fit) -> Array:
    """(V, p) how the parameters would change without each view."""
    total = fit.precision
    return np.array(
        [
            np.linalg.solve(total - information, -score)
            for information, score in zip(fit.information, fit.score, strict=True)
        ]
    )


def _expected_scatter(fit: Fit) -> Array:
    """(p, p): the sum over views of their changes' squares, on average, when the corners' noise is white."""
    total, expected = fit.precision, np.zeros_like(fit.precision)
    for information in fit.information:
        rest = np.linalg.inv(total - information)
        score = information - information @ np.linalg.solve(total, information)  # covariance of the view's score
        expected += rest @ score @ rest
    return expected


def projection_sd(theta: Array, covariance: Array, model: LensModel, pixels: Array) -> Array:
    """(n,) px: how uncertain it is where a ray is seen that is seen at ``pixels`` (n, 2), apart from a common rotation
    of the camera, which extrinsics take up. The larger axis of the error ellipse; NaN where the lens has no ray."""
    ideal = lens.undistort((pixels - theta[CENTRE]) / theta[FOCAL], model.D(theta))
    reached = np.isfinite(ideal).all(axis=1)
    sd = np.full(len(pixels), np.nan)
    if not reached.any():
        return sd
    rays = np.column_stack([ideal[reached], np.ones(int(reached.sum()))])
    _, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), model.K(theta), model.D(theta))
    by_rotation, by_camera = jacobian[:, :3], jacobian[:, 6 : 6 + len(model.names)]
    by_camera = by_camera - by_rotation @ np.linalg.lstsq(by_rotation, by_camera, rcond=None)[0]
    blocks = by_camera.reshape(len(rays), 2, -1)
    ellipses = blocks @ covariance[model.camera, model.camera] @ blocks.transpose(0, 2, 1)
    sd[reached] = np.sqrt(np.linalg.eigvalsh(ellipses)[:, -1].clip(0.0))
    return sd
