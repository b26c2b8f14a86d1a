"""The controls of the live graph beside the scene: lifecycle, background, recording, every node's state, pictures."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from html import escape

import viser
from diagnostic_msgs.msg import DiagnosticStatus

from ..graph.diagnostics_table import STALE_S, NodeReport
from ..graph.lifecycle_client import State
from .control import Control
from .jobs import Jobs, Work, on_click
from .live import LiveGraph

COUNTDOWN_S = 10
RECORD, FINISH, RESET, LEARN, CANCEL = "record", "finish recording", "reset", "learn background", "cancel"


class GraphPanel:
    """The tabs "Live" and "Cameras"."""

    def __init__(self, gui: viser.GuiApi, tabs: viser.GuiTabGroupHandle, live: LiveGraph, control: Control, jobs: Jobs):
        self._gui, self._live = gui, live
        with tabs.add_tab("Live"):
            _recording_controls(gui, control, jobs)
            _graph_buttons(gui, control, jobs)
            self._voxels = gui.add_checkbox("hull voxels", False)
            self._states = gui.add_html("")  # below: its length changes, and buttons must not move under the mouse
        with tabs.add_tab("Cameras"):
            self._pictures = gui.add_checkbox(
                "pictures", False, hint="what each camera sees with its silhouette's outline, a few times a second"
            )
            self._picture_folder = gui.add_folder(None)

    @property
    def voxels(self) -> bool:
        """Are the hull's voxels wanted?"""
        return self._voxels.value

    @property
    def pictures(self) -> bool:
        """Are the cameras' pictures wanted?"""
        return self._pictures.value

    def show_states(self) -> dict[str, str]:
        """Say how every node is; returns the cameras in trouble, and what it is."""
        now_s, reports = time.monotonic(), self._live.reports()
        content = states_html(reports, now_s)
        if content != self._states.content:
            self._states.content = content
        return {
            label_of(name): trouble
            for name, report in reports.items()
            if is_camera(name) and (trouble := trouble_of(report, now_s))
        }

    def show_pictures(self) -> None:
        """Draw the cameras' newest pictures."""
        if self.pictures:
            self._live.draw_pictures(self._gui, self._picture_folder)


def _graph_buttons(gui: viser.GuiApi, control: Control, jobs: Jobs) -> None:
    """Connect, start, suspend, stop, reset, and the countdown to learn the background."""
    transitions: dict[str, tuple[str, Work]] = {
        "connect": ("connecting", control.bring(State.INACTIVE, False)),
        "start": ("starting", control.bring(State.ACTIVE, False)),
        "suspend": ("suspending", control.bring(State.INACTIVE, True)),
        "stop": ("stopping", control.bring(State.UNCONFIGURED, True)),
    }
    nodes = gui.add_button_group("nodes", tuple(transitions))
    on_click(nodes, lambda: jobs.request(*transitions[nodes.value]))
    people = gui.add_button_group("persons", (RESET,), hint="forget everybody, and look anew")
    on_click(people, lambda: jobs.request("resetting", control.reset))
    seconds = gui.add_number("countdown, s", COUNTDOWN_S, min=0, max=120, step=1)
    background = gui.add_button_group("background", (LEARN, CANCEL))
    acts: dict[str, Callable[[], object]] = {
        LEARN: lambda: jobs.request("learning", control.learn_background(int(seconds.value))),
        CANCEL: jobs.cancel,
    }
    on_click(background, lambda: acts[background.value]())


def _recording_controls(gui: viser.GuiApi, control: Control, jobs: Jobs) -> None:
    """A name, record, finish."""
    name = gui.add_text("name of the take", "", hint="by date and time without one")
    recording = gui.add_button_group("recording", (RECORD, FINISH))
    acts: dict[str, Callable[[], object]] = {
        RECORD: lambda: jobs.request("recording", control.start_recording(name.value)),
        FINISH: lambda: jobs.request("finishing", control.stop_recording),
    }
    on_click(recording, lambda: acts[recording.value]())


# states as HTML -------------------------------------------------------------------------------------------------------


GREEN, AMBER, RED, GREY = "#3cbe5a", "#f0aa1e", "#e5484d", "#868e96"
COLOURS = {DiagnosticStatus.OK: GREEN, DiagnosticStatus.WARN: AMBER, DiagnosticStatus.ERROR: RED}
RATE, AGE = "rate_hz", "latency_p50_ms"
"""Of the diagnostics: results a second, and how old they are (median)."""
SILENT = (
    "no word since {} ({:.0f} s): its process has ended, or its computer or network is down; see its log, and start it "
    "again"
)
NO_NODES = "no node is in the graph yet: `sagoma up SESSION` plays footage, docs/first_capture.md leads to cameras"
UNHEARD = "has not been heard yet"
MOST_TEXT = 400
"""Characters of what a node says: more than any of ours, and less than a panel."""


def label_of(name: str) -> str:
    """Return what to call a node: a camera client by its camera."""
    return name.strip("/").removesuffix("/camera_client")


def is_camera(name: str) -> bool:
    """Is this the full name of a camera client?"""
    return name.endswith("/camera_client")


def trouble_of(report: NodeReport | None, now_s: float) -> str:
    """Return why nothing comes from a node: it is silent, or says error; empty while it works."""
    if report is None:
        return ""
    silent_s = now_s - report.heard_s
    if silent_s > STALE_S:
        return f"silent {silent_s:.0f} s"
    return "error" if COLOURS.get(report.level, RED) == RED else ""


def states_html(reports: Mapping[str, NodeReport | None], now_s: float) -> str:
    """Return a block a node (full name -> its last report), cameras last; those in trouble first of their kind."""
    if not reports:
        return _html(GREY, "nothing to see yet", "", NO_NODES)
    order = sorted(reports, key=lambda name: (is_camera(name), not trouble_of(reports[name], now_s), name))
    return "".join(_block(label_of(name), reports[name], now_s) for name in order)


def _block(label: str, report: NodeReport | None, now_s: float) -> str:
    if report is None:
        return _html(GREY, label, "", UNHEARD)
    silent_s = now_s - report.heard_s
    if silent_s > STALE_S:
        since = time.strftime("%H:%M:%S", time.localtime(time.time() - silent_s))
        return _html(RED, label, "", SILENT.format(since, silent_s))
    figures = [f"{report.values[RATE]} Hz"] if RATE in report.values else []
    figures += [age_of(report.values[AGE])] if AGE in report.values else []
    figures += [f"{count} {key.replace('_', ' ')}" for key, count in report.losses().items()]
    return _html(COLOURS.get(report.level, RED), label, ", ".join(figures), report.message)


def age_of(text: str) -> str:
    """Say how old results are, of milliseconds as a node writes them; its own text where that is no number."""
    try:
        age_ms = float(text)
    except ValueError:
        return text
    return f"{age_ms:.0f} ms old" if age_ms < 2000.0 else f"{age_ms / 1e3:.1f} s old"


def _html(colour: str, label: str, figures: str, says: str) -> str:
    return (
        f'<div style="border-left: 4px solid {colour}; padding: 0 0 2px 8px; margin: 0 10px 6px 10px; font-size: 13px; '
        f'line-height: 1.35; overflow-wrap: anywhere">'
        f"<b>{escape(label[:MOST_TEXT])}</b> "
        f'<span style="opacity: 0.7">{escape(figures[:MOST_TEXT])}</span>'
        f"<br>{escape(says[:MOST_TEXT])}</div>"
    )
