"""Solvers of one frame after another, each from its last pose, on the same points, side by side.

Ours, scipy's least squares on the same residuals, and those of pinocchio.py and opensim.py where the libraries are
installed; the stick figure stick by stick for libraries that want a model built joint by joint.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module

from report import Table

import numpy as np
from scipy.optimize import least_squares

from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.settings import EkfSettings
from icp_tracker.articulated_fit import ArticulatedSettings, PriorSettings, fit_articulated
from mocap_packets.state import BodyState
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse, sticks
from stick_figure.least_squares.point_factor import foot_points
from stick_figure.pose import Pose
from stick_figure.skeleton import STICK_AXIS, STICK_SIGN

from .clips import FPS, Clip, clouds

Solver = Callable[[np.ndarray], np.ndarray]
"""Points of one frame (n, 3) to the 15 reference points (15, 3), m; remembers its last pose."""
MakeSolver = Callable[[], Solver]
PRIOR = PriorSettings()
"""Every solver of unlabelled points holds what no point sees with this prior about the last pose."""
ASSIGNMENTS = 6
STOP_M = 0.002
"""Outer loops of the assignment at most, and the movement of the points below which they end."""
LABELLED_SIGMA_M = 0.02
PINOCCHIO, OPENSIM = "synthetic.pinocchio", "synthetic.opensim"


def compare_unlabelled(clip: Clip) -> None:
    """Articulated ICP by several libraries: same points, same matching, same prior, same stop."""
    points = clouds(clip, 1)
    task = f"the same {len(points[0])} points without labels, each from its own last pose"
    solvers: dict[str, MakeSolver] = {
        "all joints at once (ours)": lambda: our_solve(clip),
        "pinocchio Jacobians + numpy": lambda: import_module(PINOCCHIO).articulated_icp(clip),
        "scipy.optimize.least_squares in an ICP loop": lambda: scipy_solve(clip),
    }
    _compare(f"{task}; {clip.name}, {len(points)} frames", solvers, points, clip)


def compare_labelled(clip: Clip) -> None:
    """Inverse kinematics on the 15 points, and what a filter adds."""
    rng = np.random.default_rng(2)
    z = [true + LABELLED_SIGMA_M * rng.normal(size=(15, 3)) for true in clip.points_world]
    solvers: dict[str, MakeSolver] = {
        "closed form (ours)": lambda: our_inverse_kinematics(clip),
        "EKF, identity (ours)": lambda: _filter(clip, "identity"),
        "EKF, constant_velocity (ours)": lambda: _filter(clip, "constant_velocity"),
        "pinocchio Jacobians + numpy": lambda: import_module(PINOCCHIO).inverse_kinematics(clip),
        "OpenSim inverse kinematics": lambda: import_module(OPENSIM).inverse_kinematics(clip, z),
        "scipy.optimize.least_squares": lambda: scipy_inverse_kinematics(clip),
    }
    title = f"15 labelled points with {1e3 * LABELLED_SIGMA_M:.0f} mm of noise, {clip.name}, {len(z)} frames"
    _compare(title, solvers, z, clip)


def _filter(clip: Clip, model: str) -> Solver:
    ekf = ArticulatedEkf(clip.body, replace(EkfSettings.of_ideal_figure(), motion_model=model))
    covariance, frame = np.tile(np.eye(3), (15, 1, 1)), -1

    def step(z: np.ndarray) -> np.ndarray:
        nonlocal frame
        frame += 1
        state = ekf.step(round(frame * 1e9 / FPS), z, LABELLED_SIGMA_M**2 * covariance, np.ones(15, bool))
        return state.points_world if isinstance(state, BodyState) else np.full((15, 3), np.nan)

    return step


def _compare(title: str, solvers: Mapping[str, MakeSolver], data: list[np.ndarray], clip: Clip) -> None:
    """Print a table; a library that is not installed is left out, with the reason."""
    table = Table({"solver": "<44", "mean mm": ">9.1f", "worst mm": ">9.0f", "ms": ">9.3f"}, title)
    for name, make in solvers.items():
        try:
            solve = make()
        except ImportError as missing:
            print(f"{name:44}  skipped: {missing}")
            continue
        make()(data[0])  # compiled code and caches
        errors, times = [], []
        for points, true in zip(data, clip.points_world, strict=True):
            began = time.thread_time()
            found = solve(points)
            times.append(1e3 * (time.thread_time() - began))
            errors.append(1e3 * np.linalg.norm(found - true, axis=1))
        table.row(name, np.mean(errors), np.max(errors), np.median(times))


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
    prior = replace(PRIOR, neck_sd=0.0, limit_sd=0.0)
    settings = replace(ArticulatedSettings.of_ideal_figure(), gate_m=10.0, prior=prior, max_iterations=ASSIGNMENTS)

    def solve(pose: Pose, points: np.ndarray) -> Pose:
        return fit_articulated(clip.body, pose, points, clip.sigma_m, settings=settings).pose

    return stepwise(clip.body, clip.poses[0], solve)


def scipy_solve(clip: Clip) -> Solver:
    """scipy.optimize.least_squares inside an ICP loop: assign every point to its nearest stick, fit, assign anew."""
    body, sigma, prior = clip.body, clip.sigma_m, np.sqrt(PRIOR.information)

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


# --- the model, joint by joint

POINT_ENDS = (
    (0, "centre"),
    (1, "end"),
    (1, "start"),
    (2, "start"),
    (3, "start"),
    (4, "start"),
    (5, "start"),
    (2, "end"),
    (3, "end"),
    (4, "end"),
    (5, "end"),
    (6, "end"),
    (7, "end"),
    (8, "end"),
    (9, "end"),
)
"""(stick, which end) of each reference point."""


def local_ends(body: Body, stick: int) -> dict[str, np.ndarray]:
    """Start and end of a stick (and the torso's centre) in its own frame, m."""
    if stick == 0:
        half = np.array([0.0, 0.0, body.half_lengths[0]])
        return {"start": -half, "end": half, "centre": np.zeros(3)}
    return {"start": np.zeros(3), "end": along_stick(stick, body.lengths[stick])}


def along_stick(stick: int, length: float) -> np.ndarray:
    """The vector (3,) along a stick in its own frame."""
    return STICK_SIGN[stick] * length * np.eye(3)[STICK_AXIS[stick]]
