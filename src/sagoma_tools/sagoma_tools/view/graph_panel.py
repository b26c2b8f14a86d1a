"""The controls of the live graph beside the scene: lifecycle, background, recording, every node's state, pictures."""

from __future__ import annotations

import time
from collections.abc import Callable

import viser

from ..graph.lifecycle_client import State
from .buttons import on_click
from .control import Control
from .jobs import Jobs, Work
from .live import LiveGraph
from .states import is_camera, label_of, states_html, trouble_of

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
