"""Draws boards: as an image (for the studio's texture and for tests), and true to scale for print.

Checkerboards are drawn with a black field in the upper left corner; the field up-left of the first corner is that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from .board import Board, CharucoBoard, opencv_board
from .printing import lay_out, save_pages
from .specification import board_text

Array = npt.NDArray[np.float64]
Rectangle = tuple[float, float, float, float]  # left, top, width, height, metres, y down from the print's upper left


class BoardPicture(NamedTuple):
    """``image`` (H, W) uint8, white margin included, and ``T_pixel_board`` (3, 3): board x, y (metres) to pixels,
    pixel centres at whole numbers."""

    image: npt.NDArray[np.uint8]
    T_pixel_board: Array


def outer_fields(board: Board) -> tuple[int, int, float, float]:
    """Columns and rows of fields, and a field's width and height in metres."""
    if isinstance(board, CharucoBoard):
        return board.columns, board.rows, board.square_m, board.square_m
    return board.columns + 1, board.rows + 1, *board.field_m


def print_size_m(board: Board) -> tuple[float, float]:
    """Width and height of all fields together, without margin."""
    columns, rows, width, height = outer_fields(board)
    return columns * width, rows * height


def black_rectangles(board: Board) -> list[Rectangle]:
    """What is black on the board, left, top, width, height in metres from the upper left corner of the fields."""
    columns, rows, width, height = outer_fields(board)
    first = int(isinstance(board, CharucoBoard) and board.legacy and rows % 2 == 0)  # else the upper left one is black
    fields = [
        (column * width, row * height, width, height)
        for row in range(rows)
        for column in range(columns)
        if (row + column) % 2 == first
    ]
    return fields + (_marker_rectangles(board) if isinstance(board, CharucoBoard) else [])


def draw_board(board: Board, pixels_per_m: float, margin_m: float | None = None) -> BoardPicture:
    """Draw the board as an image, antialiased where fields end between pixels. ``margin_m``: default one field."""
    columns, rows, width, height = outer_fields(board)
    margin = max(width, height) if margin_m is None else margin_m
    size = [round((n * side + 2 * margin) * pixels_per_m) for n, side in ((columns, width), (rows, height))]
    darkness = np.zeros((size[1], size[0]))
    for left, top, wide, high in black_rectangles(board):
        across = _coverage(size[0], (left + margin) * pixels_per_m, (left + wide + margin) * pixels_per_m)
        down = _coverage(size[1], (top + margin) * pixels_per_m, (top + high + margin) * pixels_per_m)
        x, y = np.flatnonzero(across), np.flatnonzero(down)
        darkness[np.ix_(y, x)] += np.outer(down[y], across[x])
    image = np.rint(255 * (1 - darkness.clip(0, 1))).astype(np.uint8)
    first = (margin + np.array([width, height])) * pixels_per_m - 0.5
    T_pixel_board = np.array([[pixels_per_m, 0, first[0]], [0, -pixels_per_m, first[1]], [0, 0, 1.0]])
    return BoardPicture(image, T_pixel_board)


def save_for_print(board: Board, path: str | Path, paper: str = "A4") -> list[Path]:
    """Write the board true to scale (.svg or .pdf), with a ruler to check the printer; one that is larger than the
    paper over several pages, to be cut and glued. Returns the files written. InputError for another suffix or paper."""
    return save_pages(lay_out(black_rectangles(board), print_size_m(board), board_text(board), paper), Path(path))


def _coverage(size: int, low: float, high: float) -> Array:
    """Return how much of each of ``size`` pixels lies within [low, high]."""
    edge = np.arange(size)
    return (np.minimum(edge + 1, high) - np.maximum(edge, low)).clip(0, 1)


def _marker_rectangles(board: CharucoBoard) -> list[Rectangle]:
    """Return the black cells of the markers, cell by cell, in strips along the rows."""
    theirs = opencv_board(board)
    dictionary = theirs.getDictionary()
    cells = dictionary.markerSize + 2
    side = board.marker_m / cells
    rectangles = []
    for corners, marker in zip(theirs.getObjPoints(), np.ravel(theirs.getIds()), strict=True):
        left, top = np.reshape(corners, (-1, 3))[0, :2]
        picture = cv2.aruco.generateImageMarker(dictionary, int(marker), cells, borderBits=1)
        for row, line in enumerate(picture):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], (line == 0).astype(int), [0]])))
            rectangles += [
                (float(left) + a * side, float(top) + row * side, (b - a) * side, side) for a, b in edges.reshape(-1, 2)
            ]
    return rectangles
