"""Refines a body's sizes while it is tracked, from the silhouettes' rims in many different poses.

A T-pose shows sums of lengths; where an elbow, a hip or a shoulder divides them only movement tells: the flesh of two
limbs turns about the joint between them. The unknown sizes and thicknesses are solved for together with the poses, as
in the kinematic fits of Cheung, Baker & Kanade (CVPR 2003) and Mikic et al. (IJCV 2003), from rays that touch the
flesh. A few different poses are kept; with every set one of them is looked at anew, so the work a set is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure.body import Body
from stick_figure.pose import T_POSE_ANGLES, Pose

from ..acquisition.body_estimate import BodyEstimate, prior_sizes
from ..acquisition.flesh_sizes import FleshSizes
from ..articulated_solver import PriorSettings
from ..gauss_newton import Rims
from .keyframe import Keyframe
from .settings import RefinementSettings
from .shape import SIZE, ShapeModel, ShapePrior, body_of, thickness_of

NS_PER_S = 1e9
LOOKS_TO_SETTLE = 4  # looks at each of all kept poses after which nothing moves any more


@dataclass(frozen=True, eq=False)
class RefinedBody:
    """A body with the uncertainty of its sizes and how thick its limbs are, and the poses it is known from."""

    estimate: BodyEstimate
    thickness: FleshSizes
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

    def step(self, stamp_ns: int, pose: Pose, rims: Rims) -> Body | None:
        """Take a well fitted pose and its rims; a body to go on with when its sizes have changed enough."""
        if self.done or len(rims.information) == 0:
            return None
        if self._given_ns < 0:
            self._given_ns = stamp_ns
        if not self._keep(pose, rims) and self._kept:
            self._kept[self._looks % len(self._kept)].look(self._model, self._values)
            self._looks += 1
        self._solve()
        return self._due(stamp_ns)

    @property
    def refined(self) -> RefinedBody:
        """The body as it is known now."""
        covariance = np.linalg.inv(self._information + sum(k.information for k in self._kept))
        estimate = BodyEstimate(self._values[SIZE], covariance[SIZE, SIZE])
        return RefinedBody(estimate, thickness_of(self._values), len(self._kept))

    def _keep(self, pose: Pose, rims: Rims) -> bool:
        """Whether the pose is a new one that the flesh explains; then it is kept."""
        if len(self._kept) >= self._settings.keyframes:
            return False
        if not all(kept.differs(pose, self._settings.turn) for kept in reversed(self._kept)):
            return False
        keyframe = Keyframe(pose, rims, self._settings, self._pose_prior)
        keyframe.look(self._model, self._values)
        if keyframe.explained < self._settings.explained:
            return False
        self._kept.append(keyframe)
        self._looks = 0
        return True

    def _solve(self) -> None:
        """The shape that prior and kept poses speak for."""
        if not self._kept:
            return
        information = self._information + np.sum([kept.information for kept in self._kept], axis=0)
        target = self._information @ self._prior.mean + np.sum([kept.target for kept in self._kept], axis=0)
        values = np.linalg.solve(information, target)
        self._values = self._prior.clipped(values, self._settings.farthest_sd)

    def _due(self, stamp_ns: int) -> Body | None:
        """The body, when it is worth the tracker's while."""
        changed = np.abs(self._values - self._given)[SIZE].max() >= self._settings.least_change_m
        if not changed or stamp_ns - self._given_ns < self._settings.pause_s * NS_PER_S:
            return None
        self._given, self._given_ns = self._values, stamp_ns
        return body_of(self._values)


def rehearse(settings: RefinementSettings, pose_prior: PriorSettings) -> None:
    """One step on a made-up ray, so that compiled code is loaded before it is needed."""
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    x, y, z = np.eye(3).reshape(3, 3, 1)
    BodyRefiner(prior_sizes(1.7), settings, pose_prior).step(0, pose, Rims(x, y, x, z, np.ones(1), np.ones(1)))
