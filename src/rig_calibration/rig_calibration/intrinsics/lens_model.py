"""The parameters of a lens and of the board it is seen with, and what is known about them before any view is taken.

They are fx fy cx cy, the distortion coefficients in OpenCV's order, and two of the board: how far its middle stands out
along its x and its y axis (a board that is bent would otherwise be taken for lens distortion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS

from ..bundle.adjustment import Prior
from ..bundle.problem import LENS
from ..bundle.state import Ints, Layout, lens_of

Array = npt.NDArray[np.float64]

RATIONAL = "rational_polynomial"
LAYOUT = Layout(cameras=1, targets=1, with_lens=True)
DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

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
        """Names of the lens's own parameters, in order."""
        return ("fx", "fy", "cx", "cy", *DISTORTION_NAMES[: COEFFICIENTS[self.name]])

    @property
    def columns(self) -> Ints:
        """Where the lens's parameters and the board's bow lie among the solver's shared unknowns."""
        return np.r_[np.arange(LAYOUT.size)[LAYOUT.lens(0)][: len(self.names)], LAYOUT.bows[0]]

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
        lens, count = LAYOUT.lens(0).start, len(self.names)
        mean, information = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
        mean[lens : lens + LENS] = lens_of(self.camera("", focal_px, image_size))
        distortion = self.distortion_prior_sd(focal_px, image_size)
        bow = BOW_PRIOR * board_diagonal_m
        sd = np.array([FOCAL_PRIOR * focal_px] * 2 + [CENTRE_PRIOR * max(image_size)] * 2 + [*distortion.values()])
        information[self.columns, self.columns] = np.r_[0.5, 0.5, np.ones(count)] * np.r_[sd, bow, bow] ** -2.0
        information[lens : lens + 2, lens : lens + 2] += (
            np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_PRIOR * focal_px) ** 2
        )
        if radial is not None:
            coefficients = slice(lens + 4, lens + 4 + len(radial[0]))
            mean[coefficients] = radial[0]
            information[coefficients, coefficients] += radial[1]
        return Prior(mean, information)

    def distortion_prior_sd(self, focal_px: float, image_size: tuple[int, int]) -> dict[str, float]:
        """Return the prior sd of each coefficient: a long lens sees small radii only, and may have large ones."""
        radius = np.hypot(*image_size) / 2 / focal_px
        prior = {name: DISTORTION_PRIOR[name] for name in self.names[4:]}
        return {name: float(share / radius**power) for name, (share, power) in prior.items()}
