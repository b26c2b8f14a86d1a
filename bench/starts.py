"""Starts without a whole T-pose: people whom a rig cuts off, and people who walk in (for bench/acquisition.py)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from clips import Clip, Recorded
from scenes import studio_masks

from capture_rig import Rig
from capture_rig.rigid import rotation_matrix
from icp_tracker.initialization.body_sizes import ANKLE, SIZES, sizes_of_body
from mocap_packets.hull import HullProducts
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.motions.timeline import T_POSE_S
from virtual_studio.people import VolumetricBody
from virtual_studio.rig import narrowed, ring, tilted, with_camera

FPS = 30.0
HELD_S, ARRIVED_S, WALKED_S = 2.0, 2.0, 10.0  # the T-pose; the way to the middle; the walk that sizes are learnt from
SETTLED_S = 2.0  # at the end, over which the error is taken
FIRST_FRAME = 90  # of the recorded sets that begin with a T-pose
STARTED = {"hull_server.backend": "cpu", "icp_tracker.initial_pose.source": "auto"}


@dataclass(frozen=True)
class CutCase:
    """Somebody in a T-pose in a rig that does not show all of them: place (2,) m and heading, rad."""

    name: str
    rig: Rig
    place: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.4


def cut_cases(cameras: int = 3) -> list[CutCase]:
    """The same person in the middle and in places and rigs that cut a part off, by a ring of cameras."""
    rig = ring(cameras, ceiling=False)
    last = cameras - 1
    up, down = tilted(rig.cameras[last], 0.24), tilted(rig.cameras[last], -0.27)
    narrow = Rig(tuple(narrowed(camera, 1.45) for camera in rig.cameras), rig.volume)
    # the direction in which the last camera sees people from nearer: there its picture ends first
    way = rig.cameras[last].centre_world[:2] / np.linalg.norm(rig.cameras[last].centre_world[:2])
    near = (float(0.5 * way[0]), float(0.5 * way[1]))
    return [
        CutCase("in the middle", rig),
        CutCase("feet cut by one camera", with_camera(rig, last, up), near),
        CutCase("head cut by one camera", with_camera(rig, last, down), near),
        CutCase("an arm outside the volume", rig, (0.0, 0.95), 0.0),
        CutCase("at the volume's edge", rig, (1.25, 0.0), 0.0),
        CutCase("a lens too narrow", narrow),
    ]


@dataclass(frozen=True)
class Start:
    """How a start went: what was said in the first seconds, when the track began (s), its mean error (mm) in all and at
    the end, and the largest error of a size at the end (mm), and which; NaN and '' where there was no track."""

    told: str
    began_s: float = float("nan")
    mean_mm: float = float("nan")
    end_mm: float = float("nan")
    worst_size_mm: float = float("nan")
    worst_size: str = ""


def followed(
    rig: Rig, products: Iterable[HullProducts], truth: np.ndarray, fps: float, sizes: np.ndarray | None = None
) -> Start:
    """Track sets from their first on, automatically, and compare with the truth (F, 15, 3)."""
    follower = TrackingStage.of(Configuration.of(STARTED), rig)
    told, errors = "", {}
    for frame, seen in enumerate(products):
        first = follower.step(seen).people[0]
        fit, state = first.fit, first.state
        if state is None or follower.tracker.body_of(1) is None:
            if frame < HELD_S * fps and not fit.reason.startswith(("T-pose seen", "somebody is here", "no hull")):
                told = fit.reason
        elif np.isfinite(truth[frame]).all():
            errors[frame] = 1e3 * float(np.linalg.norm(state.points_world - truth[frame], axis=1).mean())
    if not errors:
        return Start(told)
    end = [error for frame, error in errors.items() if frame >= len(truth) - SETTLED_S * fps]
    body, worst, which = follower.tracker.body_of(1), float("nan"), ""
    if sizes is not None and body is not None:
        off = 1e3 * np.abs(sizes_of_body(body) - sizes)[:ANKLE]
        worst, which = float(off.max()), SIZES[int(off.argmax())]
    mean = float(np.mean(list(errors.values())))
    return Start(told, min(errors) / fps, mean, float(np.mean(end)) if end else float("nan"), worst, which)


def of_cut(case: CutCase, body: Body) -> Start:
    """Somebody takes a T-pose where the rig cuts them off, goes to the middle and walks there."""
    poses = cut_poses(case, body)
    truth = np.array([forward(body, pose) for pose in poses])
    clip = Clip.of(case.name, case.rig, FPS, studio_masks(case.rig, body, poses), truth=truth)
    return followed(case.rig, clip.carved({}), truth, FPS, sizes_of_body(body))


def cut_poses(case: CutCase, body: Body) -> list[Pose]:
    """A T-pose at the case's place and heading, the way to the middle, and a walk in a circle."""
    walk = MOTIONS["walk"](body, T_POSE_S + ARRIVED_S + WALKED_S, FPS).poses[round(T_POSE_S * FPS) :]
    turn = rotation_matrix(np.array([0.0, 0.0, case.heading]))
    far = np.r_[case.place, 0.0]
    legs = VolumetricBody(body).ankle_height + body.lengths[4] + body.lengths[8] + body.half_lengths[0]
    held = Pose.from_angles(np.r_[case.place, legs], turn, T_POSE_ANGLES)
    poses = [held] * round(HELD_S * FPS)
    for number, pose in enumerate(walk):
        share = min(number / (ARRIVED_S * FPS), 1.0)
        there = turn @ (pose.position_world * [1, 1, 0]) + far * (1.0 - share)
        place = np.array([there[0], there[1], pose.position_world[2]])
        poses.append(Pose(place, turn @ pose.R_world_torso, pose.R_joints, pose.hinges))
    return poses


def of_walk_in(what: Recorded) -> Start:
    """Somebody of a recorded set, whose T-pose is left out, or who took none."""
    first = FIRST_FRAME if np.isfinite(what.truths[0][: FIRST_FRAME // 2]).any() else 0
    return followed(what.rig, what.products[first:], what.truths[0][first:], what.fps)


def of_studio_walk(body: Body, build: float, rig: Rig, seconds: float = 6.0) -> Start:
    """Somebody who walks in a circle in the studio, from half a step on."""
    first = round((T_POSE_S + 0.4) * FPS)
    poses: Sequence[Pose] = MOTIONS["walk"](body, T_POSE_S + 0.4 + seconds, FPS, build).poses[first:]
    truth = np.array([forward(body, pose) for pose in poses])
    clip = Clip.of("walk", rig, FPS, studio_masks(rig, body, poses, build), truth=truth)
    return followed(rig, clip.carved({}), truth, FPS, sizes_of_body(body))
