"""The page: panels beside the scene, and the loop that draws what is new while somebody looks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import viser

from capture_rig.errors import InputError
from capture_rig.rig import Rig

from ..graph.lifecycle_client import State
from ..takes.folder import TakesFolder
from ..takes.take import Take
from .control import Control, Work
from .guard import Guard, guarded_server
from .live import LiveGraph
from .markdown import escape
from .playback import Playback
from .scene import RoomScene

FRAMES_HZ = 30.0
STATES_S, PICTURES_S, TAKES_S = 0.5, 0.25, 2.0
"""How often tables, the cameras' pictures and the list of takes are drawn anew."""
COUNTDOWN_S = 10
NO_TAKES = "(none yet)"
TITLE = "sagoma"


class Page:
    """Owns the web server; everything is drawn by one thread, which sleeps while nobody looks."""

    def __init__(
        self, guard: Guard, port: int, takes: TakesFolder, live: LiveGraph | None, control: Control | None
    ) -> None:
        """Without ``live`` and ``control`` the page shows takes alone."""
        self.server = guarded_server(guard, port)
        self.server.request_share_url = lambda *args, **kwargs: None  # type: ignore[method-assign]  # leaves this room
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        self._takes, self._live, self._control = takes, live, control
        self._scene = RoomScene(self.server.scene)
        self.server.initial_camera.position, self.server.initial_camera.look_at = (3.0, -3.0, 1.9), (0.0, 0.0, 0.9)
        self._playback: Playback | None = None
        self._watched = threading.Event()
        self._ended = threading.Event()
        self.frames = 0  # drawn since the start
        self._panels = _Panels.build(self)
        self.server.on_client_connect(lambda client: self._watched.set())
        self._thread = threading.Thread(target=self._draw, name="page", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return self.server.get_port()

    def show_rig(self, rig: Rig) -> None:
        """Draw the cameras."""
        self._scene.show_rig(rig)

    def show_take(self, path: Path) -> None:
        """Play this take instead of the live graph. Raises InputError when it cannot be read or holds nobody."""
        self._playback = Playback.of(path)
        if self._playback.rig is not None:
            self._scene.show_rig(self._playback.rig)
        self._panels.show_playback(self._playback)

    def show_live(self) -> None:
        """Go back to the live graph."""
        self._playback = None
        self._scene.show({})
        self._panels.show_playback(None)

    def close(self) -> None:
        """Close the page."""
        self._ended.set()
        self._watched.set()
        self._thread.join()
        if self._live is not None:
            self._live.watch_nothing()
        self.server.stop()

    def _draw(self) -> None:
        next_states = next_pictures = next_takes = 0.0
        while not self._ended.is_set():
            if not self.server.get_clients():
                if self._live is not None:
                    self._live.watch_nothing()
                self._watched.clear()
                if not self.server.get_clients():  # who came meanwhile has set it
                    self._watched.wait()
                continue
            now = time.monotonic()
            with self.server.atomic():
                self._draw_people(now)
                if now >= next_states:
                    self._panels.show_states()
                    next_states = now + STATES_S
                if now >= next_pictures:
                    self._panels.show_pictures()
                    next_pictures = now + PICTURES_S
                if now >= next_takes:
                    self._panels.show_takes(self._takes.takes())
                    next_takes = now + TAKES_S
            self.frames += 1
            self._ended.wait(max(0.0, 1.0 / FRAMES_HZ - (time.monotonic() - now)))

    def _draw_people(self, now_s: float) -> None:
        if self._playback is not None:
            self._scene.show(self._playback.figures_at(now_s))
            self._panels.show_progress(self._playback)
            return
        if self._live is None:
            return
        self._live.watch(voxels=self._panels.voxels.value, pictures=self._panels.pictures.value)
        figures = self._live.new_figures()
        if figures is not None:
            self._scene.show(figures)
        if not self._panels.voxels.value:
            self._scene.show_voxels(None)
        elif (points := self._live.new_voxels()) is not None:
            self._scene.show_voxels(points)


@dataclass
class _Panels:
    """The controls beside the scene."""

    page: Page
    said: viser.GuiMarkdownHandle
    states: viser.GuiMarkdownHandle
    voxels: viser.GuiCheckboxHandle
    pictures: viser.GuiCheckboxHandle
    picture_folder: viser.GuiFolderHandle
    take_choice: viser.GuiDropdownHandle
    take_text: viser.GuiMarkdownHandle
    position: viser.GuiSliderHandle
    plots: viser.GuiFolderHandle

    @classmethod
    def build(cls, page: Page) -> _Panels:
        """Make all controls, and connect them."""
        gui, control = page.server.gui, page._control
        said = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Live"):
            voxels = gui.add_checkbox("hull voxels", False, visible=page._live is not None)
            if control is not None:
                _graph_buttons(gui, control)
                _recording_controls(gui, control)
            states = gui.add_markdown("")
        with tabs.add_tab("Cameras"):
            pictures = gui.add_checkbox("pictures", False, hint="each camera's silhouette, or its preview")
            picture_folder = gui.add_folder(None)
        with tabs.add_tab("Takes"):
            choice = gui.add_dropdown("take", (NO_TAKES,))
            play, live = gui.add_button("play"), gui.add_button("back to live", visible=page._live is not None)
            position = gui.add_slider("seconds", 0.0, 1.0, 0.01, 0.0, disabled=True)
            take_text, plots = gui.add_markdown(""), gui.add_folder("angles")
        panels = cls(page, said, states, voxels, pictures, picture_folder, choice, take_text, position, plots)
        _on_click(play, panels.play_chosen)
        _on_click(live, page.show_live)
        position.on_update(panels.jump)
        return panels

    def play_chosen(self) -> None:
        """Play the take that the list stands on."""
        if self.take_choice.value == NO_TAKES:
            return
        try:
            self.page.show_take(self.page._takes.find(self.take_choice.value).path)
        except InputError as error:
            self.take_text.content = escape(str(error))

    def jump(self, event: viser.GuiEvent) -> None:
        """Go on playing from where somebody has moved the slider to."""
        playback = self.page._playback
        if playback is not None and event.client is not None:
            playback.jump(self.position.value)

    def show_playback(self, playback: Playback | None) -> None:
        """Show length, figures and angles of a take; of none, nothing."""
        for child in list(self.plots._children.values()):
            child.remove()
        self.position.disabled = playback is None
        self.take_text.content = "" if playback is None else escape(playback.summary)
        if playback is None:
            return
        self.position.max = playback.seconds
        with self.plots:
            for title, times_s, series in playback.plots():
                styles = [viser.uplot.Series(label="s")]
                styles += [viser.uplot.Series(label=name, stroke=colour) for name, colour in series]
                columns = (times_s, *(values for values in series.values()))
                self.page.server.gui.add_uplot(columns, tuple(styles), title=title, aspect=2.0)

    def show_progress(self, playback: Playback) -> None:
        """Move the slider to where the take plays."""
        if abs(self.position.value - playback.position_s) > STATES_S / 2:
            self.position.value = playback.position_s  # type: ignore[misc]  # settable, by a descriptor

    def show_states(self) -> None:
        """Say what the last request came to, and how every node is."""
        control, live = self.page._control, self.page._live
        recording = f"**recording {escape(control.recording)}** " if control is not None and control.recording else ""
        self.said.content = recording + (escape(control.said) if control is not None else "")
        if live is not None:
            self.states.content = live.states_list()

    def show_pictures(self) -> None:
        """Draw the cameras' newest pictures."""
        live = self.page._live
        if live is not None and self.pictures.value:
            live.draw_pictures(self.page.server.gui, self.picture_folder)

    def show_takes(self, takes: list[Take]) -> None:
        """List the takes."""
        names = tuple(take.name for take in takes) or (NO_TAKES,)
        if tuple(self.take_choice.options) != names:
            self.take_choice.options = names


def _graph_buttons(gui: viser.GuiApi, control: Control) -> None:
    """Connect, start, suspend, stop, reset, and the countdown to learn the background."""
    transitions: dict[str, tuple[str, Work]] = {
        "connect": ("connecting", control.bring(State.INACTIVE, False)),
        "start": ("starting", control.bring(State.ACTIVE, False)),
        "suspend": ("suspending", control.bring(State.INACTIVE, True)),
        "stop": ("stopping", control.bring(State.UNCONFIGURED, True)),
    }
    group = gui.add_button_group("nodes", tuple(transitions))
    _on_click(group, lambda: control.request(*transitions[group.value]))
    _on_click(
        gui.add_button("reset", hint="forget everybody, and look anew"),
        partial(control.request, "resetting", control.reset),
    )
    seconds = gui.add_number("countdown, s", COUNTDOWN_S, min=0, max=120, step=1)
    learn, cancel = gui.add_button("learn background"), gui.add_button("cancel")
    _on_click(learn, lambda: control.request("learning", control.learn_background(int(seconds.value))))
    _on_click(cancel, control.cancel)


def _recording_controls(gui: viser.GuiApi, control: Control) -> None:
    """A name, record, finish."""
    name = gui.add_text("name of the take", "", hint="by date and time without one")
    record, finish = gui.add_button("record"), gui.add_button("finish recording")
    _on_click(record, lambda: control.request("recording", control.start_recording(name.value)))
    _on_click(finish, lambda: control.request("finishing", control.stop_recording))


def _on_click(button: viser.GuiButtonHandle | viser.GuiButtonGroupHandle, act: Callable[[], object]) -> None:
    def clicked(event: viser.GuiEvent) -> None:
        act()

    button.on_click(clicked)
