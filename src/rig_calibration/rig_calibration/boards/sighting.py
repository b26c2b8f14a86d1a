"""What one image shows of a calibration target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Sighting:
    """Corners of a target found in one image of one camera.

    camera : the camera's name. moment : which frame (what several cameras show at the same moment is in the same
    place). target : which of several targets, "" when there is only one. ids (n,) : which corners, rows of the
    target's ``corners_board``. pixels (n, 2) : where, in the raw (distorted) image; pixel centres at whole numbers.
    image_size : (width, height), px. sigma_px : standard deviation of a corner's coordinate, as far as it is known.
    """

    camera: str
    moment: int
    ids: npt.NDArray[np.int64]
    pixels: npt.NDArray[np.float64]
    image_size: tuple[int, int]
    target: str = ""
    sigma_px: float = 0.2

    def __len__(self) -> int:
        return len(self.ids)
