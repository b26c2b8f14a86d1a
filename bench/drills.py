"""What can befall a tracker, and what it made of it: disturbances of a clip, and the time until the track is good."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from clips import Clip

from capture_rig.rigid import rotation_matrix
from icp_tracker.tracker import TRACKING
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.hull import HullProducts
from mocap_packets.state import Tracking
from mocap_pipeline.pipeline import MocapPipeline, Step
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES

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


def good_spells(errors_m: np.ndarray, seconds: np.ndarray) -> tuple[list[float], list[float]]:
    """When a track (F, 15) at these seconds (F,) stopped being good, and when it was good again for GOOD_FOR_S."""
    lost: list[float] = []
    found: list[float] = []
    good_since: float | None = None
    for good, t in zip(is_good(errors_m), seconds, strict=True):
        if not good:
            good_since = None
            if len(lost) == len(found):
                lost.append(float(t))
            continue
        good_since = float(t) if good_since is None else good_since
        if len(lost) > len(found) and t - good_since >= GOOD_FOR_S:
            found.append(good_since)
    return lost, found


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
        body = pipeline.body.tracker.body_of(FIRST_PERSON)
        return None if body is None else pipeline.body.restart_at(clip.stamp_ns(frame), wrong(body, before))

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
