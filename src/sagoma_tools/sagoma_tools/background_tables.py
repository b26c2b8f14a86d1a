"""Lessons of the background and saved backgrounds, as tables for people and as figures for programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table
from rich.text import Text

from camera_client.background_model import BackgroundModel, shape_text
from capture_rig.verdict import GOOD, REDO, USABLE

from .backgrounds import Lesson

STYLE = {GOOD: "green", USABLE: "yellow", REDO: "red"}
STATUS = {GOOD: 0, USABLE: 1, REDO: 2}  # exit status


def exit_status(lessons: Sequence[Lesson]) -> int:
    """0 when all are good, 1 when one is only usable, 2 when one has to be redone."""
    return max((STATUS[lesson.grade] for lesson in lessons), default=0)


def lessons_table(lessons: Sequence[Lesson]) -> Table:
    """One line a camera, and one more for each further finding."""
    table = Table(box=None, pad_edge=False)
    for title in ("camera", "verdict"):
        table.add_column(title, no_wrap=True)
    for title in ("frames", "noise", "moved %"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("why", ratio=1)
    table.add_column("what to do", ratio=1)
    for lesson in sorted(lessons, key=lambda lesson: lesson.camera):
        first, *others = _reasons(lesson)
        table.add_row(lesson.camera, Text(lesson.grade, STYLE[lesson.grade]), *_figures(lesson), *first)
        for other in others:
            table.add_row("", "", "", "", "", *other)
    return table


def _figures(lesson: Lesson) -> tuple[str, str, str]:
    report = lesson.report
    if report is None or not report.frames:
        return "", "", ""
    return str(report.frames), f"{report.noise:.2f}", f"{100 * report.moved:.2f}"


def _reasons(lesson: Lesson) -> list[tuple[str, str]]:
    """What was found and what to do, one a line; at least one."""
    report = lesson.report
    if report is None or (report.grade == REDO and not report.findings):
        return [(lesson.said, "see that its frames come (sagoma up, sagoma doctor), and run it again")]
    found = [(finding.what, finding.remedy) for finding in report.findings]
    if report.grade != REDO and not report.saved:
        found.append(("in use, but not saved", "set background_file in the camera's parameter file"))
    return found or [("", "")]


def figures(lessons: Sequence[Lesson]) -> dict[str, Any]:
    """The same, for programs."""
    return {
        lesson.camera: {"said": lesson.said, **(asdict(lesson.report) if lesson.report else {}), "grade": lesson.grade}
        for lesson in lessons
    }


def provenance_table(model: BackgroundModel, title: str) -> Table:
    """Where a saved background comes from."""
    table = Table("", "", title=title, title_justify="left", box=None, pad_edge=False, show_header=False)
    for key, value in asdict(model.provenance).items():
        if value != "":
            table.add_row(key, f"{value:.3f}" if isinstance(value, float) else str(value))
    table.add_row("image", shape_text(model.shape))
    table.add_row("moved", f"{100 * model.moving_share:.2f} % of the pixels")
    return table
