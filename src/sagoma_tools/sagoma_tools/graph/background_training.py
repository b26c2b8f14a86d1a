"""Lets camera clients of a running graph learn their backgrounds, and tells what became of it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.text import Text
from std_srvs.srv import Trigger

from camera_client.background.training import KEY, PROGRESS_KEY, TrainingReport
from capture_rig.errors import InputError
from capture_rig.verdict import REDO
from sagoma_bringup.graph import Role

from .diagnostics_table import DiagnosticsTable
from .ros_link import call_all, owners_of, settled
from .supervisor import Supervisor

SERVICE, SERVICE_TYPE = "learn_background", "std_srvs/srv/Trigger"
TIMEOUT_S = 120.0
REPORT_S = 1.5  # the diagnostics come once a second, and at once when a lesson ends
NEEDS_ONE = "sagoma background"  # what a client's diagnostics say when its background should be learned anew


@dataclass(frozen=True)
class TrainingOutcome:
    """What became of a request: ``report`` is None when no lesson took place; ``said`` is the answer, or why none."""

    camera: str
    said: str
    report: TrainingReport | None = None

    @property
    def grade(self) -> str:
        """GOOD, USABLE or REDO (capture_rig.verdict)."""
        return REDO if self.report is None else self.report.grade


def camera_of(full_name: str) -> str:
    """ "cam01" of "/cam01/camera_client"."""
    return full_name.strip("/").rpartition("/")[0] or full_name.strip("/")


def find_clients(node: Node, expect: int, wait_s: float) -> list[str]:
    """Full names of the camera clients in the graph, found by their service; waits until there are ``expect``.

    Raises InputError when there are fewer after ``wait_s``.
    """
    found = settled(lambda: owners_of(node, SERVICE, SERVICE_TYPE), expect, wait_s)
    if len(found) < max(expect, 1):
        raise InputError(
            f"found {len(found)} camera clients, expected {max(expect, 1)}",
            where="the ROS graph",
            remedy="Start them (sagoma up --cameras FOLDER), or check ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE.",
        )
    return found


def needing_training(board: DiagnosticsTable, names: Iterable[str]) -> list[str]:
    """Those of the clients ``names`` that have no background, whose last lesson failed, or that ask for a new one."""
    needy = []
    for name in names:
        report, lesson = board.report(name), training_report_of(board, name)
        failed = lesson is not None and lesson.grade == REDO
        if report is None or failed or not report.values.get("background") or NEEDS_ONE in report.message:
            needy.append(name)
    return needy


def training_report_of(board: DiagnosticsTable, name: str) -> TrainingReport | None:
    """The last lesson of the client ``name``, as its diagnostics tell it."""
    report = board.report(name)
    try:
        return None if report is None else TrainingReport.from_json(report.values[KEY])
    except (KeyError, ValueError):
        return None


def progress_of(board: DiagnosticsTable, name: str) -> str:
    """How far the lesson of the client ``name`` is, "57/100"; "" when there is none."""
    report = board.report(name)
    return "" if report is None else report.values.get(PROGRESS_KEY, "")


def train_backgrounds(
    node: Node,
    board: DiagnosticsTable,
    names: Iterable[str],
    timeout_s: float = TIMEOUT_S,
    wanted: Callable[[], bool] = lambda: True,
) -> list[TrainingOutcome]:
    """Call ~/learn_background of all clients ``names`` (full names) at once; the room must be empty.

    wanted : once it turns false, nobody is waited for any longer.
    """
    names = list(names)
    services = {f"{name}/{SERVICE}": name for name in names}
    before = {name: _number(training_report_of(board, name)) for name in names}

    def done(silent: set[str]) -> dict[str, Trigger.Response]:
        """Clients whose diagnostics tell of a lesson that is over, should the answer itself have been lost."""
        lessons = {service: training_report_of(board, services[service]) for service in silent}
        return {
            service: Trigger.Response(success=lesson.grade != REDO, message=lesson.text)
            for service, lesson in lessons.items()
            if lesson is not None and lesson.number > before[services[service]]
        }

    requests = {service: Trigger.Request() for service in services}
    replies = call_all(node, Trigger, requests, timeout_s, lambda service: wanted(), inferred=done)
    said = {name: replies[service] for service, name in services.items()}

    def told(name: str) -> bool:
        lesson = training_report_of(board, name)
        return lesson is not None and lesson.number > before[name] and lesson.text == said[name].message

    answered = [name for name in names if said[name] is not None]
    board.wait_until(lambda: all(map(told, answered)), REPORT_S)
    silence = "did not answer" + ("" if wanted() else " before it was cancelled")
    return [
        TrainingOutcome(camera_of(name), said[name].message, training_report_of(board, name) if told(name) else None)
        if said[name] is not None
        else TrainingOutcome(camera_of(name), silence)
        for name in names
    ]


def learn_backgrounds(supervisor: Supervisor, timeout_s: float = TIMEOUT_S) -> dict[str, str]:
    """Let all cameras of a supervised graph learn; the room must be empty. Returns what each one says.

    Raises InputError naming the cameras that refuse, and why, or that do not answer.
    """
    names = [spec.full_name for spec in supervisor.graph if spec.role is Role.CAMERA]
    lessons = train_backgrounds(supervisor.node, supervisor.diagnostics, names, timeout_s)
    refused = [lesson for lesson in lessons if lesson.grade == REDO]
    if refused:
        raise InputError(
            "; ".join(f"{lesson.camera}: {lesson.said}" for lesson in refused),
            where="learning the background",
            remedy="Clear the scene and try again.",
        )
    return {lesson.camera: lesson.said for lesson in lessons}


def _number(lesson: TrainingReport | None) -> int:
    return 0 if lesson is None else lesson.number


# --- Seconds counted down for somebody who has to leave the room.

SPOKEN = 5  # in a log the last so many seconds have a line each


def count_down(console: Console, what: str, seconds: int, stop: threading.Event) -> bool:
    """Show "WHAT: 10" and so on down to 1, then beep; False when ``stop`` was set meanwhile."""
    if not console.is_terminal:
        return _in_lines(console, what, seconds, stop)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for left in range(seconds, 0, -1):
            live.update(Text(f"{what}: {left}", style="bold yellow"), refresh=True)
            if stop.wait(1.0):
                return False
    console.bell()
    return True


def _in_lines(console: Console, what: str, seconds: int, stop: threading.Event) -> bool:
    for left in range(seconds, 0, -1):
        if left == seconds or left <= SPOKEN:
            console.print(f"{what}: {left} s", highlight=False)
        if stop.wait(1.0):
            return False
    return True
