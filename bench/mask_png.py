"""Measures what a silhouette message costs: writing and reading its PNG, against OpenCV's PNG and zlib's run lengths.

    python bench/mask_png.py            # half a minute

Masks are silhouettes of the studio's walking person by a camera client's default chain (four bits a pixel), the same
with shadow candidates only (two), and without (one). Figures are processor milliseconds of one mask, medians, in turns,
and the file's bytes. "zlib" : the same rows deflated by zlib's run-length strategy, as recordings of former versions
hold them: only the deflate is timed, and how long :func:`sagoma_ros.mask_png.decode` takes to read them. The last line
is JSON: of masks as they are sent, encode_ms, decode_ms, bytes; opencv and zlib: the same.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable
from typing import Any

from report import Table, execute, finish, parser

import cv2
import numpy as np
from room_methods import our_pipeline
from room_studio import LOOKS, studio_clip

from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE
from sagoma_ros import mask_png

SECONDS, SETTLED, STRIDE = 4.0, 30, 4
REPEATS = 20
IHDR_END, IDAT, TRAILER = 33, 41, 16  # bytes of our files, which have three chunks
Masks = list[np.ndarray]


def main() -> None:
    parser(__doc__).parse_args()
    sent = silhouettes()
    kinds = {
        4: sent,
        2: [np.where(m > SHADOW_CANDIDATE, FOREGROUND, np.minimum(m, 1) * SHADOW_CANDIDATE).astype("u1") for m in sent],
        1: [np.where(m > SHADOW_CANDIDATE, FOREGROUND, BACKGROUND).astype("u1") for m in sent],
    }
    table = Table("bits:>4d | by:<8 | encode ms:>9.3f | decode ms:>9.3f | bytes:>6.0f")
    figures: dict[str, Any] = {}
    for bits, masks in kinds.items():
        rows = measured(masks)
        for name, values in rows.items():
            table.row(bits, name, *values)
        if bits == 4:
            keyed = {name: dict(zip(("encode_ms", "decode_ms", "bytes"), v, strict=True)) for name, v in rows.items()}
            figures = keyed.pop("ours") | keyed
    finish(figures)


def silhouettes() -> Masks:
    """Return masks of one camera as they are sent."""
    clip = studio_clip(LOOKS[0], SECONDS)
    camera = clip.rig.names[0]
    chain = our_pipeline(clip, {}).cameras[camera]
    seen = [chain.run(image, clip.stamp_ns(k)).mask.copy() for k, image in enumerate(clip.take[camera])]
    return seen[SETTLED::STRIDE]


def measured(masks: Masks) -> dict[str, tuple[float, float, float]]:
    """Return milliseconds of encoding and decoding, and bytes, by who does it."""
    ours = [mask_png.encode(mask) for mask in masks]
    rows = [zlib.decompress(data[IDAT:-TRAILER]) for data in ours]
    theirs = [cv2.imencode(".png", mask)[1] for mask in masks]
    former = [_with_body(data, _by_zlib(raw)) for data, raw in zip(ours, rows, strict=True)]
    ms = in_turns(
        {
            "ours": [(mask_png.encode, masks), (_all_levels, ours)],
            "zlib": [(_by_zlib, rows), (_all_levels, former)],
            "opencv": [(lambda m: cv2.imencode(".png", m), masks), (_by_opencv, theirs)],
        }
    )
    sizes = {"ours": ours, "zlib": former, "opencv": theirs}
    return {name: (*both, float(np.mean([len(data) for data in sizes[name]]))) for name, both in ms.items()}


def in_turns(works: dict[str, list[tuple[Callable[[Any], object], list]]]) -> dict[str, tuple[float, ...]]:
    """Return each work's median milliseconds of processor time over its items."""
    times: dict[tuple[str, int], list[float]] = {}
    for item in range(len(works["ours"][0][1])):
        for name, both in works.items():
            for which, (work, items) in enumerate(both):
                begin = time.thread_time()
                for _ in range(REPEATS):
                    work(items[item])
                times.setdefault((name, which), []).append(1e3 * (time.thread_time() - begin) / REPEATS)
    return {name: tuple(float(np.median(times[name, which])) for which in (0, 1)) for name in works}


def _all_levels(data: bytes) -> object:
    return mask_png.decode(data, SHADOW_CANDIDATE)


def _by_opencv(data: np.ndarray) -> object:
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)


def _by_zlib(rows: bytes) -> bytes:
    packer = zlib.compressobj(2, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return packer.compress(rows) + packer.flush()


def _with_body(data: bytes, body: bytes) -> bytes:
    """Return one of our files with another deflate of its rows."""
    chunk = b"IDAT" + body
    checked = struct.pack(">I", len(body)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return data[:IHDR_END] + checked + data[4 - TRAILER :]


if __name__ == "__main__":
    execute(main)
