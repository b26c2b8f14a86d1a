"""Views of a board out of one camera's footage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from capture_rig.camera_info_file import save_camera_info
from capture_rig.errors import InputError
from capture_rig.verdict import GOOD, REDO, USABLE
from rig_calibration.boards.board import Board
from rig_calibration.boards.specification import board_text
from rig_calibration.intrinsics.result import Intrinsics, report_of
from rig_calibration.intrinsics.selection import ENOUGH_VIEWS, BoardImageProcessor, ViewCollector
from rig_calibration.intrinsics.views import MIN_VIEWS

from .footage import CameraFootage

MOST_EXAMINED = 400  # frames of a video in which the board is looked for
FEW_PICTURES = 60  # so many stills were chosen by a person, each for a reason: all are used
MOST_THOROUGH = 100  # ... and once more, longer in each, where it is hardly found
DIAGNOSED = 4  # images that are looked at for another board

Progress = Callable[[BoardImageProcessor], None]  # called after every image that was examined


def watch_footage(
    footage: CameraFootage, board: Board, model: str, progress: Progress | None = None
) -> BoardImageProcessor:
    """Look for ``board`` in the footage's images, evenly chosen where there are very many; where it is hardly found,
    once more, longer in each image.

    Raises InputError when too few show it, naming the board that was there instead, if there was one.
    """
    count = footage.count
    few = not footage.is_video and count <= FEW_PICTURES
    watcher = BoardImageProcessor(board, footage.name, ViewCollector(board, model=model, every=few), thorough=few)
    missed: list[np.ndarray] = []
    _watch(watcher, footage, max(1, count // MOST_EXAMINED), missed, progress)
    if not few and len(watcher.collector) < ENOUGH_VIEWS:
        watcher.thorough = True
        _watch(watcher, footage, max(1, count // MOST_THOROUGH), [], progress)
    _require_views(watcher, missed)
    return watcher


def _watch(
    watcher: BoardImageProcessor,
    footage: CameraFootage,
    stride: int,
    missed: list[np.ndarray],
    progress: Progress | None,
) -> None:
    """Every ``stride``-th image, until it is enough; a few of those without the board into ``missed``."""
    before: np.ndarray | None = None
    for index, (frame_index, image) in enumerate(footage):
        if index % stride == 0:
            seen = watcher.see(image, before if footage.is_video else None, frame_index)
            if seen.detection is None:
                _remember(missed, image, watcher.examined - watcher.found)
            if progress is not None:
                progress(watcher)
            if footage.is_video and watcher.collector.enough:
                return
        before = image


def _remember(missed: list[np.ndarray], image: np.ndarray, count: int) -> None:
    """Keep a few images without the board, spread over the footage."""
    if len(missed) < DIAGNOSED:
        missed.append(image)
    elif count & (count - 1) == 0:  # powers of two
        missed[count.bit_length() % DIAGNOSED] = image


def _require_views(watcher: BoardImageProcessor, missed: list[np.ndarray]) -> None:
    if len(watcher.collector) >= MIN_VIEWS:
        return
    from rig_calibration.boards.detector import diagnose_board

    other = next((text for text in (diagnose_board(image, watcher.board) for image in missed) if text), "")
    counted = ", ".join(f"{count} {reason}" for reason, count in watcher.reasons.most_common())
    raise InputError(
        f"{len(watcher.collector)} of {watcher.examined} images show the board usably ({counted})"
        + (f"; {other}" if other else ""),
        where=watcher.camera,
        remedy="Name the board that was filmed; film it sharp, well lit and whole, 20 or more views.",
    )


# --- Saves and prints what the calibration of a camera came to.

COLOURS = {GOOD: "green", USABLE: "yellow", REDO: "red"}
PICTURE_DPI = 100


def save_results(folder: Path, result: Intrinsics, board: Board, source: str) -> list[Path]:
    """NAME.yaml (camera_info), NAME.report.yaml and NAME.png in ``folder``. Raises InputError when it cannot write."""
    name = result.camera.name
    info, report, picture = (folder / f"{name}{suffix}" for suffix in (".yaml", ".report.yaml", ".png"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        save_camera_info(info, result.camera)
        about = {"source": source, "board": board_text(board), **_versions()}
        report.write_text(yaml.safe_dump(report_of(result, about), sort_keys=False, width=120), encoding="utf-8")
        from rig_calibration.intrinsics.picture import draw  # matplotlib takes a second to load

        draw(result).savefig(picture, dpi=PICTURE_DPI)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})",
            where=str(folder),
            remedy="Name a folder that may be written (--output).",
        ) from None
    return [info, report, picture]


def print_results(console: Console, results: Sequence[Intrinsics]) -> None:
    """A table of all cameras, then each one's findings with their remedies."""
    table = Table("camera", "views", "rms px", "fx px", "fy px", "cx px", "cy px", "verdict")
    for result in results:
        numbers = (f"{result.values[key]:.2f} ± {result.sd[key]:.2f}" for key in ("fx", "fy", "cx", "cy"))
        grade = result.verdict.grade
        table.add_row(
            result.camera.name, str(len(result.views)), f"{result.rms_px:.3f}", *numbers, f"[{COLOURS[grade]}]{grade}"
        )
    console.print(table)
    for result in results:
        for line in remarks(result):
            console.print(f"{result.camera.name}: {line}", markup=False, highlight=False, soft_wrap=True)


def remarks(result: Intrinsics) -> Iterable[str]:
    """Findings, and what was left out."""
    yield from map(str, result.verdict.findings)
    if result.choice is not None:
        yield f"lens model {result.choice.model}: {result.choice.reason}"
    whole = [entry for entry in result.left_out if entry.whole]
    for entry in whole[:3]:
        yield f"left out image {entry.detection.frame_index}: {entry.reason}"
    if len(whole) > 3:
        yield f"left out {len(whole) - 3} more images; see the report"
    corners = sum(len(entry.corners) for entry in result.left_out)
    if corners:
        yield f"left out {corners} single corners; see the report"


def figures(result: Intrinsics) -> dict[str, Any]:
    """For --json."""
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


def _versions() -> dict[str, str]:
    return {"date": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "opencv": cv2.__version__, "numpy": np.__version__}
