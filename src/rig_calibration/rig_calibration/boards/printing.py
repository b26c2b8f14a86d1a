"""Lays a board out on pages of paper, true to scale, and writes them as SVG (one file a page) or PDF (one file).

With a ruler, and over several pages where one is too small. The same board gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from capture_rig.errors import InputError
from capture_rig.files import write_bytes, write_text

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
MAX_PAGES = 64

Rectangle = tuple[float, float, float, float]  # left, top, width, height; y down


@dataclass(frozen=True)
class Page:
    """One page: its size, black rectangles (left, top, width, height) and texts (x, baseline y, height, text); all in
    mm from the upper left corner, y down."""

    width_mm: float
    height_mm: float
    black_mm: tuple[Rectangle, ...]
    texts: tuple[tuple[float, float, float, str], ...]


def lay_out(black_m: Sequence[Rectangle], size_m: tuple[float, float], title: str, paper: str = "A4") -> list[Page]:
    """Lay out pages with the black rectangles of a board of ``size_m`` (metres from its upper left corner): one page,
    upright or across, or the fewest that can be cut along their marks and glued. InputError for unknown paper."""
    if paper not in PAPER_MM:
        raise InputError(f"paper '{paper}' is not known", remedy=f"Give one of {', '.join(PAPER_MM)}.")
    black = [(left * 1e3, top * 1e3, wide * 1e3, high * 1e3) for left, top, wide, high in black_m]
    size = size_m[0] * 1e3, size_m[1] * 1e3
    upright = PAPER_MM[paper]
    choices = [(_pages_needed(size, paper_mm), paper_mm) for paper_mm in (upright, upright[::-1])]
    (across, down), paper_mm = min(choices, key=lambda choice: choice[0][0] * choice[0][1])
    if across * down > MAX_PAGES:
        raise InputError(
            f"the board needs {across * down} pages {paper}", remedy="Choose larger paper, or smaller fields."
        )
    return [
        _page(black, size, (column, row), (across, down), paper_mm, title)
        for row in range(down)
        for column in range(across)
    ]


def _room(paper_mm: tuple[float, float]) -> tuple[float, float]:
    return paper_mm[0] - 2 * MARGIN_MM, paper_mm[1] - 2 * MARGIN_MM - FOOT_MM


def _pages_needed(size: tuple[float, float], paper_mm: tuple[float, float]) -> tuple[int, int]:
    room = _room(paper_mm)
    return math.ceil(size[0] / room[0] - 1e-9), math.ceil(size[1] / room[1] - 1e-9)


def _page(
    black: list[Rectangle],
    size: tuple[float, float],
    place: tuple[int, int],
    count: tuple[int, int],
    paper_mm: tuple[float, float],
    title: str,
) -> Page:
    tile = size[0] / count[0], size[1] / count[1]
    low = place[0] * tile[0], place[1] * tile[1]
    room = _room(paper_mm)
    offset = MARGIN_MM + (room[0] - tile[0]) / 2 - low[0], MARGIN_MM + (room[1] - tile[1]) / 2 - low[1]
    cut = [_clipped(rectangle, low, tile) for rectangle in black]
    shapes = [(left + offset[0], top + offset[1], wide, high) for left, top, wide, high in cut if wide > 0 and high > 0]
    several = count[0] * count[1] > 1
    if several:
        shapes += _cut_marks(offset[0] + low[0], offset[1] + low[1], *tile)
        title = f"{title}: row {place[1] + 1} of {count[1]}, column {place[0] + 1} of {count[0]}; cut along the marks"
    return Page(*paper_mm, tuple(shapes + _ruler(paper_mm)), _foot(paper_mm, title))


def _clipped(rectangle: Rectangle, low: tuple[float, float], tile: tuple[float, float]) -> Rectangle:
    left, top = max(rectangle[0], low[0]), max(rectangle[1], low[1])
    right = min(rectangle[0] + rectangle[2], low[0] + tile[0])
    bottom = min(rectangle[1] + rectangle[3], low[1] + tile[1])
    return left, top, right - left, bottom - top


def _cut_marks(left: float, top: float, width: float, height: float) -> list[Rectangle]:
    """Short hair lines outside the four corners of a tile."""
    marks = []
    for x, outward_x in ((left, -1), (left + width, 1)):
        for y, outward_y in ((top, -1), (top + height, 1)):
            marks.append((min(x, x + 5 * outward_x), y - HAIR_MM / 2, 5.0, HAIR_MM))
            marks.append((x - HAIR_MM / 2, min(y, y + 5 * outward_y), HAIR_MM, 5.0))
    return marks


def _ruler(paper_mm: tuple[float, float]) -> list[Rectangle]:
    """100 mm, a tick every 10 mm; its ends are the outer edges of the end ticks' middle lines."""
    x, y = MARGIN_MM, paper_mm[1] - MARGIN_MM - 6
    ticks = [
        (x + k * 10 - HAIR_MM / 2, y - (4 if k in (0, 10) else 2), HAIR_MM, 4.0 if k in (0, 10) else 2.0)
        for k in range(11)
    ]
    return [(x, y - HAIR_MM / 2, RULER_MM, HAIR_MM), *ticks]


def _foot(paper_mm: tuple[float, float], title: str) -> tuple[tuple[float, float, float, str], ...]:
    bottom = paper_mm[1] - MARGIN_MM
    advice = "Print at 100 % (actual size): this line is 100 mm long. Glue flat on a stiff plate."
    return ((MARGIN_MM, bottom - 2.5, 2.8, advice), (MARGIN_MM, bottom + 1.0, 2.8, title))


# --- Files.

POINTS_PER_MM = 72 / 25.4


def save_pages(pages: Sequence[Page], path: Path) -> list[Path]:
    """Write ``pages`` to ``path`` (.pdf), or to it and its numbered companions (.svg); the files written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    suffix = path.suffix.lower()
    if suffix == ".pdf":
        write_bytes(path, pdf(pages))
        return [path]
    if suffix == ".svg":
        files = [path] if len(pages) == 1 else [path.with_stem(f"{path.stem}_{k + 1:02d}") for k in range(len(pages))]
        for file, page in zip(files, pages, strict=True):
            write_text(file, svg(page))
        return files
    raise InputError(f"'{path.suffix}' is neither .svg nor .pdf", where=str(path), remedy="Name a .svg or .pdf file.")


def svg(page: Page) -> str:
    """Write one page as SVG; a unit of the drawing is a millimetre."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width_mm:g}mm" height="{page.height_mm:g}mm" '
        f'viewBox="0 0 {page.width_mm:g} {page.height_mm:g}" shape-rendering="crispEdges">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    lines += [
        f'<rect x="{left:.4f}" y="{top:.4f}" width="{width:.4f}" height="{height:.4f}"/>'
        for left, top, width, height in page.black_mm
    ]
    lines += [
        f'<text x="{x:.2f}" y="{y:.2f}" font-family="Helvetica, Arial, sans-serif" font-size="{height:g}">'
        f"{escape(text)}</text>"
        for x, y, height, text in page.texts
    ]
    return "\n".join([*lines, "</svg>", ""])


def pdf(pages: Sequence[Page]) -> bytes:
    """Write all pages as one document of PDF 1.4."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>".encode(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    for k, page in enumerate(pages):
        content = _content(page).encode("latin-1", "replace")
        box = f"{page.width_mm * POINTS_PER_MM:.4f} {page.height_mm * POINTS_PER_MM:.4f}"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents {5 + 2 * k} 0 R "
            f"/Resources << /Font << /F 3 0 R >> >> >>".encode()
        )
        objects.append(b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content))
    return _document(objects)


def _content(page: Page) -> str:
    """Millimetres from the upper left corner to points from the lower left one."""
    unit, height = POINTS_PER_MM, page.height_mm
    lines = [
        f"{left * unit:.4f} {(height - top - high) * unit:.4f} {wide * unit:.4f} {high * unit:.4f} re"
        for left, top, wide, high in page.black_mm
    ]
    texts = []
    for x, y, size, text in page.texts:
        safe = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        texts.append(f"BT /F {size * unit:.2f} Tf {x * unit:.4f} {(height - y) * unit:.4f} Td ({safe}) Tj ET")
    return "\n".join([*lines, "f", *texts])


def _document(objects: Sequence[bytes]) -> bytes:
    """Numbered objects with the table that says where each begins."""
    body, offsets = b"%PDF-1.4\n", []
    for number, content in enumerate(objects, start=1):
        offsets.append(len(body))
        body += b"%d 0 obj\n%b\nendobj\n" % (number, content)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    head = b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    return (
        body
        + head
        + table
        + b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(body))
    )
