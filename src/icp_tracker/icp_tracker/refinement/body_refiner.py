"""Refines a body's sizes while it is tracked, from contour rays in many different poses.

A T-pose shows sums of lengths; where an elbow, a hip or a shoulder divides them only movement tells: the surfaces of
two limbs turn about the joint between them. The unknown sizes and thicknesses are solved for together with the poses,
as in the kinematic fits of Cheung, Baker & Kanade (CVPR 2003) and Mikic et al. (IJCV 2003), from rays that touch the
body. A few different poses are kept; with every set one of them is looked at anew, so the work a set is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.settings import setting
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.joint_limits import add_joint_limits, add_neck_rest
from stick_figure.least_squares.contour_factor import RayArrays
from stick_figure.least_squares.normal_equations import TANGENT, mirror_upper
from stick_figure.least_squares.placed_figure import State, place
from stick_figure.pose import T_POSE_ANGLES, Pose

from ..acquisition.body_sizes import BodyEstimate, LimbGirths, prior_sizes
from ..articulated_fit import PriorSettings
from .shape import SIZE, UNKNOWNS, ShapeModel, ShapePrior, body_of, contour_system, girths_of


@dataclass(frozen=True)
class RefinementSettings:
    """The sizes of a body that was measured in a T-pose, from the contour rays of the poses that follow."""

    keyframes: int = setting(64, "different poses that are kept; 0 leaves the body as it was measured", low=0, high=500)
    turn: float = setting(
        0.2, "a pose is different when some joint turned by this much against every kept one", unit="rad", low=0.01
    )
    explained: float = setting(
        0.93, "share of the rays that the body's surface must explain for a pose to count", low=0.0, high=1.0
    )
    surface_sd_m: float = setting(
        0.01, "distance of a body's surface from the capsules, where they fit well", unit="m", low=1e-4
    )
    independent_rays: float = setting(
        6.0,
        "independent rays that all rays of a pose count as: one for head, trunk and each limb, for the model's error "
        "is common to them",
        low=0.1,
        high=1e4,
    )
    thickness_sd: float = setting(
        0.12, "how people's limbs differ in thickness at equal stature, as a share of it", low=1e-3, high=1.0
    )
    farthest_sd: float = setting(
        3.0, "no size leaves what the T-pose said by more than this many standard deviations", low=0.1, high=10.0
    )
    least_change_m: float = setting(
        0.004, "the tracker takes over sizes when one of them has changed by so much", unit="m", low=0.0
    )
    pause_s: float = setting(1.0, "and not more often than this", unit="s", low=0.0)


# checked by the studio's bodies and rendered sessions of the package's README
RAYS = 400  # of a kept pose that are used
GATE_M, SLACK_M, EXPLAINED_M = 0.04, 0.05, 0.06  # see `contour_system`
LARGEST_STEP = 0.3  # m, rad


class Keyframe:
    """One kept pose with its contour rays, and what they say about the body's shape whatever the pose was exactly.

    Pose and shape share the rays: the pose is eliminated, and follows when the shape changes.

    ``information`` (UNKNOWNS, UNKNOWNS) and ``target`` (UNKNOWNS,) are its part of normal equations for the shape's
    values themselves: (sum of information) values = sum of target. Zero until the first :meth:`linearise`, and while
    the surface explains too few of its rays.
    """

    def __init__(self, pose: Pose, contour_rays: RayArrays, settings: RefinementSettings, prior: PriorSettings) -> None:
        self.pose, self.contour_rays = pose, _evenly_spread(contour_rays, settings)
        self.explained = 0.0
        self._settings, self._prior = settings, prior
        self._values: np.ndarray | None = None
        self._through = np.empty((TANGENT, UNKNOWNS + 1))
        self._forget()

    def _forget(self) -> None:
        self.information, self.target = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)

    def linearise(self, model: ShapeModel, values: np.ndarray) -> None:
        """Move the pose to where it suits a shape's ``values`` (UNKNOWNS,), and linearise there."""
        state, n = State.of(self.pose), TANGENT + UNKNOWNS
        if self._values is not None:  # the pose follows the shape, by the last linearisation
            step = self._through @ np.concatenate([self._values - values, [1.0]])
            kernels.retract(*state, step, min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), LARGEST_STEP)))
            self.pose = state.pose()
        H, g = np.empty((n, n)), np.empty(n)
        placed = place(state, model.at(values))
        self.explained = float(
            contour_system(self.contour_rays, placed, model.derivatives, (GATE_M, SLACK_M, EXPLAINED_M), H, g)
        )
        pose, shape = slice(0, TANGENT), slice(TANGENT, n)
        own, pull = self._with_prior(state, H, g)
        self._through, self._values = np.linalg.solve(own, np.column_stack([H[pose, shape], pull])), values
        if self.explained < self._settings.explained:
            self._forget()
            return
        # the pose is eliminated: Schur complement
        self.information = H[shape, shape] - H[shape, pose] @ self._through[:, :-1]
        self.target = g[shape] - H[shape, pose] @ self._through[:, -1] + self.information @ values

    def _with_prior(self, state: State, H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose's normal equations with what holds it where rays do not: scatter, the neck's rest, limits."""
        own, pull = np.zeros((TANGENT, TANGENT)), g[:TANGENT].copy()
        if self._prior.neck_sd > 0.0:
            add_neck_rest(state.RJ[0], self._prior.neck_pitch, self._prior.neck_sd**-2, own, pull)
        if self._prior.limit_sd > 0.0:
            add_joint_limits(state.RJ, state.hinges, np.inf, self._prior.limit_sd**-2, own, pull)
        mirror_upper(own)
        return own + H[:TANGENT, :TANGENT] + np.diag(self._prior.information()), pull

    def differs(self, pose: Pose, turn: float) -> bool:
        """Return whether some joint (not the torso) is turned by more than ``turn`` (rad) against this pose."""
        return bool(np.abs(pose.minus(self.pose)[6:]).max() > turn)


def _evenly_spread(contour_rays: RayArrays, settings: RefinementSettings) -> RayArrays:
    """Return at most RAYS rays, evenly spread, together of the information of the independent ones."""
    count = len(contour_rays.information)
    rows = np.arange(count) if count <= RAYS else np.arange(RAYS) * count // RAYS
    information = np.full(len(rows), settings.independent_rays / settings.surface_sd_m**2 / max(len(rows), 1))
    return contour_rays.chosen(rows, information)


NS_PER_S = 1e9
LOOKS_TO_SETTLE = 4  # looks at each of all kept poses after which nothing moves any more


@dataclass(frozen=True, eq=False)
class RefinedBody:
    """A body with the uncertainty of its sizes and how thick its limbs are, and the poses it is known from."""

    estimate: BodyEstimate
    girths: LimbGirths
    keyframes: int


class BodyRefiner:
    """Collects poses and refines one body. Deterministic."""

    def __init__(self, estimate: BodyEstimate, settings: RefinementSettings, pose_prior: PriorSettings) -> None:
        self._prior = ShapePrior.of(estimate, settings.thickness_sd)
        self._settings, self._pose_prior = settings, pose_prior
        self._information = np.linalg.inv(self._prior.covariance)
        self._model, self._values = ShapeModel(self._prior.mean), self._prior.mean
        self._given, self._given_ns = self._prior.mean, -1
        self._kept: list[Keyframe] = []
        self._looks = 0

    @property
    def done(self) -> bool:
        """Whether all poses that are kept have been looked at so often that the sizes have settled."""
        full = len(self._kept) >= self._settings.keyframes
        return full and self._looks >= LOOKS_TO_SETTLE * self._settings.keyframes

    def step(self, stamp_ns: int, pose: Pose, contour_rays: RayArrays) -> Body | None:
        """Take a well fitted pose and its rays; return a body to go on with when its sizes have changed enough."""
        if self.done or len(contour_rays.information) == 0:
            return None
        if self._given_ns < 0:
            self._given_ns = stamp_ns
        if not self._keep(pose, contour_rays) and self._kept:
            self._kept[self._looks % len(self._kept)].linearise(self._model, self._values)
            self._looks += 1
        self._solve()
        return self._due(stamp_ns)

    @property
    def refined(self) -> RefinedBody:
        """The body as it is known now."""
        covariance = np.linalg.inv(self._information + sum(k.information for k in self._kept))
        estimate = BodyEstimate(self._values[SIZE], covariance[SIZE, SIZE])
        return RefinedBody(estimate, girths_of(self._values), len(self._kept))

    def _keep(self, pose: Pose, contour_rays: RayArrays) -> bool:
        """Keep the pose if it is a new one that the surface explains; return whether it is kept."""
        if len(self._kept) >= self._settings.keyframes:
            return False
        if not all(kept.differs(pose, self._settings.turn) for kept in reversed(self._kept)):
            return False
        keyframe = Keyframe(pose, contour_rays, self._settings, self._pose_prior)
        keyframe.linearise(self._model, self._values)
        if keyframe.explained < self._settings.explained:
            return False
        self._kept.append(keyframe)
        self._looks = 0
        return True

    def _solve(self) -> None:
        """Solve for the shape that prior and kept poses speak for."""
        if not self._kept:
            return
        information = self._information + np.sum([kept.information for kept in self._kept], axis=0)
        target = self._information @ self._prior.mean + np.sum([kept.target for kept in self._kept], axis=0)
        values = np.linalg.solve(information, target)
        self._values = self._prior.clipped(values, self._settings.farthest_sd)

    def _due(self, stamp_ns: int) -> Body | None:
        """Return the refined body, or None if no size changed by least_change_m or the last one is too recent."""
        changed = np.abs(self._values - self._given)[SIZE].max() >= self._settings.least_change_m
        if not changed or stamp_ns - self._given_ns < self._settings.pause_s * NS_PER_S:
            return None
        self._given, self._given_ns = self._values, stamp_ns
        return body_of(self._values)


def warm_up_refiner(settings: RefinementSettings, pose_prior: PriorSettings) -> None:
    """Run one step on a made-up ray, so that compiled code is loaded before it is needed."""
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    x, y = np.eye(3)[:2, None]
    ray = RayArrays.of(x, y, x, np.ones(1), np.ones(1))
    BodyRefiner(prior_sizes(1.7), settings, pose_prior).step(0, pose, ray)
