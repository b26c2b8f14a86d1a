"""The first pose of somebody who just comes in: several hypotheses are tracked until one is clearly the best.

A body of average proportions, as tall as the hull, is fitted from natural postures at every heading; where it explains
too little, a stouter or a slimmer one takes its place if that explains more. The best fits are followed from set to
set, through gaps; each costs what outlines, by their certainty, hull and joint limits say against it
(``monitor/evidence.py``). What a single hull leaves open, front or back above all, time decides: knees and elbows bend
one way, toes lie ahead of the ankles, and whoever walks walks forwards. Lengths start as people's proportions with
their spread (``body_sizes.prior_sizes``), and are learnt while the person moves (``refinement/``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from capture_rig.visibility import RigVisibility
from mocap_packets.fit import GONE_AFTER_S
from mocap_packets.hull import HullProducts
from stick_figure.body import Body
from stick_figure.body_surface import build_of_girth
from stick_figure.kinematics import farthest_apart_m, forward
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.placed_figure import STICKS, Figure, State, place
from stick_figure.pose import Pose

from ..articulated_fit import GUESS, ArticulatedSettings, make_data, minimise, rays_in_use
from ..monitor.evidence import EXPLAINED_M, GATE_M, SAME_M, Evidence, evidence_of, ray_cost
from ..monitor.pose_library import (
    OF_NEWCOMERS,
    WITH_ARMS,
    WITH_LEGS,
    WITH_SIDES,
    exchanged,
    natural_poses,
    turned_around,
)
from .body_parts import evidence_of_feet
from .body_sizes import STATURE_SPREAD_M, BodyEstimate, sizes_of_stature
from .initial_pose import InitialPose
from .truncation import FEET, HEAD, TYPICAL_STATURE_M, Stance, advice_text, cut_parts
from .upright import FEWEST_VOXELS, Upright, pitch_of, stance_of

NO_HULL = "no hull"
# Thresholds: shares chosen with walks of the test data, the studio and mesh_fit_ people (how much more who faces the
# right way explains); girths and their shares with walks of the studio's stout people (python bench/acquisition.py);
# times: judgement.
FIRST_ITERATIONS, STARTS = 20, 12  # of the first fits, of which there are so many
HYPOTHESES = 5  # hypotheses that are followed
LOOK_EVERY_S = 0.25  # how often other hypotheses are looked for
PATIENT_S = 3.0  # somebody of whom a part is not seen has so long to step where it is
BENT_WALK_SD_M = 0.015  # a walking person's crown is so much lower than a standing one's, and a hull's so uncertain
FLOOR_SD_M = 0.03  # of a body whose feet are not seen: on what it stands
STEP_M, STEP_S = 0.4, 1.0  # way of about a second of somebody who walks, and does so forwards; slower, people shuffle
# shares of the outlines that count as much: walking forwards, toes ahead of the ankles. Those who face
# the right way explain 0.05 to 0.17 more than when turned round, on rendered walks: these decide where it is less
WALKING_SHARE, FEET_SHARE = 0.04, 0.02
SURE_SHARE = 0.03  # so much more of the outlines a pose must explain than any that faces elsewhere
GIRTHS, LITTLE_SHARE = (1.0, 1.3, 0.8), 0.7  # over the average: tried where a body of average girth explains less
BETTER_SHARE = 0.02  # another girth that explains so much more is right
LEAST_AGREEMENT = 0.5  # of outlines and body: in clutter, torn outlines are no body's, but then all of it is seen
SEEN_RAYS = 3  # explained rays that show a stick to a camera
FEET_EVIDENCE = 5.0  # log-likelihood ratio of the feet's heading from which they count about that much
LEFT_FOOT, RIGHT_FOOT = 13, 14
EXPLAINED_COST = ray_cost(EXPLAINED_M, GATE_M)


@dataclass(frozen=True)
class MotionSettings:
    """A first pose without a T-pose, of somebody who moves about."""

    watch_s: float = setting(
        1.0, "a person without a T-pose is watched for so long before being followed", unit="s", low=0.0, high=60.0
    )


@dataclass(eq=False)
class PoseHypothesis:
    """A pose that is tracked over ``sets`` frame sets.

    cost : what speaks against it, as a share of the rays; share : of the rays that it explains; seen : of its sticks,
    as cameras look at them, that rays show; all summed over the sets. feet : log-likelihood ratio of its heading from
    the feet. way : m, gone forwards of late (negative: backwards).
    """

    pose: Pose
    cost: float = 0.0
    share: float = 0.0
    seen: float = 0.0
    feet: float = 0.0
    way: float = 0.0
    sets: int = 0

    @property
    def mean_cost(self) -> float:
        """Cost of a set on average, as a share of its rays; with what its direction of walking and its feet cost."""
        walking = WALKING_SHARE * float(np.clip(self.way / STEP_M, -1.0, 1.0))
        feet = FEET_SHARE * float(np.tanh(self.feet / max(self.sets, 1) / FEET_EVIDENCE))
        return self.cost / max(self.sets, 1) - walking - feet

    @property
    def mean_share(self) -> float:
        """Share of the rays that it explains, on average."""
        return self.share / max(self.sets, 1)

    @property
    def agreement(self) -> float:
        """Harmonic mean of the shares of the rays that it explains, and of itself that they show (F-measure)."""
        return 2.0 * self.share * self.seen / max((self.share + self.seen) * self.sets, 1e-12)


class MotionSource:
    """A first pose of one body in any upright posture, once one hypothesis of some sets in a row is clearly best."""

    def __init__(
        self,
        settings: MotionSettings,
        visibility: RigVisibility | None = None,
        stature_m: tuple[float, float] = (1.2, 2.2),
        known: Body | None = None,
    ) -> None:
        """visibility : of the rig; None: everything is seen. stature_m : least and largest; known : whose it is."""
        self._settings, self._visibility, self._stature_m, self._known = settings, visibility, stature_m, known
        self._fit_settings = ArticulatedSettings()
        self.reset()

    def reset(self) -> None:
        """Forget what was watched."""
        self._girth, self._girth_is_known, self._last_ns = 0, False, 0
        self._watch_anew()

    def _watch_anew(self) -> None:
        """Forget the hypotheses, not which girths have been tried."""
        self._followed: list[PoseHypothesis] = []
        self._heights: list[float] = []
        self._began_ns = self._looked_ns = 0
        self._estimate: BodyEstimate | None = None
        self._cameras = np.zeros(0, np.int32)  # of the rays of the last set

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the pose of the best hypothesis once it is clear, or why it is not."""
        voxels = seen.voxels.points_world
        if not 0 <= seen.stamp_ns - self._last_ns <= GONE_AFTER_S * NS_PER_S:
            self.reset()
        if len(voxels) < FEWEST_VOXELS or len(seen.contour_rays) == 0:
            return InitialPose(reason=NO_HULL)
        pitch = pitch_of(voxels)
        stance = stance_of(voxels, pitch)
        cut = () if self._visibility is None else cut_parts(voxels, stance, pitch, self._visibility)
        body = self._body(stance, cut)
        if body is None:
            return InitialPose(reason=f"no adult's height: {stance.stature:.2f} m")
        line, settings = seen.centerline, self._fit_settings
        data = make_data(line.points_world, line.sigma, seen.voxels, settings, seen.contour_rays, self._visibility)
        if len(data.contour_rays.information) == 0:
            return InitialPose(reason="no outlines")
        self._cameras = rays_in_use(seen.contour_rays, self._visibility).camera
        step_s, self._last_ns = (seen.stamp_ns - self._last_ns) / NS_PER_S, seen.stamp_ns
        self._follow(body, data, step_s)
        if not self._followed:
            self._began_ns = seen.stamp_ns
        if not self._followed or seen.stamp_ns - self._looked_ns > LOOK_EVERY_S * NS_PER_S:
            self._looked_ns = seen.stamp_ns
            self._look(body, data, stance)
        self._add_feet(body, voxels, stance, pitch, cut)
        return self._answer(seen.stamp_ns, body, data, stance, cut)

    # --- the body

    def _body(self, stance: Stance, cut: tuple[str, ...]) -> Body | None:
        """Return a body of average proportions, as tall as this one has been; None for a height that nobody has."""
        low, high = self._stature_m
        if self._known is not None:
            return self._known if stance.stature > 0.75 * self._known.stature else None
        if HEAD in cut:
            height, sd = max(stance.stature, TYPICAL_STATURE_M), STATURE_SPREAD_M
        else:
            height, sd = stance.stature, FLOOR_SD_M if FEET in cut else BENT_WALK_SD_M
        if not 0.75 * low <= height <= high:
            return None
        self._heights.append(height)
        stature = max(float(np.percentile(self._heights, 80.0)), low)
        if self._estimate is None or abs(self._estimate.stature - stature) > 0.005:
            self._estimate = sizes_of_stature(stature, sd)
        body, girth = self._estimate.body, GIRTHS[self._girth]
        return body if girth == 1.0 else replace(body, build=build_of_girth(girth))

    # --- the hypotheses

    def _look(self, body: Body, data: Data, stance: Stance) -> None:
        """Fit the best of the natural postures and follow those that differ from what is followed, and are no worse."""
        figure, free = Figure.of(body), replace(self._fit_settings, prior=GUESS, max_iterations=FIRST_ITERATIONS)
        crown = stance.floor_world + body.stature
        guesses = natural_poses(body, stance.place_world, crown, OF_NEWCOMERS)
        costs = [(evidence_of(figure, pose, data).cost, pose) for pose in guesses]
        best = [pose for _, pose in sorted(costs, key=lambda pair: pair[0])[:STARTS]]
        fitted = [minimise(body, pose, data, free)[0] for pose in best]
        fitted.sort(key=lambda pose: evidence_of(figure, pose, data).cost)
        others = [exchanged(body, fitted[0], WITH_SIDES), turned_around(fitted[0])]
        if self._followed:  # legs and arms that passed each other
            best_pose = self._followed[0].pose
            others += [exchanged(body, best_pose, limbs) for limbs in (WITH_LEGS, WITH_ARMS)]
        around = [minimise(body, pose, data, free)[0] for pose in others]
        for pose in [fitted[0], *around, *fitted[1:]]:
            if self._is_new(body, pose):
                self._followed.append(PoseHypothesis(pose))
                self._compare(figure, self._followed[-1], data)
        self._keep_the_best()

    def _keep_the_best(self) -> None:
        """Keep as many hypotheses as can be followed, the best first, one that faces elsewhere among them."""
        self._followed.sort(key=lambda hypothesis: hypothesis.mean_cost)
        best, rest = self._followed[0], self._followed[HYPOTHESES:]
        elsewhere = [other for other in rest if _faces_elsewhere(best.pose, other.pose)]
        del self._followed[HYPOTHESES:]
        if elsewhere and not any(_faces_elsewhere(best.pose, other.pose) for other in self._followed):
            self._followed[-1] = elsewhere[0]

    def _is_new(self, body: Body, pose: Pose) -> bool:
        return all(farthest_apart_m(body, pose, other.pose) > SAME_M for other in self._followed)

    def _follow(self, body: Body, data: Data, step_s: float) -> None:
        """Fit every hypothesis to this set too; those that have become one with a better one are dropped."""
        figure, followed = Figure.of(body), self._followed
        for hypothesis in followed:
            before = hypothesis.pose
            hypothesis.pose = minimise(body, before, data, self._fit_settings)[0]
            moved = hypothesis.pose.position_world - before.position_world
            hypothesis.way *= math.exp(-step_s / STEP_S)
            hypothesis.way += float(moved[:2] @ before.R_world_torso[:2, 0])
            self._compare(figure, hypothesis, data)
        self._followed = []
        for hypothesis in sorted(followed, key=lambda e: e.mean_cost):
            if self._is_new(body, hypothesis.pose):
                self._followed.append(hypothesis)

    def _add_feet(self, body: Body, voxels: np.ndarray, stance: Stance, pitch: float, cut: tuple[str, ...]) -> None:
        """Add what the toes say of each hypothesis's heading, where the feet are seen."""
        if FEET in cut:
            return
        low = voxels[voxels[:, 2] < stance.floor_world + 0.1 * stance.stature]
        for hypothesis in self._followed:
            ahead = hypothesis.pose.R_world_torso[:2, 0] / np.linalg.norm(hypothesis.pose.R_world_torso[:2, 0])
            axes = np.array([ahead, [-ahead[1], ahead[0]]])
            feet = forward(body, hypothesis.pose)[[LEFT_FOOT, RIGHT_FOOT]]
            standing = [
                axes @ (foot[:2] - stance.place_world)
                for foot in feet
                if foot[2] - stance.floor_world < 0.07 * stance.stature
            ]
            local = np.column_stack([(low[:, :2] - stance.place_world) @ axes.T, low[:, 2] - stance.floor_world])
            own = Upright(local, stance.place_world, ahead, stance.floor_world, stance.stature, pitch)
            hypothesis.feet += evidence_of_feet(own, standing)

    def _compare(self, figure: Figure, hypothesis: PoseHypothesis, data: Data) -> None:
        """Add a set's evidence; the rays count by their certainty: torn outlines say little."""
        evidence, certainty = evidence_of(figure, hypothesis.pose, data), data.contour_rays.information
        certainty = certainty / max(float(certainty.sum()), 1e-12)
        explained = evidence.costs < EXPLAINED_COST
        hypothesis.cost += float(certainty @ evidence.costs) + evidence.beyond / max(len(evidence.costs), 1)
        hypothesis.share += float(certainty @ explained)
        hypothesis.seen += self._share_seen(figure, hypothesis.pose, evidence, explained)
        hypothesis.sets += 1

    def _share_seen(self, figure: Figure, pose: Pose, evidence: Evidence, explained: np.ndarray) -> float:
        """Return the share of a pose's sticks, as the cameras that look there see them, which explained rays show."""
        placed = place(State(*pose.arrays), figure)
        looks = np.ones((STICKS, int(self._cameras.max()) + 1), bool)
        if self._visibility is not None:
            looks = self._visibility.seen_by(0.5 * (placed.A + placed.B))
        rays = np.zeros(looks.shape, np.int64)
        sticks = placed.surface.stick[evidence.matched.capsule]
        np.add.at(rays, (sticks[explained], self._cameras[explained]), 1)
        return float(np.mean(rays[looks] >= SEEN_RAYS)) if looks.any() else 0.0

    # --- the decision

    def _answer(self, stamp_ns: int, body: Body, data: Data, stance: Stance, cut: tuple[str, ...]) -> InitialPose:
        """Return the best hypothesis if it has been watched, explains enough, and none that faces elsewhere rivals."""
        settings, rivals = self._settings, self._followed
        best = rivals[0]
        rivals_sets = max(other.sets for other in rivals)
        watched_s = (stamp_ns - self._began_ns) / NS_PER_S
        if cut and self._visibility is not None:
            told = advice_text(cut, stance, self._visibility)
        else:
            told = f"somebody is here: watched for {min(watched_s, settings.watch_s):.1f} of {settings.watch_s:.1f} s"
        if not self._girth_is_known and 2.0 * watched_s >= settings.watch_s and self._known is None:
            self._girth_is_known = True
            if best.mean_share < LITTLE_SHARE:
                self._try_girths(body, data)
        if watched_s < (max(PATIENT_S, settings.watch_s) if HEAD in cut or FEET in cut else settings.watch_s):
            return InitialPose(reason=told)
        too_little = f"nobody upright: a body explains {100 * best.mean_share:.0f} % of it"
        if best.agreement < LEAST_AGREEMENT:
            self._girth, self._girth_is_known = 0, False
            self._watch_anew()
            return InitialPose(reason=told if cut else too_little)  # cut, the stature may be wrong, too
        elsewhere = [other.mean_cost for other in rivals if _faces_elsewhere(best.pose, other.pose)]
        if 2 * best.sets < rivals_sets or min(elsewhere, default=np.inf) - best.mean_cost < SURE_SHARE:
            if watched_s > 4.0 * settings.watch_s:
                self._watch_anew()
            return InitialPose(reason=told if cut else "front and back look alike: walk a step")
        estimate = self._estimate
        self.reset()
        return InitialPose(best.pose, body, "", estimate, is_fitted=True)

    def _try_girths(self, body: Body, data: Data) -> None:
        """Take the one of GIRTHS with which the best pose explains clearly most of a set; what it explains and where it
        is seen then count as if it had been so thick in all sets."""
        tried, followed = [], self._followed[0]
        for girth in GIRTHS:
            other = body if girth == 1.0 else replace(body, build=build_of_girth(girth))
            tried.append(PoseHypothesis(minimise(other, followed.pose, data, self._fit_settings)[0]))
            self._compare(Figure.of(other), tried[-1], data)
        best = max(range(len(GIRTHS)), key=lambda girth: tried[girth].share)
        if tried[best].share > tried[0].share + BETTER_SHARE:
            self._girth = best
            for hypothesis in self._followed:
                hypothesis.share *= tried[best].share / tried[0].share
                hypothesis.seen *= tried[best].seen / max(tried[0].seen, 1e-12)


def _faces_elsewhere(pose: Pose, other: Pose) -> bool:
    return float(pose.R_world_torso[:, 0] @ other.R_world_torso[:, 0]) < 0.5
