"""Wide lenses as opticians design them, which no polynomial describes exactly."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RadiusOfAngle = Callable[[Array], Array]

WIDTH_PX, HEIGHT_PX = 644, 486
WIDEST_RAD = np.deg2rad(85.0)
TABLE = 20_000  # steps of 0.07 mrad: a thousandth of a pixel after linear interpolation

PROJECTIONS: dict[str, RadiusOfAngle] = {
    "between rectilinear and equidistant": lambda angle: (np.tan(np.minimum(angle, 1.4)) + angle) / 2,
    "stereographic": lambda angle: 2 * np.tan(angle / 2),
    "equidistant": lambda angle: angle,
    "equisolid": lambda angle: 2 * np.sin(angle / 2),
    "orthographic": np.sin,
}
"""By name, the radius in the image, in focal lengths, at an angle off the axis, rad (Kingslake 1989, ch. 12)."""


class DesignedLens:
    """A camera at the origin with such a lens, ``across_deg`` wide, its principal point some pixels off the middle."""

    name, width, height = "cam01", WIDTH_PX, HEIGHT_PX

    def __init__(self, radius_of: RadiusOfAngle, across_deg: float) -> None:
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
