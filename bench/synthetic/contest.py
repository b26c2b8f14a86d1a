"""The same points through our solvers and other people's, side by side."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module

import numpy as np

from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.settings import EkfSettings
from mocap_packets.state import BodyState

from .clips import FPS, Clip, clouds
from .rivals import Solver, our_inverse_kinematics, our_solve, scipy_inverse_kinematics, scipy_solve

LABELLED_SIGMA_M = 0.02


def unlabelled_contest(clip: Clip) -> None:
    """Articulated ICP by several hands: same points, same matching, same prior, same stop."""
    points = clouds(clip, 1)
    task = f"the same {len(points[0])} points without labels, each from its own last pose"
    print(f"\n{task}; {clip.name}, {len(points)} frames")
    _header()
    _row("all joints at once (ours)", lambda: our_solve(clip), points, clip)
    pinocchio = "synthetic.pinocchio"
    _row("pinocchio Jacobians + numpy", lambda: import_module(pinocchio).articulated_icp(clip), points, clip)
    _row("scipy.optimize.least_squares in an ICP loop", lambda: scipy_solve(clip), points, clip)


def labelled_contest(clip: Clip) -> None:
    """Inverse kinematics on the 15 points, and what a filter adds."""
    rng = np.random.default_rng(2)
    z = [true + LABELLED_SIGMA_M * rng.normal(size=(15, 3)) for true in clip.points_world]
    print(f"\n15 labelled points with {1e3 * LABELLED_SIGMA_M:.0f} mm of noise, {clip.name}, {len(z)} frames")
    _header()
    _row("closed form (ours)", lambda: our_inverse_kinematics(clip), z, clip)
    for model in ("identity", "constant_velocity"):
        _row(f"EKF, {model} (ours)", lambda model=model: _filter(clip, model), z, clip)
    _row("pinocchio Jacobians + numpy", lambda: import_module("synthetic.pinocchio").inverse_kinematics(clip), z, clip)
    _row("OpenSim inverse kinematics", lambda: import_module("synthetic.opensim").inverse_kinematics(clip, z), z, clip)
    _row("scipy.optimize.least_squares", lambda: scipy_inverse_kinematics(clip), z, clip)


def _filter(clip: Clip, model: str) -> Solver:
    ekf, covariance = ArticulatedEkf(clip.body, EkfSettings(motion_model=model)), np.tile(np.eye(3), (15, 1, 1))
    frame = -1

    def step(z: np.ndarray) -> np.ndarray:
        nonlocal frame
        frame += 1
        state = ekf.step(round(frame * 1e9 / FPS), z, LABELLED_SIGMA_M**2 * covariance, np.ones(15, bool))
        return state.points_world if isinstance(state, BodyState) else np.full((15, 3), np.nan)

    return step


def _header() -> None:
    print(f"{'solver':44}{'mean mm':>9}{'worst mm':>9}{'ms':>9}")


def _row(name: str, make: Callable[[], Solver], data: list[np.ndarray], clip: Clip) -> None:
    """One line of a table; a library that is not installed gets its reason instead."""
    try:
        solve = make()
    except ImportError as missing:
        print(f"{name:44}  skipped: {missing}")
        return
    solve_first = make()
    solve_first(data[0])  # compiled code and caches
    errors, times = [], []
    for points, true in zip(data, clip.points_world, strict=True):
        began = time.thread_time()
        found = solve(points)
        times.append(1e3 * (time.thread_time() - began))
        errors.append(1e3 * np.linalg.norm(found - true, axis=1))
    print(f"{name:44}{np.mean(errors):9.1f}{np.max(errors):9.0f}{np.median(times):9.3f}", flush=True)
