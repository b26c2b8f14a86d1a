"""How well, how far down, how fast boards are found in renders, noise of 2.5 grey levels (of bench/calibration.py)."""

from __future__ import annotations

import time

from report import Table

import cv2
import numpy as np
from rendered_boards import camera, looking_at_board, render, true_corners

from rig_calibration.boards.board import read_board
from rig_calibration.boards.detector import find_board

LENS = camera(D=(-0.2, 0.08, 0.001, -0.001, 0.0))
TURNS_DEG, ROLLS_DEG = (0, 20, 45, 80), (0, 4, -6, 10)


def accuracy(blurs: tuple[float, ...]) -> list[dict]:
    """Errors of the corners of a 9 x 6 board, fields of 25 px, by tilt and blur; OpenCV's for comparison."""
    board, rows = read_board("checkerboard 9x6 25mm"), []
    for tilt in (0, 40, 70):
        for blur in blurs:
            T = looking_at_board(board, 0.6, tilt, 7, 3)
            image, truth = render(LENS, board, T, blur=blur, noise=2.5, oversample=10), true_corners(LENS, board, T)
            detection = find_board(image, board, thorough=True)
            ours = detection.pixels - truth[detection.ids] if detection else np.full((1, 2), np.nan)
            bias = float(np.abs(ours.mean(0)).max())
            rows.append(
                {
                    "tilt_deg": tilt,
                    "blur_px": blur,
                    "rms_px": _rms(ours),
                    "bias_px": bias,
                    "sigma_px": detection.sigma_px if detection else np.nan,
                    **_opencv(image, truth),
                }
            )
    return rows


def _opencv(image: np.ndarray, truth: np.ndarray) -> dict:
    """RMS of findChessboardCornersSB and of findChessboardCorners with cornerSubPix; NaN where they find nothing."""
    found = {}
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    for name, (ok, corners) in {
        "sb_px": cv2.findChessboardCornersSB(image, (9, 6), flags=flags),
        "classic_px": cv2.findChessboardCorners(image, (9, 6)),
    }.items():
        if ok and name == "classic_px":
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
            corners = cv2.cornerSubPix(image, corners.reshape(-1, 1, 2), (4, 4), (-1, -1), stop)
        corners = np.reshape(corners, (-1, 2)) if ok else np.full_like(truth, np.nan)
        found[name] = min(_rms(corners - truth), _rms(corners[::-1] - truth)) if ok else float("nan")
    return found


def grazing(angles: tuple[int, ...], widths: tuple[int, ...]) -> list[dict]:
    """Of four ways the board may lie turned, how many are found, and their RMS error, by tilt and width of a field."""
    board, rows = read_board("checkerboard 9x6 100mm"), []
    for tilt in angles:
        for width in widths:
            errors, found = [], 0
            for k, (turn, roll) in enumerate(zip(TURNS_DEG, ROLLS_DEG, strict=True)):
                T = looking_at_board(board, 600 * 0.1 / width, tilt, roll, turn)
                image = render(LENS, board, T, blur=(0.5, 0.8)[k % 2], noise=2.5, seed=k, oversample=8)
                if (detection := find_board(image, board, thorough=True)) is not None:
                    found += 1
                    errors.append(_rms(detection.pixels - true_corners(LENS, board, T)[detection.ids]))
            size = f"{width} x {width * np.cos(np.deg2rad(tilt)):.1f}"
            rows.append(
                {"tilt_deg": tilt, "field_px": size, "found": found, "rms_px": max(errors, default=float("nan"))}
            )
    return rows


def speed() -> list[dict]:
    """Processor time of finding, and of not finding, a board."""
    board, rows = read_board("checkerboard 9x6 25mm"), []
    for width, height in ((640, 480), (1920, 1200)):
        eye = camera(width, height, focal=0.94 * width)
        image = render(eye, board, looking_at_board(board, 0.6, 30, 5), oversample=3)
        other = read_board("checkerboard 11x8 25mm")
        rows.append(
            {
                "image": f"{width} x {height}",
                "found_ms": _cpu_ms(image, board),
                "not_found_ms": _cpu_ms(image, other),
                "thorough_not_found_ms": _cpu_ms(image, other, thorough=True),
            }
        )
    return rows


def _cpu_ms(image: np.ndarray, board, thorough: bool = False) -> float:
    find_board(image, board)
    times = []
    for _ in range(3):
        start = time.process_time()
        find_board(image, board, thorough=thorough)
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def board_figures(quick: bool) -> dict[str, list[dict]]:
    """Print the tables; return them."""
    tables = {
        "accuracy": accuracy((1.0,) if quick else (0.5, 1.0, 2.0)),
        "grazing": grazing((80,) if quick else (60, 70, 75, 80, 82), (16,) if quick else (24, 16, 12, 8)),
        "speed": speed(),
    }
    for title, rows in tables.items():
        shown = {key: ">14.3f" if isinstance(value, float) else ">14" for key, value in rows[0].items()}
        table = Table(shown, title)
        for row in rows:
            table.row(*row.values())
    return tables
