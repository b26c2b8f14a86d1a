"""Prints scores, evaluations and live runs as tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.table import Table

from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from ..console import plain_table
from ..graph.processes import Usage
from ..graph.ros_link import label_of
from .scores import AngleScores, PointScores, Scores
from .track_evaluation import PeopleScores, TrackEvaluation

POINT_COLUMNS: Mapping[str, tuple[str, str]] = {
    "mean": ("mean_mm", "{:.1f}"),
    "median": ("median_mm", "{:.1f}"),
    "95 %": ("p95_mm", "{:.1f}"),
    ">200 mm": ("over_200mm", "{:.1%}"),
    "no offset": ("mean_mm_without_offset", "{:.1f}"),
    "in 95 %": ("inside_95", "{:.0%}"),
    "NEES": ("nees", "{:.1f}"),
}
"""Title, field of `PointScores` and format of each column."""


def print_scores(console: Console, scores: Scores) -> None:
    """Print the errors of points (thesis Table 7.2, and more) and angles (Table 7.1), and the covariances' coverage."""
    table = plain_table("error of the points (RMSE: thesis Table 7.2)", ["point"], ["RMSE mm", *POINT_COLUMNS])
    for point, name in enumerate(POINT_NAMES):
        table.add_row(name.replace("_", " "), f"{scores.points.rmse_mm[point]:.1f}", *_cells(scores.points, point))
    of_all, calls = scores.all_points, scores.calls
    table.add_row("all", f"{of_all.rmse_mm:.1f}", *_cells(of_all), style="bold")
    console.print(table)
    console.print(
        f"{scores.tracked} of {scores.frames} frames tracked; {100 * of_all.inside_95_without_offset:.0f} % of the "
        "errors inside their 95 % ellipsoid without constant offsets; NEES is 3 where the covariance is consistent"
    )
    console.print(
        f"doubt: of {calls.wrong.sum()} parts of the body with a point over 200 mm, called doubtful or lost: "
        f"{_percent(calls.flagged_of_bad)}; of {calls.clear.sum()} frames with all points below 100 mm, with any part "
        f"called: {_percent(calls.false_alarms)}"
    )
    console.print(_angles(scores.angles))
    console.print(f"truth: {scores.angles.source}; frames: where it determines the angle (see docs/how-to/evaluate.md)")


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if np.isfinite(share) else "-"


def _cells(scores: PointScores, point: int | tuple[()] = ()) -> list[str]:
    """Return the POINT_COLUMNS of a point, or of all points together."""
    values = ((np.asarray(getattr(scores, field))[point], shown) for field, shown in POINT_COLUMNS.values())
    return [shown.format(value).replace("%", " %") for value, shown in values]


def _angles(angles: AngleScores) -> Table:
    table = plain_table("RMSE (thesis Table 7.1)", ["angle"], ["rad", "deg", "frames"])
    rmse_rad, share = (angles.torso_rmse_rad, *angles.rmse_rad), (1.0, *angles.share_defined)
    for name, rad, defined in zip(("torso", *ANGLE_NAMES), rmse_rad, share, strict=True):
        table.add_row(name.replace("_", " "), f"{rad:.2f}", f"{np.rad2deg(rad):.1f}", f"{100 * defined:.0f} %")
    return table


def print_evaluation(console: Console, evaluated: TrackEvaluation) -> None:
    """Print the evaluation of a track: scores where there is a truth, states, time to track, jitter."""
    console.print(f"session {evaluated.session.folder}", style="bold")
    if evaluated.scores is not None:
        print_scores(console, evaluated.scores)
    else:
        console.print(f"{len(evaluated.track)} of {evaluated.frames} frames have a body; there is no truth")
    states = ", ".join(f"{state} in {count} frames" for state, count in evaluated.states.items())
    switches = "" if evaluated.switches is None else f"; {evaluated.switches} identity switches"
    console.print(f"tracking {evaluated.time_to_track_s:.2f} s after the first frame; {states}{switches}")
    resting = int(evaluated.at_rest.sum())
    console.print(f"jitter at rest: {evaluated.jitter_mm:.2f} mm rms ({resting} points in frames)")
    if evaluated.scores is not None and evaluated.thesis is not None:
        ratio = evaluated.thesis.mean_mm / evaluated.scores.mean_mm
        console.print(
            f"the thesis's method on the same hulls: mean {evaluated.thesis.mean_mm:.1f} mm, {ratio:.1f} times ours",
            style="bold",
        )


def print_people(console: Console, people: PeopleScores) -> None:
    """Print a row for each person of a session with several truths, where the rig shows that person."""
    columns = "numbers", *POINT_COLUMNS, "flagged", "alarms", "frames", "switches"
    table = plain_table("every person, where the rig shows them", ["truth"], columns)
    who = people.who
    for count, (of_person, scores, switches) in enumerate(
        zip(who.numbers, people.scores, who.switches, strict=True), 1
    ):
        name, numbers = f"person {count}", "+".join(map(str, of_person)) or "-"
        if scores is None:
            table.add_row(name, numbers, "no track")
            continue
        called = _percent(scores.calls.flagged_of_bad), _percent(scores.calls.false_alarms)
        frames = f"{scores.tracked} of {scores.frames}"
        table.add_row(name, numbers, *_cells(scores.all_points), *called, frames, str(switches))
    console.print(table)
    nobody = f"; tracks of nobody: {', '.join(map(str, who.ghosts))}" if who.ghosts else ""
    console.print(
        f"{sum(filter(None, who.switches))} identity switches; {who.ghost_frames} frames with a track of nobody{nobody}"
    )


def print_ablation(console: Console, rows: Mapping[str, Scores | None]) -> None:
    """Print one row a configuration, None where it found no body; ratio: the first row's mean to this one's."""
    table = plain_table("ablation: each row adds one part to the row above", ["method"], [*POINT_COLUMNS, "ratio"])
    first = next(iter(rows.values()), None)
    for name, scores in rows.items():
        if scores is None:
            table.add_row(name, "no body")
            continue
        better = "" if first is None else f"{first.mean_mm / scores.mean_mm:.1f}"
        table.add_row(name, *_cells(scores.all_points), better)
    console.print(table)


def print_ages(console: Console, ages_ms: Mapping[str, np.ndarray]) -> None:
    """Print the age of frame sets at each point, since exposure."""
    table = plain_table("since exposure", ["point"], ["p50 ms", "p95 ms", "max ms"])
    for name, values in ages_ms.items():
        table.add_row(name.removesuffix("_ms"), *(f"{v:.1f}" for v in np.percentile(values, [50, 95, 100])))
    console.print(table)


def print_nodes(console: Console, usage: Mapping[str, Usage], diagnostics: Mapping[str, Mapping[str, str]]) -> None:
    """Print one row a process and a node: memory; results."""
    table = plain_table("nodes", ["node"], ["resident MiB", "results"])
    results = {label_of(name): report.get("results", "") for name, report in diagnostics.items()}
    for label in dict.fromkeys([*usage, *results]):
        memory = f"{usage[label].resident_mib:.0f}" if label in usage else ""  # a node may share its process
        table.add_row(label, memory, results.get(label, ""))
    console.print(table)
