"""From one frame set's hull to the pose and the 15 reference points, set after set.

Until there is a body, every set goes to a source of the first pose (``initialization/``). From then on: start from the
filter's prediction, choose the rows of the body that is expected there, fit, let the monitor judge and repair
(``monitor/``), refine the body's sizes (``refinement/``), widen the covariance of doubtful parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture_rig.stamps import NS_PER_S
from capture_rig.visibility import RigVisibility
from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, UNKNOWN, Fit, TrackQuality
from mocap_packets.hull import NO_CENTERLINE, NO_CONTOUR_RAYS, NO_VOXELS, ContourRays, HullProducts, VoxelSamples
from mocap_packets.state import Prediction
from stick_figure.body import Body
from stick_figure.kinematics import farthest_apart_m, forward
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.normal_equations import TANGENT
from stick_figure.pose import T_POSE_ANGLES, Pose

from .articulated_fit import (
    LONGEST_S,
    TOLERANCE_M,
    FitResult,
    assess,
    make_data,
    minimise,
    rays_at_stamp,
    rays_in_use,
    unknown_covariance,
)
from .extrinsic_monitor import ContourResiduals
from .initialization.body_sizes import BodyEstimate, covariance_of_sizes
from .initialization.initial_pose import InitialPose, KnownPose, PoseSource
from .initialization.pose_source import make_pose_source
from .monitor.evidence import SAME_M
from .monitor.track_monitor import TrackAssessment, TrackMonitor
from .refinement.bend_estimator import TrunkBendEstimator
from .refinement.body_refiner import BodyRefiner, known_sizes, warm_up_refiner
from .settings import IcpNodeSettings, TrackerSettings
from .thesis.hierarchical_icp import fit_hierarchical

ACQUIRING, TRACKING = "acquiring", "tracking"
FROM_NOTHING, FROM_INITIAL, FROM_OWN = "nothing", "initial", "own"
# Thresholds: measured by python bench/recovery.py.
FOLLOW_SETS = 15  # at most that start from the own pose after a change-over: the filter accepts a jump after five
FEWEST_POINTS = 15  # fewer centerline points count as none
FIRST_ITERATIONS = 30  # of the first fit


class IcpTracker:
    """Tracks one body. Deterministic: the same sets and predictions give the same results to the last bit."""

    def __init__(
        self, source: PoseSource, settings: TrackerSettings | None = None, visibility: RigVisibility | None = None
    ) -> None:
        """``visibility`` : where hulls show a body; None: everywhere."""
        self._source, self._visibility = source, visibility
        self._settings = settings or TrackerSettings()
        self._monitor = TrackMonitor(self._settings.recovery)
        self.reset()

    def reset(self) -> None:
        """Forget the body and start again with a first pose."""
        self._body: Body | None = None
        self._trunk = TrunkBendEstimator(self._settings.articulated)
        self._pose: Pose | None = None
        self._refiner: BodyRefiner | None = None
        self._monitor.reset()
        self._own_sets: int | None = None  # sets since a change-over while the filter has not caught up
        self._matched: tuple[FitResult, ContourRays] | None = None

    @property
    def body(self) -> Body | None:
        """The tracked body; None before the first pose. It changes as its sizes are refined."""
        return self._body

    @property
    def bent_body(self) -> Body | None:
        """The tracked body with the present bend of its trunk; None before the first pose."""
        return None if self._body is None else self._trunk.of(self._body)

    @property
    def pose(self) -> Pose | None:
        """The pose in the last set; None before the first one."""
        return self._pose

    @property
    def residuals(self) -> ContourResiduals | None:
        """The contour rays of the last set with their match, if it was fitted and the fit is not lost."""
        if self._matched is None:
            return None
        fit, rays = self._matched
        rays = rays_in_use(rays, self._visibility)
        return ContourResiduals(fit.reference_points_world, rays, fit.matched)

    def expected(self, stamp_ns: int, prediction: Prediction | None = None) -> Pose | None:
        """Return the pose that is expected in the next set; None before the first pose."""
        if prediction is None or prediction.pose is None or self._own_sets is not None:
            return self._pose
        return None if self._pose is None else self._predicted(stamp_ns, prediction, prediction.pose)

    def move_to(self, pose: Pose) -> None:
        """Continue from another pose of the same body. ValueError while there is no body."""
        if self._body is None:
            raise ValueError("no body is followed yet")
        self._pose, self._own_sets = pose, 0
        self._monitor.reset()

    @property
    def refined_sizes(self) -> BodyEstimate | None:
        """The refined sizes of a measured body with their covariance; None for a body whose sizes were given."""
        return None if self._refiner is None else self._refiner.refined

    @property
    def _all_joints(self) -> bool:
        return self._settings.method == "articulated"

    def step(self, seen: HullProducts, prediction: Prediction | None = None, learn: bool = True) -> Fit:
        """Fit one frame set of one body, all of it finite; ``learn`` : refine the body's sizes with it, too."""
        self._matched = None
        if self._body is None or self._pose is None:
            return self._acquire(seen)
        return self._track(self._trunk.of(self._body), self._pose, seen, prediction, learn)

    def _track(self, body: Body, pose: Pose, seen: HullProducts, prediction: Prediction | None, learn: bool) -> Fit:
        """Fit the tracked body to a set; ``pose`` is that of the set before."""
        start, started_from = self._start(body, pose, seen.stamp_ns, prediction)
        if reason := too_few_points(seen):
            self._pose = start
            self._monitor.mark_lost()
            return _not_seen(seen, LOST, started_from, f"nobody in the volume: {reason}", body, start)

        if prediction is not None:  # cameras that are not in step see the body at several instants
            rays = rays_at_stamp(seen.contour_rays, body, start, prediction.velocity)
            seen = replace(seen, contour_rays=rays)
        data = self._data(seen)
        fit = self._solve(body, start, data)
        settings = self._settings.articulated
        found = self._monitor.assess(seen.stamp_ns, body, fit.pose, data, settings, fit.matched)
        if found.better is not None:
            fit = assess(body, found.better, data, fit.solution.iterations, fit.solution.converged, settings)
        elif found.quality.state == GOOD and learn:
            fit = self._refine_body(seen.stamp_ns, fit, data)
        if found.better is not None or found.quality.state == LOST:
            self._own_sets = 0
        self._pose = fit.pose
        judged = self._judged(seen.stamp_ns, started_from, fit, found)
        if judged.state != LOST and len(data.contour_rays.information) > 0:
            self._matched = fit, seen.contour_rays
        if found.better is None and found.quality.state == GOOD and self._body is not None:
            self._trunk.update(seen.stamp_ns, self._body, fit.pose, data.contour_rays, fit.matched)
        return judged

    def _start(self, body: Body, own: Pose, stamp_ns: int, prediction: Prediction | None) -> tuple[Pose, str]:
        """Return the pose to start from and its origin: the filter's prediction, or the own pose of the set before."""
        if prediction is None or prediction.pose is None:
            return own, FROM_OWN
        predicted = self._predicted(stamp_ns, prediction, prediction.pose)
        if self._own_sets is not None:
            agrees = farthest_apart_m(body, predicted, own) <= SAME_M  # then the filter has followed a recovered pose
            self._own_sets = None if agrees or self._own_sets + 1 >= FOLLOW_SETS else self._own_sets + 1
            if self._own_sets is not None:
                return own, FROM_OWN
        return predicted, str(prediction.stamp_ns)

    def _predicted(self, stamp_ns: int, prediction: Prediction, pose: Pose) -> Pose:
        """Return the filter's pose, predicted to a stamp, with its joints described within their ranges.

        The filter's own description may hold elbows that are bent a little the wrong way, where a fit would stay.
        """
        pose = Pose.from_angles(pose.position_world, pose.R_world_torso, pose.angles())
        ahead_s = min(max((stamp_ns - prediction.stamp_ns) / NS_PER_S, 0.0), LONGEST_S)
        return pose.retract(prediction.velocity * ahead_s)

    def _data(self, seen: HullProducts) -> Data:
        """Lay out the fit's data."""
        voxels, contour_rays = (seen.voxels, seen.contour_rays) if self._all_joints else (NO_VOXELS, NO_CONTOUR_RAYS)
        line = seen.centerline
        settings, visibility = self._settings.articulated, self._visibility
        return make_data(line.points_world, line.sigma, voxels, settings, contour_rays, visibility, seen.keypoints)

    def _solve(self, body: Body, start: Pose, data: Data, iterations: int | None = None) -> FitResult:
        """Fit the body by the chosen method; ``iterations`` : of the all-joints solve, else those of the settings."""
        settings = self._settings.articulated
        if self._all_joints:
            patience = settings if iterations is None else replace(settings, max_iterations=iterations)
            pose, spent, moved = minimise(body, start, data, patience)
            return assess(body, pose, data, spent, moved < TOLERANCE_M, settings)
        pose, spent, converged = fit_hierarchical(body, start, data.points, self._settings.descendant_weight)
        return assess(body, pose, data, spent, converged, settings)

    def _refine_body(self, stamp_ns: int, fit: FitResult, data: Data) -> FitResult:
        """Return the fit, repeated with a refined body when there is one."""
        if self._refiner is None:
            return fit
        body = self._refiner.step(stamp_ns, fit.pose, data.contour_rays, self._trunk.bend)
        if body is None:
            return fit
        self._body = body
        return self._solve(self._trunk.of(body), fit.pose, data)

    def _judged(self, stamp_ns: int, started_from: str, fit: FitResult, found: TrackAssessment) -> Fit:
        """Return the fit with the monitor's quality, and its covariance widened."""
        quality, covariance = found.quality, self._with_sizes(fit)
        if found.spread is not None:
            covariance = covariance + found.spread
        visible = fit.visible if quality.state != LOST else np.zeros(15, dtype=bool)
        of_parts = TRACKING if GOOD in quality.parts else DOUBTFUL
        state = of_parts if quality.state == GOOD else quality.state
        return Fit(
            *(stamp_ns, state, started_from, quality.reason, 0, fit.reference_points_world, covariance, visible),
            *(fit.pose, fit.solution, quality, found.change, found.moved),
        )

    def _with_sizes(self, fit: FitResult) -> np.ndarray:
        """Return the fit's covariance, with that of the body's sizes."""
        if self._refiner is None:
            return fit.covariance
        return fit.covariance + covariance_of_sizes(fit.pose, np.sqrt(np.diag(self._refiner.sizes_covariance)))

    # --- the first pose

    def _acquire(self, seen: HullProducts) -> Fit:
        """Find a first pose, and start tracking if it explains enough of the set."""
        found = self._source.find_pose(seen)
        if found.pose is None or found.body is None:
            return _not_seen(seen, ACQUIRING, FROM_NOTHING, found.reason)
        if reason := too_few_points(seen):
            return _not_seen(seen, ACQUIRING, FROM_NOTHING, reason)
        fit = self._solve(found.body, found.pose, self._data(seen), FIRST_ITERATIONS)
        explained = fit.solution.inliers / fit.solution.points
        if explained < self._settings.acquire_inliers and not found.is_fitted:
            reason = f"the first pose explains only {100 * explained:.0f} % of the points"
            return _not_seen(seen, ACQUIRING, FROM_NOTHING, reason)
        self._body, self._pose, self._refiner = found.body, fit.pose, self._new_refiner(found)
        # the first pose measures every point, even those that the hull hides
        points, visible = fit.reference_points_world, np.ones(15, dtype=bool)
        known = (points, self._with_sizes(fit), visible, fit.pose, fit.solution)
        return Fit(seen.stamp_ns, TRACKING, FROM_INITIAL, "", 0, *known)

    def _new_refiner(self, found: InitialPose) -> BodyRefiner | None:
        """Return the refiner of a new body: of sizes and build, of the build alone where sizes are given, or None where
        both are."""
        refinement, body = self._settings.refinement, found.body
        if body is None or refinement.keyframes == 0 or not self._all_joints:
            return None
        if found.estimate is not None:
            return BodyRefiner(found.estimate, refinement, None, body.build)
        if body.build.any():
            return None
        return BodyRefiner(known_sizes(body), refinement, body)


def make_tracker(settings: IcpNodeSettings, visibility: RigVisibility | None = None) -> IcpTracker:
    """Make a tracker by the settings; ``visibility`` : where hulls show a body.

    Raises InputError for files that cannot be used.
    """
    return IcpTracker(make_pose_source(settings.initial_pose, settings.body_file, visibility), settings, visibility)


def warm_up(settings: TrackerSettings, visibility: RigVisibility | None = None) -> None:
    """Run some fits on made-up data, so that compiled code is loaded before the first frame set arrives."""
    body = Body.from_stature(1.7)
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    tracker = IcpTracker(KnownPose(pose, body), replace(settings, acquire_inliers=0.0), visibility)
    points = forward(body, pose)
    voxels = VoxelSamples(points, np.ones(len(points), bool))
    ahead, aside = np.tile([1.0, 0.0, 0.0], (15, 1)), np.tile([0.0, 1.0, 0.0], (15, 1))
    late_s = np.full(15, 0.001)
    contour_rays = ContourRays(points, ahead, aside, np.full(15, 0.1), np.full(15, 0.01), time_s=late_s)
    for k in range(3):  # initialization, a fit, and a search for another pose
        predicted = Prediction.of(k, pose, np.zeros(TANGENT))
        tracker.step(HullProducts.of_points(k, points, 0.01, voxels, contour_rays=contour_rays), predicted)
    if settings.method == "articulated":
        trunk = TrunkBendEstimator(settings.articulated)
        data = make_data(points, 0.01, voxels, settings.articulated, contour_rays, visibility)
        matched = assess(body, pose, data, 0, True, settings.articulated).matched
        for k in range(2):
            trunk.update(k, body, pose, data.contour_rays, matched)
    if settings.refinement.keyframes > 0:
        warm_up_refiner(settings.refinement)


def too_few_points(seen: HullProducts) -> str:
    """Return why a set has too few points to be fitted; empty when it has enough."""
    points = len(seen.centerline)
    return "" if points >= FEWEST_POINTS else f"{points} centerline points, {FEWEST_POINTS} needed"


def fits_nothing(stamp_ns: int, reason: str) -> Fit:
    """Return the fit of somebody without a first pose, with the reason."""
    return _not_seen(HullProducts(stamp_ns, NO_CENTERLINE), ACQUIRING, FROM_NOTHING, reason)


def _not_seen(
    seen: HullProducts, state: str, started_from: str, reason: str, body: Body | None = None, pose: Pose | None = None
) -> Fit:
    """Return the result of a set without a fit: the prediction, if any, with unknown covariance."""
    points = np.zeros((15, 3)) if body is None or pose is None else forward(body, pose)
    nothing = (points, unknown_covariance(), np.zeros(15, dtype=bool))
    quality = TrackQuality(LOST, reason, (LOST,) * len(PART_NAMES), 0.0) if state == LOST else UNKNOWN
    return Fit(seen.stamp_ns, state, started_from, reason, 0, *nothing, pose, None, quality)
