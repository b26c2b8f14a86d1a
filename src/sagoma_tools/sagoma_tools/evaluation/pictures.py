"""Pictures of a track: the skeleton over footage and silhouettes, angles and point errors over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import matplotlib
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.session import Session
from capture_rig.truth import Truth

matplotlib.use("Agg")
from matplotlib import pyplot as plt

# (start, end) reference points of each drawn line: spine, head, shoulders, hips, arms, legs
BONES = (
    (2, 0),
    (2, 1),
    (3, 4),
    (5, 6),
    (0, 5),
    (0, 6),
    (3, 7),
    (7, 11),
    (4, 8),
    (8, 12),
    (5, 9),
    (9, 13),
    (6, 10),
    (10, 14),
)
LEFT, RIGHT = {3, 5, 7, 9, 11, 13}, {4, 6, 8, 10, 12, 14}
LEFT_BGR, RIGHT_BGR, MIDDLE_BGR, TRUTH_BGR = (255, 160, 40), (60, 90, 255), (60, 230, 60), (255, 255, 255)
SILHOUETTE_TINT_BGR = np.array([60.0, 190.0, 60.0])


def read_frames(video: Path, wanted: Sequence[int]) -> Iterator[np.ndarray]:
    """The wanted frames (ascending, 0-based) of a video, BGR."""
    capture = cv2.VideoCapture(str(video))
    try:
        position = 0
        for frame in wanted:
            while position < frame and capture.grab():
                position += 1
            ok, image = capture.read()
            if not ok:
                raise EOFError(f"{video} has no frame {frame}")
            position += 1
            yield image
    finally:
        capture.release()


def draw_skeleton(
    image: np.ndarray, camera: CameraModel, points_world: np.ndarray, colour: tuple | None = None
) -> None:
    """Draw the 15 points (15, 3) into a (distorted) BGR image: left limbs blue, right limbs red, or one ``colour``."""
    pixels = camera.project(points_world)
    thick = max(1, round(camera.height / 240))
    for a, b in BONES:
        if np.isfinite(pixels[[a, b]]).all():
            cv2.line(image, _rounded(pixels[a]), _rounded(pixels[b]), colour or _side_colour(a, b),
                     1 if colour else thick, cv2.LINE_AA)  # fmt: skip
    for pixel in pixels[np.isfinite(pixels).all(1)]:
        cv2.circle(image, _rounded(pixel), thick + 1, colour or (255, 255, 255), -1, cv2.LINE_AA)


def _rounded(pixel: np.ndarray) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _side_colour(a: int, b: int) -> tuple[int, int, int]:
    left, right = {a, b} & LEFT, {a, b} & RIGHT
    return MIDDLE_BGR if bool(left) == bool(right) else LEFT_BGR if left else RIGHT_BGR


def tint(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image, its silhouette (H, W) tinted green and its outline drawn, the rest darkened."""
    inside = mask > 0
    out = image * np.float32(0.55)
    out[inside] = 0.6 * image[inside] + 0.4 * SILHOUETTE_TINT_BGR
    out = out.astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(out, contours, -1, (0, 255, 255), 1)


def overlay(
    camera: CameraModel,
    image: np.ndarray,
    mask: np.ndarray | None,
    points_world: np.ndarray,
    truth_world: np.ndarray | None,
) -> np.ndarray:
    """One camera's picture: footage, silhouette (in the image's own pixels), truth in white, skeleton in colour."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if mask is not None:
        picture = tint(picture, mask)
    if truth_world is not None:
        draw_skeleton(picture, camera, truth_world, TRUTH_BGR)
    draw_skeleton(picture, camera, points_world)
    cv2.putText(picture, camera.name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 2, cv2.LINE_AA)
    return picture


def montage(pictures: Sequence[np.ndarray], columns: int, max_width: int = 1800) -> np.ndarray:
    """Pictures of possibly different sizes side by side, ``columns`` a row, scaled to one height."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    cells = [
        cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_CONSTANT) for p in pictures
    ]
    cells += [np.zeros((height, width, 3), np.uint8)] * (-len(cells) % columns)
    sheet = np.vstack([np.hstack(cells[row : row + columns]) for row in range(0, len(cells), columns)])
    scale = min(1.0, max_width / sheet.shape[1])
    return cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def session_overlay(
    session: Session, frames: Sequence[int], points_world: np.ndarray, masks: dict[str, list[np.ndarray]] | None = None
) -> np.ndarray:
    """Rows of frames, columns of cameras: the track (len(frames), 15, 3) over the session's footage.

    masks : silhouettes of each camera at those frames, in image pixels.
    """
    truth = truth_at(session.truth, frames)
    rows: list[list[np.ndarray]] = [[] for _ in frames]
    for camera in session.rig.cameras:
        for index, image in enumerate(read_frames(session.videos[camera.name], frames)):
            mask = masks[camera.name][index] if masks else None
            rows[index].append(overlay(camera, image, mask, points_world[index], truth[index]))
    return montage([picture for row in rows for picture in row], columns=len(session.rig.cameras))


def truth_at(truth: Truth | None, frames: Sequence[int]) -> list[np.ndarray | None]:
    """The truth's points (15, 3) of each frame; None where it has none."""
    if truth is None:
        return [None] * len(frames)
    row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
    return [truth.points_world[row_of[f]] if f in row_of else None for f in frames]


def plot_angles(
    path: Path, names: Sequence[str], seconds: np.ndarray, angles: np.ndarray,
    truth_seconds: np.ndarray | None = None, truth_angles: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Angles (F, 18) rad over time against the truth, one panel each, in degrees (like thesis fig. 7.4 to 7.7)."""
    figure, axes = plt.subplots(6, 3, figsize=(13, 13), sharex=True, constrained_layout=True)
    for index, (axis, name) in enumerate(zip(axes.flat, names, strict=True)):
        if truth_angles is not None and truth_seconds is not None:
            axis.plot(
                truth_seconds, np.rad2deg(unwrapped(truth_angles[:, index])), color="0.7", linewidth=3, label="truth"
            )
        axis.plot(seconds, np.rad2deg(unwrapped(angles[:, index])), color="C0", linewidth=1.1, label="estimate")
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.grid(alpha=0.3)
    axes.flat[0].legend(fontsize=8)
    figure.supxlabel("time [s]")
    figure.supylabel("angle [deg]")
    figure.savefig(path, dpi=100)
    plt.close(figure)


def plot_point_errors(path: Path, names: Sequence[str], seconds: np.ndarray, errors_mm: np.ndarray) -> None:
    """Error (F, 15) in mm of each reference point over time (like thesis fig. 7.9 to 7.13)."""
    figure, axes = plt.subplots(5, 3, figsize=(13, 11), sharex=True, sharey=True, constrained_layout=True)
    for axis, name, error in zip(axes.flat, names, errors_mm.T, strict=True):
        axis.plot(seconds, error, linewidth=1)
        axis.set_title(f"{name.replace('_', ' ')}: mean {np.nanmean(error):.0f} mm", fontsize=9)
        axis.grid(alpha=0.3)
    figure.supxlabel("time [s]")
    figure.supylabel("error [mm]")
    figure.savefig(path, dpi=100)
    plt.close(figure)


def unwrapped(angles: np.ndarray) -> np.ndarray:
    """Angles (F,) rad without jumps of 2 pi, for plotting; NaN gaps stay gaps."""
    known = np.isfinite(angles)
    out = np.full(len(angles), np.nan)
    out[known] = np.unwrap(angles[known])
    return out
