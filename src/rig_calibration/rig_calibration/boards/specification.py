"""Reads what a board is: from a YAML file, or from a line of text such as "checkerboard 9x6 25mm"."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2

from capture_rig.errors import InputError
from capture_rig.yaml_file import read_mapping

from .board import Board, CharucoBoard, Checkerboard

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
MIN_CORNERS, MAX_CORNERS = 3, 60
MIN_FIELD_M, MAX_FIELD_M = 1e-3, 3.0
KEYS = {
    "checkerboard": ({"columns", "rows"}, {"field_m", "square_m"}),
    "charuco": ({"columns", "rows", "square_m", "marker_m", "dictionary"}, {"legacy"}),
}
EXAMPLES = (
    'Give a YAML file, or text such as "checkerboard 9x6 25mm" (inner corners, side of a field), '
    '"checkerboard 4x3 297x210mm", or "charuco 11x8 30mm 22mm DICT_5X5_100" (fields, side of a field, of a marker).'
)

_SIZE = r"(\d+)\s*[x×]\s*(\d+)"
_NUMBER = r"(\d+(?:\.\d+)?)"
_UNIT = r"\s*(mm|cm|m|in)"
_CHECKERBOARD = re.compile(rf"(?:checker|chess)board\s+{_SIZE}\s+{_NUMBER}(?:\s*[x×]\s*{_NUMBER})?{_UNIT}", re.I)
_CHARUCO = re.compile(rf"charuco\s+{_SIZE}\s+{_NUMBER}{_UNIT}\s+{_NUMBER}{_UNIT}\s+(DICT_\w+)(\s+legacy)?", re.I)


def read_board(text: str) -> Board:
    """Read the board that ``text`` names (a YAML file) or describes; InputError otherwise.

    YAML keys: type (checkerboard: columns, rows of inner corners, field_m: side or [width, height]; charuco: columns,
    rows of fields, square_m, marker_m, dictionary, legacy).
    """
    text = str(text).strip()
    if text.lower().endswith((".yaml", ".yml")):
        path = Path(text)
        return _from_mapping(read_mapping(path, EXAMPLES), text)
    if match := _CHECKERBOARD.fullmatch(text):
        columns, rows, width, height, unit = match.groups()
        scale = METRES[unit.lower()]
        sides = [_metres(width, scale), _metres(height or width, scale)]
        return _checkerboard({"columns": int(columns), "rows": int(rows), "field_m": sides}, f'board "{text}"')
    if match := _CHARUCO.fullmatch(text):
        columns, rows, square, square_unit, marker, marker_unit, dictionary, legacy = match.groups()
        mapping = {
            "columns": int(columns),
            "rows": int(rows),
            "square_m": _metres(square, METRES[square_unit.lower()]),
            "marker_m": _metres(marker, METRES[marker_unit.lower()]),
            "dictionary": dictionary.upper(),
            "legacy": bool(legacy),
        }
        return _charuco(mapping, f'board "{text}"')
    raise InputError("describes no board", where=f'board "{text}"', remedy=EXAMPLES)


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


def _metres(number: str, scale: float) -> float:
    return round(float(number) * scale, 9)


def _from_mapping(mapping: Mapping[str, Any], where: str) -> Board:
    kind = mapping.get("type")
    if not isinstance(kind, str) or kind not in KEYS:
        raise InputError(
            f"type = {kind!r} is not a type of board", where=where, remedy=f"Give one of {', '.join(KEYS)}."
        )
    needed, optional = KEYS[kind]
    given = set(mapping) - {"type"}
    if missing := sorted(needed - given):
        raise InputError(f"key '{missing[0]}' is missing", where=where, remedy=EXAMPLES)
    if unknown := sorted(map(str, given - needed - optional)):
        raise InputError(
            f"key '{unknown[0]}' is not known for a {kind}",
            where=where,
            remedy=f"Known keys: {', '.join(sorted(needed | optional))}.",
        )
    return _checkerboard(mapping, where) if kind == "checkerboard" else _charuco(mapping, where)


def _checkerboard(mapping: Mapping[str, Any], where: str) -> Checkerboard:
    columns, rows = (_count(mapping, key, where, "inner corners") for key in ("columns", "rows"))
    key = "field_m" if "field_m" in mapping else "square_m"
    if key not in mapping:
        raise InputError("key 'field_m' is missing", where=where, remedy="Give the side of a field in metres.")
    sides = mapping[key] if isinstance(mapping[key], list | tuple) else [mapping[key]] * 2
    if len(sides) != 2:
        raise InputError(
            f"{key} = {mapping[key]!r} is neither a side nor [width, height]",
            where=where,
            remedy="Give metres, such as 0.025 or [0.297, 0.21].",
        )
    width, height = (_length(side, key, where) for side in sides)
    if columns == rows and columns % 2 == 0:
        raise InputError(
            f"a checkerboard of {columns} x {rows} inner corners looks the same from all four sides",
            where=where,
            remedy=f"Use one with an odd and an even number, or cover a row of fields: {columns} x {rows - 1}.",
        )
    return Checkerboard(columns, rows, (width, height))


def _charuco(mapping: Mapping[str, Any], where: str) -> CharucoBoard:
    columns, rows = (_count(mapping, key, where, "fields") for key in ("columns", "rows"))
    square, marker = (_length(mapping[key], key, where) for key in ("square_m", "marker_m"))
    if marker >= square:
        raise InputError(
            f"marker_m = {marker:g} is not smaller than square_m = {square:g}",
            where=where,
            remedy="Give the side of a field first, then the side of a marker.",
        )
    legacy = mapping.get("legacy", False)
    if not isinstance(legacy, bool):
        raise InputError(
            f"legacy = {legacy!r} is neither true nor false",
            where=where,
            remedy="Prints of OpenCV before 4.6 with an even number of rows are legacy.",
        )
    dictionary = _dictionary(mapping["dictionary"], columns * rows // 2, where)
    return CharucoBoard(columns, rows, square, marker, dictionary, legacy)


def _dictionary(name: Any, markers: int, where: str) -> str:
    known = sorted(key for key in dir(cv2.aruco) if re.fullmatch(r"DICT_(\dX\d_\d+|ARUCO_\w+|APRILTAG_\w+)", key))
    if name not in known:
        raise InputError(
            f"dictionary = {name!r} is not one of OpenCV's", where=where, remedy=f"Known are {', '.join(known)}."
        )
    size = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList)
    if markers > size:
        raise InputError(
            f"the board has {markers} markers, but {name} only {size}",
            where=where,
            remedy="Use a larger dictionary, or fewer fields.",
        )
    return str(name)


def _count(mapping: Mapping[str, Any], key: str, where: str, of: str) -> int:
    value = mapping[key]
    if not isinstance(value, int) or isinstance(value, bool) or not MIN_CORNERS <= value <= MAX_CORNERS:
        raise InputError(
            f"{key} = {value!r} is not a number of {of} from {MIN_CORNERS} to {MAX_CORNERS}",
            where=where,
            remedy="Count them on the board.",
        )
    return value


def _length(value: Any, key: str, where: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not MIN_FIELD_M <= value <= MAX_FIELD_M:
        raise InputError(
            f"{key} = {value!r} is not a length of {MIN_FIELD_M:g} to {MAX_FIELD_M:g} m",
            where=where,
            remedy="Lengths in files are in metres: 25 mm is 0.025.",
        )
    return float(value)
