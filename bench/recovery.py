"""Recovery drills: break a track on purpose, and measure the time until it is good again.

    python bench/recovery.py [SESSION ...] [--exact] [--motion NAME ...] [--moments N] [--set NODE.PARAMETER=VALUE]

Each drill disturbs a running track once, or at each of N moments of the clip, each in a run of its own: 1 s of blank
silhouettes, 10 missing frame sets, a camera lost for 1 s, or a wrong pose put into filter and tracker (heading
flipped, left and right swapped, an arm folded away, 0.4 m off). Motions of the virtual studio are seen by five cameras
around and one above (exact silhouettes); sessions bring their own. Two more drills are motions themselves: an arm
against the chest for 2 s, and leaving the volume and coming back.

A cell is the time in seconds from the end of the disturbance to a good track (all points < 200 mm and their mean
< 60 mm for 0.2 s), or "never", of several moments the median and the longest; then the mean error in mm after that
time; then the share of frames that were bad although tracker and filter both said that they track, "of" the share that
was bad. The row "undisturbed" gives the share of good frames and the mean error of the same stretch without a drill:
what recovery can hope for. The last line is JSON.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Clip, session_clip
from drills import DRILLS, Outcome, is_good, play
from scenes import studio_clip

from sagoma_tools.arguments import parse_settings
from virtual_studio.motions.catalogue import HARD_CASES

MOTION_S = 6.0
MOTION_DRILLS = {"arm against the chest 2 s": "arm_on_chest", "left and came back": "leave_and_return"}
LEFT_HAND_POINT, NECK_POINT, ON_CHEST_M = 11, 2, 0.35
DISTURBED_AT, SPREAD = 0.45, 0.15
"""Where in the clip the disturbance begins, as a share of its length, and how far several moments spread around it."""

Figures = dict[str, float | None]
Column = dict[str, Figures]


def drilled(clip: Clip, settings: dict[str, Any], moments: int = 1) -> Column:
    """The figures of the undisturbed clip and of every drill."""
    shares = np.linspace(DISTURBED_AT - SPREAD, DISTURBED_AT + SPREAD, moments) if moments > 1 else [DISTURBED_AT]
    begins, clouds = [round(share * len(clip)) for share in shares], clip.carved(settings)
    longest = begins[0] + max(drill.frames(clip.fps) for drill in DRILLS)
    calm = play(clip, clouds, settings).errors_m[longest:]
    column: Column = {"undisturbed": {"good": round(float(is_good(calm).mean()), 3), "mean_mm": _mean_mm(calm)}}
    for drill in DRILLS:
        runs = [(play(clip, clouds, settings, drill, begin), begin) for begin in begins]
        column[drill.name] = together([figures_of(o, b, b + drill.frames(clip.fps), clip.fps) for o, b in runs])
    return column


def together(runs: list[Figures]) -> Figures:
    """Of several moments: the median time and the longest one, None for never, and the means of the rest."""
    if len(runs) == 1:
        return runs[0]
    times = [np.inf if run["recovered_s"] is None else run["recovered_s"] for run in runs]
    kept = {key: [run[key] for run in runs if run[key] is not None] for key in ("mean_mm", "bad", "bad_but_sure")}
    figures: Figures = {key: round(float(np.mean(values)), 3) if values else None for key, values in kept.items()}
    spread = {"recovered_s": np.median(times), "longest_s": np.max(times)}
    return figures | {key: round(float(v), 3) if np.isfinite(v) else None for key, v in spread.items()}


def moved(name: str, settings: dict[str, Any]) -> Figures:
    """The figures of a motion that is a drill in itself."""
    clip = studio_clip(MOTION_DRILLS[name], HARD_CASES[MOTION_DRILLS[name]].duration_s)
    outcome = play(clip, clip.carved(settings), settings)
    disturbed = np.flatnonzero(hidden(name, clip))
    return figures_of(outcome, int(disturbed[0]), int(disturbed[-1]) + 1, clip.fps)


def hidden(name: str, clip: Clip) -> np.ndarray:
    """Frames (F,) at which the motion hides what is to be tracked: partly outside the volume, hand near the spine."""
    if MOTION_DRILLS[name] == "leave_and_return":
        xy, volume = clip.truth[..., :2], clip.rig.volume
        return ~((xy > volume.low[:2]) & (xy < volume.high[:2])).all(axis=(1, 2))
    return np.linalg.norm(clip.truth[:, LEFT_HAND_POINT] - clip.truth[:, NECK_POINT], axis=1) < ON_CHEST_M


def figures_of(outcome: Outcome, begin: int, end: int, fps: float) -> Figures:
    """Time to recovery from the end of a disturbance, mean error from then on, and bad frames that nobody admitted."""
    recovered_s = outcome.time_to_good(end, fps)
    bad = ~is_good(outcome.errors_m[begin:])
    return {
        "recovered_s": None if recovered_s is None else round(recovered_s, 3),
        "mean_mm": _mean_mm(outcome.errors_m[end + round((recovered_s or 0.0) * fps) :]),
        "bad": round(float(bad.mean()), 3),
        "bad_but_sure": round(float((bad & outcome.sure[begin:]).mean()), 3),
    }


def _mean_mm(errors_m: np.ndarray) -> float | None:
    return round(float(1e3 * np.nanmean(errors_m)), 1) if np.isfinite(errors_m).any() else None


def print_table(columns: Mapping[str, Column]) -> None:
    """Rows are drills, columns are clips."""
    table = Table({"drill": "", **dict.fromkeys(columns, "")}, markdown=True)
    for name in {name: None for column in columns.values() for name in column}:
        table.row(name, *(_cell(column.get(name)) for column in columns.values()))


def _cell(figures: Figures | None) -> str:
    if figures is None:
        return ""
    if "good" in figures:
        return f"{100 * (figures['good'] or 0.0):.0f} % good, {figures['mean_mm']} mm"
    time = _seconds(figures["recovered_s"])
    if "longest_s" in figures:
        time += f" ({_seconds(figures['longest_s'])})"
    share = f"{100 * (figures['bad_but_sure'] or 0.0):.0f} of {100 * (figures['bad'] or 0.0):.0f} %"
    return f"{time}, {figures['mean_mm']} mm, {share}"


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f} s"


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("sessions", nargs="*", type=Path, help="session folders with a reference")
    given.add_argument("--exact", action="store_true", help="the sessions' exact silhouettes, not their footage")
    given.add_argument("--motion", nargs="*", default=["tour", "walk"], help="motions of the virtual studio")
    given.add_argument("--moments", type=int, default=1, help="how often each drill is held, at as many moments")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    motions = {name: moved(name, settings) for name in MOTION_DRILLS} if arguments.motion else {}
    clips = [studio_clip(motion, MOTION_S) for motion in arguments.motion]
    clips += [session_clip(folder, arguments.exact) for folder in arguments.sessions]
    columns = {clip.name: drilled(clip, settings, arguments.moments) for clip in clips}
    if motions:
        columns["itself"] = motions
    print_table(columns)
    finish(columns)


if __name__ == "__main__":
    execute(main)
