"""Clips as people have them, written by the tests themselves with the codecs that OpenCV's build can write."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_rig.video import Video

CODECS = {"mp4v": ".mp4", "XVID": ".avi", "MJPG": ".avi", "avc1": ".mp4"}  # MPEG-4, MPEG-4 as XVID has it, MJPEG, H.264


def write_clip(path: Path, images: Sequence[np.ndarray], fps: float = 50.0, codec: str = "mp4v") -> Path:
    """Write images (h, w) or (h, w, 3); grey ones as colour, 4:2:0. Skips where the build cannot write the codec."""
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, (width, height))
    if not writer.isOpened():
        pytest.skip(f"this build of OpenCV cannot write {codec}")
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image)
    writer.release()
    return path


def cut_off(path: Path, share: float) -> Path:
    """Keep that share of a file, as when the recorder's disk was full."""
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    return path


def with_late_frames(path: Path, regular: int, late: int) -> Path:
    """Rewrite the time stamps of an MP4: after the first ``regular`` frames, ``late`` take twice as long each."""
    content = bytearray(path.read_bytes())
    place = content.index(b"stts")
    entries, count, delta = struct.unpack(">III", content[place + 8 : place + 20])
    assert entries == 1 and regular + late == count
    content[place + 8 : place + 20] = struct.pack(">IIIII", 2, regular, delta, late, 2 * delta)
    for box in (b"stts", b"stbl", b"minf", b"mdia", b"trak", b"moov"):
        start = content.index(box) - 4
        content[start : start + 4] = struct.pack(">I", struct.unpack(">I", content[start : start + 4])[0] + 8)
    if b"elst" in content:  # the edit list would cut the clip to its former length
        duration = content.index(b"elst") + 12
        content[duration : duration + 4] = struct.pack(
            ">I", 10 * struct.unpack(">I", content[duration : duration + 4])[0]
        )
    assert content.index(b"mdat") < place  # the frames' own offsets are as they were
    path.write_bytes(content)
    return path


@cache
def scene(count: int, width: int = 644, height: int = 486, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Read-only, noisy grey pictures (h, w) of a textured wall; a bright square before it moves by 6 pixels a frame."""
    rng = np.random.default_rng(seed)
    wall = 90.0 + 400.0 * cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width)), (0, 0), 3.0)
    pictures = []
    for frame in range(count):
        picture = wall + rng.normal(0.0, 3.0, wall.shape)
        picture[100:160, 40 + 6 * frame : 100 + 6 * frame] = 220.0
        pictures.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return tuple(pictures)


def place_of_square(image: np.ndarray) -> float:
    """Column of the square's middle."""
    return float(np.mean(np.nonzero(cv2.blur(image[..., 1] if image.ndim == 3 else image, (9, 9))[130] > 190)[0]))


def transcoded(session: Path, folder: Path, codec: str, fps: float) -> Path:
    """Copy a session folder with its videos written anew, and what goes with them but session.yaml."""
    folder.mkdir()
    for path in sorted(session.iterdir()):
        if path.suffix == ".mp4":
            with Video(path) as video:
                write_clip(folder / (path.stem + CODECS[codec]), list(video), fps, codec)
        elif path.suffix in (".csv", ".yaml") and path.name != "session.yaml":
            shutil.copy(path, folder)
    return folder
