"""Refines a body's sizes and build while it is tracked, from contour rays in many different poses.

A T-pose shows sums of lengths; only movement shows where an elbow, a hip or a shoulder divides them: the surfaces of
two limbs turn about the joint between them. The unknown sizes and the build are solved for together with the poses,
as in the kinematic fits of Cheung, Baker & Kanade (CVPR 2003) and Mikic et al. (IJCV 2003), from rays that touch the
body. A few different poses are kept; every set linearises one of them again, so the work a set is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.least_squares.contour_factor import RayArrays
from stick_figure.least_squares.effective_information import SURFACE_SD_M
from stick_figure.least_squares.extremities import ANGLES, COUNT, TURN_SD
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.trunk_bend import REST_SD

from ..articulated_fit import PRIOR
from ..initialization.body_sizes import SIZES, BodyEstimate, prior_sizes, sizes_of_body
from .keyframes import Keyframes, differs_from_all, linearise_keyframe, solve_shape, write_keyframe
from .shape import BUILD, SIZE, ShapeArrays, ShapePrior, body_of, figure_change

# Thresholds: chosen with rendered bodies of our mesh; measured by python bench/people.py; PATIENT_S, LEAST_SHARE,
# BELOW_BEST with stout people who walk in (python bench/people.py --first-pose).
TURN = 0.2  # rad, by which some joint of a different pose has turned
EXPLAINED = 0.93  # share of the rays, in a pose that counts
INDEPENDENT_RAYS = 18.0  # one for each capsule: the model's error is common to a capsule's
RAYS = 400  # of a kept pose that are used
# after PATIENT_S without a pose that reaches EXPLAINED, poses count that explain about as much as the best so far: the
# average surface explains 0.84 to 0.92 of the rays of a stout walker of 1.88 m
PATIENT_S, LEAST_SHARE, BELOW_BEST = 0.2, 0.6, 0.02
LEAST_CHANGE_M, PAUSE_S = 0.004, 0.2
LOOKS_TO_SETTLE = 4  # linearisations of every kept pose after which the sizes have converged
AT_REST = np.zeros(BEND_NUMBERS)
GIVEN_SD_M = 0.001  # sizes that were given are kept


@dataclass(frozen=True)
class RefinementSettings:
    """Sizes and build of a body that was measured or guessed, from the contour rays of the poses that follow.

    turn : rad, a pose is different when some joint turned by this much against every kept one. explained : share of the
    rays that the surface must explain for a pose to count; less while no pose reaches it. surface_sd_m : distance of a
    body's surface from the capsules, where they fit well; independent_rays : effective number of a pose's rays.
    least_change_m : of a size or a part of the surface, for a new body to be returned; at most one every pause_s.
    """

    keyframes: int = setting(64, "different poses that are kept; 0 leaves the body as it was measured", low=0, high=500)
    turn: float = TURN
    explained: float = EXPLAINED
    surface_sd_m: float = SURFACE_SD_M
    independent_rays: float = INDEPENDENT_RAYS
    least_change_m: float = LEAST_CHANGE_M
    pause_s: float = PAUSE_S


def _evenly_spread(contour_rays: RayArrays, settings: RefinementSettings) -> RayArrays:
    """Return at most RAYS rays, evenly spread, with the information of ``independent_rays`` in total."""
    count = len(contour_rays.information)
    rows = np.arange(count) if count <= RAYS else np.arange(RAYS) * count // RAYS
    information = np.full(len(rows), settings.independent_rays / settings.surface_sd_m**2 / max(len(rows), 1))
    return contour_rays.chosen(rows, information)


class BodyRefiner:
    """Collects poses and refines one body. Deterministic."""

    def __init__(
        self,
        estimate: BodyEstimate,
        settings: RefinementSettings,
        given: Body | None = None,
        build: np.ndarray | None = None,
    ) -> None:
        """``given`` : a body whose sizes are known, so that its build alone is learnt. ``build`` (BUILD_NUMBERS,) : the
        first guess for a body that is not near the average."""
        self._sizes_from = given
        self._prior, self._settings = ShapePrior.of(estimate), settings
        self._pose_prior = np.concatenate([PRIOR, REST_SD**-2, np.full(COUNT * ANGLES, TURN_SD**-2)])
        self._information = np.linalg.inv(self._prior.covariance)
        self._target = self._information @ self._prior.mean
        self._model, self._values = ShapeArrays.of(self._prior.mean), self._prior.mean.copy()
        if build is not None:
            self._values[BUILD] = build
        self._given, self._given_ns, self._began_ns = self._values, -1, -1
        self._kept, self._rays = Keyframes.of(settings.keyframes), list[RayArrays]()
        self._looks, self._best_share, self._patient = 0, 0.0, True
        self._known: np.ndarray | None = None

    @property
    def settled(self) -> bool:
        """Whether all kept poses have been linearised so often that the sizes no longer change."""
        return self._looks >= LOOKS_TO_SETTLE * max(len(self._rays), 1)

    @property
    def done(self) -> bool:
        """Whether no more poses are kept and the sizes have settled."""
        return len(self._rays) >= self._settings.keyframes and self.settled

    def step(self, stamp_ns: int, pose: Pose, contour_rays: RayArrays, bend: np.ndarray = AT_REST) -> Body | None:
        """Add a well fitted pose, its rays and the trunk's bend (7,); return the refined body when it has changed
        enough, else None.

        Once the sizes have settled, a set costs the comparison of its pose with the kept ones.
        """
        if self.done or len(contour_rays.information) == 0:
            return None
        if self._given_ns < 0:
            self._given_ns = self._began_ns = stamp_ns
        self._patient = stamp_ns - self._began_ns < PATIENT_S * NS_PER_S
        if not self._keep(pose, contour_rays, bend):
            if not self._rays or self.settled:
                return self._due(stamp_ns)
            self._linearise(self._looks % len(self._rays))
            self._looks += 1
        self._solve()
        return self._due(stamp_ns)

    @property
    def sizes_covariance(self) -> np.ndarray:
        """Covariance (10, 10) m^2 of the sizes as they are known now."""
        if self._known is None:
            self._known = self.refined.covariance
        return self._known

    @property
    def refined(self) -> BodyEstimate:
        """The sizes as they are known now."""
        covariance = np.linalg.inv(self._information + self._kept.information[: len(self._rays)].sum(axis=0))
        return BodyEstimate(self._values[SIZE], covariance[SIZE, SIZE])

    @property
    def keyframes(self) -> int:
        """How many poses are kept."""
        return len(self._rays)

    def _keep(self, pose: Pose, contour_rays: RayArrays, bend: np.ndarray) -> bool:
        """Keep the pose if it is a new one that the surface explains; return whether it is kept."""
        count = len(self._rays)
        if count >= self._settings.keyframes or not differs_from_all(
            self._kept, count, pose.arrays, self._settings.turn
        ):
            return False
        write_keyframe(self._kept, count, pose.arrays, bend, self._values)
        self._rays.append(_evenly_spread(contour_rays, self._settings))
        if self._linearise(count) < self._least_share:
            self._rays.pop()
            return False
        self._looks = 0
        return True

    def _linearise(self, k: int) -> float:
        """Linearise one keyframe; return the share of its rays that the surface explains."""
        kept, rays, least = self._kept, self._rays[k], self._least_share
        explained = float(linearise_keyframe(kept, k, rays, self._model, self._values, self._pose_prior, least))
        self._best_share = max(self._best_share, explained)
        return explained

    @property
    def _least_share(self) -> float:
        """Share of its rays that the surface must explain for a pose to count."""
        most = self._settings.explained
        return most if self._patient else min(most, max(self._best_share - BELOW_BEST, LEAST_SHARE))

    def _solve(self) -> None:
        """Solve for the shape from the prior and the kept poses."""
        self._known = None
        values = solve_shape(self._kept, len(self._rays), self._information, self._target)
        self._values = self._prior.clipped(values)

    def _due(self, stamp_ns: int) -> Body | None:
        """Return the refined body, or None if nothing changed by least_change_m or the last one is too recent."""
        changed = figure_change(self._model, self._values, self._given) >= self._settings.least_change_m
        if not changed or stamp_ns - self._given_ns < self._settings.pause_s * NS_PER_S:
            return None
        self._given, self._given_ns = self._values, stamp_ns
        if self._sizes_from is not None:
            return replace(self._sizes_from, build=self._values[BUILD])
        return body_of(self._values)


def known_sizes(body: Body) -> BodyEstimate:
    """Return the sizes of a given body, with the standard deviation of a body file's."""
    return BodyEstimate(sizes_of_body(body), np.diag(np.full(len(SIZES), GIVEN_SD_M**2)))


def warm_up_refiner(settings: RefinementSettings) -> None:
    """Run one step on a made-up ray, which counts, so that compiled code is loaded before it is needed."""
    pose = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    x, y = np.eye(3)[:2, None]
    ray = RayArrays.of(x, y, x, np.ones(1), np.ones(1))
    BodyRefiner(prior_sizes(1.7), replace(settings, explained=0.0)).step(0, pose, ray)
