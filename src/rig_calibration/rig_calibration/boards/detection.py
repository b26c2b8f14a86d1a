"""Finds a calibration board in one image."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .board import Board, CharucoBoard
from .charuco import find_charuco
from .checkerboard import find_checkerboard
from .corner_grid import CornerGrid
from .image_variants import variants_for
from .sighting import Sighting


def find_board(
    image: npt.NDArray[np.uint8],
    board: Board,
    *,
    camera: str = "",
    moment: int = 0,
    target: str = "",
    thorough: bool = False,
) -> Sighting | None:
    """The board's corners in an image (H, W) or (H, W, 3) BGR uint8; None when they are not found.

    Of a checkerboard the whole width and height must be seen (a hand may cover some corners); of a ChArUco board any
    part. ``thorough`` looks longer: for small, dim and blurred boards, and for boards on the floor at a grazing angle.
    The order of the ids follows the board's colours or markers; where a half turn is not visible (see
    ``Checkerboard.half_turn_is_visible``), rows are taken to run to the right in the image.
    """
    grey = as_grey(image)
    variants = variants_for(grey.shape, thorough)
    if isinstance(board, CharucoBoard):
        grid = find_charuco(grey, board, variants)
    else:
        grid = find_checkerboard(grey, board, variants)
    return None if grid is None else sighting_of(grid, grey.shape, camera=camera, moment=moment, target=target)


def as_grey(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(H, W) uint8 of a grey or BGR image."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image


def sighting_of(grid: CornerGrid, shape: tuple[int, ...], *, camera: str, moment: int, target: str) -> Sighting:
    """The grid, which is in the board's order, as a sighting."""
    found = grid.found.ravel()
    return Sighting(
        camera=camera,
        moment=moment,
        target=target,
        ids=np.flatnonzero(found),
        pixels=grid.pixels.reshape(-1, 2)[found].copy(),
        image_size=(shape[1], shape[0]),
        sigma_px=grid.sigma_px,
    )
