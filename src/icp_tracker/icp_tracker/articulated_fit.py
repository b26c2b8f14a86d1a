"""All joints at once: robust Gauss-Newton of the articulated figure on the centerline's points and the hull's voxels.

The same points, the same matching (nearest point of the nearest stick) and the same hard joint constraints as the
hierarchical ICP of thesis 4.3, but the 24 tangent components of the pose are solved together, so that no error of a
limb is frozen before its descendants have spoken:

    minimise  sum_i rho(|x_i - c_i|) / sigma_i^2  +  sum_v rho(distance of voxel v to the flesh) / sigma_v^2
              +  sum_s rho(distance of stick point s from the hull) / sigma_s^2  +  |pose (-) start|^2_Lambda

with c_i the foot point on the closest stick, rho Geman-McClure or X84, and Lambda a weak prior that holds what the
data do not see. Ball joints move on SO(3): no gimbal lock. Elbows and knees may pass straight during the solve (a
limit there is a saddle that traps arms) and are bent the right way again afterwards, with the same points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.settings import setting
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS, ContourRays, VoxelSamples
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.least_squares.contour_factor import RayArrays
from stick_figure.least_squares.gauss_newton import Data, Stop, Weights, gauss_newton, linearise
from stick_figure.least_squares.normal_equations import TANGENT, mirror_upper, point_covariances
from stick_figure.least_squares.placed_figure import STICKS, Figure, State, place, reference_points, surface_distances
from stick_figure.least_squares.point_factor import GEMAN_MCCLURE, X84, summarise
from stick_figure.pose import Pose

# --- What a fit of the stick figure to one cloud of centerline points returns.

# sticks that meet at each reference point: torso centre, head tip, neck, shoulders, hips, elbows, knees, hands, feet
SUPPORTING_STICKS = (
    (0,),
    (1,),
    (0, 1),
    (0, 2),
    (0, 3),
    (0, 4),
    (0, 5),
    (2, 6),
    (3, 7),
    (4, 8),
    (5, 9),
    (6,),
    (7,),
    (8,),
    (9,),
)
UNKNOWN_SD_M = 10.0
"""Standard deviation (m) given to a point about which nothing is known."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """The stick figure fitted to a cloud of points, world frame.

    pose : the figure's pose; converged : the last step was below the tolerance within the iterations allowed.
    iterations : solver iterations; points, inliers : data points given, and those within the robust gate.
    rms_m : root mean square distance (m) of the inliers to their sticks; stick_inliers : (10,) inliers a stick.
    information : (24, 24) data information of the pose's tangent (Gauss-Newton H, 1/m^2 and 1/rad^2).
    reference_points_world : (15, 3) m; covariance : (15, 3, 3) m^2, from the solver's information.
    visible : (15,) bool, enough points support a stick that meets at the reference point.
    """

    pose: Pose
    converged: bool
    iterations: int
    points: int
    inliers: int
    rms_m: float
    stick_inliers: np.ndarray
    information: np.ndarray
    reference_points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray


def visible_points(stick_inliers: np.ndarray, needed: int) -> np.ndarray:
    """(15,) bool: at least ``needed`` inliers on one of the sticks that meet at the point."""
    return np.array([max(stick_inliers[j] for j in sticks) >= needed for sticks in SUPPORTING_STICKS])


def unknown_covariance() -> np.ndarray:
    """(15, 3, 3) covariance of points about which nothing is known."""
    return np.broadcast_to(np.eye(3) * UNKNOWN_SD_M**2, (15, 3, 3)).copy()


GATE_SIGMAS = 3.0  # the gate of a point is wider by so many of its own standard deviations
HINGE_MARGIN = 0.15  # rad a hinge may stay on the wrong side of straight


@dataclass(frozen=True)
class PriorSettings:
    """How far the pose may leave its start where no datum says otherwise: standard deviations of a Gaussian prior."""

    position_sd_m: float = setting(0.1, "torso position", unit="m", low=1e-4, high=100.0)
    rotation_sd: float = setting(0.2, "torso rotation", unit="rad", low=1e-4, high=100.0)
    ball_sd: float = setting(0.15, "neck, shoulders and hips", unit="rad", low=1e-4, high=100.0)
    hinge_sd: float = setting(0.2, "elbows and knees", unit="rad", low=1e-4, high=100.0)
    neck_sd: float = setting(
        0.25, "head about its rest direction; in the solve, not in the covariance (0: off)", unit="rad", low=0.0
    )
    neck_pitch: float = setting(0.1, "rest direction of the head, forward of the torso's axis", unit="rad")
    limit_sd: float = setting(
        0.2, "joint limits, as a soft cost beyond the range; not in the covariance (0: off)", unit="rad", low=0.0
    )

    def information(self) -> np.ndarray:
        """(24,) inverse variances of the tangent slots."""
        sd = np.full(TANGENT, self.ball_sd)
        sd[:3], sd[3:6] = self.position_sd_m, self.rotation_sd
        sd[kernels.HINGE_SLOT] = self.hinge_sd
        return 1.0 / sd**2


@dataclass(frozen=True)
class VolumeSettings:
    """The voxels of the hull's surface against the figure's flesh."""

    weight: float = setting(
        900.0, "centerline points that all voxels together are worth; 0 leaves the voxels out", low=0.0, high=1e6
    )
    samples: int = setting(1000, "surface voxels that are looked at", low=10, high=100000)
    gate_m: float = setting(0.06, "distance at which a voxel's weight has fallen to 1/4", unit="m", low=1e-3)
    tight_m: float = setting(
        0.025, "excess of the hull over the flesh at which the voxels' weight has fallen to a half", unit="m", low=1e-3
    )
    inside_weight: float = setting(
        6.0, "centerline points that one point of a stick outside the hull is worth; 0: off", low=0.0, high=1e6
    )
    inside_samples: int = setting(1000, "voxels of surface and interior that stand for the hull", low=10, high=100000)
    inside_slack_m: float = setting(0.045, "distance from those voxels that still counts as inside", unit="m", low=0.0)
    inside_gate_m: float = setting(0.2, "distance at which that weight has fallen to 1/4", unit="m", low=1e-3)
    covariance_share: float = setting(
        0.05,
        "share of their worth with which voxels enter the covariance (their errors are common to many)",
        low=0.0,
        high=1.0,
    )
    clearance_weight: float = setting(
        10.0, "centerline points that keeping an arm out of the torso is worth; 0: off", low=0.0, high=1e6
    )


@dataclass(frozen=True)
class ContourSettings:
    """The silhouettes' rims against the figure's flesh."""

    weight: float = setting(
        10000.0, "centerline points that all rims together are worth; 0 leaves the rims out", low=0.0, high=1e6
    )
    rays: int = setting(1200, "rays that are looked at", low=10, high=100000)
    surface_sd_m: float = setting(
        0.01,
        "distance of the flesh from a body's surface: a ray less certain than this counts less",
        unit="m",
        low=1e-4,
    )
    gate_m: float = setting(0.06, "misfit at which a ray's weight has fallen to 1/4", unit="m", low=1e-3)
    slack_m: float = setting(
        0.05, "the flesh may touch a ray this far from the stretch where the ray touches the hull", unit="m", low=0.0
    )


@dataclass(frozen=True)
class ArticulatedSettings:
    """Settings of the all-joints solve."""

    robust: str = setting(
        "geman_mcclure",
        "weight of distant points: smooth (hulls) or X84 rejection per stick (clean points)",
        choices=("geman_mcclure", "x84"),
    )
    gate_m: float = setting(0.08, "distance at which a Geman-McClure weight has fallen to 1/4", unit="m", low=1e-3)
    rejection_floor_m: float = setting(0.005, "least scale of the X84 rejection", unit="m", low=0.0)
    model_sigma_m: float = setting(
        0.03, "distance of a perfect centerline point from its stick (a body is no stick figure)", unit="m", low=1e-4
    )
    correlation: float = setting(
        4.0, "data that carry the information of one independent datum (neighbours share voxels)", low=1.0
    )
    max_iterations: int = setting(8, "Gauss-Newton iterations at most", low=1, high=1000)
    tolerance_m: float = setting(
        0.002, "converged when an iteration moves no reference point farther than this", unit="m", low=0.0
    )
    step_limit: float = setting(0.5, "largest component of one step", unit="m, rad", low=1e-3)
    support_points: int = setting(3, "inliers that make a reference point visible", low=1)
    support_voxels: int = setting(
        5, "surface voxels on the flesh of a point's stick that make it visible without inliers", low=1
    )
    prior: PriorSettings = setting(PriorSettings, "prior about the start of the fit")
    volume: VolumeSettings = setting(VolumeSettings, "the hull's voxels")
    contour: ContourSettings = setting(ContourSettings, "the silhouettes' rims")


def fit_articulated(
    body: Body,
    start: Pose,
    points_world: np.ndarray,
    sigma_m: np.ndarray | float = 0.0,
    voxels: VoxelSamples = NO_VOXELS,
    settings: ArticulatedSettings | None = None,
    contour_rays: ContourRays = NO_CONTOUR_RAYS,
) -> FitResult:
    """Fit the figure to ``points_world`` (n, 3) m with noise ``sigma_m`` (n,), voxels and rims, from ``start``."""
    settings = settings or ArticulatedSettings()
    data = make_data(points_world, sigma_m, voxels, settings, contour_rays)
    pose, iterations, moved = minimise(body, start, data, settings)
    return assess(body, pose, data, iterations, moved < settings.tolerance_m, settings)


def minimise(body: Body, start: Pose, data: Data, settings: ArticulatedSettings) -> tuple[Pose, int, float]:
    """Return the pose reached from ``start``, the iterations it took, and how far (m) the last one moved a point."""
    state, figure, weights = State.of(start), Figure.of(body), make_weights(data, settings)
    _, _, distance = surface_distances(data.voxels, place(state, figure))
    stop = Stop(settings.max_iterations, settings.tolerance_m, settings.step_limit)
    iterations, moved = gauss_newton(data, state, figure, discount_loose_hull(weights, distance, settings), stop)
    kernels.canonicalise_hinges(state.RJ, state.hinges, np.zeros(TANGENT), HINGE_MARGIN)
    return state.pose(), iterations, moved


def discount_loose_hull(weights: Weights, distance: np.ndarray, settings: ArticulatedSettings) -> Weights:
    """Reduce the weight of the surface voxels, by their distances (m,) m from the body's surface.

    A hull of few cameras is up to twice the body's volume, and the surface of what it adds is not the body's. Its
    excess is the median distance: about 10 mm for six cameras around a person, 60 mm for four on two sides.
    """
    if weights.voxel == 0.0:
        return weights
    excess = max(float(np.median(distance)), 0.0)
    return weights._replace(voxel=weights.voxel / (1.0 + (excess / settings.volume.tight_m) ** 4))


def assess(
    body: Body, pose: Pose, data: Data, iterations: int, converged: bool, settings: ArticulatedSettings
) -> FitResult:
    """Return what the data say about ``pose``: residuals, information, reference points and their covariance.

    The covariance is ``correlation * J (H + Lambda)^-1 J^T`` per point, and larger by the reduced chi-square where the
    inliers lie farther off than their own sigma says. It serves any fit, also the hierarchical one. What
    hull and stick figure share (a hull is wider than the body, a shoulder is no single point) is not in it: it lasts
    for many sets, and the filter accounts for it.
    """
    placed = place(State.of(pose), Figure.of(body))
    capsule, _, distance = surface_distances(data.voxels, placed)
    weights = discount_loose_hull(make_weights(data, settings), distance, settings)
    weights = weights._replace(voxel=settings.volume.covariance_share * weights.voxel, inside=0.0)
    H, g = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    match, counts = linearise(data, placed, weights, H, g), np.zeros(STICKS, np.int64)
    mirror_upper(H)
    total, chi2, freedom = summarise(match, counts)
    scale = settings.correlation * max(1.0, chi2 / max(freedom - TANGENT, 1.0))
    inliers, near = int(counts.sum()), capsule[np.abs(distance) < settings.volume.gate_m]
    near_sticks = np.bincount(placed.surface.stick[near], minlength=STICKS)
    return FitResult(
        pose,
        bool(converged),
        int(iterations),
        len(data.points),
        inliers,
        float(np.sqrt(total / max(inliers, 1))),
        counts,
        H,
        reference_points(placed),
        point_covariances(H + np.diag(weights.prior), placed, scale),
        visible_points(counts, settings.support_points) | visible_points(near_sticks, settings.support_voxels),
    )


def make_data(
    points_world: np.ndarray,
    sigma_m: np.ndarray | float,
    voxels: VoxelSamples,
    settings: ArticulatedSettings,
    contour_rays: ContourRays = NO_CONTOUR_RAYS,
) -> Data:
    """The data as arrays. A point's variance is its own noise and the model's misfit, added in quadrature."""
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),))
    volume = settings.volume
    surface = (voxels if volume.weight > 0.0 else NO_VOXELS).surface_points(volume.samples)
    hull = (voxels if volume.inside_weight > 0.0 else NO_VOXELS).hull_points(volume.inside_samples)
    gate2 = settings.gate_m**2 + (GATE_SIGMAS * sigma) ** 2
    return Data(
        points,
        1.0 / (settings.model_sigma_m**2 + sigma**2),
        gate2,
        surface,
        hull,
        _contour_rays(contour_rays, settings),
    )


def _contour_rays(rays: ContourRays, settings: ArticulatedSettings) -> RayArrays:
    """Lay out the rays with their share of the weight of all of them."""
    rays = (rays if settings.contour.weight > 0.0 else NO_CONTOUR_RAYS).thinned(settings.contour.rays)
    trust = settings.contour.surface_sd_m**2 / (settings.contour.surface_sd_m**2 + rays.sigma**2)
    information = trust * (settings.contour.weight / settings.model_sigma_m**2 / max(len(rays), 1))
    return RayArrays.of(rays.points_world, rays.directions, rays.normals, rays.half_lengths, information)


def make_weights(data: Data, settings: ArticulatedSettings) -> Weights:
    """The settings as information: what counts how much."""
    prior, volume, one = settings.prior, settings.volume, 1.0 / settings.model_sigma_m**2
    voxels = len(data.voxels)
    return Weights(
        prior=prior.information(),
        robust=X84 if settings.robust == "x84" else GEMAN_MCCLURE,
        floor=settings.rejection_floor_m,
        voxel=volume.weight * one / voxels if voxels else 0.0,
        voxel_gate=volume.gate_m,
        contour_gate=settings.contour.gate_m,
        contour_slack=settings.contour.slack_m,
        clearance=volume.clearance_weight * one if voxels else 0.0,
        inside=volume.inside_weight * one if len(data.hull) else 0.0,
        inside_slack=volume.inside_slack_m,
        inside_gate=volume.inside_gate_m,
        neck=_information(prior.neck_sd),
        neck_pitch=prior.neck_pitch,
        limit=_information(prior.limit_sd),
    )


def _information(sd: float) -> float:
    return 0.0 if sd == 0.0 else 1.0 / sd**2
