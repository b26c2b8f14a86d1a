"""The page: panels beside the scene, and the loop that draws updates while a browser is connected."""

from __future__ import annotations

import threading
import time
from html import escape
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.rig import Rig

from ..graph.ros_link import RosLink
from ..takes.folder import TakesFolder, describe
from .control import RECORDING, Jobs
from .graph_panel import GraphPanel
from .scene import ViewerScene
from .server import Guard, guarded_server
from .takes_panel import PLAY, TakePlayback, TakesPanel

EVERY_S = 0.25
"""Period at which tables, the cameras' pictures and the list of takes are redrawn."""


class Page:
    """Owns the web server; everything is drawn by one thread, and nothing without a browser."""

    def __init__(
        self, guard: Guard, port: int | None, takes: TakesFolder, link: RosLink | None = None, rig: Rig | None = None
    ) -> None:
        """``link`` and ``rig`` : of the live graph; without a link the page shows takes alone."""
        self.server = guarded_server(guard, port)
        self.server.request_share_url = lambda *args, **kwargs: None  # type: ignore[method-assign]  # leaves this room
        gui = self.server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()  # the scene beside it, not under it
        gui.set_panel_label("sagoma")
        self._takes, self._jobs = takes, Jobs()
        self._scene, self._rig = ViewerScene(self.server), rig
        self._scene.show_rig(rig)
        self._playback: TakePlayback | None = None
        self._ended = threading.Event()
        self._said = gui.add_html("")
        tabs = gui.add_tab_group()
        self._graph = None if link is None else GraphPanel(gui, tabs, link, takes, self._jobs)
        leave = None if link is None else self.show_live
        self._take_panel = TakesPanel(gui, tabs, takes, self._jobs, self.play, leave)
        self._thread = threading.Thread(target=self._draw, name="page", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return self.server.get_port()

    def play(self, name: str) -> None:
        """Play a take of the folder, or report why it cannot be played."""

        def work() -> str:
            self._show(TakePlayback.of(self._takes.find(name)))
            return f"playing {name}"

        self._jobs.request(f"reading {name}", work)

    def show_take(self, path: Path) -> None:
        """Show this bag's first pose instead of the live graph. Raises InputError when it has none."""
        take = describe(path)
        if take.problem:
            raise InputError(take.problem)
        playback = TakePlayback.of(take)
        playback.playing = False
        self._show(playback)
        self._jobs.report(f"{take.name}: its first pose, at {playback.position_s:.2f} s; '{PLAY}' plays it")

    def show_live(self) -> None:
        """Go back to the live graph."""
        self._playback = None
        self._scene.show({})
        self._scene.show_rig(self._rig)
        self._take_panel.show_playback(None)
        self._jobs.report("")

    def close(self) -> None:
        """Close the page, and finish a recording under way."""
        self._ended.set()
        self._thread.join()
        self.server.stop()
        if self._graph is not None:
            self._graph.close()

    def _show(self, playback: TakePlayback) -> None:
        self._scene.show_rig(playback.rig)
        self._take_panel.show_playback(playback)
        self._playback = playback

    def _draw(self) -> None:
        next_s = 0.0
        while not self._ended.is_set():
            if not self.server.get_clients():
                if self._graph is not None:
                    self._graph.live.watch_nothing()
                self._ended.wait(EVERY_S)
                continue
            now = time.monotonic()
            try:
                with self.server.atomic():
                    self._draw_people(now)
                    if now >= next_s:
                        next_s = now + EVERY_S
                        self._draw_panels()
            except Exception as error:  # a message that cannot be read, a take that vanished: the page goes on
                self._jobs.report(f"the page could not be drawn: {error}")
            self._ended.wait(max(0.0, 1.0 / 30.0 - (time.monotonic() - now)))

    def _draw_people(self, now_s: float) -> None:
        if self._playback is not None:
            self._scene.show(self._playback.figures_at(now_s))
            self._scene.show_voxels(None)
            self._take_panel.show_progress(self._playback)
        elif self._graph is not None:
            self._scene.show(self._graph.figures())
            if not self._graph.voxels.value:
                self._scene.show_voxels(None)
            elif (points := self._graph.live.new_voxels()) is not None:
                self._scene.show_voxels(points)

    def _draw_panels(self) -> None:
        """Show the takes, the last request's result, every node's state, and the cameras' pictures."""
        self._take_panel.show_takes(self._takes.takes())
        name = self._graph.control.recording if self._graph is not None else ""
        recording, last = RECORDING.format(name), self._jobs.said
        said = f'<b style="color: #e5484d">&#9679; {escape(recording)}</b><br>' if name else ""
        said += escape(last) if last != recording else ""
        self._said.content = (
            f'<div style="font-size: 14px; min-height: 1.4em; overflow-wrap: anywhere; padding: 0 10px">{said}</div>'
        )
        if self._graph is not None:
            self._graph.show()
