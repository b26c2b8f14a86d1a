"""Our trackers on clouds of points, each from the true first pose, and what one frame set costs at full size."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from ekf_tracker.filter import PeopleFilter
from ekf_tracker.settings import EkfSettings
from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.thesis.hierarchical_icp import DESCENDANT_WEIGHT
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import NO_VOXELS, HullProducts, VoxelSamples
from mocap_packets.state import BodyState
from mocap_pipeline.pipeline import TrackingStage
from virtual_studio.people import Capsules, VolumetricBody

from .clips import FPS, Clip, clouds

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


def thesis(descendant_weight: float = DESCENDANT_WEIGHT) -> Method:
    """Hierarchical ICP from the pose before, and a filter whose model is that nothing moves (thesis 4.3, 5.2).

    The weight of the descendants' points, the thesis's epsilon, is "chosen heuristically" and not told.
    """
    return Method(
        f"thesis, epsilon {descendant_weight:g}",
        TrackerSettings(method="hierarchical", descendant_weight=descendant_weight),
        EkfSettings(motion_model="identity"),
        feedback=False,
    )


def all_joints_alone() -> Method:
    """The all-joints solve from its own pose before, told that the data are sticks."""
    return replace(chain_for_sticks(), name="all joints at once, from its own last pose", feedback=False)


def chain() -> Method:
    """What the graph runs, with its defaults: for people in hulls, whose errors last for many sets."""
    return Method("our chain, with its defaults")


def chain_for_sticks() -> Method:
    """The same, told that the data are sticks: the body is the figure, and every set's errors are new."""
    figure = TrackerSettings(articulated=ArticulatedSettings.of_ideal_figure())
    return Method("our chain, told that the data are sticks", figure, EkfSettings.of_ideal_figure())


def track(
    method: Method, clip: Clip, points: list[np.ndarray], sigma_m: float, voxels: list[VoxelSamples] | None = None
) -> Run:
    """Follow the clouds (n, 3) m of a clip; sigma_m: what the points say of their own noise."""
    tracker = PeopleTracker(lambda: IcpTracker(KnownPose(clip.poses[0], clip.body), method.icp), most=1)
    follower = TrackingStage(tracker, PeopleFilter(method.ekf), method.feedback)
    errors, times, inside = [], [], []
    for frame, (cloud, true) in enumerate(zip(points, clip.points_world, strict=True)):
        stamp_ns, samples = round(frame * NS / FPS), voxels[frame] if voxels else NO_VOXELS
        began = time.thread_time()
        (fit,) = follower.fit(HullProducts.of_points(stamp_ns, cloud, sigma_m, samples))
        fitted = time.thread_time()
        state = follower.filter((fit,))[fit.person]
        times.append((1e3 * (fitted - began), 1e3 * (time.thread_time() - fitted)))
        if not isinstance(state, BodyState):
            raise RuntimeError(f"{clip.name}, frame {frame}: the filter has no state: {state.reason}")
        error = state.points_world - true
        errors.append((np.linalg.norm(fit.reference_points_world - true, axis=1), np.linalg.norm(error, axis=1)))
        inside.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(state.point_covariance), error) < INSIDE_95)
    (fitted_m, filtered_m), cost = np.swapaxes(errors, 0, 1), np.array(times)
    return Run(fitted_m, filtered_m, cost[:, 0], cost[:, 1], np.array(inside))


# --- one frame set at full size: 500 points and 1500 voxels

TIMED_POINTS, VOXELS = 500, 1500
VOXEL_M = 0.02


def times_ms(clip: Clip) -> dict[str, float]:
    """Median CPU time of fit and filter, ms, with the defaults."""
    method, body = chain(), VolumetricBody(clip.body)
    points = clouds(clip, 3, TIMED_POINTS)
    voxels = [surface_voxels(body.place(pose), np.random.default_rng(k)) for k, pose in enumerate(clip.poses)]
    run = track(method, clip, points, clip.sigma_m, voxels)
    icp_ms, ekf_ms = float(np.median(run.icp_ms)), float(np.median(run.ekf_ms))
    sizes = f"{len(points[0])} points and {len(voxels[0].points_world)} voxels"
    print(f"\none frame set of {sizes}: fit {icp_ms:.2f} ms, filter {ekf_ms:.3f} ms (medians, CPU time of one thread)")
    return {"icp_ms": round(icp_ms, 3), "ekf_ms": round(ekf_ms, 3)}


def surface_voxels(capsules: Capsules, rng: np.random.Generator) -> VoxelSamples:
    """`VOXELS` surface voxels of a body: random points on the capsules' skins that no other one covers."""
    area = np.linalg.norm(capsules.ends - capsules.starts, axis=1) * capsules.radii.sum(1)
    part = rng.choice(len(area), 8 * VOXELS, p=area / area.sum())
    u, radii = rng.random(len(part)), capsules.radii[part]
    axis = (capsules.ends - capsules.starts)[part]
    across = np.cross(axis, rng.normal(size=axis.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    skin = (
        capsules.starts[part] + u[:, None] * axis + (radii @ [1.0, 0.0] * (1 - u) + radii[:, 1] * u)[:, None] * across
    )
    outside = np.ones(len(skin), bool)
    for start, end, (r0, r1) in zip(capsules.starts, capsules.ends, capsules.radii, strict=True):
        along = end - start
        v = np.clip((skin - start) @ along / (along @ along), 0.0, 1.0)
        distance = np.linalg.norm(skin - start - v[:, None] * along, axis=1)
        outside &= distance > r0 + v * (r1 - r0) - 1e-3
    voxels = np.unique((skin[outside] / VOXEL_M).astype(int), axis=0) * VOXEL_M
    chosen = rng.permutation(voxels)[:VOXELS]
    return VoxelSamples(chosen, np.ones(len(chosen), bool))
