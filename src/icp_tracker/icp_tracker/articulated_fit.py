"""All joints at once: robust Gauss-Newton of the articulated figure on points, hull and contour rays.

The same points, the same matching (nearest point of the nearest stick) and the same hard joint constraints as the
hierarchical ICP of thesis 4.3, but the 24 tangent components of the pose are solved together, so that no error of a
limb is frozen before its descendants are fitted:

    minimise  sum_i rho(|x_i - c_i|) / sigma_i^2  +  sum_v rho(distance of voxel v from the body's surface) / sigma_v^2
              +  sum_r rho(distance of contour ray r from the body's surface) / sigma_r^2
              +  sum_k rho(reprojection error of keypoint k)  +  |pose (-) start|^2_Lambda

with c_i the foot point on the closest stick, rho Geman-McClure, and Lambda a weak prior that holds unobserved joints.
Ball joints move on SO(3): no gimbal lock. Elbows and knees may pass straight during the solve (a limit there is a
saddle that traps arms) and are bent the right way again afterwards, with the same points. Weights are equivalent
centerline points: a term of weight 900 counts as much as 900 points of the centerline. Errors of rays and voxels are
correlated, those of keypoints (if there is a detector) are not, so the weight of a keypoint is OVERCOUNTED times its
information.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from capture_rig.settings import setting
from capture_rig.visibility import EVERYWHERE, RigVisibility
from mocap_packets.fit import Solution
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS, ContourRays, VoxelSamples
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.least_squares import gauss_newton
from stick_figure.least_squares.contour_factor import SLACK_M, RayArrays, RayMatch, match_rays
from stick_figure.least_squares.effective_information import SURFACE_SD_M
from stick_figure.least_squares.extremities import RAYS_PER_INDEPENDENT_SAMPLE, STIFF_SD, TURN_SD
from stick_figure.least_squares.gauss_newton import Data, Stop, Weights
from stick_figure.least_squares.keypoint_factor import GATE_SIGMAS, NO_KEYPOINTS, Keypoints
from stick_figure.least_squares.normal_equations import TANGENT
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import HINGE_MARGIN_RAD, Pose
from stick_figure.trunk_bend import with_joint_centres

# Thresholds: chosen with python bench/people.py on rendered and real sessions, in steps of about a half; UNSEEN_SD to
# UNKNOWN_SD_M by the share of true points inside their 95 % ellipsoids (`inside_95` there).
POINT_GATE_M = 0.08  # distance at which a centerline point's weight has fallen to 1/4
STICK_SD_M = 0.03  # of a perfect centerline point from its stick: a body is no stick figure
TOLERANCE_M = 0.002  # converged when an iteration moves no reference point farther than this
SURFACE_SAMPLES, HULL_SAMPLES = 1000, 1000  # sampled voxels of the surface, and of surface and interior
RAYS = 1200  # contour rays that are used
# prior about the start; twice and three times as wide loses arms of stylised people (bench/people.py --makers)
POSITION_SD_M, ROTATION_SD, BALL_SD, HINGE_SD = 0.1, 0.2, 0.15, 0.2  # m, rad
UNSEEN_SD = 0.5  # m, rad, of unobserved slots of the tangent: a joint's free range to either side, a forearm's 15 cm
SUPPORT_POINTS = 3  # inliers that make a reference point visible
SUPPORT_VOXELS = 5  # surface voxels on the body near a point's stick that make it visible without inliers
UNKNOWN_SD_M = 10.0  # standard deviation of an unknown point
PRIOR_SD = np.repeat([POSITION_SD_M, ROTATION_SD, BALL_SD], [3, 3, TANGENT - 6])
PRIOR_SD[kernels.HINGE_SLOT] = HINGE_SD
PRIOR = PRIOR_SD**-2
LONGEST_S = 0.1  # longest interval between two sets that motion and evidence are scaled to
GUESS = 3.0  # factor of the prior's width in a fit that starts from a guess
UNSEEN = np.full(TANGENT, UNSEEN_SD**-2)
# sticks that meet at each reference point, one or two: torso centre, head tip, neck, shoulders, hips, elbows, knees,
# hands, feet
FIRST_SUPPORT = np.array([0, 1, 0, 0, 0, 0, 0, 2, 3, 4, 5, 6, 7, 8, 9])
SECOND_SUPPORT = np.array([0, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 6, 7, 8, 9])


@dataclass(frozen=True)
class VolumeSettings:
    """The voxels of the hull against the body's surface."""

    weight: float = setting(
        900.0, "all surface voxels together, in centerline points; 0 leaves the voxels out", low=0.0, high=1e6
    )


@dataclass(frozen=True)
class ContourSettings:
    """The contour rays against the body's surface.

    rigid : the body is the stick figure: hands, feet and trunk are rigid, its joints are the figure's.
    """

    weight: float = setting(
        10000.0, "all contour rays together, in centerline points; 0 leaves the rays out", low=0.0, high=1e6
    )
    rigid: bool = False


@dataclass(frozen=True)
class ArticulatedSettings:
    """Settings of the all-joints solve.

    model_sigma_m : distance of a perfect centerline point from its stick. prior : standard deviations about the start,
    over PRIOR_SD. max_iterations : of Gauss-Newton.
    """

    volume: VolumeSettings = field(default_factory=VolumeSettings)
    contour: ContourSettings = field(default_factory=ContourSettings)
    model_sigma_m: float = STICK_SD_M
    prior: float = 1.0
    max_iterations: int = 8

    @classmethod
    def of_ideal_figure(cls) -> ArticulatedSettings:
        """Return the settings for a body that is the stick figure, whose points lie on the sticks."""
        return cls(model_sigma_m=1e-3, contour=ContourSettings(rigid=True))


@dataclass(frozen=True, eq=False)
class FitResult:
    """The stick figure fitted to a cloud of points, world frame.

    reference_points_world : (15, 3) m; covariance : (15, 3, 3) m^2, from the solver's information.
    visible : (15,) bool, enough points support a stick that meets at the reference point.
    matched : the rays' match.
    """

    pose: Pose
    solution: Solution
    reference_points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray
    matched: RayMatch


def minimise(body: Body, start: Pose, data: Data, settings: ArticulatedSettings) -> tuple[Pose, int, float]:
    """Return the pose reached from ``start``, the iterations it took, and how far (m) the last one moved a point."""
    state, figure, weights = PoseState.of(start), BodyModel.of(body), make_weights(data, settings)
    stop = Stop(settings.max_iterations, TOLERANCE_M, HINGE_MARGIN_RAD)
    iterations, moved = gauss_newton.minimise(data, state, figure, weights, stop)
    return state.pose(), iterations, moved


def assess(
    body: Body, pose: Pose, data: Data, iterations: int, converged: bool, settings: ArticulatedSettings
) -> FitResult:
    """Evaluate the data at ``pose``: residuals, information, reference points and their covariance.

    The covariance of a point is ``J H^-1 J^T``, H the set's :mod:`stick_figure.least_squares.effective_information`.
    Most of it lasts for many sets (the filter's share); a joint's place in its limb (the filter's joint uncertainty) is
    not in it.
    """
    weights = make_weights(data, settings)
    found = gauss_newton.assess(data, PoseState(*pose.arrays), BodyModel.of(body), weights, UNSEEN)
    points_world, covariance, counts, rms_m, near_sticks, matched = found
    if not settings.contour.rigid and len(data.contour_rays.information) > 0:
        points_world = with_joint_centres(body, pose, points_world)
    solution = Solution(len(data.points), int(counts.sum()), rms_m, int(iterations), bool(converged))
    visible = _supported(counts, SUPPORT_POINTS) | _supported(near_sticks, SUPPORT_VOXELS)
    return FitResult(pose, solution, points_world, covariance, visible, matched)


def make_data(
    points_world: np.ndarray,
    sigma_m: np.ndarray | float,
    voxels: VoxelSamples,
    settings: ArticulatedSettings,
    contour_rays: ContourRays = NO_CONTOUR_RAYS,
    visibility: RigVisibility | None = None,
    keypoints: Keypoints = NO_KEYPOINTS,
) -> Data:
    """Lay out the data. A point's variance is its own noise and the model's, added in quadrature; its gate is wider by
    GATE_SIGMAS of its own noise.

    Where the hull is cut by the limits of the rig's ``visibility``, its faces are not the body's surface, and slices
    have wrong centroids. Neither is used.
    """
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),))
    volume = settings.volume
    surface = (voxels if volume.weight > 0.0 else NO_VOXELS).surface_points(SURFACE_SAMPLES)
    contour_rays = contour_rays if settings.contour.weight > 0.0 else NO_CONTOUR_RAYS
    if visibility is not None:
        whole = visibility.near_unseen.rows_outside(points)
        points, sigma = points.take(whole, axis=0), sigma.take(whole)
        surface = surface.take(visibility.near_unseen.rows_outside(surface), axis=0)
    gate2 = POINT_GATE_M**2 + (GATE_SIGMAS * sigma) ** 2
    return Data(
        points,
        1.0 / (settings.model_sigma_m**2 + sigma**2),
        gate2,
        surface,
        np.ascontiguousarray(voxels.hull_points(HULL_SAMPLES), dtype=np.float64),
        _contour_rays(rays_in_use(contour_rays, visibility), settings),
        EVERYWHERE if visibility is None else visibility.unseen_cells,
        keypoints,
    )


def rays_in_use(rays: ContourRays, visibility: RigVisibility | None = None) -> ContourRays:
    """Return the rays that a fit uses: those that touch the hull within the rig's view, thinned."""
    if visibility is not None:
        in_sight = visibility.unseen_cells.rows_outside(rays.points_world)
        rays = rays.chosen(in_sight) if len(in_sight) < len(rays) else rays
    return rays.thinned(RAYS)


def rays_at_stamp(rays: ContourRays, body: Body, pose: Pose, velocity: np.ndarray) -> ContourRays:
    """Return the rays as if all were exposed at the set's stamp: motion compensation, as lidars deskew a scan.

    A ray of ``time_s`` touches a point of the surface that has moved by its velocity times that; the ray moved back by
    as much touches the body as it was at the stamp. The point is the nearest of the body in the ``pose`` that is
    expected at the stamp, with a ``velocity`` (24,) of its tangent, m/s and rad/s.
    """
    if not rays.time_s.any():
        return rays
    figure, span_s = BodyModel.of(body), np.abs(rays.time_s).max()
    now, then = (place(PoseState.of(each), figure) for each in (pose, pose.retract(velocity * span_s)))
    arrays = ray_arrays(rays, np.ones(len(rays)))
    match, share = match_rays(arrays, now, SLACK_M), (rays.time_s / span_s)[:, None]
    starts, ends = (then.P - now.P)[match.capsule], (then.Q - now.Q)[match.capsule]
    moved = starts + match.along[:, None] * (ends - starts)
    return replace(rays, points_world=rays.points_world - share * moved, time_s=np.zeros(len(rays)))


def _contour_rays(rays: ContourRays, settings: ArticulatedSettings) -> RayArrays:
    """Lay out the rays with each one's share of the total weight."""
    trust = SURFACE_SD_M**2 / (SURFACE_SD_M**2 + rays.sigma**2)  # a ray less certain than the surface counts less
    information = trust * (settings.contour.weight / settings.model_sigma_m**2 / max(len(rays), 1))
    return ray_arrays(rays, information)


def ray_arrays(rays: ContourRays, information: np.ndarray) -> RayArrays:
    """Lay out rays (n) with information (n,), 1/m^2."""
    return RayArrays.of(rays.points_world, rays.directions, rays.normals, rays.half_lengths, information)


def make_weights(data: Data, settings: ArticulatedSettings) -> Weights:
    """Turn the settings into information of each term."""
    volume, one, voxels = settings.volume, 1.0 / settings.model_sigma_m**2, len(data.voxels)
    return Weights(
        prior=PRIOR / settings.prior**2,
        voxel=volume.weight * one / voxels if voxels else 0.0,
        ends=RAYS_PER_INDEPENDENT_SAMPLE / (STIFF_SD if settings.contour.rigid else TURN_SD) ** 2,
    )


def unknown_covariance() -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2 of unknown points."""
    return np.broadcast_to(np.eye(3) * UNKNOWN_SD_M**2, (15, 3, 3)).copy()


def _supported(count_of_stick: np.ndarray, needed: int) -> np.ndarray:
    """Return (15,) bool: at least ``needed`` on one of the sticks that meet at the point."""
    enough = count_of_stick >= needed
    return np.asarray(enough[FIRST_SUPPORT] | enough[SECOND_SUPPORT])
