"""Accuracy and speed of both fits on synthetic sticks: ``python -m icp_tracker.benchmark``.

The experiment of the article that the thesis reprints: points spread evenly over the sticks of a moving figure, 40 sets
a second, Gaussian noise of a sixth of the hips' distance; every fit starts from the one before. Prints a table and one
line of JSON.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward, sticks
from stick_figure.pose import Pose

from .acquisition.initial_pose import rotation_matrix
from .articulated_solver import ArticulatedSettings, fit_articulated
from .hierarchical_icp import HierarchicalSettings, fit_hierarchical

FPS, SECONDS, MOTIONS = 40.0, 4.0, 4
SIGMA_M = 0.034
# a range of motion well inside the joints' (rad), in the order of the angles
_MIDDLE = np.array([
    0.0, 0.2, -0.4, np.pi + 0.4, -0.35, -0.35, 0.1, -0.1, -1.0, -1.0, 0.2, -0.2, -0.45, -0.45, 0.9, 0.9, 0.0, 0.0,
])  # fmt: skip
_SWING = np.array([0.4, 0.4, 1.0, 1.0, 0.65, 0.65, 0.7, 0.7, 0.9, 0.9, 0.3, 0.3, 0.85, 0.85, 0.8, 0.8, 0.3, 0.3])
Fit = Callable[[Pose, np.ndarray], Pose]


def motion(seed: int) -> list[Pose]:
    """Poses of a smooth random motion."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(FPS * SECONDS)) / FPS
    frequency, phase = rng.uniform(0.1, 0.9, (24, 3, 1)), rng.uniform(0, 2 * np.pi, (24, 3, 1))
    wave = np.sin(2 * np.pi * frequency * t + phase).mean(1).T
    angles, positions, turns = _MIDDLE + _SWING * wave[:, :18], [0, 0, 1.2] + 0.5 * wave[:, 18:21], wave[:, 21:]
    return [
        Pose.from_angles(p, rotation_matrix(r * [0.15, 0.15, 1.5]), a)
        for p, r, a in zip(positions, turns, angles, strict=True)
    ]


def cloud(body: Body, pose: Pose, count: int, rng: np.random.Generator) -> np.ndarray:
    """About ``count`` noisy points (n, 3) m spread over the sticks."""
    numbers = np.maximum(2, np.round(count * body.lengths / body.lengths.sum()).astype(int))
    ends = sticks(body, pose)
    clean = [a + ((np.arange(n) + 0.5) / n)[:, None] * (b - a) for (a, b), n in zip(ends, numbers, strict=True)]
    points = np.concatenate(clean)
    return points + SIGMA_M * rng.normal(size=points.shape)


def measure(body: Body, fit: Fit, count: int) -> tuple[float, float]:
    """Mean error (mm) of the 15 points, and the median time (ms) of a fit."""
    errors, times = [], []
    for seed in range(MOTIONS):
        rng, poses = np.random.default_rng(100 + seed), motion(seed)
        pose = fit(poses[0], cloud(body, poses[0], count, rng))
        for truth in poses:
            points = cloud(body, truth, count, rng)
            began = time.perf_counter()
            pose = fit(pose, points)
            times.append(1e3 * (time.perf_counter() - began))
            errors.append(1e3 * np.linalg.norm(forward(body, pose) - forward(body, truth), axis=1).mean())
    return float(np.mean(errors)), float(np.median(times))


def fits(body: Body) -> dict[str, Fit]:
    """The fits that are compared, by name."""
    articulated = ArticulatedSettings(model_sigma_m=SIGMA_M)
    hierarchical = {
        "hierarchical": HierarchicalSettings(),
        "hierarchical_0.1": HierarchicalSettings(descendant_weight=0.1),
        "hierarchical_proximal": HierarchicalSettings(weighting="proximal"),
    }
    found: dict[str, Fit] = {
        "articulated": lambda pose, points: fit_articulated(body, pose, points, settings=articulated).pose
    }
    for name, settings in hierarchical.items():
        found[name] = partial(_hierarchical, body, settings)
    return found


def _hierarchical(body: Body, settings: HierarchicalSettings, pose: Pose, points: np.ndarray) -> Pose:
    return fit_hierarchical(body, pose, points, settings).pose


def main() -> None:
    """Measure, print the table, and last the JSON line."""
    body = Body.from_stature(1.75)
    figures: dict[str, float] = {}
    print(f"{'fit':24}{'points':>8}{'mean mm':>10}{'ms':>8}")
    for name, fit in fits(body).items():
        for count in (300, 500):
            mean_mm, ms = measure(body, fit, count)
            print(f"{name:24}{count:8}{mean_mm:10.1f}{ms:8.2f}")
            figures |= {f"{name}_{count}_mean_mm": round(mean_mm, 1), f"{name}_{count}_ms": round(ms, 3)}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
