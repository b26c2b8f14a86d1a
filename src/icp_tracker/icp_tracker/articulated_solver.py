"""All joints at once: robust Gauss-Newton of the articulated figure on the centerline's points and the hull's voxels.

The same points, the same matching (nearest point of the nearest stick) and the same hard joint constraints as the
hierarchical ICP of thesis 4.3, but the 24 tangent components of the pose are solved together, so that no error of a
limb is frozen before its descendants have spoken:

    minimise  sum_i rho(|x_i - c_i|) / sigma_i^2  +  sum_v rho(distance of voxel v to the flesh) / sigma_v^2
              +  |pose (-) start|^2_Lambda

with c_i the foot point on the closest stick, rho Geman-McClure or X84, and Lambda a weak prior that holds what the
data do not see. Ball joints move on SO(3): no gimbal lock. Elbows and knees may pass straight during the solve (a
limit there is a saddle that traps arms) and are bent the right way again afterwards, with the same points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from capture_rig.settings import setting
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.pose import Pose

from .figure_arrays import Figure, State
from .fit_result import FitResult, visible_points
from .flesh import Flesh
from .foot_points import STICKS
from .gauss_newton import (
    GEMAN_MCCLURE,
    X84,
    Data,
    Stop,
    Weights,
    gauss_newton,
    measure,
    points_and_covariances,
)
from .normal_equations import TANGENT, mirror_upper
from .voxel_cloud import NO_VOXELS, VoxelCloud

HINGE_MARGIN = 0.15  # rad a hinge may stay on the wrong side of straight


@dataclass(frozen=True)
class PriorSettings:
    """How far the pose may leave its start where no datum says otherwise: standard deviations of a Gaussian prior."""

    position_sd_m: float = setting(1.0, "torso position", unit="m", low=1e-4, high=100.0)
    rotation_sd: float = setting(1.0, "torso rotation", unit="rad", low=1e-4, high=100.0)
    ball_sd: float = setting(0.7, "neck, shoulders and hips", unit="rad", low=1e-4, high=100.0)
    hinge_sd: float = setting(0.7, "elbows and knees", unit="rad", low=1e-4, high=100.0)
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

    worth: float = setting(
        900.0, "centerline points that all voxels together are worth; 0 leaves the voxels out", low=0.0, high=1e6
    )
    samples: int = setting(1000, "surface voxels that are looked at", low=10, high=100000)
    gate_m: float = setting(0.06, "distance at which a voxel's weight has fallen to 1/4", unit="m", low=1e-3)
    covariance_share: float = setting(
        0.05, "share of their worth with which voxels enter the covariance (their errors are common to many)",
        low=0.0, high=1.0,
    )  # fmt: skip
    clearance_worth: float = setting(
        10.0, "centerline points that keeping an arm out of the torso is worth; 0: off", low=0.0, high=1e6
    )


@dataclass(frozen=True)
class ArticulatedSettings:
    """Settings of the all-joints solve."""

    robust: str = setting(
        "geman_mcclure", "weight of distant points: smooth (hulls) or X84 rejection per stick (clean points)",
        choices=("geman_mcclure", "x84"),
    )  # fmt: skip
    gate_m: float = setting(0.08, "distance at which a Geman-McClure weight has fallen to 1/4", unit="m", low=1e-3)
    rejection_floor_m: float = setting(0.005, "least scale of the X84 rejection", unit="m", low=0.0)
    model_sigma_m: float = setting(
        0.03, "distance of a perfect centerline point from its stick (a body is no stick figure)", unit="m", low=1e-4
    )
    correlation: float = setting(
        4.0, "data that carry the information of one independent datum (neighbours share voxels)", low=1.0
    )
    max_iterations: int = setting(8, "Gauss-Newton iterations at most", low=1, high=1000)
    tolerance: float = setting(2e-3, "converged when no component of the step exceeds this", unit="m, rad", low=0.0)
    step_limit: float = setting(0.5, "largest component of one step", unit="m, rad", low=1e-3)
    support_points: int = setting(3, "inliers that make a reference point visible", low=1)
    prior: PriorSettings = setting(PriorSettings, "prior about the start of the fit")
    volume: VolumeSettings = setting(VolumeSettings, "the hull's voxels")


def fit_articulated(
    body: Body,
    start: Pose,
    points_world: np.ndarray,
    sigma_m: np.ndarray | float = 0.0,
    voxels: VoxelCloud = NO_VOXELS,
    settings: ArticulatedSettings | None = None,
) -> FitResult:
    """Fit the figure to ``points_world`` (n, 3) m with noise ``sigma_m`` (n,), and to ``voxels``, from ``start``."""
    settings = settings or ArticulatedSettings()
    data = make_data(points_world, sigma_m, voxels, settings)
    pose, iterations, step = minimise(body, start, data, settings)
    return assess(body, pose, data, iterations, step < settings.tolerance, settings)


def minimise(body: Body, start: Pose, data: Data, settings: ArticulatedSettings) -> tuple[Pose, int, float]:
    """The pose reached from ``start``, the iterations it took, and the size of the last step."""
    state = State.of(start)
    stop = Stop(settings.max_iterations, settings.tolerance, settings.step_limit)
    iterations, step = gauss_newton(data, *state, *_figure(body), make_weights(len(data.voxels), settings), stop)
    kernels.canonicalise_hinges(state.RJ, state.hinges, np.zeros(TANGENT), HINGE_MARGIN)
    return state.pose(), iterations, step


def assess(
    body: Body, pose: Pose, data: Data, iterations: int, converged: bool, settings: ArticulatedSettings
) -> FitResult:
    """What the data say about ``pose``: residuals, information matrix, reference points and their covariance.

    The covariance is ``correlation * J (H + Lambda)^-1 J^T`` per point, and larger by the reduced chi-square where the
    inliers lie farther off than their own sigma says. It serves any fit, also the hierarchical one.
    """
    state, (figure, flesh) = State.of(pose), _figure(body)
    weights = make_weights(len(data.voxels), settings)
    weights = weights._replace(voxel=settings.volume.covariance_share * weights.voxel)
    H, g = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    counts, distances = np.zeros(STICKS, np.int64), np.empty(len(data.points))
    total, chi2, freedom = measure(data, *state, figure, flesh, weights, H, g, distances, counts)
    mirror_upper(H)
    inliers = int(counts.sum())
    scale = settings.correlation * max(1.0, chi2 / max(freedom - TANGENT, 1.0))
    P, covariance = np.empty((15, 3)), np.empty((15, 3, 3))
    points_and_covariances(*state, figure, H + np.diag(weights.prior), scale, P, covariance)
    return FitResult(
        pose, bool(converged), int(iterations), len(data.points), inliers, float(np.sqrt(total / max(inliers, 1))),
        counts, H, P, covariance, visible_points(counts, settings.support_points),
    )  # fmt: skip


def make_data(
    points_world: np.ndarray, sigma_m: np.ndarray | float, voxels: VoxelCloud, settings: ArticulatedSettings
) -> Data:
    """The data as arrays. A point's variance is its own noise and the model's misfit, added in quadrature."""
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),))
    surface = (voxels if settings.volume.worth > 0.0 else NO_VOXELS).surface_points(settings.volume.samples)
    return Data(points, 1.0 / (settings.model_sigma_m**2 + sigma**2), surface)


def make_weights(voxels: int, settings: ArticulatedSettings) -> Weights:
    """The settings as information: what counts how much."""
    prior, volume, one = settings.prior, settings.volume, 1.0 / settings.model_sigma_m**2
    return Weights(
        prior=prior.information(),
        robust=X84 if settings.robust == "x84" else GEMAN_MCCLURE,
        gate=settings.gate_m,
        floor=settings.rejection_floor_m,
        voxel=volume.worth * one / voxels if voxels else 0.0,
        voxel_gate=volume.gate_m,
        clearance=volume.clearance_worth * one if voxels else 0.0,
        neck=_information(prior.neck_sd),
        neck_pitch=prior.neck_pitch,
        limit=_information(prior.limit_sd),
    )


@lru_cache(maxsize=4)
def _figure(body: Body) -> tuple[Figure, Flesh]:
    return Figure.of(body), Flesh.of(body)


def _information(sd: float) -> float:
    return 0.0 if sd == 0.0 else 1.0 / sd**2
