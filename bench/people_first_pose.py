"""First poses: what the T-pose tells of limb lengths; starts of people whom a rig cuts off, and who walk in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice, product
from pathlib import Path

from report import Table

import numpy as np
from clips import Clip, Recorded, canvas_masks, session_with_truth
from people_sets import BUILDS as WALKERS
from people_sets import recorded
from scenes import studio_masks

from capture_rig import Rig
from capture_rig.rigid import rotation_matrix
from capture_rig.session import Session, footage_stamp_ns
from capture_rig.visibility import RigVisibility
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.initialization.body_sizes import ANKLE, MEAN_OVER_STATURE, SIZES, body_of_sizes, sizes_of_body
from icp_tracker.initialization.hull_source import HullSource, TPoseSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import HullProducts
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from mocap_pipeline.session_footage import EPOCH_NS
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.motions.timeline import T_POSE_S
from virtual_studio.people import VolumetricBody, person_of
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import narrowed, ring, tilted, with_camera

UNUSUAL = (  # stature, m; build; length of arms and legs, over the average's: small, slim, stout, tall and stout
    *((1.30, 1.0, 1.0, 1.0), (1.80, 0.8, 1.03, 1.04), (1.70, 1.45, 1.0, 1.0), (1.95, 1.3, 1.04, 1.03)),
)
LONGEST = 60  # sets of a session that are looked at
FPS = 30.0
HELD_S, ARRIVED_S, WALKED_S = 2.0, 2.0, 10.0  # the T-pose; the way to the middle; the walk that sizes are learnt from
SETTLED_S = 2.0  # at the end, over which the error is taken
FIRST_FRAME = 90  # of the recorded sets that begin with a T-pose
STARTED = {"hull_server.backend": "cpu", "icp_tracker.initial_pose.source": "auto"}


def of_session(session: Session, exact: bool) -> dict[str, object]:
    """The first pose that a session's footage gives: errors of the sizes, of the points, of the heading."""
    pipeline = HullPipeline(session.rig, HullSettings(backend="cpu"))
    source = HullSource(TPoseSettings(), None, RigVisibility(session.rig))
    points = session.truth.stick_figure_points()
    for frame, frame_masks in enumerate(islice(canvas_masks(session, exact), LONGEST)):
        stamp_ns = footage_stamp_ns(EPOCH_NS, frame, session.fps)
        answer = source.find_pose(pipeline.run(FrameSet.of_instant(stamp_ns, frame_masks)).products)
        if answer.pose is not None:
            truth, found = points[frame], forward(answer.body, answer.pose)
            (x, y), across = (truth[3] - truth[4])[:2], (found[3] - found[4])[:2]  # from shoulder to shoulder
            off_rad = np.arctan2(across @ [y, -x], across @ [x, y])
            return {
                "sets": frame + 1,
                "sizes_mm": mm(answer.estimate.sizes - sizes_of_body(Body.from_points(points))),
                "points_mm": round(1e3 * float(np.linalg.norm(found - truth, axis=1).mean()), 1),
                "heading_deg": round(float(np.degrees(off_rad)), 1),
            }
    return {"sets": None, "reason": answer.reason}


def mm(metres: np.ndarray) -> list[float]:
    return list(np.round(1e3 * metres, 1).tolist())


def of_people(cameras: int, ceiling: bool, number: int) -> dict[str, object]:
    """Many people in the studio: mean and rms error of each size, refusals, and how many are taken back to front."""
    rng, errors, claims, refused, backward = np.random.default_rng(cameras), [], [], [], 0
    for body, pose, products, visibility in hulls_of_people(cameras, ceiling, number, rng):
        answer = HullSource(TPoseSettings(hold_sets=1), None, visibility).find_pose(products)
        if answer.pose is None:
            refused.append(answer.reason)
            continue
        backward += int(answer.pose.R_world_torso[:, 0] @ pose.R_world_torso[:, 0] < 0.0)
        estimate, truth = answer.estimate, sizes_of_body(body)
        truth[SIZES.index("ankle_height")] = VolumetricBody(body).ankle_height
        errors.append(estimate.sizes - truth)
        claims.append(errors[-1] / estimate.sd)
    return {
        "people": number,
        "found": len(errors),
        "refused": refused,
        "back_to_front": backward,
        "mean_mm": mm(np.mean(errors, axis=0)),
        "rms_mm": mm(np.sqrt(np.mean(np.square(errors), axis=0))),
        "rms_over_sd": np.round(np.sqrt(np.mean(np.square(claims), axis=0)), 2).tolist(),
    }


def hulls_of_people(cameras: int, ceiling: bool, number: int, rng: np.random.Generator) -> Iterator[tuple]:
    """Body, pose and hull products of random people in a T-pose, arms 15 degrees up to down, elbows a little bent."""
    rig = ring(cameras, ceiling=ceiling)
    visibility = RigVisibility(rig)
    eyes, pipeline = ExactSilhouettes(rig), HullPipeline(rig, HullSettings(backend="cpu"))
    for k in range(number):
        body = body_of_sizes(MEAN_OVER_STATURE * rng.uniform(1.4, 2.05) * rng.uniform(0.95, 1.05, len(SIZES)))
        pose = t_pose(body, rng)
        parts = VolumetricBody(body).place(pose)
        parts.radii[:] *= rng.uniform(0.85, 1.25)
        masks = eyes.render(parts)
        stamp_ns = (k + 1) * 1_000_000_000
        hull = pipeline.run(FrameSet.of_instant(stamp_ns, masks))
        yield body, pose, hull.products, visibility


def t_pose(body: Body, rng: np.random.Generator) -> Pose:
    u, angles = rng.uniform, T_POSE_ANGLES.copy()
    raised, spread = u(-0.26, 0.26), u(0.0, 0.15)
    values = {
        "left_shoulder_x": raised,
        "right_shoulder_x": np.pi - raised + u(-0.05, 0.05),
        "left_elbow": -u(0.0, 0.3),
        "right_elbow": -u(0.0, 0.3),
        "left_hip_x": spread,
        "right_hip_x": -spread,
    }
    for name, value in values.items():
        angles[ANGLE_NAMES.index(name)] = value
    heading = u(-np.pi, np.pi)
    R = np.array([[np.cos(heading), -np.sin(heading), 0.0], [np.sin(heading), np.cos(heading), 0.0], [0.0, 0.0, 1.0]])
    lowest = forward(body, Pose.from_angles(np.zeros(3), R, angles))[13:, 2].min()
    return Pose.from_angles(np.r_[u(-0.2, 0.2, 2), VolumetricBody(body).ankle_height - lowest], R, angles)


def first_pose(sessions: list[Path], kept: Path, quick: bool) -> dict[str, object]:
    """For every session that begins with a T-pose, from exact and from segmented silhouettes, and for people of random
    stature, proportions, build, place and heading in the virtual studio, with six and with three cameras. A row of the
    table is one input; a cell is the error of a size in mm (of many people: mean and rms).
    """
    results: dict[str, dict[str, object]] = {}
    for folder in sessions:
        session = session_with_truth(folder)
        for exact in (True,) if quick else (True, False):
            results[f"{folder.name}, {'exact' if exact else 'own'} silhouettes"] = of_session(session, exact)
    for cameras, ceiling in ((5, True), (3, False)):
        results[f"studio, {cameras + ceiling} cameras"] = of_people(cameras, ceiling, 10 if quick else 60)
    table = Table({"input": "<30", "figure": "<10", **{name[:9]: ">9.4g" for name in SIZES}})
    for name, result in results.items():
        for key in ("sizes_mm", "mean_mm", "rms_mm", "rms_over_sd"):
            if key in result:
                table.row(name[:30], key, *result[key])
        rest = {key: value for key, value in result.items() if not isinstance(value, list) or key == "refused"}
        print(f"{name[:30]:30} {rest}")
    return {"sizes": list(SIZES), **results, **of_starts(kept, quick)}


def of_starts(products: Path, quick: bool) -> dict[str, dict[str, object]]:
    """Print the tables of people who are cut off, and of people who walk in."""
    results: dict[str, dict[str, object]] = {}
    columns = "start:<44 | s:>5.1f | mean:>6.1f | end:>6.1f | size:>6.0f | which:<20 | told:<90"
    table = Table(columns, "cut off in a T-pose, then 10 s of walking; s to the track, mm, largest error of a size, mm")
    for stature, case in product((1.75,) if quick else (1.62, 1.75, 1.88), cut_cases()):
        _put(table, results, f"{case.name}, {stature:.2f} m", of_cut(case, Body.from_stature(stature)))
    table, walked = Table(columns, "walking in, no T-pose"), []
    for (stature, build, arms, legs), cameras in product((*WALKERS, *UNUSUAL), (3, 6) if quick else (3, 4, 6, 8)):
        rig, name = ring(cameras, ceiling=False), f"studio, {cameras} cameras, {stature:.2f} m, build {build:g}"
        _put(table, results, name, of_studio_walk(person_of(stature, arms, legs), build, rig))
        walked.append(results[name])
    for what in recorded(products, ["walk_ring5top", "charleston_ring5top", "zombie_he3", "walkin"]):
        _put(table, results, what.name, of_walk_in(what))
    began_s, end_mm = ([walk[key] for walk in walked] for key in ("began_s", "end_mm"))
    ends = {"least_mm": np.nanmin(end_mm), "most_mm": np.nanmax(end_mm)}
    return results | {"walking_in": {"began_s": np.nanmedian(began_s), "latest_s": np.nanmax(began_s), **ends}}


def _put(table: Table, results: dict[str, dict[str, object]], name: str, start: Start) -> None:
    results[name] = asdict(start)
    told = start.told
    table.row(name, start.began_s, start.mean_mm, start.end_mm, start.worst_size_mm, start.worst_size, told)


# --- starts without a whole T-pose


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
