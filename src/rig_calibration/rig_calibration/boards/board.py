"""The calibration boards, plain checkerboards and ChArUco boards, and detections of a target in one image.

Board frame: seen from in front, x to the right along the rows of the print, y up, z out of the print towards the
viewer (so z is up when the board lies on the floor); origin at the first corner, the upper left one; metres.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.yaml_file import read_mapping


@dataclass(frozen=True)
class Checkerboard:
    """A checkerboard of ``columns`` x ``rows`` inner corners; ``field_m`` is (width, height) of one field.

    Fields need not be square: a floor board may be made of sheets of paper.
    """

    columns: int
    rows: int
    field_m: tuple[float, float]

    @property
    def corners_board(self) -> Array:
        """(columns * rows, 3) inner corners in reading order, board frame."""
        return _grid(self.columns, self.rows, self.field_m)

    @property
    def half_turn_is_visible(self) -> bool:
        """Whether the board looks different after half a turn: when one of its numbers is odd and the
        other even: the colours of opposite outer fields differ then."""
        return (self.columns + self.rows) % 2 == 1


@dataclass(frozen=True)
class CharucoBoard:
    """A ChArUco board (Garrido-Jurado et al. 2014; OpenCV's aruco module) of ``columns`` x ``rows`` fields.

    ``square_m`` and ``marker_m`` are the sides of a field and of a marker; ``dictionary`` is OpenCV's name, as
    "DICT_5X5_100"; ``legacy`` boards (OpenCV before 4.6) begin with a white field where the number of rows is even.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False

    @property
    def corners_board(self) -> Array:
        """((columns - 1) * (rows - 1), 3) inner corners in reading order, board frame."""
        return _grid(self.columns - 1, self.rows - 1, (self.square_m, self.square_m))

    @property
    def half_turn_is_visible(self) -> bool:
        """Whether a half turn shows: always, by its markers."""
        return True

    @property
    def starts_black(self) -> bool:
        """Whether the upper left field is black."""
        return not (self.legacy and self.rows % 2 == 0)


Board: TypeAlias = Checkerboard | CharucoBoard


def _grid(columns: int, rows: int, field_m: tuple[float, float]) -> Array:
    row, column = np.mgrid[:rows, :columns].reshape(2, -1)
    return np.column_stack([column * field_m[0], -row * field_m[1], np.zeros(columns * rows)])


@dataclass(frozen=True, eq=False)
class TargetDetection:
    """Corners of a target found in one image of one camera.

    camera : the camera's name. frame : its number (in the same frame of several cameras a target is in the same place).
    target : name of the target, "" when there is only one. ids (n,) : rows of the target's ``corners_board``. pixels
    (n, 2) : in the raw (distorted) image; pixel centres at whole numbers. image_size : (width, height), px. sigma_px :
    standard deviation of a corner's coordinate, as far as it is known. blur_px : that of the blur across the board's
    edges, 0 where it was not measured.
    """

    camera: str
    frame_index: int
    ids: npt.NDArray[np.int64]
    pixels: Array
    image_size: tuple[int, int]
    target: str = ""
    sigma_px: float = 0.2
    blur_px: float = 0.0

    def __len__(self) -> int:
        return len(self.ids)


def opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's board, whose corner ids are ours."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    theirs = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
    theirs.setLegacyPattern(board.legacy)
    return theirs


# --- What a board is, read from a YAML file, or from a line of text such as "checkerboard 9x6 25mm".


METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
MIN_CORNERS, MAX_CORNERS = 3, 60
MIN_FIELD_M, MAX_FIELD_M = 1e-3, 3.0
KEYS = {
    "checkerboard": ({"columns", "rows", "field_m"}, set[str]()),
    "charuco": ({"columns", "rows", "square_m", "marker_m", "dictionary"}, {"legacy"}),
}
EXAMPLES = (
    'Give a YAML file, or text such as "checkerboard 9x6 25mm" (inner corners, side of a field), '
    '"checkerboard 4x3 297x210mm", or "charuco 11x8 30mm 22mm DICT_5X5_100" (fields, side of a field, of a marker).'
)

LEGACY = "Prints of OpenCV before 4.6 with an even number of rows are legacy."
_SIZE = r"(?P<columns>\d+)\s*[x×]\s*(?P<rows>\d+)"
_NUMBER, _UNIT = r"\d+(?:\.\d+)?", r"\s*(mm|cm|m|in)"
_CHECKERBOARD = rf"(?:checker|chess)board\s+{_SIZE}\s+({_NUMBER})(?:\s*[x×]\s*({_NUMBER}))?{_UNIT}"
_CHARUCO = rf"charuco\s+{_SIZE}\s+({_NUMBER}){_UNIT}\s+({_NUMBER}){_UNIT}\s+(DICT_\w+)(\s+legacy)?"


def read_board(text: str) -> Board:
    """Read the board that ``text`` names (a YAML file) or describes; InputError otherwise.

    YAML keys: type (checkerboard: columns, rows of inner corners, field_m: side or [width, height]; charuco: columns,
    rows of fields, square_m, marker_m, dictionary, legacy).
    """
    text = str(text).strip()
    if text.lower().endswith((".yaml", ".yml")):
        return _board(read_mapping(Path(text), EXAMPLES), text)
    mapping: dict[str, Any]
    if match := re.fullmatch(_CHECKERBOARD, text, re.I):
        _, _, width, height, unit = match.groups()
        mapping = {"type": "checkerboard", "field_m": [_metres(width, unit), _metres(height or width, unit)]}
    elif match := re.fullmatch(_CHARUCO, text, re.I):
        _, _, square, square_unit, marker, marker_unit, dictionary, legacy = match.groups()
        mapping = {"type": "charuco", "dictionary": dictionary.upper(), "legacy": bool(legacy)}
        mapping |= {"square_m": _metres(square, square_unit), "marker_m": _metres(marker, marker_unit)}
    else:
        raise InputError("describes no board", where=f'board "{text}"', remedy=EXAMPLES)
    counts = {key: int(match[key]) for key in ("columns", "rows")}
    return _board(mapping | counts, f'board "{text}"')


def board_text(board: Board) -> str:
    """Describe the board in one line that :func:`read_board` reads back as the same board."""
    if isinstance(board, CharucoBoard):
        tail = " legacy" if board.legacy else ""
        sizes = f"{_mm(board.square_m)}mm {_mm(board.marker_m)}mm"
        return f"charuco {board.columns}x{board.rows} {sizes} {board.dictionary}{tail}"
    width, height = board.field_m
    field = _mm(width) if width == height else f"{_mm(width)}x{_mm(height)}"
    return f"checkerboard {board.columns}x{board.rows} {field}mm"


def _mm(metres: float) -> str:
    return f"{round(metres * 1e3, 6):.10g}"


def _metres(number: str, unit: str) -> float:
    return round(float(number) * METRES[unit.lower()], 9)


def _board(mapping: Mapping[str, Any], where: str) -> Board:
    kind = mapping.get("type")
    if not isinstance(kind, str) or kind not in KEYS:
        remedy = f"Give one of {', '.join(KEYS)}."
        raise InputError(f"type = {kind!r} is not a type of board", where=where, remedy=remedy)
    mapping = {"field_m" if key == "square_m" and kind == "checkerboard" else key: mapping[key] for key in mapping}
    needed, optional = KEYS[kind]
    if missing := sorted(needed - set(mapping)):
        raise InputError(f"key '{missing[0]}' is missing", where=where, remedy=EXAMPLES)
    if unknown := sorted(map(str, set(mapping) - needed - optional - {"type"})):
        remedy = f"Known keys: {', '.join(sorted(needed | optional))}."
        raise InputError(f"key '{unknown[0]}' is not known for a {kind}", where=where, remedy=remedy)
    counts, lengths = (MIN_CORNERS, MAX_CORNERS, int), (MIN_FIELD_M, MAX_FIELD_M, int | float)
    columns, rows = (_number(mapping[key], key, where, *counts) for key in ("columns", "rows"))
    if kind == "checkerboard":
        field = mapping["field_m"]
        sides = field if isinstance(field, list | tuple) and len(field) == 2 else [field] * 2
        width, height = (float(_number(side, "field_m", where, *lengths)) for side in sides)
        if columns == rows and columns % 2 == 0:
            what = f"a checkerboard of {columns} x {rows} inner corners looks the same from all four sides"
            remedy = f"Use one with an odd and an even number, or cover a row of fields: {columns} x {rows - 1}."
            raise InputError(what, where=where, remedy=remedy)
        return Checkerboard(columns, rows, (width, height))
    square, marker = (float(_number(mapping[key], key, where, *lengths)) for key in ("square_m", "marker_m"))
    legacy, name, markers = mapping.get("legacy", False), mapping["dictionary"], columns * rows // 2
    known = sorted(key for key in dir(cv2.aruco) if re.fullmatch(r"DICT_(\dX\d_\d+|ARUCO_\w+|APRILTAG_\w+)", key))
    if name not in known:
        remedy = f"Known are {', '.join(known)}."
        raise InputError(f"dictionary = {name!r} is not one of OpenCV's", where=where, remedy=remedy)
    size = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList)
    for wrong, what, remedy in (
        (marker >= square, f"marker_m = {marker:g} is not smaller than square_m = {square:g}", "Give the field first."),
        (not isinstance(legacy, bool), f"legacy = {legacy!r} is neither true nor false", LEGACY),
        (markers > size, f"the board has {markers} markers, but {name} only {size}", "Use a larger dictionary."),
    ):
        if wrong:
            raise InputError(what, where=where, remedy=remedy)
    return CharucoBoard(columns, rows, square, marker, name, legacy)


def _number(value: Any, key: str, where: str, low: float, high: float, kind: Any) -> Any:
    """Return a number of corners or fields, or a length; InputError for anything else."""
    if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high:
        wanted, remedy = "length in metres", "Lengths in files are in metres: 25 mm is 0.025, oblong [0.297, 0.21]."
        if kind is int:
            wanted, remedy = "whole number", "Count them on the board."
        raise InputError(f"{key} = {value!r} is not a {wanted} from {low:g} to {high:g}", where=where, remedy=remedy)
    return value
