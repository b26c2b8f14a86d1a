"""Our trackers on clouds of points, each from the true first pose."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.settings import EkfSettings
from icp_tracker.acquisition.initial_pose import KnownPose
from icp_tracker.thesis.hierarchical_icp import HierarchicalSettings
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import NO_VOXELS, HullProducts, VoxelSamples
from mocap_packets.state import BodyState, Prediction

from .clips import FPS, Clip

NS = 1e9
INSIDE_95 = 7.815
"""95 % of a chi-square with 3 degrees of freedom."""


@dataclass(frozen=True)
class Method:
    """A tracker: the fit's and the filter's settings; feedback: the fit starts from the filter's prediction."""

    name: str
    icp: TrackerSettings = field(default_factory=TrackerSettings)
    ekf: EkfSettings = field(default_factory=EkfSettings)
    feedback: bool = True


@dataclass(frozen=True, eq=False)
class Run:
    """Errors (F, 15) m of the fitted and the filtered points, times (F,) ms of CPU, inside (F, 15): within 95 %."""

    fitted: np.ndarray
    filtered: np.ndarray
    icp_ms: np.ndarray
    ekf_ms: np.ndarray
    inside: np.ndarray


def thesis(descendant_weight: float = 0.2) -> Method:
    """Hierarchical ICP from the pose before, and a filter whose model is that nothing moves (thesis 4.3, 5.2).

    The weight of the descendants' points, the thesis's epsilon, is "chosen heuristically" and not told.
    """
    return Method(
        f"thesis, epsilon {descendant_weight:g}",
        TrackerSettings(method="hierarchical", hierarchical=HierarchicalSettings(descendant_weight=descendant_weight)),
        EkfSettings(motion_model="identity"),
        feedback=False,
    )


def all_joints_alone() -> Method:
    """The all-joints solve from its own pose before."""
    return Method("all joints at once, from its own last pose", feedback=False)


def chain() -> Method:
    """What the graph runs, with its defaults."""
    return Method("our chain")


def chain_for_sticks() -> Method:
    """The same, told that the figure is the body: no joint lies elsewhere, and a perfect point is on its stick."""
    settings = TrackerSettings()
    exact = replace(settings.articulated, model_sigma_m=1e-3)
    return Method("our chain, told that the data are sticks", replace(settings, articulated=exact))


def track(
    method: Method, clip: Clip, points: list[np.ndarray], sigma_m: float, voxels: list[VoxelSamples] | None = None
) -> Run:
    """Follow the clouds (n, 3) m of a clip; sigma_m: what the points say of their own noise."""
    icp, ekf = IcpTracker(KnownPose(clip.poses[0], clip.body), method.icp), ArticulatedEkf(clip.body, method.ekf)
    feedback: Prediction | None = None
    errors, times, inside = [], [], []
    for frame, (cloud, true) in enumerate(zip(points, clip.points_world, strict=True)):
        stamp_ns, samples = round(frame * NS / FPS), voxels[frame] if voxels else NO_VOXELS
        began = time.thread_time()
        fit = icp.step(HullProducts.of_points(stamp_ns, cloud, sigma_m, samples), feedback if method.feedback else None)
        fitted = time.thread_time()
        state = ekf.step(stamp_ns, *fit.reference_points)
        times.append((1e3 * (fitted - began), 1e3 * (time.thread_time() - fitted)))
        if not isinstance(state, BodyState):
            raise RuntimeError(f"{clip.name}, frame {frame}: the filter has no state: {state.reason}")
        feedback = state.prediction
        error = state.points_world - true
        errors.append((np.linalg.norm(fit.reference_points_world - true, axis=1), np.linalg.norm(error, axis=1)))
        inside.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(state.point_covariance), error) < INSIDE_95)
    (fitted_m, filtered_m), cost = np.swapaxes(errors, 0, 1), np.array(times)
    return Run(fitted_m, filtered_m, cost[:, 0], cost[:, 1], np.array(inside))
