"""Lays a board out on pages of paper, true to scale, and writes them as SVG (one file a page) or PDF (one file).

With a ruler, and over several pages where one is too small. The same board gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import matplotlib
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from capture_rig.errors import InputError
from capture_rig.files import write_bytes

PAPER_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
MARGIN_MM = 10.0  # what printers leave white
FOOT_MM = 14.0  # for ruler and text
RULER_MM = 100.0
HAIR_MM = 0.2
MARK_MM = 5.0
TEXT_PT = 7.0
MAX_PAGES = 64
MM_PER_INCH = 25.4

Pair = tuple[float, float]
Rectangle = tuple[float, float, float, float]  # left, top, width, height; y down


def lay_out(black_m: Sequence[Rectangle], size_m: Pair, title: str, paper: str = "A4") -> list[Figure]:
    """Lay out pages with the black rectangles of a board of ``size_m`` (metres from its upper left corner): one page,
    upright or across, or the fewest that can be cut along their marks and glued. InputError for unknown paper."""
    if paper not in PAPER_MM:
        raise InputError(f"paper '{paper}' is not known", remedy=f"Give one of {', '.join(PAPER_MM)}.")
    black = [(left * 1e3, top * 1e3, wide * 1e3, high * 1e3) for left, top, wide, high in black_m]
    size = size_m[0] * 1e3, size_m[1] * 1e3
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
            page_title = title + place * (count > 1)
            pages.append(_page(black, (column * tile[0], row * tile[1]), tile, paper_mm, page_title, count > 1))
    return pages


def _room(paper_mm: Pair) -> Pair:
    return paper_mm[0] - 2 * MARGIN_MM, paper_mm[1] - 2 * MARGIN_MM - FOOT_MM


def _pages_needed(size: Pair, paper_mm: Pair) -> tuple[int, int]:
    across, down = (math.ceil(side / room - 1e-9) for side, room in zip(size, _room(paper_mm), strict=True))
    return across, down


def _page(black: list[Rectangle], low: Pair, tile: Pair, paper_mm: Pair, title: str, marks: bool) -> Figure:
    """Draw what lies within ``tile`` from ``low`` on, in the middle of a page; coordinates in mm, y down."""
    left, top = (MARGIN_MM + (room - side) / 2 for room, side in zip(_room(paper_mm), tile, strict=True))
    cut = [_clipped(rectangle, low, tile) for rectangle in black]
    shapes = [(x - low[0] + left, y - low[1] + top, wide, high) for x, y, wide, high in cut if wide > 0 and high > 0]
    shapes += _cut_marks(left, top, *tile) * marks + _ruler(paper_mm)
    figure = Figure(figsize=(paper_mm[0] / MM_PER_INCH, paper_mm[1] / MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, paper_mm[0]), ylim=(paper_mm[1], 0.0))
    axes.set_axis_off()
    outlines = [Outline([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], closed=True) for x, y, w, h in shapes]
    black_parts = Outline.make_compound_path(*outlines)  # one path: no seams between fields that touch
    axes.add_artist(PathPatch(black_parts, facecolor="black", linewidth=0))
    advice = "Print at 100 % (actual size): this line is 100 mm long. Glue flat on a stiff plate."
    for text, above_mm in ((advice, 2.5), (title, -1.0)):
        axes.text(MARGIN_MM, paper_mm[1] - MARGIN_MM - above_mm, text, fontsize=TEXT_PT, parse_math=False)
    return figure


def _clipped(rectangle: Rectangle, low: Pair, tile: Pair) -> Rectangle:
    left, top = max(rectangle[0], low[0]), max(rectangle[1], low[1])
    right = min(rectangle[0] + rectangle[2], low[0] + tile[0])
    bottom = min(rectangle[1] + rectangle[3], low[1] + tile[1])
    return left, top, right - left, bottom - top


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


def save_pages(pages: Sequence[Figure], path: Path) -> list[Path]:
    """Write ``pages`` to ``path`` (.pdf), or to it and its numbered companions (.svg); the files written."""
    kind = path.suffix.lower()
    if kind not in (".svg", ".pdf"):
        raise InputError(
            f"'{path.suffix}' is neither .svg nor .pdf", where=str(path), remedy="Name a .svg or .pdf file."
        )
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
