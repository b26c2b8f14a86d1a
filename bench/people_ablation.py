"""What each part of tracker and filter is worth: the sets of bench/people.py, one part taken out in every row.

Parts that no setting switches off are replaced for the row by what does nothing. Sets of other makers' people
(avatar_...), which nothing was tuned on, are pooled by the number of cameras, those called held by themselves.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any
from unittest.mock import patch

from report import Table

import numpy as np
from clips import Recorded
from people_sets import states_of
from people_studies import SHOWN_ERRORS, Calls, Errors, figures

from icp_tracker.refinement.shape import BUILD, ShapePrior
from icp_tracker.tracker import IcpTracker
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from sagoma_tools.evaluation.in_process import OURS, ablation_rows
from sagoma_tools.evaluation.scores import LARGE_ERROR_MM
from stick_figure.least_squares.extremities import STIFF_SD
from stick_figure.least_squares.gauss_newton import Data

LEAST_MM, LEAST_SHARE = 0.5, 0.01
"""What a part has to bring in some column to be worth its code."""
FIT, MONITOR, FILTER = "icp_tracker.articulated_fit.", "icp_tracker.monitor.", "ekf_tracker.track."
TRACKER, REFINEMENT = "icp_tracker.tracker.IcpTracker.", "icp_tracker.refinement."
SOURCE, TRACK_MONITOR = "icp_tracker.initialization.hull_source.", MONITOR + "track_monitor.TrackMonitor."
RIGID_TRUNK_SD = np.full(7, 1e-6)  # rad and m that it bends by


@dataclass(frozen=True)
class Change:
    """What a row changes: fields of the configuration by dotted name, not all of them parameters; names in modules and
    classes, and what replaces them; blind : without what the rig does not show."""

    fields: Mapping[str, object] = field(default_factory=dict)
    names: Mapping[str, object] = field(default_factory=dict)
    blind: bool = False


def without_centerline(self: IcpTracker, seen: HullProducts, data: Any = IcpTracker._data) -> Data:
    """Lay out all but the centerline, once there is a pose."""
    return data(self, seen if self.pose is None else replace(seen, centerline=NO_CENTERLINE))


def average_build(estimate: Any, of: Any = ShapePrior.of) -> ShapePrior:
    """Return the prior of a body whose build is known to be the average."""
    prior = of(estimate)
    prior.covariance[BUILD, BUILD] = 1e-12 * np.eye(len(prior.covariance[BUILD]))
    return prior


def lengths_as_measured(self: IcpTracker, found: Any, make: Any = IcpTracker._new_refiner) -> Any:
    """Return what refines the build alone."""
    return make(self, replace(found, estimate=None))


def same_quality(self: object, quality: Any) -> Any:
    """Return the quality as it was."""
    return quality


def nothing(*_: Any, **__: Any) -> None:
    """Do nothing, find nothing."""


MISFIT = {MONITOR + "body_filter.BodyFilter.with_misfit": same_quality}
NO_BODY_FILTER = MISFIT | {
    MONITOR + "body_filter.BodyFilter.with_other": same_quality,
    TRACK_MONITOR + "_changed_body": nothing,
}
NO_TRUNK = {
    REFINEMENT + "bend_estimator.TrunkBendEstimator.update": nothing,
    REFINEMENT + "body_refiner.REST_SD": RIGID_TRUNK_SD,
}
NO_ENDS = {FIT + "TURN_SD": STIFF_SD, REFINEMENT + "body_refiner.TURN_SD": STIFF_SD}
ONE_GIRTH = {SOURCE + "LITTLE_SHARE": 0.0}
CHANGES: dict[str, Change] = {
    # the data and what they are compared with
    "without the centerline (slices)": Change(names={TRACKER + "_data": without_centerline}),
    "without the hull's surface": Change({"icp.articulated.volume.weight": 0.0}),
    "without contour rays": Change({"icp.articulated.contour.weight": 0.0}),
    "without what the rig cannot show": Change(blind=True),
    "loose prior of the fit": Change({"icp.articulated.prior": 4.0}),
    "fits start from the fit before": Change({"feedback": False}),
    # the body
    "rigid trunk": Change({"ekf.bend": 0.0}, NO_TRUNK),
    "stiff hands and feet": Change(names=NO_ENDS),
    "average build": Change(names=ONE_GIRTH | {REFINEMENT + "shape.ShapePrior.of": staticmethod(average_build)}),
    "joint centres of the figure": Change(names={FIT + "with_joint_centres": lambda body, pose, points: points}),
    "no refinement of lengths and build": Change({"icp.refinement.keyframes": 0}),
    "lengths as measured at first": Change(names={TRACKER + "_new_refiner": lengths_as_measured}),
    # the first pose
    "first pose: no sizes of the T-pose": Change(names={SOURCE + "with_t_pose": lambda estimate, *_: estimate}),
    "first pose: one girth": Change(names=ONE_GIRTH),
    # the monitor
    "no search for poses of limbs and body": Change({"icp.recovery.search": False}),
    "no limb search and limb filter": Change(names={TRACK_MONITOR + "_update_limbs": nothing}),
    "no body filter": Change(names=NO_BODY_FILTER),
    "limb and body filter without memory": Change(names={MONITOR + "limb_filter.MEMORY_S": 1e-9}),
    "a limb not found is never doubted": Change(names={MONITOR + "limb_filter.UNFOUND_LOG_PRIOR": -1e3}),
    "a body that explains little is not doubted": Change(names=MISFIT),
    "doubt does not widen covariances": Change(names={TRACK_MONITOR + "_spread": nothing}),
    # the filter
    "identity model": Change({"ekf.motion_model": "identity"}),
    "no joint limits in the filter": Change({"ekf.limit_sd_rad": 0.0}),
    "nothing known of a limb is released": Change(
        names={FILTER + "BodyTrack._release_limbs": lambda self, prior, anew: prior}
    ),
    "every error new in every set": Change({"ekf.measurement_bias.share": 0.0}),
    "joints known for certain": Change({"ekf.measurement_bias.joints": 0.0}),
    "sizes known for certain": Change(names={TRACKER + "_with_sizes": lambda self, fit: fit.covariance}),
    # no part: what chance makes of the same tracker
    "control: limbs are searched in another order": Change(
        names={MONITOR + "track_monitor.LIMB_TURNS": (1, 0, 3, 1, 0, 2)}
    ),
}


def ablation(sets: Iterable[Recorded]) -> dict[str, Any]:
    """From the thesis's method to ours, a part more in each row, then rows that take one away from ours.

    A cell is the mean error of the 15 points in mm / the share of the tracked frames with a point more than 200 mm off,
    of the first persons of a column's sets; brings : the most, over the columns, by which a row is worse than ours, mm
    (as it is or without constant offsets) and share of the frames (over 200 mm, or untracked). A second table says of
    all sets together which share of the parts more than 200 mm off is called doubtful or lost, of the clear frames with
    any part called, and of the parts with all points inside
    the track's own 95 % ellipsoids.
    """
    found: dict[str, dict[str, list[tuple[Errors, Calls]]]] = {}
    for what in sets:
        if len(what.truths) != 1:
            continue
        for row, judged in judged_rows(what).items():
            found.setdefault(row, defaultdict(list))[column_of(what)].append(judged)
            print(f"{what.name}: {row}: {_cell(pooled([judged[0]]))}", flush=True)
    columns = {row: {name: pooled([e for e, _ in each]) for name, each in of.items()} for row, of in found.items()}
    shown = Table({"mm / over 200 mm": "", **dict.fromkeys(columns.get(OURS, ()), ""), "brings": ""}, markdown=True)
    brings = {}
    for row, cells in columns.items():
        brings[row] = worth(cells, columns[OURS]) if row in CHANGES else None
        shown.row(row, *map(_cell, cells.values()), brings[row] and "{:.1f} mm, {:.1%}".format(*brings[row]))
    doubt = doubt_of({row: [calls for each in of.values() for _, calls in each] for row, of in found.items()})
    little = [row for row, most in brings.items() if most and most[0] < LEAST_MM and most[1] < LEAST_SHARE]
    print(f"less than {LEAST_MM} mm and {LEAST_SHARE:.0%} in every column: {'; '.join(little)}")
    rounded = {
        row: {name: {key: round(cell[key], 4) for key in SHOWN_ERRORS} for name, cell in cells.items()}
        for row, cells in columns.items()
    }
    return {"rows": rounded, "brings": brings, "doubt": doubt, "little": little}


def pooled(several: list[Errors]) -> dict[str, float]:
    """The figures of a cell: frames over 200 mm by the errors as they are."""
    mm = np.concatenate([errors.mm for errors in several])
    worst = np.nanmax(mm, axis=1, initial=0.0)[np.isfinite(mm).any(axis=1)]
    return {**figures(several), "over_200mm": float(np.mean(worst > LARGE_ERROR_MM))}


def column_of(what: Recorded) -> str:
    """The column that a set belongs to."""
    words, cameras = what.name.split("_"), len(what.rig.cameras)
    if words[0] != "avatar":
        return what.name
    return f"{'held out' if words[1] == 'held' else 'others'}, {'6 or 8' if cameras > 4 else cameras} cameras"


def judged_rows(what: Recorded) -> dict[str, tuple[Errors, Calls]]:
    """Every row's errors and calls on a set."""
    start = {"hull_server.backend": "cpu", **what.start}
    rows = {name: (configuration, Change()) for name, configuration in ablation_rows(start).items()}
    ours = rows[OURS][0]
    rows |= {name: (reduce(with_field, change.fields.items(), ours), change) for name, change in CHANGES.items()}
    return {name: judged(what, *row) for name, row in rows.items()}


def judged(what: Recorded, configuration: Configuration, change: Change) -> tuple[Errors, Calls]:
    """Errors and calls on a set with a part replaced."""
    with ExitStack() as replaced:
        for name, value in change.names.items():
            replaced.enter_context(patch(name, value))
        states = states_of(what, TrackingStage.of(configuration, None if change.blind else what.rig))
    return Errors.of_states(what, states), Calls.of_states(what, states)


def with_field(whole: Any, change: tuple[str, object]) -> Any:
    """A nested dataclass with one field changed, by its dotted name."""
    name, _, rest = change[0].partition(".")
    return replace(whole, **{name: with_field(getattr(whole, name), (rest, change[1])) if rest else change[1]})


def worth(cells: Mapping[str, Mapping[str, float]], ours: Mapping[str, Mapping[str, float]]) -> tuple[float, float]:
    """The most by which the columns of a row are worse than ours: mm, and share of the frames."""
    off = {key: [cells[name][key] - ours[name][key] for name in ours] for key in SHOWN_ERRORS}
    mm, share = np.nanmax([off["mean_mm"], off["without_offset_mm"]]), np.nanmax([off["over_200mm"]])
    return round(float(mm), 2), round(float(max(share, -min(off["tracked"]))), 4)


def doubt_of(calls: Mapping[str, list[Calls]]) -> dict[str, dict[str, Any]]:
    """Print the second table."""
    shown = Table("of all sets:<46 | wrong:>6d | called:>7.1% | clear:>6d | also called:>12.2% | inside:>7.1%")
    doubt = {}
    for row, several in calls.items():
        whole = Calls.together(several).figures()
        doubt[row] = {key: whole[key] for key in ("wrong_parts", "wrong_called", "clear_frames", "clear_called")}
        doubt[row]["parts_inside"] = whole["parts_inside"]
        shown.row(row, *doubt[row].values())
    return doubt


def _cell(found: Mapping[str, float]) -> str:
    """A cell of the first table."""
    if not found["tracked"] > 0.0:
        return "no body"
    lost = "" if found["tracked"] > 0.9 else f" ({found['tracked']:.0%} tracked)"
    return "{mean_mm:.1f} / {over_200mm:.1%}".format(**found) + lost
