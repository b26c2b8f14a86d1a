"""Clicking outer corners: the file, the clicks, and the window on a figure that nobody sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_room import corner_pixels, on_floor, outer_pixels, picture, three_cameras
from matplotlib.backend_bases import KeyEvent, MouseButton, MouseEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard, TargetDetection
from sagoma_tools.calibration.clicking import ClickWindow, OuterCorners, find_from_clicks, read_corners, save_corners

BOARD = Checkerboard(7, 4, (0.12, 0.12))
CAMERA = three_cameras()["cam01"]
LYING = on_floor(BOARD, 0.4)
OUTER = outer_pixels(CAMERA, BOARD, LYING, 7)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return picture(CAMERA, BOARD, LYING)


def fit_to(image: np.ndarray):
    return lambda outer: find_from_clicks(image, BOARD, outer, model=CAMERA, frame_index=0, target="floor")


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 3, 0, 1), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_corners_clicked_in_any_order_are_numbered_by_the_boards_colours(
    image: np.ndarray, order: tuple[int, ...]
) -> None:
    detection = fit_to(image)(OUTER[list(order)] + [2.0, -1.5])
    expected = corner_pixels(CAMERA, BOARD, LYING)[detection.ids]
    assert len(detection) > 20 and np.abs(detection.pixels - expected).max() < 0.5


def test_corners_file_is_read_back_as_it_was_saved(tmp_path: Path) -> None:
    given = {"cam01": OuterCorners(OUTER), "cam02": OuterCorners(OUTER + 1, frame=7)}
    save_corners(tmp_path / "corners.yaml", given)
    read = read_corners(tmp_path / "corners.yaml")
    assert read["cam02"].frame == 7 and read["cam01"].frame is None
    assert read["cam01"].pixels == pytest.approx(OUTER, abs=0.06)


@pytest.mark.parametrize(
    "text, words",
    [
        ("cam01: [[1, 2], [3, 4], [5, 6]]", "is not four"),
        ("cam01: [[1, 2], [3, 4], [5, 6], [7, left]]", "is not four"),
        ("cam01: {corners: [[1, 2], [3, 4], [5, 6], [7, 8]], frame: -1}", "frame = -1"),
        ("cam01: {pixels: [[1, 2], [3, 4], [5, 6], [7, 8]]}", "has the keys"),
    ],
)
def test_corners_file_that_cannot_be_used_is_refused_naming_the_camera(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "corners.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"corners.yaml: cam01: .*{words}"):
        read_corners(path)


def window_on(image: np.ndarray, fit=None) -> tuple[Figure, ClickWindow]:
    figure = Figure(figsize=(8, 6))
    FigureCanvasAgg(figure)
    window = ClickWindow(figure, "cam01", image, fit or fit_to(image))
    figure.canvas.draw()
    return figure, window


def press(figure: Figure, pixel: np.ndarray, button: MouseButton = MouseButton.LEFT) -> None:
    x, y = figure.axes[0].transData.transform(pixel)
    figure.canvas.callbacks.process("button_press_event", MouseEvent("button_press_event", figure.canvas, x, y, button))


def key(figure: Figure, name: str) -> None:
    figure.canvas.callbacks.process("key_press_event", KeyEvent("key_press_event", figure.canvas, name))


def test_window_accepts_four_clicks_and_enter(image: np.ndarray) -> None:
    figure, window = window_on(image)
    for pixel in OUTER:
        press(figure, pixel)
    assert window.detection is not None and not window.accepted
    key(figure, "enter")
    assert window.accepted
    assert window.pixels == pytest.approx(OUTER, abs=1.0)


def test_window_ignores_the_right_button_and_enter_before_four_clicks(image: np.ndarray) -> None:
    figure, window = window_on(image)
    press(figure, OUTER[0], MouseButton.RIGHT)
    press(figure, OUTER[0])
    key(figure, "enter")
    assert len(window.points) == 1 and not window.accepted
    key(figure, "u")
    assert window.points == []


def test_four_clicks_that_show_no_board_are_dropped_with_the_reason(image: np.ndarray) -> None:
    def refuse(outer: np.ndarray) -> TargetDetection:
        raise InputError("no field's corner is there")

    figure, window = window_on(image, refuse)
    for pixel in OUTER:
        press(figure, pixel)
    assert window.points == [] and window.detection is None
    assert window.message.startswith("no field's corner is there. Click again")


def test_undo_takes_one_click_back(image: np.ndarray) -> None:
    figure, window = window_on(image)
    for pixel in OUTER:
        press(figure, pixel)
    key(figure, "u")
    assert len(window.points) == 3 and window.detection is None
    assert "the first one of the last row" in window.message
