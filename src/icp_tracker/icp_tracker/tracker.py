"""From one frame set's centerline to the pose and the 15 reference points, set after set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture_rig.rig import Volume
from mocap_packets.fit import GOOD, LOST, Fit, Solution
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS, ContourRays, HullProducts, VoxelSamples
from mocap_packets.state import Prediction
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.pose import T_POSE_ANGLES, Pose

from .acquisition.initial_pose import InitialPose, KnownPose, PoseSource
from .acquisition.pose_source import make_pose_source
from .articulated_fit import FitResult, assess, make_data, minimise, unknown_covariance
from .monitor.track_monitor import TrackMonitor
from .monitor.track_quality import widened_covariance
from .refinement.body_refiner import BodyRefiner, RefinedBody, warm_up_refiner
from .settings import IcpNodeSettings, TrackerSettings
from .thesis.hierarchical_icp import fit_hierarchical

ACQUIRING, TRACKING = "acquiring", "tracking"
FROM_NOTHING, FROM_INITIAL, FROM_OWN = "nothing", "initial", "own"
NS_PER_S = 1e9
AGREES_M = 0.1  # the filter has followed a recovered pose when all points of its prediction are so near to it
FOLLOW_SETS = 15  # and it is waited for that long


class IcpTracker:
    """Follows one body. Deterministic: the same sets and predictions give the same results to the last bit."""

    def __init__(self, source: PoseSource, settings: TrackerSettings | None = None) -> None:
        self._source = source
        self._settings = settings or TrackerSettings()
        self._body: Body | None = None
        self._pose: Pose | None = None
        self._refiner: BodyRefiner | None = None
        self._monitor = TrackMonitor(self._settings.recovery)
        self._own_sets = 0  # fits that still start from the own pose, because the filter has to follow first

    @property
    def body(self) -> Body | None:
        """The body being followed; None before the first pose. It changes when its sizes become known better."""
        return self._body

    @property
    def refined_body(self) -> RefinedBody | None:
        """How well the sizes of a measured body are known by now; None for a body whose sizes were given."""
        return None if self._refiner is None else self._refiner.refined

    @property
    def needs_voxels(self) -> bool:
        """Whether the next step looks at the hull's voxels."""
        if self._pose is None and self._source.needs_voxels:
            return True
        volume = self._settings.articulated.volume
        return self._settings.method == "articulated" and max(volume.weight, volume.inside_weight) > 0.0

    @property
    def needs_contour_rays(self) -> bool:
        """Whether the next step looks at the silhouettes' rims."""
        return self._settings.method == "articulated" and self._settings.articulated.contour.weight > 0.0

    def reset(self) -> None:
        """Forget the pose and look for a first one again."""
        self._body = self._pose = self._refiner = None
        self._monitor.reset()
        self._own_sets = 0

    def step(self, seen: HullProducts, prediction: Prediction | None = None) -> Fit:
        """Fit what one frame set shows. Of several people one is followed."""
        seen, dropped = seen.finite()
        if self._pose is None or self._body is None:
            found = self._source.find_pose(seen)
            if found.pose is not None and found.body is not None:
                seen = seen.of_body_at(forward(found.body, found.pose))
            return self._acquire(found, seen, dropped)
        start, started_from = self._start(seen.stamp_ns, self._pose, prediction)
        seen = seen.of_body_at(forward(self._body, start))
        if len(seen.centerline.points_world) < self._settings.min_points:
            self._pose = start
            reason = f"nobody in the volume: {self._too_few(seen)}"
            return _unseen(seen.stamp_ns, LOST, started_from, reason, dropped, start, forward(self._body, start))
        data = self._data(seen)
        fit = self._fit(self._body, start, data, self._settings)
        return self._monitored(seen.stamp_ns, started_from, dropped, fit, data)

    def _too_few(self, seen: HullProducts) -> str:
        return f"{len(seen.centerline.points_world)} centerline points, {self._settings.min_points} needed"

    def _monitored(self, stamp_ns: int, started_from: str, dropped: int, fit: FitResult, data: Data) -> Fit:
        """What comes of a fit once it is judged: itself, a better one, or that the body is lost."""
        assert self._body is not None
        found = self._monitor.examine(self._body, fit.pose, data, self._settings.articulated)
        if found.better is not None:
            fit = assess(self._body, found.better, data, fit.iterations, fit.converged, self._settings.articulated)
            self._own_sets = FOLLOW_SETS
        elif found.quality.state == GOOD:
            fit = self._refined(stamp_ns, fit, data)
        self._pose = fit.pose
        if found.quality.state == LOST:
            self._own_sets = FOLLOW_SETS
            fit = replace(fit, visible=np.zeros(15, dtype=bool))
        hypothesis = None if found.hypothesis is None else forward(self._body, found.hypothesis)
        covariance = widened_covariance(fit.covariance, found.quality, fit.reference_points_world, hypothesis)
        seen = _seen(stamp_ns, started_from, dropped, replace(fit, covariance=covariance))
        state = TRACKING if found.quality.state == GOOD else found.quality.state
        return replace(seen, state=state, reason=found.quality.reason, quality=found.quality, recovered=found.change)

    def _refined(self, stamp_ns: int, fit: FitResult, data: Data) -> FitResult:
        """The fit, done again with a better known body when there is one."""
        body = None if self._refiner is None else self._refiner.step(stamp_ns, fit.pose, data.contour_rays)
        if body is None:
            return fit
        self._body = body
        return self._fit(body, fit.pose, data, self._settings)

    def _new_refiner(self, found: InitialPose) -> BodyRefiner | None:
        """What refines the body that was found: nothing where its sizes are given and not measured."""
        settings = self._settings
        if found.estimate is None or settings.refinement.keyframes == 0 or not self.needs_contour_rays:
            return None
        return BodyRefiner(found.estimate, settings.refinement, settings.articulated.prior)

    def _acquire(self, found: InitialPose, seen: HullProducts, dropped: int) -> Fit:
        reason = found.reason
        if found.pose is not None and found.body is not None:
            if len(seen.centerline.points_world) >= self._settings.min_points:
                fit = self._fit(found.body, found.pose, self._data(seen), self._patient())
                explained = fit.inliers / fit.points
                if explained >= self._settings.acquire_inliers:
                    self._body, self._pose = found.body, fit.pose
                    self._refiner = self._new_refiner(found)
                    # the first pose is itself a measurement of every point, also of those the hull hides
                    seen_whole = replace(fit, visible=np.ones(15, dtype=bool))
                    return _seen(seen.stamp_ns, FROM_INITIAL, dropped, seen_whole)
                reason = f"the first pose explains only {100 * explained:.0f} % of the points"
            else:
                reason = self._too_few(seen)
        return _unseen(seen.stamp_ns, ACQUIRING, FROM_NOTHING, reason, dropped, None, np.zeros((15, 3)))

    def _patient(self) -> TrackerSettings:
        articulated = replace(self._settings.articulated, max_iterations=self._settings.acquire_iterations)
        return replace(self._settings, articulated=articulated)

    def _start(self, stamp_ns: int, own: Pose, prediction: Prediction | None) -> tuple[Pose, str]:
        if prediction is None or prediction.pose is None:
            return own, FROM_OWN
        ahead_s = (stamp_ns - prediction.stamp_ns) / NS_PER_S
        ahead_s = min(max(ahead_s, 0.0), self._settings.extrapolation_limit_s)
        predicted = prediction.pose.retract(prediction.velocity * ahead_s)
        if self._own_sets > 0 and self._body is not None:
            apart = np.linalg.norm(forward(self._body, predicted) - forward(self._body, own), axis=1).max()
            self._own_sets = self._own_sets - 1 if apart > AGREES_M else 0
            if self._own_sets > 0:
                return own, FROM_OWN
        return predicted, str(prediction.stamp_ns)

    def _data(self, seen: HullProducts) -> Data:
        """What the fit looks at."""
        all_joints = self._settings.method == "articulated"
        voxels, contour_rays = (seen.voxels, seen.contour_rays) if all_joints else (NO_VOXELS, NO_CONTOUR_RAYS)
        return make_data(
            seen.centerline.points_world, seen.centerline.sigma, voxels, self._settings.articulated, contour_rays
        )

    @staticmethod
    def _fit(body: Body, start: Pose, data: Data, settings: TrackerSettings) -> FitResult:
        if settings.method == "articulated":
            pose, iterations, moved = minimise(body, start, data, settings.articulated)
            return assess(body, pose, data, iterations, moved < settings.articulated.tolerance_m, settings.articulated)
        found = fit_hierarchical(body, start, data.points, settings.hierarchical)
        return assess(body, found.pose, data, found.iterations, found.converged, settings.articulated)


def make_tracker(settings: IcpNodeSettings, volume: Volume | None = None) -> IcpTracker:
    """A tracker whose first pose comes from where the settings say; ``volume`` : where hulls end, unless they say so.

    Raises InputError for files that cannot be used.
    """
    return IcpTracker(make_pose_source(settings.initial_pose, settings.body_file, volume), settings)


def warm_up(settings: TrackerSettings) -> None:
    """Run some fits on made-up data, so that compiled code is loaded before the first frame set arrives."""
    body = Body.from_stature(1.7)
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    tracker = IcpTracker(KnownPose(pose, body), replace(settings, acquire_inliers=0.0))
    points = forward(body, pose)
    voxels = VoxelSamples.checked(points, np.ones(len(points)))
    ahead, aside = np.tile([1.0, 0.0, 0.0], (15, 1)), np.tile([0.0, 1.0, 0.0], (15, 1))
    contour_rays = ContourRays(points, ahead, aside, np.full(15, 0.1), np.full(15, 0.01), np.zeros(15))
    for k in range(3):  # acquisition, a fit, and a look for another pose
        tracker.step(HullProducts.of_points(k, points, 0.01, voxels, contour_rays=contour_rays))
    if settings.refinement.keyframes > 0:
        warm_up_refiner(settings.refinement, settings.articulated.prior)


def _seen(stamp_ns: int, started_from: str, dropped: int, fit: FitResult) -> Fit:
    return Fit(
        stamp_ns,
        TRACKING,
        started_from,
        "",
        dropped,
        fit.reference_points_world,
        fit.covariance,
        fit.visible,
        fit.pose,
        Solution(fit.points, fit.inliers, fit.rms_m, fit.iterations, fit.converged),
    )


def _unseen(
    stamp_ns: int, state: str, started_from: str, reason: str, dropped: int, pose: Pose | None, points: np.ndarray
) -> Fit:
    unseen = np.zeros(15, dtype=bool)
    return Fit(stamp_ns, state, started_from, reason, dropped, points, unknown_covariance(), unseen, pose, None)
