"""What each term of the all-joints solve is worth: the whole chain, videos in, once a row and a session.

    python bench/tracking_ablation.py SESSION [SESSION ...] [--exact]

Every session is carved once; then filter and solver run over its hulls once a row. A cell is the mean error of the 15
points in mm / the share of frames with a point more than 200 mm off / the share of point errors inside the track's own
95 % ellipsoid. --exact takes the sessions' exact silhouettes instead of segmenting their footage. The last line is
JSON: {row: {session: {"mean_mm", "over_200mm", "inside_95"}}}.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from capture_rig.errors import InputError
from capture_rig.frame_set import FrameSet
from capture_rig.session import Session, footage_stamp_ns, load_session
from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.state import EkfState
from hull_server.pipeline import HullPipeline
from icp_tracker.pose_source import make_pose_source
from icp_tracker.tracker import IcpTracker
from icp_tracker.voxel_cloud import VoxelCloud
from sagoma_tools.evaluation.in_process import EPOCH_NS, Configuration, Feedback, exact_silhouettes, silhouettes
from sagoma_tools.evaluation.scores import Scores, score
from sagoma_tools.evaluation.track import Track
from sagoma_tools.live_run import start_settings

SOLVE = "icp_tracker.articulated."
NO_SURFACE = {SOLVE + "volume.worth": 0.0}
NO_INSIDE = {SOLVE + "volume.inside_worth": 0.0}
NO_CLEARANCE = {SOLVE + "volume.clearance_worth": 0.0}
LOOSE_PRIOR = {
    SOLVE + "prior.position_sd_m": 1.0, SOLVE + "prior.rotation_sd": 1.0,
    SOLVE + "prior.ball_sd": 0.7, SOLVE + "prior.hinge_sd": 0.7,
}  # fmt: skip
THESIS = {"icp_tracker.method": "hierarchical", "ekf_tracker.motion_model": "identity"}
ROWS: dict[str, dict[str, object]] = {
    "thesis: hierarchical ICP, identity model": THESIS,
    "all joints, centerline alone": NO_SURFACE | NO_INSIDE,
    "+ inside": NO_SURFACE,
    "+ surface": NO_INSIDE,
    "all terms (default)": {},
    "default, surface trusted in any hull": {SOLVE + "volume.tight_m": 1e3},
    "default, loose prior": LOOSE_PRIOR,
    "default, arms may cross the torso": NO_CLEARANCE,
    "default, no floor of the covariance": {SOLVE + "joint_sd_m": 0.0},
    "default, visible by centerline only": {SOLVE + "support_voxels": 1_000_000},
    "default, identity model": {"ekf_tracker.motion_model": "identity"},
}


@dataclass(frozen=True, eq=False)
class Hull:
    """What the hull node publishes of one frame set."""

    stamp_ns: int
    points_world: np.ndarray
    sigma: np.ndarray
    voxels: VoxelCloud


def carve(session: Session, exact: bool) -> list[Hull]:
    """The hulls of all frames, with the default settings."""
    configuration = Configuration.of({"hull_server.backend": "cpu"})
    pipeline, hulls = HullPipeline(session.rig, configuration.hull), []
    masks = exact_silhouettes(session) if exact else silhouettes(session, configuration.camera)
    for frame, frame_masks in enumerate(masks):
        stamp_ns = footage_stamp_ns(EPOCH_NS, frame, session.fps)
        result = pipeline.run(FrameSet(stamp_ns, frame_masks, dict.fromkeys(frame_masks, stamp_ns), ()))
        points, sigma, voxels = (
            array.astype(np.float32).astype(np.float64)
            for array in (result.centerline.points_world, result.centerline.sigma, result.voxels.points_world)
        )
        hulls.append(Hull(stamp_ns, points, sigma, VoxelCloud.checked(voxels, result.voxels.surface)))
    return hulls


def follow(session: Session, hulls: list[Hull], settings: dict[str, object]) -> Scores:
    """Track the hulls with these settings and score the track against the session's truth."""
    configuration = Configuration.of({**start_settings(session, "auto"), **settings})
    icp = IcpTracker(make_pose_source(configuration.icp.initial_pose, configuration.icp.body_file), configuration.icp)
    ekf: ArticulatedEkf | None = None
    feedback: Feedback | None = None
    states: dict[int, EkfState] = {}
    for frame, hull in enumerate(hulls):
        fit = icp.step(hull.stamp_ns, hull.points_world, hull.sigma, hull.voxels, feedback)
        if ekf is None and icp.body is not None:
            ekf = ArticulatedEkf(icp.body, configuration.ekf)
        if ekf is None:
            continue
        state = ekf.step(hull.stamp_ns, fit.reference_points_world, fit.covariance, fit.visible)
        if isinstance(state, EkfState):
            states[frame] = state
            feedback = Feedback(hull.stamp_ns, state.pose, state.drift)
    if not states or session.truth is None:
        raise InputError("no body was found, or there is no reference", where=str(session.folder))
    columns = zip(*((s.points_world, s.point_covariance, s.angles) for s in states.values()), strict=True)
    return score(Track(np.array(list(states)), *(np.stack(column) for column in columns)), session.truth)


def main() -> None:
    """Print the table, row by row, and the line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="+", type=Path, help="session folders with a reference")
    parser.add_argument("--exact", action="store_true", help="exact silhouettes instead of segmented footage")
    arguments = parser.parse_args()
    sessions = [load_session(folder) for folder in arguments.sessions]
    hulls = [carve(session, arguments.exact) for session in sessions]
    names = [session.folder.name for session in sessions]
    print(f"| mm / over 200 mm / inside 95 % | {' | '.join(names)} |")
    print("|---|" + "---|" * len(names), flush=True)
    table: dict[str, dict[str, dict[str, float]]] = {}
    for row, settings in ROWS.items():
        scores = [follow(session, carved, settings) for session, carved in zip(sessions, hulls, strict=True)]
        cells = [f"{s.mean_mm:.0f} / {s.over_200mm:.2f} / {s.inside_95:.2f}" for s in scores]
        print(f"| {row} | {' | '.join(cells)} |", flush=True)
        table[row] = {
            name: {key: round(float(getattr(s, key)), 4) for key in ("mean_mm", "over_200mm", "inside_95")}
            for name, s in zip(names, scores, strict=True)
        }
    print(json.dumps(table))


if __name__ == "__main__":
    main()
