"""Trains the backgrounds of the camera clients in a running graph, and collects the verdict of each client.

A client trains in its service ~/learn_background and publishes the training report in its diagnostics. A lost service
response is therefore replaced by the report.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from rclpy.node import Node
from std_srvs.srv import Trigger

from camera_client.background.training import KEY, PROGRESS_KEY, TrainingReport
from capture_rig.errors import InputError
from capture_rig.verdict import REDO
from sagoma_bringup.graph import Role

from . import ANSWER_S, START_TIMEOUT_S
from .diagnostics_table import DiagnosticsTable
from .ros_link import call_all, find_nodes, label_of, owners_of
from .supervisor import Supervisor

SERVICE, SERVICE_TYPE = "learn_background", "std_srvs/srv/Trigger"
NEEDS_ONE = "sagoma background"  # part of a client's message when its background should be trained again


@dataclass(frozen=True)
class TrainingOutcome:
    """The response to one training request. ``message``: the client's response, or why there is none; ``report``: None
    when no training took place."""

    camera: str
    message: str
    report: TrainingReport | None = None

    @property
    def grade(self) -> str:
        """GOOD, USABLE or REDO (capture_rig.verdict)."""
        return REDO if self.report is None else self.report.grade


def find_clients(node: Node, expect: int, wait_s: float) -> list[str]:
    """Full names of the camera clients in the graph, found by their service; waits until there are ``expect``.

    Raises InputError when there are fewer after ``wait_s``.
    """
    return find_nodes(lambda: owners_of(node, SERVICE, SERVICE_TYPE), "camera clients", max(expect, 1), wait_s)


def needing_training(diagnostics: DiagnosticsTable, names: Iterable[str]) -> list[str]:
    """Return the clients that have no background, whose last training failed, or that ask for a new one."""
    needing = []
    for name in names:
        status, training = diagnostics.report(name), training_report_of(diagnostics, name)
        failed = training is not None and training.grade == REDO
        if status is None or failed or not status.values.get("background") or NEEDS_ONE in status.message:
            needing.append(name)
    return needing


def training_report_of(diagnostics: DiagnosticsTable, name: str) -> TrainingReport | None:
    """Return the client's last training report in its diagnostics."""
    status = diagnostics.report(name)
    try:
        return None if status is None else TrainingReport.from_json(status.values[KEY])
    except (KeyError, ValueError):
        return None


def progress_of(diagnostics: DiagnosticsTable, name: str) -> str:
    """Frames of the client's training so far, "57/100"; "" when it is not training."""
    status = diagnostics.report(name)
    return "" if status is None else status.values.get(PROGRESS_KEY, "")


def train_backgrounds(
    node: Node,
    diagnostics: DiagnosticsTable,
    names: Iterable[str],
    timeout_s: float = START_TIMEOUT_S,
    wanted: Callable[[], bool] = lambda: True,
) -> list[TrainingOutcome]:
    """Train all clients ``names`` (full names) at once; the room must be empty. Stops waiting once ``wanted`` is false.

    The outcome of each client, in the order of ``names``.
    """
    names = list(names)
    before = {name: _number(training_report_of(diagnostics, name)) for name in names}

    def new_report(name: str) -> TrainingReport | None:
        report = training_report_of(diagnostics, name)
        return report if _number(report) > before[name] else None

    def unknown(name: str) -> bool:
        return wanted() and new_report(name) is None

    requests = {name: Trigger.Request() for name in names}
    replies = call_all(node, Trigger, requests, timeout_s, unknown, suffix=f"/{SERVICE}")
    answered, replied_s = [name for name in names if replies[name] is not None], time.monotonic()

    def is_known(name: str) -> bool:
        status = diagnostics.report(name)
        refused = not replies[name].success and status is not None and status.heard_s > replied_s
        return refused or new_report(name) is not None  # a report is published before the response, a refusal has none

    diagnostics.wait_until(lambda: all(map(is_known, answered)), ANSWER_S)
    silence = "did not answer" + ("" if wanted() else " before it was cancelled")

    def outcome(name: str) -> TrainingOutcome:
        reply, report = replies[name], new_report(name)
        said = report.text if report is not None else silence if reply is None else reply.message
        return TrainingOutcome(label_of(name), said, report)

    return list(map(outcome, names))


def learn_backgrounds(supervisor: Supervisor) -> dict[str, str]:
    """Train all cameras of a supervised graph; the room must be empty. Returns each client's response.

    Raises InputError naming the cameras that refuse, and why, or that do not answer.
    """
    names = [spec.full_name for spec in supervisor.graph if spec.role is Role.CAMERA]
    outcomes = train_backgrounds(supervisor.node, supervisor.diagnostics, names)
    failed = [outcome for outcome in outcomes if outcome.grade == REDO]
    if failed:
        what = "; ".join(f"{outcome.camera}: {outcome.message}" for outcome in failed)
        raise InputError(what, where="learning the background", remedy="Clear the scene and try again.")
    return {outcome.camera: outcome.message for outcome in outcomes}


def _number(report: TrainingReport | None) -> int:
    return 0 if report is None else report.number
