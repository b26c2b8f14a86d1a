"""Tracking on synthetic sticks: our methods, the thesis's, and the statistical bound.

    python bench/tracking.py [--quick]

1. Moving stick figures, 300 noisy points a frame, trackers from the true first pose: mean error of the 15 points.
2. Time of one set with 500 points and 1500 voxels.

Times are CPU time of one thread. The last line is JSON: {"mean_mm", "default_mean_mm", "alone_mean_mm",
"thesis_mean_mm", "bound_mm", "icp_ms", "ekf_ms"}; "mean_mm" is that of our chain told that the data are sticks,
"alone_mean_mm" that of the same fit without the filter's prediction.
"""

from __future__ import annotations

from report import Table, execute, finish, parser

import numpy as np
from synthetic.bounds import BOUND_EVERY, SETTLED, Bounds, bounds
from synthetic.clips import FPS, POINTS, Clip, clouds, random_clip, studio_clip
from synthetic.trackers import Method, Run, all_joints_alone, chain, chain_for_sticks, thesis, times_ms, track

from virtual_studio.motions.catalogue import MOTIONS

LOST_M = 0.2
"""A clip is lost when a point is farther off than this at its end."""
QUICK_CLIPS = ("tour", "walk")
QUICK_S, FULL_S = 4.0, 6.0


def main() -> None:
    """Print the tables and the line of JSON."""
    quick = parser(__doc__, quick="few, short clips: under a minute").parse_args().quick
    names = QUICK_CLIPS if quick else [name for name in MOTIONS if name != "t_pose_only"]
    clips = [studio_clip(name, QUICK_S if quick else FULL_S) for name in names]
    figures = protocol(clips + [random_clip(seed) for seed in range(1 if quick else 4)])
    finish(figures | times_ms(studio_clip("tour", 2.0 if quick else QUICK_S)))


def protocol(clips: list[Clip]) -> dict[str, float]:
    """Print the table of the trackers and the bounds, clip by clip; returns the means."""
    methods = (thesis(0.1), thesis(), all_joints_alone(), chain_for_sticks(), chain())
    runs: dict[Method, list[Run]] = {method: [] for method in methods}
    limits: list[Bounds] = []
    noise_mm = 1e3 * clips[0].sigma_m
    print(
        f"{len(clips)} clips at {FPS:g} Hz, {POINTS} points, noise of a sixth of the hips' distance, {noise_mm:.0f} mm"
    )
    columns = ("thesis 0.1", "thesis 0.2", "all joints", "told sticks", "defaults")
    table = Table(
        {"clip": "<24", "frames": ">6d", **dict.fromkeys(columns, ">11"), "bound": ">10.1f"},
        "mean error of the 15 filtered points, mm (+: at the end a point is over 200 mm off)",
    )
    for seed, clip in enumerate(clips):
        points = clouds(clip, seed)
        for method in methods:
            runs[method].append(track(method, clip, points, clip.sigma_m))
        limits.append(bounds(clip, BOUND_EVERY, SETTLED))
        table.row(clip.name, len(clip.poses), *(_cell(run[-1]) for run in runs.values()), limits[-1].mm)
    _print_means(runs, limits)
    theirs = runs[thesis()]
    return {
        "mean_mm": _rounded(mean_mm(runs[chain_for_sticks()])),
        "default_mean_mm": _rounded(mean_mm(runs[chain()])),
        "alone_mean_mm": _rounded(mean_mm(runs[all_joints_alone()])),
        "thesis_mean_mm": _rounded(min(mean_mm(theirs), mean_mm(theirs, fitted=True))),
        "bound_mm": _rounded(float(np.mean([limit.mm for limit in limits]))),
    }


def mean_mm(runs: list[Run], fitted: bool = False) -> float:
    """Mean over the clips of the mean error after the start, mm, of the filter's points or of the fit's."""
    return float(np.mean([1e3 * (run.fitted if fitted else run.filtered)[SETTLED:].mean() for run in runs]))


def _cell(run: Run) -> str:
    return f"{1e3 * run.filtered[SETTLED:].mean():.1f}{'+' if run.filtered[-1].max() > LOST_M else ' '}"


def _print_means(runs: dict[Method, list[Run]], limits: list[Bounds]) -> None:
    table = Table(
        "mean of all clips:<44 | fit mm:>7.1f | filter mm:>9.1f | lost:>5d | inside 95 %:>11.0% | "
        "fit ms:>7.2f | filter ms:>9.2f"
    )
    for method, run in runs.items():
        lost = sum(r.filtered[-1].max() > LOST_M for r in run)
        inside = float(np.mean([r.inside[SETTLED:].mean() for r in run]))
        icp_ms, ekf_ms = (np.median(np.concatenate(ms)) for ms in ([r.icp_ms for r in run], [r.ekf_ms for r in run]))
        table.row(method.name, mean_mm(run, fitted=True), mean_mm(run), lost, inside, icp_ms, ekf_ms)
    for name, one, all_so_far in (
        ("bound: which place a point is of, unknown", "frame_mm", "mm"),
        ("bound, were it known", "labelled_frame_mm", "labelled_mm"),
    ):
        values = [float(np.mean([getattr(limit, key) for limit in limits])) for key in (one, all_so_far)]
        table.row(name, *values, None, None, None, None)


def _rounded(mm: float) -> float:
    return round(mm, 2)


if __name__ == "__main__":
    execute(main)
