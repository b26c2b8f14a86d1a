"""The numbers that an adjustment of one camera finds, and what is known about them before any view is taken.

The vector is fx fy cx cy, the distortion coefficients in OpenCV's order, and two of the board: how far its middle
stands out along its x and its y axis (a board that is bent would otherwise be taken for lens distortion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS

Array = npt.NDArray[np.float64]

DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
BOW_NAMES = ("bow_x", "bow_y")
FOCAL, CENTRE = slice(0, 2), slice(2, 4)

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
BOW_PRIOR = 0.003  # of the board's diagonal: a millimetre on a sheet of A4


@dataclass(frozen=True)
class LensModel:
    """Which parameters there are. ``name`` is ROS's: plumb_bob or rational_polynomial."""

    name: str

    def __post_init__(self) -> None:
        if self.name not in COEFFICIENTS:
            raise InputError(f"'{self.name}' is not a lens model", remedy=f"Use one of {', '.join(COEFFICIENTS)}.")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the camera's own parameters, in the vector's order."""
        return ("fx", "fy", "cx", "cy", *DISTORTION_NAMES[: COEFFICIENTS[self.name]])

    @property
    def camera(self) -> slice:
        """The camera's own part of the vector."""
        return slice(0, len(self.names))

    @property
    def distortion(self) -> slice:
        return slice(4, len(self.names))

    @property
    def size(self) -> int:
        return len(self.names) + len(BOW_NAMES)

    def K(self, theta: Array) -> Array:
        """(3, 3) the camera matrix."""
        fx, fy, cx, cy = theta[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def D(self, theta: Array) -> Array:
        """(5,) or (8,) the distortion coefficients."""
        return np.array(theta[self.distortion])

    def start(self, focal_px: float, image_size: tuple[int, int]) -> Array:
        """A lens without distortion, the principal point in the middle."""
        theta = np.zeros(self.size)
        theta[FOCAL], theta[CENTRE] = focal_px, (np.array(image_size) - 1) / 2
        return theta


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal, with mean (p,) and ``precision`` (p, p), the inverse of its covariance."""

    mean: Array
    precision: Array

    def cost(self, theta: Array) -> float:
        difference = theta - self.mean
        return float(difference @ self.precision @ difference)


def prior_of(model: LensModel, focal_px: float, image_size: tuple[int, int]) -> Prior:
    """What is known of a camera whose focal length is roughly ``focal_px``."""
    precision = np.zeros((model.size, model.size))
    precision[0, 0] = precision[1, 1] = 0.5 / (FOCAL_PRIOR * focal_px) ** 2
    precision[:2, :2] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_PRIOR * focal_px) ** 2
    distortion = distortion_prior_sd(model, focal_px, image_size)
    sd = np.array([*[CENTRE_PRIOR * max(image_size)] * 2, *distortion.values(), BOW_PRIOR, BOW_PRIOR])
    precision[2:, 2:] += np.diag(sd**-2.0)
    return Prior(model.start(focal_px, image_size), precision)


def distortion_prior_sd(model: LensModel, focal_px: float, image_size: tuple[int, int]) -> dict[str, float]:
    """Of each coefficient before any view: a long lens sees rays of small radius only, and may have large ones."""
    radius = np.hypot(*image_size) / 2 / focal_px
    return {name: float(DISTORTION_PRIOR[name][0] / radius ** DISTORTION_PRIOR[name][1]) for name in model.names[4:]}
