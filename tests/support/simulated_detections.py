"""A simulated detector of 2D poses: the joints of a session's truth in its cameras' images, with noise and errors.

``python tests/support/simulated_detections.py SESSION FOLDER --cameras cam01 cam03 cam05`` makes of a session one of
these cameras alone, and of its truth what a detector finds in their images, FOLDER/keypoints/CAM.csv:

    python -m sagoma_tools.cli evaluate FOLDER --json
    python -m sagoma_tools.cli evaluate FOLDER --json --keypoints FOLDER/keypoints
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rig import save_rig
from capture_rig.session import load_session
from icp_tracker.initialization.initial_pose import pose_from_reference
from mocap_packets.keypoints import NUMBERS, Detections
from stick_figure.body import Body
from stick_figure.least_squares.keypoint_factor import HIP_ASIDE_M
from stick_figure.least_squares.posed_model import BodyModel, PosedModel, PoseState, place, surface_distances
from stick_figure.skeleton import POINT_NAMES

JOINTS = tuple(
    f"{side}_{j}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)
"""Those of COCO that have a place in the figure."""
NOISE_PX, OUTLIERS, MISSED = 8.0, 0.1, 0.5  # sd; share that is anywhere in the image; share of the hidden not found
FREE_M, STEP_M = 0.15, 0.02  # of the way to the camera what hides nothing: the joint's own flesh; samples of the rest


def coco_joints(points_world: np.ndarray, wrist_fraction: float) -> np.ndarray:
    """Return the JOINTS (12, 3), m, of the 15 reference points of somebody, whose hands lie there on the forearm."""
    at = dict(zip(POINT_NAMES, points_world, strict=True))
    aside = at["left_hip"] - at["right_hip"]
    aside *= HIP_ASIDE_M / np.linalg.norm(aside)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        elbow = at[f"{side}_elbow"]
        at[f"{side}_wrist"] = elbow + 0.146 / 0.254 / wrist_fraction * (at[f"{side}_hand"] - elbow)
        at[f"{side}_hip"] = at[f"{side}_hip"] + sign * aside
        at[f"{side}_ankle"] = at[f"{side}_foot"]
    return np.array([at[name] for name in JOINTS])


def hidden(joints_world: np.ndarray, placed: PosedModel, camera: CameraModel) -> np.ndarray:
    """Return which joints (n,) bool the body's own surface hides from a camera."""
    ways = camera.centre_world - joints_world
    steps = np.arange(FREE_M, np.linalg.norm(ways, axis=1).max(), STEP_M)
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    places = joints_world[:, None] + steps[:, None] * (ways / lengths)[:, None]
    inside = surface_distances(np.ascontiguousarray(places.reshape(-1, 3)), placed)[2] < 0.0
    return inside.reshape(len(joints_world), -1).any(axis=1)


def detect(
    joints_world: np.ndarray, placed: PosedModel, camera: CameraModel, stamp_ns: int, rng: np.random.Generator
) -> Detections:
    """Return what the detector finds of somebody in an image."""
    size, count = (camera.width, camera.height), len(joints_world)
    pixels = camera.project(joints_world) + NOISE_PX * rng.normal(size=(count, 2))
    anywhere = rng.uniform(size=count) < OUTLIERS
    pixels[anywhere] = rng.uniform(size=(count, 2))[anywhere] * size
    found = ((pixels >= 0.0) & (pixels < size)).all(axis=1)
    found &= ~hidden(joints_world, placed, camera) | (rng.uniform(size=count) >= MISSED)
    values = np.column_stack([pixels, np.tile([NOISE_PX**2, 0.0, NOISE_PX**2, 1.0], (count, 1))])
    values[~found] = np.nan
    return Detections(camera.name, stamp_ns, JOINTS, values[None])


def write_detections(folder: Path, frames: dict[int, Detections]) -> None:
    """Write the table of one camera, as `mocap_pipeline.session_footage.load_detections` reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    (name,) = {one.camera for one in frames.values()}
    with (folder / f"{name}.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frame", *(f"{joint}_{number}" for joint in JOINTS for number in NUMBERS)])
        for frame, one in frames.items():
            rows.writerow([frame, *("" if np.isnan(v) else f"{v:.3f}" for v in one.values.ravel())])


def main() -> None:
    """Make a session of some cameras, with detections."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cameras", nargs="+", required=True)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    session, rng = load_session(args.session), np.random.default_rng(args.seed)
    truth = session.truth
    assert truth is not None
    args.folder.mkdir(parents=True)
    save_rig(
        replace(session.rig, cameras=tuple(session.rig.camera(name) for name in args.cameras)), args.folder / "rig.yaml"
    )
    for path in args.session.iterdir():
        if path.name.startswith(tuple(args.cameras)) or path.name in ("session.yaml", truth.source.name):
            (args.folder / path.name).symlink_to(path.resolve())
    points, tables = truth.stick_figure_points(), {name: dict[int, Detections]() for name in args.cameras}
    body = Body.from_points(points)
    for frame, own in zip(truth.frames.tolist(), truth.points_world, strict=True):
        pose = pose_from_reference(truth.frames, points, frame, "truth", body).pose
        placed = place(PoseState.of(pose), BodyModel.of(body))
        for name, found in tables.items():
            found[frame] = detect(coco_joints(own, truth.wrist_fraction), placed, session.rig.camera(name), 0, rng)
    for found in tables.values():
        write_detections(args.folder / "keypoints", found)


if __name__ == "__main__":
    main()
