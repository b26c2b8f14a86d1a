"""Takes beside the scene: a list, one that is played with slider and curves, and its actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any

import numpy as np
import viser

from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from motion_export.isb_angles import isb_angles
from motion_export.motion import NS_PER_S, Motion, point_deviations

from ..graph import ROUND_S
from ..graph.topics import FIRST_BODY_ID
from ..recording.reader import rig_in
from ..recording.recorded_motion import recorded_motions
from ..takes.exporting import FORMATS
from ..takes.folder import TakesFolder, trim
from ..takes.take import FIGURES, Take, date, figures, remark, summary_lines
from .control import ALL_FORMATS, Deliver, Jobs, add_buttons, draw_video, export_files
from .scene import PersonPose

Array = np.ndarray

SIDES = ("left", "right")
PLOTTED = {"knee_flexion": 1.0, "elbow_flexion": 1.0, "shoulder_elevation": -1.0, "hip_flexion": 1.0}
"""Angles that are drawn (docs/reference/points.md), each with the sign that makes bent or raised limbs positive."""
HELD_S = 0.1
"""Longest gap over which a pose is shown: of sets that a graph at its limit leaves out, not of a lost person."""
PLOT_POINTS = 1000
"""Of a curve: more than a page is wide."""


@dataclass
class TakePlayback:
    """Plays in real time, again and again, from the first pose on; second 0 is the take's first frame set.

    begins_ns : stamp of second 0. seconds : length of the take. first_pose_s : of the first tracked pose. position_s :
    the second shown now.
    """

    take: Take
    motions: dict[str, Motion]
    begins_ns: int
    seconds: float
    first_pose_s: float
    rig: Rig | None = None
    playing: bool = True
    position_s: float = 0.0
    _moved_s: float = -math.inf

    @classmethod
    def of(cls, take: Take) -> TakePlayback:
        """Read a take. Raises InputError when it cannot be read or holds nobody."""
        rig = None
        with suppress(InputError):  # the motion can be seen without the cameras
            rig = load_rig(rig_file) if (rig_file := rig_in(take.path)) is not None else None
        motions = recorded_motions(take.path)
        first_ns = min(map(first_pose_ns, motions.values()))
        last_ns = max(motion.start_ns + round(motion.times_s[-1] * 1e9) for motion in motions.values())
        begins_ns, ends_ns = first_ns, last_ns
        if take.summary is not None:
            quality = take.summary.quality
            begins_ns, ends_ns = min(first_ns, quality.begins_ns), max(last_ns, quality.ends_ns)
        seconds = max((ends_ns - begins_ns) / 1e9, 1e-3)
        first_pose_s = (first_ns - begins_ns) / 1e9
        return cls(take, motions, begins_ns, seconds, first_pose_s, rig, position_s=first_pose_s)

    def jump(self, seconds: float) -> None:
        """Go on from there."""
        self.position_s = min(max(seconds, 0.0), self.seconds)

    def figures_at(self, now_s: float) -> dict[str, PersonPose]:
        """Move on to this moment, unless paused or without a browser for a while; return everybody there."""
        if self.playing and now_s - self._moved_s < ROUND_S:
            self.position_s += now_s - self._moved_s
            if self.position_s > self.seconds:
                self.position_s = self.first_pose_s
        self._moved_s = now_s
        stamp_ns, there = self.begins_ns + round(self.position_s * 1e9), {}
        for body_id, motion in self.motions.items():
            if (k := last_frame(motion, stamp_ns)) is not None:
                sigma_m = point_deviations(motion.covariance[k])
                there[body_id] = PersonPose(motion.points_world[k], sigma_m, str(motion.states[k]))
        return there

    def plots(self, body_id: str) -> Iterator[tuple[str, Array, Array]]:
        """Yield title, times (n,) s and the curves (2, n) degrees of a person's left and right side, NaN in gaps."""
        motion = self.motions[body_id]
        step = max(1, len(motion) // PLOT_POINTS)
        times_s = motion.times_s[::step] + (motion.start_ns - self.begins_ns) / 1e9
        angles = isb_angles(motion)
        for name, sign in PLOTTED.items():
            sides = np.stack([sign * angles[f"{side}_{name}"][::step] for side in SIDES])
            yield name.replace("_", " "), times_s, sides


def first_pose_ns(motion: Motion) -> int:
    """Return the stamp of the first frame in which a person is tracked."""
    return motion.start_ns + round(float(motion.times_s[np.argmax(motion.tracked)]) * NS_PER_S)


def last_frame(motion: Motion, stamp_ns: int) -> int | None:
    """Return a person's last tracked frame at a stamp, held over the sets that were left out."""
    now = round((stamp_ns - motion.start_ns) * motion.rate_hz / NS_PER_S)
    if not 0 <= now < len(motion):
        return None
    first = max(0, now - math.floor(HELD_S * motion.rate_hz))
    tracked = np.flatnonzero(motion.tracked[first : now + 1])
    return first + int(tracked[-1]) if len(tracked) else None


# the panel -----------------------------------------------------------------------------------------------------------


NO_TAKES = "(none yet)"
PLAY = "play"


class TakesPanel:
    """The tab "Takes"; ``play`` and ``leave`` begin to play a take by name, and go back to the live graph."""

    def __init__(
        self,
        gui: viser.GuiApi,
        tabs: viser.GuiTabGroupHandle,
        takes: TakesFolder,
        jobs: Jobs,
        play: Callable[[str], None],
        leave: Callable[[], None] | None,
    ) -> None:
        self._gui, self._jobs, self._folder, self._takes = gui, jobs, takes, dict[str, Take]()
        self._playback: TakePlayback | None = None
        player: dict[str, Callable[[Deliver], object]] = {
            PLAY: lambda send: self._play(play),
            "pause": lambda send: self._pause(),
        }
        if leave is not None:
            player["back to live"] = lambda send: leave()
        with tabs.add_tab("Takes"):
            self._choice = gui.add_dropdown("take", (NO_TAKES,))
            self._about = gui.add_html("")
            add_buttons(gui, "replay", player)
            self._position = gui.add_slider("second", 0.0, 1.0, 0.01, 0.0, disabled=True)
            self._person = gui.add_dropdown("angles of", (FIRST_BODY_ID,), visible=False)
            self._plots = gui.add_folder("angles", visible=False)
            with gui.add_folder("for other programs"):
                self._format = gui.add_dropdown("format", (ALL_FORMATS, *FORMATS))
                files = {"export": self._job("exporting", self._export), "video": self._job("drawing", self._draw)}
                add_buttons(gui, "files", files)
            with gui.add_folder("change"):
                self._name = gui.add_text("new name", "", hint="for rename and trim")
                self._begin = gui.add_number("from, s", 0.0, min=0.0, step=0.01)
                self._end = gui.add_number("to, s", 0.0, min=0.0, step=0.01)
                marks = {"begin": self._begin, "end": self._end}
                mark = {word: lambda send, at=at: _set(at, self._position.value) for word, at in marks.items()}
                add_buttons(gui, "slider to", mark)
                change = {"rename": self._job("renaming", self._rename), "trim": self._job("trimming", self._trim)}
                add_buttons(gui, "take", change)
                bin_ = {"delete": self._job("deleting", self._delete), "restore": self._job("restoring", self._restore)}
                add_buttons(gui, "bin", bin_)
        self._position.on_update(self._jump)
        self._choice.on_update(lambda event: self._show_about())
        self._person.on_update(lambda event: self._show_curves() if event.client is not None else None)

    def _job(self, what: str, work: Callable[[Deliver], str]) -> Callable[[Deliver], object]:
        return lambda send: self._jobs.request(what, partial(work, send))

    def _export(self, send: Deliver) -> str:
        return export_files(self._folder, self._jobs, self.chosen, self._format.value, send)

    def _draw(self, send: Deliver) -> str:
        return draw_video(self._folder, self._jobs, self.chosen, send)

    def _rename(self, send: Deliver) -> str:
        return f"{self.chosen} is now {self._folder.rename(self.chosen, self._name.value).name}"

    def _trim(self, send: Deliver) -> str:
        path = trim(self._folder, self.chosen, self._name.value, self._begin.value, self._end.value)
        return f"made {path.name}: {self._begin.value:.2f} s to {self._end.value:.2f} s of {self.chosen}"

    def _delete(self, send: Deliver) -> str:
        return f"{self._folder.delete(self.chosen).name} is in the bin: 'restore' brings it back"

    def _restore(self, send: Deliver) -> str:
        deleted = self._folder.deleted()
        return f"{self._folder.restore(deleted[0].path.name).name} is back" if deleted else "the bin is empty"

    @property
    def chosen(self) -> str:
        """The selected name; empty while there is none."""
        return self._choice.value if self._choice.value in self._takes else ""

    def show_takes(self, takes: Sequence[Take]) -> None:
        """List the takes."""
        known, self._takes = self._takes, {take.name: take for take in takes}
        names = tuple(self._takes) or (NO_TAKES,)
        if tuple(self._choice.options) != names:
            self._choice.options = names
            if not known and self._playback is not None:  # it began before there was a list
                self._choose(self._playback.take.name)
        if known != self._takes:
            self._show_about()

    def show_playback(self, playback: TakePlayback | None) -> None:
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
        _set(self._end, round(playback.seconds, 2))
        self._choose(playback.take.name)
        _set(self._person, next(iter(playback.motions)))
        self._show_curves()

    def show_progress(self, playback: TakePlayback) -> None:
        """Move the slider to where the take plays."""
        if abs(self._position.value - playback.position_s) > 0.2:
            _set(self._position, round(playback.position_s, 2))

    def _show_curves(self) -> None:
        """Draw the angles of the chosen person."""
        self._remove_curves()
        if self._playback is None or self._person.value not in self._playback.motions:
            return
        with self._plots:
            for title, times_s, sides in self._playback.plots(self._person.value):
                curves = [viser.uplot.Series(label=side, stroke=ink, width=2) for side, ink in SIDE_COLOURS.items()]
                known = np.nan_to_num(sides)  # uPlot itself finds no range where a curve begins with NaN
                y = viser.uplot.Scale(range=(known.min() - MARGIN_DEG, known.max() + MARGIN_DEG))
                self._gui.add_uplot(
                    (times_s, *sides),
                    (viser.uplot.Series(label="s"), *curves),
                    title=f"{title}, degrees",
                    height=PLOT_PX,
                    scales={"x": viser.uplot.Scale(time=False), "y": y},
                )

    def _remove_curves(self) -> None:
        for child in list(self._plots._children.values()):
            child.remove()

    def _choose(self, name: str) -> None:
        if name in self._choice.options:
            _set(self._choice, name)

    def _play(self, begin: Callable[[str], None]) -> None:
        """Play the chosen take, or resume it."""
        playback = self._playback
        if playback is not None and playback.take.name == self.chosen:
            self._go_on(playback)
        elif self.chosen:
            begin(self.chosen)

    def _go_on(self, playback: TakePlayback) -> None:
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

    def _show_about(self) -> None:
        take = self._takes.get(self._choice.value)
        self._about.content = "" if take is None else about_html(take)


WORDS = {"persons": "persons: {}", "± mm": "± {} mm"}
"""Figures whose title does not stand behind them."""
TEXT = "font-size: 13px; line-height: 1.35; overflow-wrap: anywhere; padding: 0 10px"
SIDE_COLOURS = dict(zip(SIDES, ("#5aa9ff", "#ff9a4d"), strict=True))
PLOT_PX = 150
"""Height of a plot: two of them stand below the player on a laptop's screen."""
MARGIN_DEG = 10.0


def _set(handle: Any, value: object) -> None:
    """Set a control's value: viser's types call it read-only, its descriptors do not."""
    handle.value = value


def about_html(take: Take) -> str:
    """Return the figures of a take as HTML."""
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
