"""Solvers of one frame after another, each from its last pose: ours, and scipy's least squares on the same residuals.

pinocchio.py and opensim.py hold the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from icp_tracker.articulated_fit import ArticulatedSettings, PriorSettings, fit_articulated
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse, sticks
from stick_figure.least_squares.point_factor import foot_points
from stick_figure.pose import Pose

from .clips import Clip

Solver = Callable[[np.ndarray], np.ndarray]
"""Points of one frame (n, 3) to the 15 reference points (15, 3), m; remembers its last pose."""
PRIOR = PriorSettings()
"""Every solver of unlabelled points holds what no point sees with this prior about the last pose."""
ASSIGNMENTS = 6
STOP_M = 0.002
"""Outer loops of the assignment at most, and the movement of the points below which they end."""


def stepwise(body: Body, start: Pose, solve: Callable[[Pose, np.ndarray], Pose]) -> Solver:
    """A solver that goes on from its last pose."""
    last = start

    def step(points: np.ndarray) -> np.ndarray:
        nonlocal last
        last = solve(last, points)
        return forward(body, last)

    return step


# --- 300 points without labels


def our_solve(clip: Clip) -> Solver:
    """The all-joints solve, told the noise; without robust gate, rest of the head and joint limits, like the others."""
    settings = ArticulatedSettings(
        model_sigma_m=1e-3, gate_m=10.0, prior=replace(PRIOR, neck_sd=0.0, limit_sd=0.0), max_iterations=ASSIGNMENTS
    )

    def solve(pose: Pose, points: np.ndarray) -> Pose:
        return fit_articulated(clip.body, pose, points, clip.sigma_m, settings=settings).pose

    return stepwise(clip.body, clip.poses[0], solve)


def scipy_solve(clip: Clip) -> Solver:
    """scipy.optimize.least_squares inside an ICP loop: assign every point to its nearest stick, fit, assign anew."""
    body, sigma, prior = clip.body, clip.sigma_m, np.sqrt(PRIOR.information())

    def solve(start: Pose, points: np.ndarray) -> Pose:
        pose = start
        for _ in range(ASSIGNMENTS):
            stick, _ = matched(body, pose, points)

            def residuals(d: np.ndarray, pose: Pose = pose, stick: np.ndarray = stick) -> np.ndarray:
                moved = pose.retract(d)
                foot = points - feet_on(sticks(body, moved), stick, points)
                return np.concatenate([foot.ravel() / sigma, prior * moved.minus(start)])

            step = least_squares(residuals, np.zeros(24), method="lm", xtol=1e-5, ftol=1e-5).x
            before, pose = forward(body, pose), pose.retract(step)
            if np.linalg.norm(forward(body, pose) - before, axis=1).max() < STOP_M:
                break
        return pose

    return stepwise(body, clip.poses[0], solve)


def matched(body: Body, pose: Pose, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest stick (n,) of every point and the place (n,) along it."""
    ends, n = sticks(body, pose), len(points)
    stick, along = np.empty(n, np.int64), np.empty(n)
    A, B = np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1])
    foot_points(points, A, B, stick, along, np.empty((n, 3)), np.empty(n))
    return stick, along


def feet_on(ends: np.ndarray, stick: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Foot points (n, 3) of the points on the sticks they are assigned to."""
    start, along = ends[stick, 0], ends[stick, 1] - ends[stick, 0]
    place = np.einsum("ni,ni->n", points - start, along) / np.einsum("ni,ni->n", along, along)
    return start + np.clip(place, 0.0, 1.0)[:, None] * along


# --- 15 points with labels


def our_inverse_kinematics(clip: Clip) -> Solver:
    """The closed form of thesis Table 5.4, corrected."""
    return stepwise(clip.body, clip.poses[0], lambda pose, z: inverse(clip.body, z, pose))


def scipy_inverse_kinematics(clip: Clip) -> Solver:
    """scipy.optimize.least_squares (Levenberg-Marquardt, numeric Jacobian) on the 45 differences."""
    body = clip.body

    def solve(pose: Pose, z: np.ndarray) -> Pose:
        def residuals(d: np.ndarray) -> np.ndarray:
            return (forward(body, pose.retract(d)) - z).ravel()

        return pose.retract(least_squares(residuals, np.zeros(24), method="lm", xtol=1e-6, ftol=1e-6).x)

    return stepwise(body, clip.poses[0], solve)
