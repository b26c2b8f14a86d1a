"""The controls of the live graph beside the scene: lifecycle, background, recording, every node's state, pictures."""

from __future__ import annotations

import time
from functools import partial

import viser

from ..graph.lifecycle_client import State
from .buttons import on_click
from .control import Control
from .jobs import Jobs, Work
from .live import LiveGraph
from .states import is_camera, label_of, states_html, trouble_of

COUNTDOWN_S = 10


class GraphPanel:
    """The tabs "Live" and "Cameras"."""

    def __init__(self, gui: viser.GuiApi, tabs: viser.GuiTabGroupHandle, live: LiveGraph, control: Control, jobs: Jobs):
        self._gui, self._live = gui, live
        with tabs.add_tab("Live"):
            self._states = gui.add_html("")
            self._voxels = gui.add_checkbox("hull voxels", False)
            with gui.add_folder("recording"):
                _recording_controls(gui, control, jobs)
            with gui.add_folder("graph"):
                _graph_buttons(gui, control, jobs)
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
    group = gui.add_button_group("nodes", tuple(transitions))
    on_click(group, lambda: jobs.request(*transitions[group.value]))
    on_click(
        gui.add_button("reset", hint="forget everybody, and look anew"),
        partial(jobs.request, "resetting", control.reset),
    )
    seconds = gui.add_number("countdown, s", COUNTDOWN_S, min=0, max=120, step=1)
    learn, cancel = gui.add_button("learn background"), gui.add_button("cancel")
    on_click(learn, lambda: jobs.request("learning", control.learn_background(int(seconds.value))))
    on_click(cancel, jobs.cancel)


def _recording_controls(gui: viser.GuiApi, control: Control, jobs: Jobs) -> None:
    """A name, record, finish."""
    name = gui.add_text("name of the take", "", hint="by date and time without one")
    record, finish = gui.add_button("record", color="red"), gui.add_button("finish recording")
    on_click(record, lambda: jobs.request("recording", control.start_recording(name.value)))
    on_click(finish, lambda: jobs.request("finishing", control.stop_recording))
