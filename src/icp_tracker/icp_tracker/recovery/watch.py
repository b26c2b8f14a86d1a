"""The watch over a track: judges every fitted pose, looks for better ones, and says when to change over.

A fit finds the nearest explanation of the hull, which need not be the best: an arm that was lost in a fat hull, a body
that faces backward, both are local optima that no prior leaves. So other poses are tried, a few every frame set: places
of one limb, the body turned round, and when all is lost, stances anywhere in the hull. A pose that explains the
silhouettes' outlines better becomes the challenger, is followed beside the first for some frame sets, and takes over
once its lead is clear: a single set is not enough, chance leads do not last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose

from ..articulated_solver import ArticulatedSettings, PriorSettings, minimise
from ..flesh import Flesh
from ..gauss_newton import Data
from .body_library import about_face, arms_exchanged, legs_exchanged, moved_to, sides_exchanged, stances
from .challenger import Challenger
from .evidence import PART_NAMES, Evidence, weigh
from .hull_map import HullMap
from .limb_library import LIMBS, limb_poses
from .limb_search import other_place
from .quality import GOOD, LOST, UNKNOWN, TrackQuality, Usual, contested, judge
from .settings import RecoverySettings

SAME_M = 0.10  # poses whose 15 points are so near to each other are one
FAR_M = 0.4  # a pose so far from the followed one, or farther, needs twice the evidence: tracks slip, they seldom leap
FREE = PriorSettings(position_sd_m=0.3, rotation_sd=0.4, ball_sd=0.5, hinge_sd=0.5)
FREE_ITERATIONS = 12
STANCES_A_SET = 6
UNEASY_FALL, UNEASY_EVERY = 0.03, 4  # so little less explained than usual is a reason to look at the body turned
BEHIND_MOST = 3.0  # rays that another pose may be behind when it is first looked at


@dataclass(frozen=True, eq=False)
class Examined:
    """What became of a fitted pose: how good it is; a better one to change over to, if any, and what it changes."""

    quality: TrackQuality
    better: Pose | None = None
    change: str = ""
    rival: Pose | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """One frame set as the watch looks at it."""

    body: Body
    flesh: Flesh
    data: Data
    settings: ArticulatedSettings

    def weigh(self, pose: Pose) -> Evidence:
        """The evidence about a pose."""
        return weigh(self.body, self.flesh, pose, self.data.rims, self.data.hull)

    def fitted(self, pose: Pose, free: bool = False) -> Pose:
        """The pose that the fit reaches from another one, more freely if it is only a guess."""
        settings = replace(self.settings, prior=FREE, max_iterations=FREE_ITERATIONS) if free else self.settings
        return minimise(self.body, pose, self.data, settings)[0]

    def apart_m(self, pose: Pose, other: Pose) -> float:
        """How far apart (m) two poses' reference points are at most."""
        return float(np.linalg.norm(forward(self.body, pose) - forward(self.body, other), axis=1).max())


class Watch:
    """Judges and repairs the track of one body. Deterministic; its work is bounded at every frame set."""

    def __init__(self, settings: RecoverySettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget what is usual for the body, and the challenger."""
        self._usual = Usual()
        self._challenger: Challenger | None = None
        self._sets = self._looks = self._limb_looks = 0
        self._last_good: Pose | None = None

    def examine(self, body: Body, pose: Pose, data: Data, settings: ArticulatedSettings) -> Examined:
        """Judge a pose that was fitted to the data, and look for a better one."""
        if len(data.rims.information) == 0 or len(data.hull) == 0:
            return Examined(UNKNOWN)
        scene = Scene(body, _flesh(body), data, settings)
        evidence = scene.weigh(pose)
        quality = judge(evidence, self._usual.share)
        self._sets += 1
        if quality.state == GOOD:
            self._usual.add(evidence.share)
            self._last_good = pose
        if not self._settings.search:
            return Examined(quality)
        self._follow(scene, pose, evidence)
        self._look_for_another(scene, pose, evidence, quality)
        return self._decide(scene, pose, quality)

    # --- the challenger ----------------------------------------------------------------------------------------------

    def _follow(self, scene: Scene, pose: Pose, evidence: Evidence) -> None:
        """Fit the challenger to this set too, and compare."""
        rival = self._challenger
        if rival is None:
            return
        fitted = scene.fitted(rival.pose)
        if scene.apart_m(fitted, pose) < SAME_M:
            self._challenger = None
            return
        self._challenger = rival.compared(fitted, scene.weigh(fitted), evidence)

    def _decide(self, scene: Scene, pose: Pose, quality: TrackQuality) -> Examined:
        rival, s = self._challenger, self._settings
        if rival is None:
            return Examined(quality)
        sets = s.lead_sets * (1.0 + min(scene.apart_m(rival.pose, pose) / FAR_M, 1.0))
        enough = rival.sets >= s.lead_sets and rival.lead >= s.lead_rays * max(1.0, sets / rival.sets)
        if enough or (rival.sets >= 2 and rival.lead >= s.clear_rays):
            self._challenger = None
            known = quality if rival.evidence is None else judge(rival.evidence, self._usual.share)
            return Examined(known, rival.pose, rival.why)
        if rival.sets >= s.patient_sets or (rival.sets >= 2 and rival.lead < 0.0):
            self._challenger = None
            return Examined(quality)
        return Examined(contested(quality, rival, s.lead_rays), rival=rival.pose)

    def _look_for_another(self, scene: Scene, pose: Pose, evidence: Evidence, quality: TrackQuality) -> None:
        """Try one other pose; if it explains more than pose and challenger, it is the challenger."""
        if self._challenger is not None and quality.state != LOST and self._sets % 2:
            return  # following one takes as long as trying one
        guess = self._guess(scene, pose, quality)
        if guess is None:
            return
        fitted = scene.fitted(guess.pose, free=guess.part is None)
        lead = evidence.lead_of(scene.weigh(fitted))
        behind = BEHIND_MOST if guess.part is None else 0.0  # only a limb's place is fitted to the end at once
        least = -behind if self._challenger is None else max(self._challenger.lead + 1.0, 0.0)
        known = [pose] if self._challenger is None else [pose, self._challenger.pose]
        if lead > least and all(scene.apart_m(fitted, other) > SAME_M for other in known):
            self._challenger = replace(guess, pose=fitted)

    # --- where to look -----------------------------------------------------------------------------------------------

    def _guess(self, scene: Scene, pose: Pose, quality: TrackQuality) -> Challenger | None:
        """What to try at this set: a lost body's stances, the whole body turned, or one limb elsewhere."""
        turn, every = self._sets, self._settings.turned_every
        if quality.state == LOST and turn % 2 == 0:
            return self._stance(scene, turn // 2)
        if quality.state != GOOD:
            every = 1 if quality.state == LOST else 2
        elif self._usual.share is not None and quality.explained < self._usual.share - UNEASY_FALL:
            every = min(every, UNEASY_EVERY)
        if turn % every == 0:
            return self._whole_body(scene, pose)
        return self._limb(scene, pose, quality)

    def _whole_body(self, scene: Scene, pose: Pose) -> Challenger:
        """The body turned or exchanged, one way after another; the most likely errors come most often."""
        body, turn = scene.body, self._looks % 6
        self._looks += 1
        if turn in (0, 2):
            return Challenger(sides_exchanged(body, pose), "left and right exchanged", None)
        if turn in (1, 4):
            return Challenger(about_face(pose), "the body facing the other way", None)
        if turn == 5 and self._last_good is not None:
            return Challenger(moved_to(self._last_good, scene.data.hull), "the last good pose", None)
        if (self._looks // 6) % 2:
            return Challenger(legs_exchanged(body, pose), "left and right leg exchanged", None)
        return Challenger(arms_exchanged(body, pose), "left and right arm exchanged", None)

    def _stance(self, scene: Scene, turn: int) -> Challenger:
        """The best of a few stances; others at the next set."""
        every = stances(scene.body, scene.data.hull)
        parts = len(every) // STANCES_A_SET
        best = min(every[turn % parts :: parts], key=lambda pose: scene.weigh(pose).cost)
        return Challenger(best, "the body found anew", None)

    def _limb(self, scene: Scene, pose: Pose, quality: TrackQuality) -> Challenger | None:
        """One limb elsewhere: limb after limb, a part of each one's library at a time; all of it for a doubtful one."""
        doubtful = [limb for limb in LIMBS if quality.parts[limb.part] != GOOD]
        limbs, look = doubtful or LIMBS, self._limb_looks
        self._limb_looks += 1
        limb = limbs[look % len(limbs)]
        library, parts = limb_poses(limb), self._settings.limb_parts
        if not doubtful:
            library = library.part(look // len(limbs), parts)
        hull = HullMap.of(scene.data.hull)
        other = other_place(scene.body, scene.flesh, pose, limb, library, scene.data.rims, hull)
        return None if other is None else Challenger(other, f"{PART_NAMES[limb.part]} elsewhere", limb.part)


@lru_cache(maxsize=4)
def _flesh(body: Body) -> Flesh:
    return Flesh.of(body)
