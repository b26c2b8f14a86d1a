"""The first pose of somebody in the hull: several hypotheses are tracked until one is clearly the best.

A body of average proportions, as tall as the hull, is fitted from natural postures at every heading, the T-pose among
them; where it explains too little, a stouter or a slimmer one takes its place if that explains more. The best fits are
tracked from set to set, through gaps; the cost of each adds up outlines, by their certainty, and joint limits
(``monitor/evidence.py``). Ambiguities of a single hull, front or back above all, are resolved over time: knees and
elbows bend one way, toes lie ahead of the ankles, and people walk forwards.

A T-pose, arms and legs within some degrees of one, is accepted after a few sets, any other pose after a second. Lengths
start as people's proportions with their spread (``body_sizes``), which the outlines of a T-pose narrow at once; they
are refined while the person moves (``refinement/``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.rigid import rotation_matrix
from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from capture_rig.visibility import RigVisibility
from mocap_packets.fit import GONE_AFTER_S
from mocap_packets.hull import HullProducts
from stick_figure.body import TYPICAL_STATURE_M, Body
from stick_figure.body_surface import build_of_girth
from stick_figure.kinematics import farthest_apart_m, forward
from stick_figure.pose import Pose

from ..articulated_fit import ArticulatedSettings, make_data, rays_in_use
from ..monitor.evidence import SAME_M
from ..monitor.pose_library import (
    NATURAL_POSTURES,
    WITH_ARMS,
    WITH_LEGS,
    WITH_SIDES,
    angles_of_posture,
    exchanged,
    natural_poses,
    turned_around,
)
from .body_sizes import STATURE_SPREAD_M, BodyEstimate, sizes_of_stature
from .initial_pose import InitialPose
from .pose_hypothesis import T_POSE_RAD, InitializationObservation, PoseHypothesis, farthest_stick
from .t_pose_sizes import with_t_pose
from .truncation import FEET, HEAD, Stance, advice_text, cut_parts, pitch_of, stance_of

# Thresholds: shares chosen with walks of the test data, the studio and mesh_fit_ people (by how much poses that face
# the right way explain more); girths and their shares with walks of the studio's stout people (python
# bench/people.py --first-pose); times: judgement.
FEWEST_VOXELS = 200
STARTS = 12  # natural postures that are fitted at a time
HYPOTHESES = 5  # hypotheses that are tracked
LOOK_EVERY_S = 0.25  # between searches for further hypotheses
PATIENT_S = 3.0  # time for somebody who is partly out of view to step into it
BENT_WALK_SD_M = 0.015  # of the stature from the hull's crown: walking lowers the crown
FLOOR_SD_M = 0.03  # of the stature of a body whose feet are not seen: the floor's height
SURE_SHARE = 0.03  # of the outlines: margin over every pose that faces another way
GIRTHS, LITTLE_SHARE = (1.0, 1.3, 0.8), 0.7  # over the average: tried where a body of average girth explains less
BETTER_SHARE = 0.02  # of the outlines: margin that selects another girth
LEAST_AGREEMENT = 0.5  # of outlines and body (F-measure): torn outlines of clutter agree with no body
STILL_M = 0.03  # largest movement over the sets of a held T-pose
LEVEL, LOWERED = "level", "lowered"


@dataclass(frozen=True)
class TPoseSettings:
    """What counts as a T-pose."""

    arms: str = setting(
        LEVEL,
        "the pose that is asked for: arms level sideways (T-pose) or lowered by 45 degrees (A-pose)",
        choices=(LEVEL, LOWERED),
    )
    stature_low_m: float = setting(1.2, "least stature", unit="m", low=0.5, high=2.6)
    stature_high_m: float = setting(2.2, "largest stature", unit="m", low=0.5, high=2.6)
    hold_sets: int = setting(5, "frame sets in a row that must show the pose", low=1, high=1000)


@dataclass(frozen=True)
class MotionSettings:
    """A first pose without a T-pose, of somebody who moves about."""

    watch_s: float = setting(
        1.0, "a person without a T-pose is watched for so long before being followed", unit="s", low=0.0, high=60.0
    )


class HullSource:
    """Finds the first pose of a body: tracks hypotheses until one is clearly best."""

    def __init__(
        self,
        t_pose: TPoseSettings,
        motion: MotionSettings | None,
        visibility: RigVisibility | None = None,
        known: Body | None = None,
    ) -> None:
        """motion : None accepts a T-pose only. visibility : of the rig; None: everything is seen. known : the body, if
        its sizes are known."""
        self._t_pose, self._motion, self._visibility, self._known = t_pose, motion, visibility, known
        lowered = {} if t_pose.arms == LEVEL else {"shoulder_x": -np.pi / 4}
        self._asked = angles_of_posture(lowered, lowered)
        self._settings = ArticulatedSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._girth, self._girth_is_known, self._last_ns = 0, False, 0
        self._watch_anew()

    def _watch_anew(self) -> None:
        """Forget the hypotheses, not which girths have been tried."""
        self._followed: list[PoseHypothesis] = []
        self._heights: list[float] = []
        self._began_ns = self._looked_ns = 0
        self._held: list[np.ndarray] = []  # where the trunk was in the sets in a row that showed a T-pose
        self._estimate: BodyEstimate | None = None

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the best hypothesis's pose once it is clearly best, else the reason."""
        voxels = seen.voxels.points_world
        if not 0 <= seen.stamp_ns - self._last_ns <= GONE_AFTER_S * NS_PER_S:
            self.reset()
        if len(voxels) < FEWEST_VOXELS:
            self._held = []
            return InitialPose(reason="no hull")
        pitch = pitch_of(voxels)
        stance = stance_of(voxels, pitch)
        cut = () if self._visibility is None else cut_parts(voxels, stance, pitch, self._visibility)
        body = self._body(stance, cut)
        if body is None:
            return InitialPose(reason=f"no adult's height: {stance.stature:.2f} m")
        line, rays = seen.centerline, seen.contour_rays
        data = make_data(line.points_world, line.sigma, seen.voxels, self._settings, rays, self._visibility)
        if len(data.contour_rays.information) == 0:
            return InitialPose(reason="no outlines")
        cameras = rays_in_use(rays, self._visibility).camera
        dt_s, self._last_ns = (seen.stamp_ns - self._last_ns) / NS_PER_S, seen.stamp_ns
        observed = InitializationObservation(
            dt_s, body, data, self._settings, cameras, voxels, pitch, stance, cut, self._visibility
        )
        self._update_hypotheses(observed)
        if not self._followed:
            self._began_ns = seen.stamp_ns
        if not self._followed or seen.stamp_ns - self._looked_ns > LOOK_EVERY_S * NS_PER_S:
            self._looked_ns = seen.stamp_ns
            self._add_hypotheses(observed)
        return self._decide(observed, (seen.stamp_ns - self._began_ns) / NS_PER_S)

    # --- the body

    def _body(self, stance: Stance, cut: tuple[str, ...]) -> Body | None:
        """Return a body of average proportions and the height seen so far; None for a height out of range."""
        low, high = self._t_pose.stature_low_m, self._t_pose.stature_high_m
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

    def _add_hypotheses(self, seen: InitializationObservation) -> None:
        """Fit the best of the natural postures, and add the fits that differ from all hypotheses."""
        body, stance = seen.body, seen.stance
        crown, postures = stance.floor_world + body.stature, (*NATURAL_POSTURES, self._asked)
        guesses = natural_poses(body, stance.place_world, crown, postures)

        def cost(pose: Pose) -> float:
            return seen.evidence_of(pose).cost

        fitted = sorted((seen.fitted(pose, guess=True) for pose in sorted(guesses, key=cost)[:STARTS]), key=cost)
        best = fitted[0]
        others = [exchanged(body, best, WITH_SIDES), turned_around(best)]
        if self._followed:  # legs and arms that passed each other
            others += [exchanged(body, self._followed[0].pose, limbs) for limbs in (WITH_LEGS, WITH_ARMS)]
        ahead = np.arctan2(*stance.forward_world[::-1])
        asked = Pose.from_angles(best.position_world, rotation_matrix(np.array([0.0, 0.0, ahead])), self._asked)
        held = (seen.fitted(pose) for pose in (asked, turned_around(asked)))
        free_ones = (best, *(seen.fitted(pose, guess=True) for pose in others), *fitted[1:])
        for hypothesis in [PoseHypothesis(pose, self._asked) for pose in held] + [*map(PoseHypothesis, free_ones)]:
            if self._is_new(body, hypothesis.pose):
                self._followed.append(hypothesis)
                hypothesis.add(seen)
        self._keep_the_best()

    def _keep_the_best(self) -> None:
        """Keep the HYPOTHESES best, one that faces elsewhere among them."""
        self._followed.sort(key=lambda hypothesis: hypothesis.mean_cost)
        best, rest = self._followed[0], self._followed[HYPOTHESES:]
        elsewhere = [other for other in rest if best.faces_elsewhere(other)]
        del self._followed[HYPOTHESES:]
        if elsewhere and not any(best.faces_elsewhere(other) for other in self._followed):
            self._followed[-1] = elsewhere[0]

    def _is_new(self, body: Body, pose: Pose) -> bool:
        return all(farthest_apart_m(body, pose, other.pose) > SAME_M for other in self._followed)

    def _update_hypotheses(self, seen: InitializationObservation) -> None:
        """Fit every hypothesis to this set; drop those that have converged to a better one."""
        followed, self._followed = self._followed, []
        for hypothesis in followed:
            hypothesis.update(seen)
        for hypothesis in sorted(followed, key=lambda one: one.mean_cost):
            if self._is_new(seen.body, hypothesis.pose):
                self._followed.append(hypothesis)

    # --- the decision

    def _decide(self, seen: InitializationObservation, watched_s: float) -> InitialPose:
        """Return the best hypothesis if it holds a T-pose or was watched long enough, explains enough, and no rival
        faces elsewhere; else the reason."""
        best = self._best(seen)
        fault = self._hold(seen, best.pose)
        waiting = InitialPose(reason=self._progress(seen, watched_s, fault))
        if not self._girth_is_known and (
            2 * len(self._held) >= self._t_pose.hold_sets or 2 * watched_s >= self._watch_s
        ):
            self._girth_is_known = True
            if self._known is None and best.mean_share < LITTLE_SHARE:
                self._try_girths(seen)
        if not (self._is_held or self._was_watched(seen, watched_s)):
            return waiting
        if best.agreement < LEAST_AGREEMENT:
            too_little = f"nobody upright: a body explains {100 * best.mean_share:.0f} % of it"
            self._girth, self._girth_is_known = 0, False
            self._watch_anew()
            return waiting if seen.cut else InitialPose(reason=too_little)  # cut, the stature may be wrong, too
        if not self._is_sure(best):
            if watched_s > 4.0 * self._watch_s:
                self._watch_anew()
            return waiting if seen.cut else InitialPose(reason="front and back look alike: walk a step")
        return self._accepted(seen, best)

    @property
    def _watch_s(self) -> float:
        """Time (s) to watch a person without a T-pose."""
        return (self._motion or MotionSettings()).watch_s

    @property
    def _is_held(self) -> bool:
        """Whether enough sets in a row have shown a T-pose."""
        return len(self._held) >= self._t_pose.hold_sets

    def _was_watched(self, seen: InitializationObservation, watched_s: float) -> bool:
        """Whether a pose that is none of a T-pose may be accepted by now."""
        is_cut = HEAD in seen.cut or FEET in seen.cut
        return self._motion is not None and watched_s >= (max(PATIENT_S, self._watch_s) if is_cut else self._watch_s)

    def _is_sure(self, best: PoseHypothesis) -> bool:
        """Whether the best hypothesis has been tracked for long enough, and is clearly better than those that face
        elsewhere."""
        elsewhere = [other.mean_cost for other in self._followed if best.faces_elsewhere(other)]
        is_new = 2 * best.sets < max(other.sets for other in self._followed)
        return not is_new and min(elsewhere, default=np.inf) - best.mean_cost >= SURE_SHARE

    def _progress(self, seen: InitializationObservation, watched_s: float, fault: str) -> str:
        """Return in words what the first pose waits for; ``fault`` : of the T-pose."""
        if seen.cut and self._visibility is not None:
            return advice_text(seen.cut, seen.stance, self._visibility)
        if self._held:
            return f"T-pose seen, hold it ({len(self._held)} of {self._t_pose.hold_sets})"
        if self._motion is None:
            return fault
        return f"somebody is here: watched for {min(watched_s, self._watch_s):.1f} of {self._watch_s:.1f} s"

    def _accepted(self, seen: InitializationObservation, best: PoseHypothesis) -> InitialPose:
        """Return the first pose; the sizes are those that a held T-pose shows."""
        body, estimate = seen.body, self._estimate
        if self._is_held and estimate is not None:
            floor = np.array([0.0, 0.0, seen.stance.floor_world])
            estimate = with_t_pose(estimate, forward(body, best.pose) - floor, seen.voxels - floor, seen.pitch)
            body = replace(estimate.body, build=body.build)
        self.reset()
        return InitialPose(best.pose, body, "", estimate, is_fitted=True)

    def _best(self, seen: InitializationObservation) -> PoseHypothesis:
        """Return the best hypothesis, or one that holds a T-pose and is hardly worse."""
        best = self._followed[0]
        rivals = [one for one in self._followed if one.mean_cost < best.mean_cost + SURE_SHARE]
        asked = (one for one in rivals if farthest_stick(seen.body, one.pose, self._asked)[1] < T_POSE_RAD)
        return best if seen.cut else next(asked, best)

    def _hold(self, seen: InitializationObservation, pose: Pose) -> str:
        """Count the sets in a row that show the requested pose, held still; return the pose's fault in words."""
        stick, off = farthest_stick(seen.body, pose, self._asked)
        if seen.cut or off >= T_POSE_RAD:
            self._held = []
            return f"no T-pose: the {stick.replace('_', ' ')} is {np.degrees(off):.0f} degrees off"
        self._held.append(pose.position_world)
        moved_m = float(np.linalg.norm(self._held[-1] - self._held[0]))
        if moved_m > STILL_M:
            self._held = []
        return f"stand still: moved by {moved_m:.2f} m"

    def _try_girths(self, seen: InitializationObservation) -> None:
        """Choose the one of GIRTHS with which the best pose explains clearly most of a set, and scale the hypotheses'
        explained and seen shares as if all sets had had it."""
        tried, best_pose = list[PoseHypothesis](), self._followed[0].pose
        for girth in GIRTHS:
            body = seen.body if girth == 1.0 else replace(seen.body, build=build_of_girth(girth))
            other = replace(seen, body=body)
            tried.append(PoseHypothesis(other.fitted(best_pose)))
            tried[-1].add(other)
        best = max(range(len(GIRTHS)), key=lambda girth: tried[girth].share)
        if tried[best].share > tried[0].share + BETTER_SHARE:
            self._girth = best
            for hypothesis in self._followed:
                hypothesis.share *= tried[best].share / tried[0].share
                hypothesis.seen *= tried[best].seen / max(tried[0].seen, 1e-12)
