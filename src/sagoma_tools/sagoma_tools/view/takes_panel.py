"""The controls of takes beside the scene: a list, one to play with slider and curves, and what can be done with it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
import viser

from ..graph.topics import FIRST_BODY_ID
from ..takes.exporting import FORMATS
from ..takes.take import FIGURES, Take, date, figures, remark, summary_lines
from .control import ALL_FORMATS, Deliver, Jobs, TakeActions, Tell, Work, on_click, on_click_deliver
from .playback import SIDES, Playback

NO_TAKES = "(none yet)"
PLAY, PAUSE, BACK = "play", "pause", "back to live"
EXPORT, VIDEO = "export", "video"
RENAME, TRIM, DELETE, RESTORE = "rename", "trim", "delete", "restore"
BEGIN, END = "begin", "end"
"""The slider follows what is played in such steps: each is a message to every browser."""


class TakesPanel:
    """The tab "Takes"; ``play`` and ``leave`` begin to play a take by name, and go back to the live graph."""

    def __init__(
        self,
        gui: viser.GuiApi,
        tabs: viser.GuiTabGroupHandle,
        work: TakeActions,
        jobs: Jobs,
        play: Callable[[str], None],
        leave: Callable[[], None] | None,
    ) -> None:
        self._gui, self._jobs, self._takes = gui, jobs, dict[str, Take]()
        self._playback: Playback | None = None
        self.stale = threading.Event()  # the list is not what the folder holds any more
        with tabs.add_tab("Takes"):
            self._choice = gui.add_dropdown("take", (NO_TAKES,))
            self._about = gui.add_html("")
            player = gui.add_button_group("replay", (PLAY, PAUSE, BACK) if leave is not None else (PLAY, PAUSE))
            self._position = gui.add_slider("second", 0.0, 1.0, 0.01, 0.0, disabled=True)
            self._person = gui.add_dropdown("angles of", (FIRST_BODY_ID,), visible=False)
            self._plots = gui.add_folder("angles", visible=False)
            with gui.add_folder("for other programs"):
                self._format = gui.add_dropdown("format", (ALL_FORMATS, *FORMATS))
                files = gui.add_button_group("files", (EXPORT, VIDEO))
            with gui.add_folder("change"):
                self._new_name = gui.add_text("new name", "", hint="for rename and trim")
                self._from = gui.add_number("from, s", 0.0, min=0.0, step=0.01)
                self._to = gui.add_number("to, s", 0.0, min=0.0, step=0.01)
                mark = gui.add_button_group("slider to", (BEGIN, END))
                change = gui.add_button_group("take", (RENAME, TRIM))
                bin_group = gui.add_button_group("bin", (DELETE, RESTORE))
        on_click(player, lambda: players[player.value]())
        self._position.on_update(self._jump)
        self._choice.on_update(lambda event: self._show_about())
        self._person.on_update(lambda event: self._show_curves() if event.client is not None else None)
        on_click(mark, lambda: self._mark(mark.value))
        on_click(change, lambda: jobs.request(*changes[change.value]()))
        on_click(bin_group, lambda: jobs.request(*changes[bin_group.value]()))
        on_click_deliver(files, lambda send: jobs.request(*made[files.value](send)))
        players: dict[str, Callable[[], object]] = {
            PLAY: lambda: self._play(play),
            PAUSE: self._pause,
            BACK: leave or (lambda: None),
        }
        changes: dict[str, Callable[[], tuple[str, Work]]] = {
            RENAME: lambda: ("renaming", self._changing(partial(work.rename, self.chosen, self._new_name.value))),
            TRIM: lambda: ("trimming", self._changing(partial(work.trim, *self._part()))),
            DELETE: lambda: ("deleting", self._changing(partial(work.delete, self.chosen))),
            RESTORE: lambda: ("restoring", self._changing(work.restore)),
        }
        made: dict[str, Callable[[Deliver], tuple[str, Work]]] = {
            EXPORT: lambda send: ("exporting", partial(work.export, self.chosen, self._format.value, send)),
            VIDEO: lambda send: ("drawing", partial(work.video, self.chosen, send)),
        }

    @property
    def chosen(self) -> str:
        """The name that the list stands on; empty while there is none."""
        return self._choice.value if self._choice.value in self._takes else ""

    def show_takes(self, takes: Sequence[Take]) -> None:
        """List the takes; one that has been renamed stays chosen."""
        known, self._takes, chosen = self._takes, {take.name: take for take in takes}, self._choice.value
        names = tuple(self._takes) or (NO_TAKES,)
        if tuple(self._choice.options) != names:
            self._choice.options = names
            if not known and self._playback is not None:  # it began before there was a list
                self._choose(self._playback.take.name)
            new = self._takes.keys() - known.keys()
            if chosen in known and chosen not in self._takes and len(new) == 1:
                self._choose(new.pop())
        if known != self._takes:
            self._show_about()

    def show_playback(self, playback: Playback | None) -> None:
        """Show the angles and the length of a take; of none, nothing."""
        self._playback = playback
        self._plots.visible = playback is not None
        self._person.visible = playback is not None and len(playback.motions) > 1
        self._position.disabled = playback is None
        if playback is None:
            self._remove_curves()
            return
        self._person.options = tuple(playback.motions)
        self._position.max = round(playback.seconds, 2)
        _set(self._position, round(playback.position_s, 2))
        _set(self._to, round(playback.seconds, 2))
        self._choose(playback.take.name)
        _set(self._person, next(iter(playback.motions)))
        self._show_curves()

    def show_progress(self, playback: Playback) -> None:
        """Move the slider to where the take plays."""
        if abs(self._position.value - playback.position_s) > 0.2:
            _set(self._position, round(playback.position_s, 2))

    def _part(self) -> tuple[str, str, float, float]:
        return self.chosen, self._new_name.value, self._from.value, self._to.value

    def _changing(self, work: Work) -> Work:
        """The same work, after which the list is drawn anew before its outcome is told."""

        def changing(tell: Tell) -> str:
            try:
                return work(tell)
            finally:
                self.stale.set()

        return changing

    def _show_curves(self) -> None:
        """Draw the angles of the person who is chosen."""
        self._remove_curves()
        if self._playback is None or self._person.value not in self._playback.motions:
            return
        with self._plots:
            for title, times_s, sides in self._playback.plots(self._person.value):
                styles = [viser.uplot.Series(label="s")]
                styles += [
                    viser.uplot.Series(label=side, stroke=colour, width=2) for side, colour in SIDE_COLOURS.items()
                ]
                scales = {"x": NOT_A_DATE, "y": viser.uplot.Scale(range=whole_range(sides))}
                self._gui.add_uplot(
                    (times_s, *sides),
                    tuple(styles),
                    title=title,
                    height=PLOT_PX,
                    scales=scales,
                    axes=AXES,
                    padding=PADDING_PX,
                )

    def _remove_curves(self) -> None:
        for child in list(self._plots._children.values()):
            child.remove()

    def _choose(self, name: str) -> None:
        if name in self._choice.options:
            _set(self._choice, name)

    def _play(self, begin: Callable[[str], None]) -> None:
        """Play what is chosen; go on with it where it is being played."""
        playback = self._playback
        if playback is not None and playback.take.name == self.chosen:
            self._go_on(playback)
        elif self.chosen:
            begin(self.chosen)

    def _go_on(self, playback: Playback) -> None:
        playback.playing = True
        self._jobs.report(f"playing {playback.take.name}")

    def _pause(self) -> None:
        """Stand still, or go on."""
        playback = self._playback
        if playback is None:
            return
        if not playback.playing:
            self._go_on(playback)
        else:
            playback.playing = False
            _set(self._position, round(playback.position_s, 2))
            self._jobs.report(f"paused at {playback.position_s:.2f} s; '{PLAY}' goes on")

    def _jump(self, event: viser.GuiEvent) -> None:
        """Go on playing from where somebody has moved the slider to."""
        if self._playback is not None and event.client is not None:
            self._playback.jump(self._position.value)

    def _mark(self, which: str) -> None:
        _set(self._from if which == BEGIN else self._to, self._position.value)

    def _show_about(self) -> None:
        take = self._takes.get(self._choice.value)
        self._about.content = "" if take is None else about_html(take)


WORDS = {"persons": "persons: {}", "± mm": "± {} mm"}
"""Figures whose title does not stand behind them."""
TEXT = "font-size: 13px; line-height: 1.35; overflow-wrap: anywhere; padding: 0 10px"
NOT_A_DATE = viser.uplot.Scale(time=False)
"""Of a curve's times: seconds of the take."""
SIDE_COLOURS = dict(zip(SIDES, ("#5aa9ff", "#ff9a4d"), strict=True))
PLOT_PX = 150
"""Height of a plot: two of them stand below the player on a laptop's screen."""
PADDING_PX = (10, 16, 0, 0)
"""Above, right, below, left of the curves: room for half of the uppermost number."""
INK, GRID = "#d5d8dd", viser.uplot.Axis_Grid(stroke="#3d4149", width=1)
AXES = (
    viser.uplot.Axis(label="seconds", stroke=INK, grid=GRID, size=26, labelSize=18),
    viser.uplot.Axis(label="degrees", stroke=INK, grid=GRID, size=40, labelSize=18),
)
GRID_DEG = 30.0
"""Curves' ranges begin and end at multiples of it."""


def _set(handle: Any, value: object) -> None:
    """Set a control's value: viser's types call it read-only, its descriptors do not."""
    handle.value = value


def whole_range(curves: np.ndarray) -> tuple[float, float]:
    """Return the range of all curves in degrees; given, because uPlot finds none where a curve begins with NaN."""
    values = curves[np.isfinite(curves)]
    if not len(values):
        return -GRID_DEG, GRID_DEG
    low = GRID_DEG * np.floor(values.min() / GRID_DEG)
    return float(low), float(max(GRID_DEG * np.ceil(values.max() / GRID_DEG), low + GRID_DEG))


def about_html(take: Take) -> str:
    """Return what is known of a take as HTML."""
    if take.problem:
        return f'<div style="{TEXT}; color: #f0aa1e">{escape(take.problem)}</div>'
    cells = " &nbsp; ".join(
        f'<span style="white-space: nowrap">{WORDS.get(title, "{} " + title).format(f"<b>{escape(value)}</b>")}</span>'
        for title, value in zip(FIGURES, figures(take), strict=True)
    )
    lines = "<br>".join(map(escape, summary_lines(take.summary))) if take.summary is not None else ""
    said = escape(" ".join(filter(None, (date(take), remark(take)))))
    more = f"<details><summary>cameras and persons</summary>{lines}</details>" if lines else ""
    return f'<div style="{TEXT}; padding-bottom: 8px">{said}<br>{cells}{more}</div>'
