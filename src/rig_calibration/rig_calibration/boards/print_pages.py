"""Writes pages as SVG (one file a page) or PDF (one file); the same board gives the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from capture_rig.errors import InputError

from .print_layout import Page

POINTS_PER_MM = 72 / 25.4


def save_pages(pages: Sequence[Page], path: Path) -> list[Path]:
    """Write ``pages`` to ``path`` (.pdf), or to it and its numbered companions (.svg); the files written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    suffix = path.suffix.lower()
    if suffix == ".pdf":
        path.write_bytes(pdf(pages))
        return [path]
    if suffix == ".svg":
        files = [path] if len(pages) == 1 else [path.with_stem(f"{path.stem}_{k + 1:02d}") for k in range(len(pages))]
        for file, page in zip(files, pages, strict=True):
            file.write_text(svg(page), encoding="utf-8")
        return files
    raise InputError(f"'{path.suffix}' is neither .svg nor .pdf", where=str(path), remedy="Name a .svg or .pdf file.")


def svg(page: Page) -> str:
    """One page; a unit of the drawing is a millimetre."""
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
    """All pages in one document of PDF 1.4."""
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
