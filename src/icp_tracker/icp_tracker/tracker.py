"""From one frame set's centerline to the pose and the 15 reference points, set after set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from capture_rig.settings import setting
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

from .articulated_solver import ArticulatedSettings, assess, fit_articulated, make_data
from .fit_result import FitResult, unknown_covariance
from .hierarchical_icp import HierarchicalSettings, fit_hierarchical
from .initial_pose import KnownPose, PoseSource
from .one_body import BodyNumbers, of_one_body
from .voxel_cloud import NO_VOXELS, VoxelCloud

ACQUIRING, TRACKING = "acquiring", "tracking"
FROM_NOTHING, FROM_INITIAL, FROM_OWN = "nothing", "initial", "own"
NS_PER_S = 1e9


@dataclass(frozen=True)
class TrackerSettings:
    """How the figure is fitted, set after set."""

    method: str = setting(
        "articulated", "the fit: all joints at once, or the thesis's hierarchical ICP",
        choices=("articulated", "hierarchical"),
    )  # fmt: skip
    articulated: ArticulatedSettings = setting(ArticulatedSettings, "the all-joints solve")
    hierarchical: HierarchicalSettings = setting(HierarchicalSettings, "the hierarchical ICP")
    min_points: int = setting(15, "fewer centerline points than this count as none", low=3)
    extrapolation_limit_s: float = setting(
        0.1, "the predicted motion is followed for at most this long", unit="s", low=0.0, high=10.0
    )
    acquire_iterations: int = setting(30, "iterations of the first fit", low=1, high=1000)
    acquire_inliers: float = setting(
        0.4, "share of the points that the first fit must explain to be believed", low=0.0, high=1.0
    )


class Predicted(Protocol):
    """The filter's state after an earlier frame set: a pose and the rate (24,) of its tangent, 1/s."""

    @property
    def stamp_ns(self) -> int: ...
    @property
    def pose(self) -> Pose | None: ...
    @property
    def velocity(self) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class IcpResult:
    """What one frame set gave.

    state : "acquiring" or "tracking"; started_from : "nothing", "initial", "own", or the stamp (ns) of the filter's
    state; reason : why there is no fit, else empty; dropped_points : points that were not finite.
    reference_points_world (15, 3) m, covariance (15, 3, 3) m^2, visible (15,): zeros, huge and False before the first
    pose; the unmoved prediction, huge and False when the set has too few points. fit : the solver's result, if any.
    """

    stamp_ns: int
    state: str
    started_from: str
    reason: str
    dropped_points: int
    reference_points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray
    pose: Pose | None
    fit: FitResult | None


class IcpTracker:
    """Follows one body. Deterministic: the same sets and predictions give the same results to the last bit."""

    def __init__(self, source: PoseSource, settings: TrackerSettings | None = None) -> None:
        self._source = source
        self._settings = settings or TrackerSettings()
        self._body: Body | None = None
        self._pose: Pose | None = None

    @property
    def body(self) -> Body | None:
        """The body being followed; None before the first pose."""
        return self._body

    @property
    def needs_voxels(self) -> bool:
        """Whether the next step looks at the hull's voxels."""
        if self._pose is None and self._source.needs_voxels:
            return True
        volume = self._settings.articulated.volume
        return self._settings.method == "articulated" and max(volume.worth, volume.inside_worth) > 0.0

    def reset(self) -> None:
        """Forget the pose and look for a first one again."""
        self._body = self._pose = None

    def step(
        self,
        stamp_ns: int,
        points_world: np.ndarray,
        sigma_m: np.ndarray | float = 0.0,
        voxels: VoxelCloud | None = None,
        prediction: Predicted | None = None,
        numbers: BodyNumbers | None = None,
    ) -> IcpResult:
        """Fit one frame set: centerline ``points_world`` (n, 3) m with noise ``sigma_m`` (n,), and hull voxels.

        ``numbers`` says whose they are when there may be several people; one is followed.
        """
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),))
        if self._pose is None or self._body is None:
            if numbers is not None:
                points, sigma, voxels = of_one_body(points, sigma, voxels, numbers, None)
            points, sigma, dropped = _finite(points, sigma)
            return self._acquire(stamp_ns, points, sigma, voxels, dropped)
        start, started_from = self._start(stamp_ns, self._pose, prediction)
        if numbers is not None:
            points, sigma, voxels = of_one_body(points, sigma, voxels, numbers, forward(self._body, start))
        points, sigma, dropped = _finite(points, sigma)
        if len(points) < self._settings.min_points:
            self._pose = start
            reason = f"{len(points)} centerline points, {self._settings.min_points} needed"
            return _unseen(stamp_ns, TRACKING, started_from, reason, dropped, start, forward(self._body, start))
        fit = self._fit(self._body, start, points, sigma, voxels or NO_VOXELS, self._settings)
        self._pose = fit.pose
        return _seen(stamp_ns, started_from, dropped, fit)

    def _acquire(
        self, stamp_ns: int, points: np.ndarray, sigma: np.ndarray, voxels: VoxelCloud | None, dropped: int
    ) -> IcpResult:
        found = self._source.look(points, None if voxels is None else voxels.points_world)
        reason = found.reason
        if found.pose is not None and found.body is not None:
            if len(points) >= self._settings.min_points:
                fit = self._fit(found.body, found.pose, points, sigma, voxels or NO_VOXELS, self._patient())
                explained = fit.inliers / fit.points
                if explained >= self._settings.acquire_inliers:
                    self._body, self._pose = found.body, fit.pose
                    # the first pose is itself a measurement of every point, also of those the hull hides
                    seen_whole = replace(fit, visible=np.ones(15, dtype=bool))
                    return _seen(stamp_ns, FROM_INITIAL, dropped, seen_whole)
                reason = f"the first pose explains only {100 * explained:.0f} % of the points"
            else:
                reason = f"{len(points)} centerline points, {self._settings.min_points} needed"
        return _unseen(stamp_ns, ACQUIRING, FROM_NOTHING, reason, dropped, None, np.zeros((15, 3)))

    def _patient(self) -> TrackerSettings:
        articulated = replace(self._settings.articulated, max_iterations=self._settings.acquire_iterations)
        return replace(self._settings, articulated=articulated)

    def _start(self, stamp_ns: int, own: Pose, prediction: Predicted | None) -> tuple[Pose, str]:
        if prediction is None or prediction.pose is None:
            return own, FROM_OWN
        ahead_s = (stamp_ns - prediction.stamp_ns) / NS_PER_S
        ahead_s = min(max(ahead_s, 0.0), self._settings.extrapolation_limit_s)
        return prediction.pose.retract(prediction.velocity * ahead_s), str(prediction.stamp_ns)

    @staticmethod
    def _fit(
        body: Body, start: Pose, points: np.ndarray, sigma: np.ndarray, voxels: VoxelCloud, settings: TrackerSettings
    ) -> FitResult:
        if settings.method == "articulated":
            return fit_articulated(body, start, points, sigma, voxels, settings.articulated)
        found = fit_hierarchical(body, start, points, settings.hierarchical)
        data = make_data(points, sigma, NO_VOXELS, settings.articulated)
        return assess(body, found.pose, data, found.iterations, found.converged, settings.articulated)


def warm_up(settings: TrackerSettings) -> None:
    """Run one fit on made-up points, so that compiled code is loaded before the first frame set arrives."""
    body = Body.from_stature(1.7)
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    tracker = IcpTracker(KnownPose(pose, body), replace(settings, acquire_inliers=0.0))
    points = forward(body, pose)
    tracker.step(0, points, 0.01, VoxelCloud.checked(points, np.ones(len(points))))


def _finite(points: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Points (n, 3) and sigmas (n,) that are finite numbers, and how many were not."""
    good = np.isfinite(points).all(axis=1) & np.isfinite(sigma)
    return np.ascontiguousarray(points[good]), np.ascontiguousarray(sigma[good]), int((~good).sum())


def _seen(stamp_ns: int, started_from: str, dropped: int, fit: FitResult) -> IcpResult:
    return IcpResult(
        stamp_ns, TRACKING, started_from, "", dropped, fit.reference_points_world, fit.covariance, fit.visible,
        fit.pose, fit,
    )  # fmt: skip


def _unseen(
    stamp_ns: int, state: str, started_from: str, reason: str, dropped: int, pose: Pose | None, points: np.ndarray
) -> IcpResult:
    unseen = np.zeros(15, dtype=bool)
    return IcpResult(
        stamp_ns, state, started_from, reason, dropped, points, unknown_covariance(), unseen, pose, None
    )  # fmt: skip
