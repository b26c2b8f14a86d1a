"""Calibrates lenses from footage of a board: collects views, solves, saves NAME.yaml, report and picture, prints."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from capture_rig.camera_info_file import save_camera_info
from capture_rig.errors import InputError
from capture_rig.files import make_folder
from capture_rig.yaml_file import save_mapping
from rig_calibration.boards.board import Board, board_text
from rig_calibration.boards.detector import diagnose_board
from rig_calibration.intrinsics.calibrate import AUTO, MIN_VIEWS, calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics, report_of
from rig_calibration.intrinsics.selection import ViewCollector

from ..console import GRADE_STYLE, doing, until_stopped
from .footage import CameraFootage, open_footage_of_cameras

MAX_EXAMINED = 400  # frames of a video in the first pass
MAX_THOROUGH = 100  # ... in the second, if the first found too few views
FEW_VIEWS = 12
FEW_PICTURES = 60  # up to this many stills were chosen by hand: all are used
DIAGNOSED = 4  # images that are searched for another board
PICTURE_DPI = 100


def calibrate_footage(
    sources: Sequence[str], board: Board, model: str, output: Path, console: Console
) -> tuple[list[Intrinsics], list[InputError]]:
    """Calibrate each camera of ``sources`` and save it into ``output``; results, and why the other cameras failed.

    Raises InputError when every camera fails.
    """
    results: list[Intrinsics] = []
    failures: list[InputError] = []
    for footage in open_footage_of_cameras(sources).values():
        try:
            views = _collected(footage, board, "plumb_bob" if model == AUTO else model)
            until_stopped()
            seen = f"{views.examined} images, board found in {views.found}, {len(views)} views kept"
            console.print(f"{footage.name}: {seen}")
            result = calibrate_intrinsics(views.detections, board, name=footage.name, model=model)
            save_results(output, result, board, ", ".join(sources))
            results.append(result)
        except InputError as error:
            failures.append(error)
    if not results:
        for failure in failures[:-1]:
            print(f"sagoma: {failure}", file=sys.stderr)
        raise failures[-1]
    console.print(f"results in {output}")
    return results, failures


def _collected(footage: CameraFootage, board: Board, model: str) -> ViewCollector:
    """Search the footage's images for ``board``, evenly chosen from a long video, until the views suffice.

    Where few views are found, a second pass searches each image longer. Raises InputError when too few images show
    the board, naming the other board that they show, if they do.
    """
    count, done = len(footage), doing(f"{footage.name}: looking for the board in images")
    few = not footage.is_video and count <= FEW_PICTURES
    views = ViewCollector(board, footage.name, model=model, every=few, thorough=few)
    for examined in (MAX_EXAMINED,) if few else (MAX_EXAMINED, MAX_THOROUGH):
        for frame_index, image in islice(footage, 0, None, max(1, count // examined)):
            views.process(image, frame_index)
            done(views.examined)
            if footage.is_video and views.enough:
                return views
        if len(views) >= FEW_VIEWS:
            break
        views.thorough = True
    if len(views) < MIN_VIEWS:
        some = (image for _, image in islice(footage, 0, None, max(1, count // DIAGNOSED)))
        other = next((text for text in (diagnose_board(image, board) for image in some) if text), "")
        counted = ", ".join(f"{count} {reason}" for reason, count in views.reasons.most_common())
        raise InputError(
            f"{len(views)} of {views.examined} images show the board usably ({counted})"
            + (f"; {other}" if other else ""),
            where=footage.name,
            remedy="Name the board that was filmed; film it sharp, well lit and whole, 20 or more views.",
        )
    return views


def save_results(folder: Path, result: Intrinsics, board: Board, source: str) -> list[Path]:
    """Write NAME.yaml (camera_info), NAME.report.yaml and NAME.png into ``folder``."""
    name = result.camera.name
    info, report, picture = (folder / f"{name}{suffix}" for suffix in (".yaml", ".report.yaml", ".png"))
    from rig_calibration.intrinsics.picture import draw  # matplotlib takes a second to load

    make_folder(folder)
    save_camera_info(info, result.camera)
    about = {"source": source, "board": board_text(board), "date": time.strftime("%Y-%m-%dT%H:%M:%S%z")}
    about |= {"opencv": cv2.__version__, "numpy": np.__version__}
    save_mapping(report, report_of(result, about), width=120)
    draw(result).savefig(picture, dpi=PICTURE_DPI)
    return [info, report, picture]


def print_results(console: Console, results: Sequence[Intrinsics]) -> None:
    """Print a table of all cameras, then the findings of each with their remedies."""
    table = Table("camera", "views", "rms px", "fx px", "fy px", "cx px", "cy px", "verdict")
    for result in results:
        numbers = (f"{result.values[key]:.2f} ± {result.sd[key]:.2f}" for key in ("fx", "fy", "cx", "cy"))
        grade = f"[{GRADE_STYLE[result.verdict.grade]}]{result.verdict.grade}"
        table.add_row(result.camera.name, str(len(result.views)), f"{result.rms_px:.3f}", *numbers, grade)
    console.print(table)
    for result in results:
        for line in remarks(result):
            console.print(f"{result.camera.name}: {line}")


def remarks(result: Intrinsics) -> Iterable[str]:
    """Return findings, the choice of the lens model, and the numbers of images and corners left out."""
    yield from map(str, result.verdict.findings)
    if result.choice:
        yield f"lens model: {result.choice}"
    if result.left_out:
        yield f"left out {len(result.left_out)} images; see the report"


def figures(result: Intrinsics) -> dict[str, Any]:
    """Return the result as plain data for --json."""
    return {
        "camera": result.camera.name,
        "verdict": result.verdict.grade,
        "findings": [str(finding) for finding in result.verdict.findings],
        "views": len(result.views),
        "rms_px": round(result.rms_px, 4),
        "model": result.camera.distortion_model,
        "values": {name: round(float(value), 6) for name, value in result.values.items()},
        "sd": {name: round(sd, 6) for name, sd in result.sd.items()},
    }
