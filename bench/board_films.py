"""Board corners, and lenses, from calibration films: by codec and bit rate.

    python bench/board_films.py [--quick] [--ffmpeg PATH] [--rate 25]

One studio camera (640 x 480, noise of 3 grey levels, a waved board) is filmed once; the same pictures are written with
what OpenCV's build writes (MPEG-4, MJPEG of several qualities), and with --ffmpeg (a program that has libx264 and
libxvid) at several rates. Corners are compared with where they are, lenses with the true one. The last line is JSON.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from report import Table, execute, finish, parser

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from rig_calibration.boards.detector import find_board
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from sagoma_tools.calibration.footage import CameraFootage
from sagoma_tools.calibration.intrinsics import watch_footage
from virtual_studio.recording.footage import HAND_BOARD
from virtual_studio.rendering.board_camera import FilmingCamera, Optics
from virtual_studio.rendering.camera import Sensor
from virtual_studio.rig import ring
from virtual_studio.scene.boards import print_of
from virtual_studio.scene.handling import hands, wave

MJPEG_QUALITIES = (90, 50, 25, 10)
WITH_FFMPEG = {
    **{f"H.264 crf {crf}": ("mp4", "-c:v", "libx264", "-crf", str(crf)) for crf in (18, 23, 28, 33, 38)},
    **{f"MPEG-4 (XVID) q {q}": ("avi", "-c:v", "libxvid", "-q:v", str(q)) for q in (3, 6, 12, 20, 31)},
}
EVERY = 3  # frames whose corners are compared
EXPOSURE_S = 0.004


def film(camera: CameraModel, fps: float, brief: bool) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Pictures (h, w) of a waved board, and where its corners are seen in each (54, 2)."""
    board, filming = (
        print_of(HAND_BOARD),
        FilmingCamera(camera, 0, Optics(Sensor(3.0, 0.005, 1), exposure_s=EXPOSURE_S)),
    )
    waved = wave(camera, board, 1, brief)
    times = (np.arange(round(waved.duration_s * fps)) + 0.5) / fps
    pictures, corners = [], []
    for number, t in enumerate(times):
        T = waved.path(t)
        pictures.append(filming.take(number, board, waved.path, t, hands(board, T)))
        corners.append(camera.project(HAND_BOARD.corners_board @ T[:3, :3].T + T[:3, 3]))
    return pictures, corners


def clips(
    pictures: Sequence[np.ndarray], fps: float, folder: Path, ffmpeg: str, quick: bool
) -> Iterator[tuple[str, Path]]:
    """Write the film in every codec, one at a time."""
    size = pictures[0].shape[::-1]
    yield "lossless (FFV1)", _written(folder / "lossless.mkv", cv2.CAP_FFMPEG, "FFV1", fps, size, pictures)
    yield "MPEG-4, as OpenCV writes it", _written(folder / "mpeg4.mp4", cv2.CAP_FFMPEG, "mp4v", fps, size, pictures)
    for quality in MJPEG_QUALITIES[:: 3 if quick else 1]:
        path = folder / f"mjpeg{quality}.avi"
        yield f"MJPEG quality {quality}", _written(path, cv2.CAP_OPENCV_MJPEG, "MJPG", fps, size, pictures, quality)
    for name, (suffix, *options) in WITH_FFMPEG.items() if ffmpeg else ():
        path = folder / f"clip.{suffix}"
        source = ["-i", str(folder / "lossless.mkv"), "-pix_fmt", "yuv420p"]
        subprocess.run([ffmpeg, "-loglevel", "error", "-y", *source, *options, str(path)], check=True)
        yield name, path


def _written(
    path: Path,
    backend: int,
    codec: str,
    fps: float,
    size: tuple[int, ...],
    pictures: Sequence[np.ndarray],
    quality: float | None = None,
) -> Path:
    writer = cv2.VideoWriter(str(path), backend, cv2.VideoWriter.fourcc(*codec), fps, (size[0], size[1]))
    if quality is not None:
        writer.set(cv2.VIDEOWRITER_PROP_QUALITY, quality)
    for picture in pictures:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def corner_errors(footage: CameraFootage, corners: Sequence[np.ndarray]) -> tuple[np.ndarray, int, int]:
    """(n, 2) px of all corners found, in how many pictures, of how many that show the board whole."""
    errors, found, whole = [np.empty((0, 2))], 0, 0
    for number, image in footage:
        truth = corners[number]
        if number % EVERY or not ((truth > 8) & (truth < np.array(image.shape[::-1]) - 9)).all():
            continue
        whole += 1
        detection = find_board(image, HAND_BOARD)
        if detection is not None:
            found += 1
            either = detection.pixels - truth[detection.ids], detection.pixels - truth[::-1][detection.ids]
            errors.append(min(either, key=lambda e: float(np.square(e).sum())))
    return np.concatenate(errors), found, whole


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__, quick="half the places of the board, two qualities of MJPEG")
    given.add_argument("--ffmpeg", default="", help="a program with libx264 and libxvid")
    given.add_argument("--rate", type=float, default=25.0, help="frames a second")
    options = given.parse_args()
    camera = ring(1, False).cameras[0]
    pictures, corners = film(camera, options.rate, options.quick)
    table = Table(
        "clip:<28 | kbit/s:>7.0f | found:>6d | of:>4d | corner sd px:>12.3f | views:>5d | rms px:>6.3f | "
        "focal %:>7.3f | sd %:>6.3f | centre px:>9.2f | verdict:<7",
        f"a board's film, {len(pictures)} pictures",
    )
    figures = {}
    with tempfile.TemporaryDirectory(prefix="sagoma_films_") as folder:
        for name, path in clips(pictures, options.rate, Path(folder), options.ffmpeg, options.quick):
            footage = CameraFootage("cam01", (path,))
            errors, found, whole = corner_errors(footage, corners)
            watcher = watch_footage(footage, HAND_BOARD, "plumb_bob")
            result = calibrate_intrinsics(watcher.collector.best(), HAND_BOARD, name="cam01", model="auto")
            K, truth = result.camera.K, camera.K
            focal = 100 * float(np.abs(K.diagonal()[:2] / truth.diagonal()[:2] - 1).max())
            table.row(
                name,
                path.stat().st_size * 8e-3 / (len(pictures) / options.rate),
                found,
                whole,
                float(np.sqrt(np.square(errors).mean())) if len(errors) else np.nan,
                len(result.views),
                result.rms_px,
                focal,
                100 * result.sd["fx"] / truth[0, 0],
                float(np.hypot(*(K[:2, 2] - truth[:2, 2]))),
                result.verdict.grade,
            )
            figures[name] = round(focal, 4)
    finish({"focal_percent": figures})


if __name__ == "__main__":
    execute(main)
