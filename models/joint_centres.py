"""The table of joint centres: where shoulders, hips and neck of people lie against the figure fitted to their surface.

    python models/random_people.py --body ... --motions ... output/random_people
    python models/joint_centres.py output/random_people [--prove FOLDER] [--write]

Tracks all sets of the folder (hull products of one person each), the reference points left where the figure has them,
and regresses how far the true points lie off on the pose (`stick_figure/trunk_bend.py` says on what): ridge
regression over both sides of everybody, every set with the same weight; what is constant stays out, as it differs with
the definition of a point. Prints the mean error of the points before and after, of the folder's sets and of those that
--prove names; --write replaces the table in the tree. That one was learnt from 42 random people and the `mesh_fit_`
sets of one person, with a prior of upper arms (`body_sizes.py`) that was 4 % longer than today's.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from clips import load
from numpy.typing import NDArray

from mocap_packets.fit import FIRST_PERSON
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from stick_figure import trunk_bend as table
from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES

Array = NDArray[np.float64]

OPENING, EVERY = 60, 3  # frames of the T-pose; of the others one of so many is used
FARTHEST_M = 0.12  # sets in which a point is farther off say nothing about where joints lie
RIDGE = 0.1  # over the features' variance
FIGURE = {"icp_tracker.articulated.contour.joint_centres": False, "hull_server.backend": "cpu"}
OWN = {
    "shoulder": ("arm", "other_arm"),
    "hip": ("thigh", "other_thigh", "pelvis", "flexion"),
    "neck": ("head", "flexion", "arm_z", "other_arm_z"),
}
"""What each centre may follow from: beginnings of the features' names."""
MIRRORED = np.array([1.0, -1.0, 1.0])
LEFT = {"shoulder": "left_shoulder", "hip": "left_hip", "neck": "neck"}
RIGHT = {"shoulder": "right_shoulder", "hip": "right_hip", "neck": "neck"}


@dataclass(frozen=True, eq=False)
class Tracked:
    """Frames of one set: bodies and poses as fitted, the figure's reference points and the true ones (F, 15, 3) m."""

    bodies: list[Body]
    poses: list[Pose]
    points_world: Array
    truth_world: Array

    def features(self) -> Array:
        """(F, 2, n) of both sides."""
        return np.array([table.pose_features(*pair) for pair in zip(self.bodies, self.poses, strict=True)])

    def off(self) -> Array:
        """How far the truth lies off the figure's points (F, 15, 3), torso's frame, over the stature."""
        frames = np.array([pose.R_world_torso for pose in self.poses])
        moved = np.einsum("fij,fpi->fpj", frames, self.truth_world - self.points_world)
        return moved / np.array([body.stature for body in self.bodies])[:, None, None]

    def errors_mm(self, centres: bool) -> Array:
        """Distances (F, 15) from the truth, with the table's joint centres or without."""
        points = self.points_world
        if centres:
            rows = zip(self.bodies, self.poses, points, strict=True)
            points = np.array([table.with_joint_centres(*row) for row in rows])
        return 1e3 * np.linalg.norm(points - self.truth_world, axis=2)


def tracked(path: Path) -> Tracked | None:
    """The frames of a set that can be used; None of one with fewer than ten."""
    what, rows = load(path), []
    follower = TrackingStage.of(Configuration.of({**what.start, **FIGURE}), what.rig)
    for frame, products in enumerate(what.products):
        fit, body = follower.step(products).fit, follower.tracker.body_of(FIRST_PERSON, bent=True)
        truth = what.truths[0][frame]
        if fit.pose is None or body is None or fit.state != "tracking" or frame < OPENING or frame % EVERY:
            continue
        if np.linalg.norm(fit.reference_points_world - truth, axis=1).max() < FARTHEST_M:
            rows.append((body, fit.pose, fit.reference_points_world, truth))
    if len(rows) < 10:
        return None
    bodies, poses, points, truths = zip(*rows, strict=True)
    return Tracked(list(bodies), list(poses), np.array(points), np.array(truths))


def tracks(folder: Path) -> dict[str, Tracked]:
    """Those of all sets of one person in a folder, by name."""
    paths = sorted(path for path in folder.glob("*.pkl") if len(load(path).truths) == 1)
    with ProcessPoolExecutor() as pool:
        return {path.stem: found for path, found in zip(paths, pool.map(tracked, paths), strict=True) if found}


def regressed(sets: list[Tracked]) -> table.JointCentres:
    """The table that explains the sets best."""
    weights = np.repeat([1.0 / len(one.poses) for one in sets], [2 * len(one.poses) for one in sets])
    features = np.concatenate([one.features().reshape(-1, len(table.FEATURES)) for one in sets])
    mean = np.average(features, axis=0, weights=weights)
    off = [(one.off(), table.CENTRES) for one in sets]
    found = np.zeros((len(table.CENTRES), 3, len(table.FEATURES)))
    for c, centre in enumerate(table.CENTRES):
        left, right = POINT_NAMES.index(LEFT[centre]), POINT_NAMES.index(RIGHT[centre])
        moved = np.concatenate([np.stack([o[:, left], MIRRORED * o[:, right]], axis=1).reshape(-1, 3) for o, _ in off])
        used = np.array([name.startswith(OWN[centre]) for name in table.FEATURES])
        X, Y = (features - mean)[:, used], moved - np.average(moved, axis=0, weights=weights)
        H = X.T @ (weights[:, None] * X)
        H += RIDGE * np.diag(np.average(X**2, axis=0, weights=weights)) * len(sets)
        found[c][:, used] = np.linalg.solve(H, X.T @ (weights[:, None] * Y)).T
    return table.JointCentres(mean, found)


def write(path: Path, centres: table.JointCentres) -> None:
    """Writes the table as `stick_figure.trunk_bend` reads it."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["centre", "axis", *table.FEATURES])
        writer.writerow(["all", "mean", *(f"{value:.4f}" for value in centres.mean)])
        for name, rows in zip(table.CENTRES, centres.per_feature, strict=True):
            for axis, row in zip("xyz", rows, strict=True):
                writer.writerow([name, axis, *(f"{value:.5f}" for value in row)])


def judge(label: str, sets: dict[str, Tracked]) -> Iterator[tuple[Any, ...]]:
    """Rows of mean errors before and after: all points, shoulders, hips, neck."""
    groups: dict[str, list[int]] = {"all": list(range(len(POINT_NAMES)))}
    groups |= {c: sorted({POINT_NAMES.index(side[c]) for side in (LEFT, RIGHT)}) for c in table.CENTRES}
    pairs = [(one.errors_mm(False), one.errors_mm(True)) for one in sets.values()]
    for name, points in groups.items():
        before, after = (np.array([pair[k][:, points].mean() for pair in pairs]) for k in (0, 1))
        yield label, name, len(pairs), before.mean(), after.mean(), int((after < before).sum())


def main() -> int:
    """Learns the table and judges it."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path)
    options.add_argument("--prove", type=Path, action="append", default=[])
    options.add_argument("--write", action="store_true", help="replace the table in the tree")
    given = options.parse_args()
    learnt_from = tracks(given.folder)
    if given.write:
        write(table.TABLE, regressed(list(learnt_from.values())))
        table.joint_centres.cache_clear()
    print(f"{'of':<24} {'points':<9} sets  figure, mm  centres, mm  better in")
    for folder, sets in [(given.folder, learnt_from), *((f, tracks(f)) for f in given.prove)]:
        for row in judge(folder.name, sets):
            print("{:<24} {:<9} {:4d}  {:10.1f}  {:11.1f}  {:9d}".format(*row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
