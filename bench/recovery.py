"""Recovery drills: break a track on purpose, and measure the time until it is good again.

    python bench/recovery.py --quick                 # a minute
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

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Clip, session_clip
from scenes import studio_clip

from capture_rig.rigid import rotation_matrix
from icp_tracker.tracker import TRACKING
from mocap_packets.fit import FIRST_PERSON, Fit
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from mocap_packets.state import Tracking
from mocap_pipeline.pipeline import MocapPipeline, PersonStep, Step
from sagoma_tools.arguments import parse_settings
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES
from virtual_studio.motions.catalogue import HARD_CASES

MOTION_S = 6.0
MOTION_DRILLS = {"arm against the chest 2 s": "arm_on_chest", "left and came back": "leave_and_return"}
WRONG_SD_M = 0.02  # of which a wrong pose is sure
LEFT_HAND_POINT, NECK_POINT, ON_CHEST_M = 11, 2, 0.35
DISTURBED_AT, SPREAD = 0.45, 0.15
"""Where in the clip the disturbance begins, as a share of its length, and how far several moments spread around it."""

Figures = dict[str, float | None]
Column = dict[str, Figures]
WORST_POINT_M, MEAN_M, GOOD_FOR_S = 0.200, 0.060, 0.2
"""A track is good when no point is farther off than the first, and their mean is below the second, for so long."""
LEFT_WITH_RIGHT = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]

Answer = Step | None
Disturb = Callable[[MocapPipeline, Clip, int, Pose], Answer]


@dataclass(frozen=True)
class Drill:
    """A disturbance of so many seconds (at least one frame); `disturb` plays one frame and returns what came of it.

    Its arguments: the pipeline, the clip, the frame and the filter's pose before the drill. on_masks: it changes the
    silhouettes, so that the hull of every frame has to be carved anew.
    """

    name: str
    seconds: float
    disturb: Disturb
    on_masks: bool

    def frames(self, fps: float) -> int:
        """Length in frames."""
        return max(round(self.seconds * fps), 1)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a clip did to a track.

    points_world (F, 15, 3) m and errors_m (F, 15): the filter's points and their distance from the truth, NaN without
    track or truth; sure (F,): tracker and filter both say that they track.
    """

    points_world: np.ndarray
    errors_m: np.ndarray
    sure: np.ndarray

    def time_to_good(self, frame: int, fps: float) -> float | None:
        """Seconds from a frame to the first of GOOD_FOR_S good seconds; None if there are none."""
        wanted, run = max(round(GOOD_FOR_S * fps), 1), 0
        for row, good in enumerate(is_good(self.errors_m[frame:])):
            run = run + 1 if good else 0
            if run == wanted:
                return (row - wanted + 1) / fps
        return None


def play(
    clip: Clip, clouds: list[HullProducts], settings: dict[str, Any], drill: Drill | None = None, begin: int = 0
) -> Outcome:
    """Track the clip, whose undisturbed hulls are `clouds`, from its start to its end, disturbed from `begin` on."""
    pipeline, state, before = clip.pipeline(settings), None, None
    points, sure = np.full((len(clip), 15, 3), np.nan), np.zeros(len(clip), bool)
    for frame in range(len(clip)):
        step: Answer
        if drill is None or state is None or not begin <= frame < begin + drill.frames(clip.fps):
            step = _undisturbed(pipeline, clip, clouds, frame, drill is not None and drill.on_masks)
        else:
            before = before or state.pose
            step = drill.disturb(pipeline, clip, frame, before)
        if step is not None:
            state, sure[frame] = step.state or state, is_sure(step)
        if state is not None:
            points[frame] = state.points_world
    return Outcome(points, np.linalg.norm(points - clip.truth, axis=2), sure)


def _undisturbed(pipeline: MocapPipeline, clip: Clip, clouds: list[HullProducts], frame: int, carve: bool) -> Step:
    if carve:
        return pipeline.step_masks(clip.stamp_ns(frame), clip.masks(frame))
    return pipeline.body.step(clouds[frame])


def is_sure(step: Step) -> bool:
    """Whether tracker and filter both say that they track."""
    return (
        step.fit.state == TRACKING
        and not step.fit.reason
        and step.state is not None
        and (step.state.tracking == Tracking.TRACKING)
    )


def is_good(errors_m: np.ndarray) -> np.ndarray:
    """Whether each row (F, 15) of errors is a good track; False without a track, points without truth do not count."""
    known = np.isfinite(errors_m)
    mean = np.where(known, errors_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return known.any(axis=1) & (np.where(known, errors_m, 0.0).max(axis=1) < WORST_POINT_M) & (mean < MEAN_M)


def blank(pipeline: MocapPipeline, clip: Clip, frame: int, before: Pose) -> Answer:
    """Every camera delivers an empty silhouette."""
    masks = {name: np.zeros_like(mask) for name, mask in clip.masks(frame).items()}
    return pipeline.step_masks(clip.stamp_ns(frame), masks)


def missing(pipeline: MocapPipeline, clip: Clip, frame: int, before: Pose) -> Answer:
    """No frame set at all."""
    return None


def one_camera_lost(pipeline: MocapPipeline, clip: Clip, frame: int, before: Pose) -> Answer:
    """The second camera delivers nothing."""
    masks, lost = clip.masks(frame), clip.rig.names[1]
    return pipeline.step_masks(clip.stamp_ns(frame), {n: m for n, m in masks.items() if n != lost}, (lost,))


def wrong_pose(wrong: Callable[[Body, Pose], Pose]) -> Disturb:
    """Tracker and filter take a wrong pose, made of the right one, for certain."""

    def disturb(pipeline: MocapPipeline, clip: Clip, frame: int, before: Pose) -> Answer:
        tracking, stamp_ns = pipeline.body, clip.stamp_ns(frame)
        body = tracking.tracker.body_of(FIRST_PERSON)
        if body is None:
            return None
        pose, covariance = wrong(body, before), np.tile(WRONG_SD_M**2 * np.eye(3), (15, 1, 1))
        tracking.filters.of(FIRST_PERSON).reset()
        seen = np.ones(15, dtype=bool)
        fit = Fit(stamp_ns, TRACKING, "drill", "", 0, forward(body, pose), covariance, seen, pose, None)
        step = Step((PersonStep(fit, tracking.filter((fit,))[FIRST_PERSON]),))
        tracking.fit(HullProducts(stamp_ns, NO_CENTERLINE))  # a set without points leaves the tracker at the prediction
        return step

    return disturb


def heading_flipped(body: Body, pose: Pose) -> Pose:
    """Facing backward, every limb with it."""
    return replace(pose, R_world_torso=rotation_matrix(np.array([0.0, 0.0, np.pi])) @ pose.R_world_torso)


def sides_swapped(body: Body, pose: Pose) -> Pose:
    """Left and right change names: the same silhouette from most sides, the body facing backward."""
    return inverse(body, forward(body, pose)[LEFT_WITH_RIGHT])


def arm_folded_away(body: Body, pose: Pose) -> Pose:
    """The left hand at the left shoulder, elbow down."""
    angles = pose.angles()
    for name, value in (("shoulder_x", -1.4), ("shoulder_z", 0.0), ("shoulder_y", 0.0), ("elbow", -2.6)):
        angles[ANGLE_NAMES.index(f"left_{name}")] = value
    return Pose.from_angles(pose.position_world, pose.R_world_torso, angles)


def torso_beside(body: Body, pose: Pose) -> Pose:
    """The whole body 0.4 m to its left."""
    return replace(pose, position_world=pose.position_world + 0.4 * pose.R_world_torso[:, 1])


DRILLS = (
    Drill("blank 1 s", 1.0, blank, on_masks=True),
    Drill("10 sets missing", 10 / 60, missing, on_masks=False),
    Drill("camera lost 1 s", 1.0, one_camera_lost, on_masks=True),
    Drill("heading flipped", 0.0, wrong_pose(heading_flipped), on_masks=False),
    Drill("sides swapped", 0.0, wrong_pose(sides_swapped), on_masks=False),
    Drill("arm folded away", 0.0, wrong_pose(arm_folded_away), on_masks=False),
    Drill("torso 0.4 m off", 0.0, wrong_pose(torso_beside), on_masks=False),
)


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
    given = parser(__doc__, quick="the studio's walk alone, each drill once")
    given.add_argument("sessions", nargs="*", type=Path, help="session folders with a reference")
    given.add_argument("--exact", action="store_true", help="the sessions' exact silhouettes, not their footage")
    given.add_argument("--motion", nargs="*", default=["tour", "walk"], help="motions of the virtual studio")
    given.add_argument("--moments", type=int, default=1, help="how often each drill is held, at as many moments")
    add_settings(given)
    arguments = given.parse_args()
    if arguments.quick:
        arguments.motion, arguments.sessions, arguments.moments = ["walk"], [], 1
    settings = parse_settings(arguments.settings)
    drills = MOTION_DRILLS if arguments.motion and not arguments.quick else ()
    motions = {name: moved(name, settings) for name in drills}
    clips = [studio_clip(motion, MOTION_S) for motion in arguments.motion]
    clips += [session_clip(folder, arguments.exact) for folder in arguments.sessions]
    columns = {clip.name: drilled(clip, settings, arguments.moments) for clip in clips}
    if motions:
        columns["itself"] = motions
    print_table(columns)
    finish(columns)


if __name__ == "__main__":
    execute(main)
