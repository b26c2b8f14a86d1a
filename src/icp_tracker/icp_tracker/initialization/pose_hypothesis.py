"""Hypotheses of a first pose, with the evidence of one frame set after another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capture_rig.rigid import rotation_matrix
from capture_rig.visibility import RigVisibility
from stick_figure.body import Body
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.posed_model import STICKS, BodyModel, PoseState, place
from stick_figure.pose import Pose
from stick_figure.skeleton import HEAD, STICK_NAMES

from ..monitor.evidence import EXPLAINED_M, GATE_M, Evidence, Observation, ray_cost
from .truncation import FEET, Stance

# Thresholds: shares chosen with walks of the test data, the studio and mesh_fit_ people (by how much poses that face
# the right way explain more); the foot from Drillis & Contini 1966.
STEP_M, STEP_S = 0.4, 1.0  # movement in about a second of somebody who walks forwards; slower, people shuffle
# shares of the outlines: bonus of walking forwards, and of toes ahead of the ankles. Poses that face the right way
# explain 0.05 to 0.17 more than when turned round, on rendered walks: the bonuses decide where it is less
WALKING_SHARE, FEET_SHARE = 0.04, 0.02
FEET_EVIDENCE = 5.0  # log-likelihood ratio of the feet's heading at which the bonus saturates
FIRST_ITERATIONS = 20  # of fits that start from a natural posture
SEEN_RAYS = 3  # explained rays that show a stick to a camera
T_POSE_RAD = 0.6  # from the sticks of a T-pose: arms may be low, elbows bent, fits to three views err
EXPLAINED_COST = ray_cost(EXPLAINED_M, GATE_M)
# over the stature, a foot is .055 wide and .152 long: greatest heights of voxels of soles, of ankles, and of the ankle
# of a standing foot; radius about the ankle of a foot's voxels
SOLES_TO, ANKLES_TO, STANDING_TO, FOOT_HALF_WIDTH, FOOT_REACH = 0.045, 0.09, 0.07, 0.04, 0.17
# distance of a foot's middle ahead of the ankle, and its spread; a longer foot includes a shadow
FOOT_LEAD, FOOT_LEAD_SD, LONGEST_FOOT, FEWEST_OF_A_FOOT = 0.040, 0.020, 0.20, 8
FOOT_POINTS = [13, 14]


@dataclass(frozen=True, eq=False)
class InitializationObservation(Observation):
    """One frame set against which first poses are assessed.

    body : as known so far. cameras (n,) : of the data's rays. voxels (m, 3) m, world, of an edge ``pitch``, m.
    cut : the parts of the body that the rig does not show.
    """

    guess_iterations: ClassVar[int] = FIRST_ITERATIONS
    cameras: np.ndarray
    voxels: np.ndarray
    pitch: float
    stance: Stance
    cut: tuple[str, ...]
    visibility: RigVisibility | None

    def share_seen(self, pose: Pose, evidence: Evidence, explained: np.ndarray) -> float:
        """Return the share of pairs of stick and camera in view of it in which explained rays show the stick."""
        posed = place(PoseState(*pose.arrays), BodyModel.of(self.body))
        looks = np.ones((STICKS, int(self.cameras.max()) + 1), bool)
        if self.visibility is not None:
            looks = self.visibility.seen_by(0.5 * (posed.A + posed.B))
        rays = np.zeros(looks.shape, np.int64)
        sticks = posed.surface.stick[evidence.matched.capsule]
        np.add.at(rays, (sticks[explained], self.cameras[explained]), 1)
        return float(np.mean(rays[looks] >= SEEN_RAYS)) if looks.any() else 0.0

    def evidence_of_feet(self, pose: Pose) -> float:
        """Return the log-likelihood ratio of a pose facing forwards, not back, from the feet that stand in it.

        The middle of a foot lies ahead of its ankle by a Gaussian lead, or, turned round, behind it.
        """
        H, floor, ratio = self.stance.stature, self.stance.floor_world, 0.0
        if FEET in self.cut:
            return ratio
        up, flat = (self.voxels[:, 2] - floor) / H, self.voxels[:, :2]
        soles, ankles = flat[up < SOLES_TO], flat[(up > SOLES_TO) & (up < ANKLES_TO)]
        x, y = pose.R_world_torso[:2, 0] / np.linalg.norm(pose.R_world_torso[:2, 0])
        feet = forward(self.body, pose)[FOOT_POINTS]
        away = np.linalg.norm(ankles[:, None] - feet[:, :2], axis=2)
        for number, foot in enumerate(feet):
            own = ankles[(away[:, number] < FOOT_REACH * H) & (away.argmin(axis=1) == number)]
            if foot[2] > floor + STANDING_TO * H or len(own) < FEWEST_OF_A_FOOT:
                continue
            ahead, across = np.array([[x, y], [-y, x]]) @ (soles - np.median(own, axis=0)).T / H
            ahead = ahead[(np.abs(across) < FOOT_HALF_WIDTH) & (np.abs(ahead) < FOOT_REACH)]
            if len(ahead) >= FEWEST_OF_A_FOOT:
                heel, toe = np.percentile(ahead, [3, 97])
                sd = FOOT_LEAD_SD + max(0.0, toe - heel - LONGEST_FOOT)
                ratio += float((heel + toe) * FOOT_LEAD / sd**2)
        return ratio


@dataclass(eq=False)
class PoseHypothesis:
    """A pose that is tracked over ``sets`` frame sets.

    Summed over the sets: cost, as a share of the rays; share of the rays that it explains; seen, the share of its
    sticks that rays show; feet, the log-likelihood ratio of its heading from the feet. way : m, walked forwards of late
    (negative: backwards). angles (18,) : of a held pose, from which a fit that leaves it is repeated; None: any pose.
    """

    pose: Pose
    angles: np.ndarray | None = None
    cost: float = 0.0
    share: float = 0.0
    seen: float = 0.0
    feet: float = 0.0
    way: float = 0.0
    sets: int = 0

    @property
    def mean_cost(self) -> float:
        """Mean cost of a set, as a share of its rays, less the bonuses of walking direction and feet."""
        walking = WALKING_SHARE * float(np.clip(self.way / STEP_M, -1.0, 1.0))
        feet = FEET_SHARE * float(np.tanh(self.feet / max(self.sets, 1) / FEET_EVIDENCE))
        return self.cost / max(self.sets, 1) - walking - feet

    @property
    def mean_share(self) -> float:
        """Mean share of the rays that it explains."""
        return self.share / max(self.sets, 1)

    @property
    def agreement(self) -> float:
        """Harmonic mean of the shares of the rays that it explains, and of itself that they show (F-measure)."""
        return 2.0 * self.share * self.seen / max((self.share + self.seen) * self.sets, 1e-12)

    def faces_elsewhere(self, other: PoseHypothesis) -> bool:
        """Whether another one faces another way."""
        return float(self.pose.R_world_torso[:, 0] @ other.pose.R_world_torso[:, 0]) < 0.5

    def update(self, seen: InitializationObservation) -> None:
        """Fit the pose to the next set."""
        before, self.pose = self.pose, seen.fitted(self.pose)
        if self.angles is not None and farthest_stick(seen.body, self.pose, self.angles)[1] >= T_POSE_RAD:
            self.pose = seen.fitted(upright_pose(before, self.angles))
        moved = self.pose.position_world - before.position_world
        self.way = self.way * math.exp(-seen.dt_s / STEP_S) + float(moved[:2] @ before.R_world_torso[:2, 0])
        self.add(seen)

    def add(self, seen: InitializationObservation) -> None:
        """Add a set's evidence; rays count by their certainty, those of torn outlines little."""
        evidence, certainty = seen.evidence_of(self.pose), seen.data.contour_rays.information
        certainty = certainty / max(float(certainty.sum()), 1e-12)
        explained = evidence.costs < EXPLAINED_COST
        self.cost += float(certainty @ evidence.costs) + evidence.beyond / max(len(evidence.costs), 1)
        self.share += float(certainty @ explained)
        self.seen += seen.share_seen(self.pose, evidence, explained)
        self.feet += seen.evidence_of_feet(self.pose)
        self.sets += 1


def upright_pose(pose: Pose, angles: np.ndarray) -> Pose:
    """Return the upright pose with these angles (18,) at another one's place and heading."""
    heading = math.atan2(pose.R_world_torso[1, 0], pose.R_world_torso[0, 0])
    return Pose.from_angles(pose.position_world, rotation_matrix(np.array([0.0, 0.0, heading])), angles)


def farthest_stick(body: Body, pose: Pose, angles: np.ndarray) -> tuple[str, float]:
    """Return the stick of a body, but the head, whose direction differs most from the upright pose with these angles
    (18,), and the difference, rad."""
    upright = upright_pose(pose, angles)
    here, there = (np.diff(sticks(body, one), axis=1)[:, 0] / body.lengths[:, None] for one in (pose, upright))
    cosines = np.delete((here * there).sum(axis=1), HEAD)
    return np.delete(STICK_NAMES, HEAD)[cosines.argmin()], float(np.arccos(min(cosines.min(), 1.0)))
