"""Accuracy and cost of the filter on a synthetic person with noisy points.

    python bench/ekf.py

One row a motion model: cost of a set (median CPU time), mean error of the measured and of the filtered points, and the
share of the true points inside the 95 % ellipsoids. The last line is JSON: figures by motion model.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from report import Table, execute, finish, parser

import numpy as np

from ekf_tracker.filter import ArticulatedEkf, warm_up
from ekf_tracker.settings import EkfSettings
from mocap_packets.state import BodyState
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

FPS = 60.0
FRAMES = 1200
NOISE_M = 0.02
SETTLED = 60
"""Sets after which the start no longer shows."""
CHI2_95 = 7.815
"""95 % of a chi-square with 3 degrees of freedom."""
STATURE_M = 1.75


def motion(body: Body, frames: int) -> Iterator[np.ndarray]:
    """Reference points (15, 3) of a person who walks about, turns and moves every joint in sines of 0.3 to 0.8 Hz."""
    rng = np.random.default_rng(0)
    frequency, phase = rng.uniform(0.3, 0.8, 18), rng.uniform(0.0, 2.0 * np.pi, 18)
    bent = T_POSE_ANGLES.copy()
    bent[8:10], bent[14:16] = -0.9, 0.8
    for t in np.arange(frames) / FPS:
        position = np.array([0.6 * np.sin(0.8 * t), 0.4 * np.cos(0.5 * t), 1.1 + 0.03 * np.sin(6.0 * t)])
        c, s = np.cos(0.8 * np.sin(0.9 * t)), np.sin(0.8 * np.sin(0.9 * t))
        R_world_torso = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        angles = bent + 0.4 * np.sin(2.0 * np.pi * frequency * t + phase)
        yield forward(body, Pose.from_angles(position, R_world_torso, angles))


def measure(model: str) -> dict[str, float]:
    """Figures of one motion model; lengths in mm, cost in ms of CPU time for one set."""
    body = Body.from_stature(STATURE_M)
    ekf = ArticulatedEkf(body, replace(EkfSettings.of_ideal_figure(), motion_model=model))
    rng, covariance = np.random.default_rng(1), np.tile(np.eye(3) * NOISE_M**2, (15, 1, 1))
    cost, raw, filtered, inside = [], [], [], []
    for k, true in enumerate(motion(body, FRAMES)):
        points = true + NOISE_M * rng.standard_normal((15, 3))
        began = time.thread_time()
        state = ekf.step(round(k * 1e9 / FPS), points, covariance, np.ones(15, bool))
        cost.append(1e3 * (time.thread_time() - began))
        if k >= SETTLED and isinstance(state, BodyState):
            error = state.points_world - true
            raw.append(np.linalg.norm(points - true, axis=1).mean())
            filtered.append(np.linalg.norm(error, axis=1).mean())
            distances = np.einsum("ij,ijk,ik->i", error, np.linalg.inv(state.point_covariance), error)
            inside.append((distances < CHI2_95).mean())
    return {
        "ekf_ms": float(np.median(cost)),
        "raw_mm": 1e3 * float(np.mean(raw)),
        "mean_mm": 1e3 * float(np.mean(filtered)),
        "inside_95": float(np.mean(inside)),
    }


def main() -> None:
    """Print the table and one line of JSON."""
    parser(__doc__).parse_args()
    warm_up()
    table = Table(
        "model:<20 | ms a set:>10.2f | measured mm:>13.1f | filtered mm:>13.1f | inside 95 %:>13.1%",
        f"{FRAMES} sets at {FPS:g} Hz, points with {1e3 * NOISE_M:g} mm of noise on each axis",
    )
    results = {}
    for model in ("constant_velocity", "identity"):
        results[model] = r = measure(model)
        table.row(model, r["ekf_ms"], r["raw_mm"], r["mean_mm"], r["inside_95"])
    finish(results)


if __name__ == "__main__":
    execute(main)
