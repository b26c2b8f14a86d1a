"""Draws boards: as an image (for the studio's texture and for tests), and true to scale for print.

Checkerboards are drawn with a black field in the upper left corner; the field up-left of the first corner is that one.
Printed boards have a ruler to check the printer, and stand on several pages where one is too small: SVG (one file a
page) or PDF (one file). The same board gives the same bytes.
"""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.files import write_bytes
from capture_rig.lens import Array

from .board import METRES, Board, CharucoBoard, board_text, opencv_board

if TYPE_CHECKING:  # matplotlib loads in a second
    from matplotlib.figure import Figure

Pair = tuple[float, float]
Rectangle = tuple[float, float, float, float]  # left, top, width, height, metres, y down from the print's upper left
PAPER_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0), "A0": (841, 1189)}
MARGIN_MM, FOOT_MM = 10, 14  # unprintable margin; room for ruler and text
RULER_MM, HAIR_MM, MARK_MM = 100, 0.2, 5
MAX_PAGES = 64


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


def print_size_m(board: Board) -> Pair:
    """Width and height of all fields together, without margin."""
    columns, rows, width, height = outer_fields(board)
    return columns * width, rows * height


def black_rectangles(board: Board) -> list[Rectangle]:
    """What is black on the board, left, top, width, height in metres from the upper left corner of the fields."""
    columns, rows, width, height = outer_fields(board)
    first = int(isinstance(board, CharucoBoard) and not board.starts_black)
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


def _coverage(size: int, low: float, high: float) -> Array:
    """Return the share of each of ``size`` pixels within [low, high]."""
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


# --- For print; all in mm, y down.


def save_for_print(board: Board, path: str | Path, paper: str = "A4") -> list[Path]:
    """Write the board true to scale: .pdf, or .svg and its numbered companions; one that is larger than the paper over
    several pages, to be cut and glued. Returns the files written. InputError for another suffix or unknown paper."""
    path, pages = Path(path), lay_out(board, paper)
    kind = path.suffix.lower()
    if kind not in (".svg", ".pdf"):
        raise InputError(
            f"'{path.suffix}' is neither .svg nor .pdf", where=str(path), remedy="Name a .svg or .pdf file."
        )
    import matplotlib
    from matplotlib.backends.backend_pdf import PdfPages

    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == ".pdf":
        document = BytesIO()
        with PdfPages(document, metadata={"CreationDate": None}) as pdf:
            for page in pages:
                pdf.savefig(page)
        write_bytes(path, document.getvalue())
        return [path]
    files = [path] if len(pages) == 1 else [path.with_stem(f"{path.stem}_{k + 1:02d}") for k in range(len(pages))]
    for file, page in zip(files, pages, strict=True):
        drawing = BytesIO()
        with matplotlib.rc_context({"svg.hashsalt": "board"}):
            page.savefig(drawing, format="svg", metadata={"Date": None})
        write_bytes(file, drawing.getvalue())
    return files


def lay_out(board: Board, paper: str) -> list[Figure]:
    """Lay out pages: one, upright or across, or the fewest that can be cut along their marks and glued."""
    if paper not in PAPER_MM:
        raise InputError(f"paper '{paper}' is not known", remedy=f"Give one of {', '.join(PAPER_MM)}.")
    black, (width, height) = 1e3 * np.array(black_rectangles(board)), print_size_m(board)
    size = width * 1e3, height * 1e3
    choices = [(_pages_needed(size, sides), sides) for sides in (PAPER_MM[paper], PAPER_MM[paper][::-1])]
    (across, down), paper_mm = min(choices, key=lambda choice: choice[0][0] * choice[0][1])
    count = across * down
    if count > MAX_PAGES:
        raise InputError(f"the board needs {count} pages {paper}", remedy="Choose larger paper, or smaller fields.")
    tile = size[0] / across, size[1] / down
    pages = []
    for row in range(down):
        for column in range(across):
            place = f": row {row + 1} of {down}, column {column + 1} of {across}; cut along the marks"
            title = board_text(board) + place * (count > 1)
            pages.append(_page(black, (column * tile[0], row * tile[1]), tile, paper_mm, title, count > 1))
    return pages


def _room(paper_mm: Pair) -> Pair:
    return paper_mm[0] - 2 * MARGIN_MM, paper_mm[1] - 2 * MARGIN_MM - FOOT_MM


def _pages_needed(size: Pair, paper_mm: Pair) -> tuple[int, int]:
    across, down = (math.ceil(side / room - 1e-9) for side, room in zip(size, _room(paper_mm), strict=True))
    return across, down


def _page(black: Array, low: Pair, tile: Pair, paper_mm: Pair, title: str, marks: bool) -> Figure:
    """Draw the part of the board within ``tile`` from ``low`` on, in the middle of a page."""
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    left, top = (MARGIN_MM + (room - side) / 2 for room, side in zip(_room(paper_mm), tile, strict=True))
    near = np.maximum(black[:, :2], low)
    sides = np.minimum(black[:, :2] + black[:, 2:], np.add(low, tile)) - near
    shapes = np.hstack([near - low + [left, top], sides])[(sides > 0).all(axis=1)].tolist()
    shapes += _cut_marks(left, top, *tile) * marks + _ruler(paper_mm)
    figure = Figure(figsize=(paper_mm[0] * 1e-3 / METRES["in"], paper_mm[1] * 1e-3 / METRES["in"]))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, paper_mm[0]), ylim=(paper_mm[1], 0.0))
    axes.set_axis_off()
    outlines = [Outline([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], closed=True) for x, y, w, h in shapes]
    black_parts = Outline.make_compound_path(*outlines)  # one path: no seams between fields that touch
    axes.add_artist(PathPatch(black_parts, facecolor="black", linewidth=0))
    advice = "Print at 100 % (actual size): this line is 100 mm long. Glue flat on a stiff plate."
    for text, above_mm in ((advice, 2.5), (title, -1.0)):
        axes.text(MARGIN_MM, paper_mm[1] - MARGIN_MM - above_mm, text, fontsize=7, parse_math=False)
    return figure


def _cut_marks(left: float, top: float, width: float, height: float) -> list[Rectangle]:
    """Short hair lines outside the four corners of a tile."""
    marks = []
    for x, outer_x in ((left, left - MARK_MM), (left + width, left + width)):
        for y, outer_y in ((top, top - MARK_MM), (top + height, top + height)):
            marks += [(outer_x, y - HAIR_MM / 2, MARK_MM, HAIR_MM), (x - HAIR_MM / 2, outer_y, HAIR_MM, MARK_MM)]
    return marks


def _ruler(paper_mm: Pair) -> list[Rectangle]:
    """100 mm, a tick every 10 mm; its ends are the middle lines of the end ticks."""
    x, y = MARGIN_MM, paper_mm[1] - MARGIN_MM - 6
    heights = [4.0 if k in (0, 10) else 2.0 for k in range(11)]
    ticks = [(x + k * 10 - HAIR_MM / 2, y - height, HAIR_MM, height) for k, height in enumerate(heights)]
    return [(x, y - HAIR_MM / 2, RULER_MM, HAIR_MM), *ticks]
