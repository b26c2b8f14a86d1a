"""The first pose of a body whose sizes are known: from anything near a T-pose, nothing need be held for long.

Many rough poses (both headings, arms up to 45 degrees up or down, legs together or apart) are compared with the hull,
the best is fitted for either heading, and the fit is taken when the body explains the hull's surface, the hull
holds the figure, and feet and head say where front is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from capture_rig.rigid import rotation_matrix
from capture_rig.visibility import RigVisibility
from mocap_packets.hull import HullProducts, VoxelSamples
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.placed_figure import Figure, State, place, surface_distances
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES, HEAD, mirror_angles

from ..articulated_fit import ArticulatedSettings, PriorSettings, fit_articulated
from .body_parts import evidence_of_feet, evidence_of_head
from .body_sizes import LimbGirths
from .initial_pose import InitialPose
from .t_pose_measures import TPoseSettings
from .upright import FEWEST_VOXELS, PoseRejected, Upright, measure_upright_of_stature, reasons_of_bodies

NEAR_M = 0.06  # body and hull surface this near to each other agree
FAR_M = 0.15  # farther is no worse
AXIS_SAMPLES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


@dataclass(frozen=True)
class SurfaceMatch:
    """How well a pose and a hull agree.

    explained : share of the hull's surface that lies on the body's. held : share of the capsules' axes that lie in the
    hull. cost : m, mean distance between the surfaces and of axes to hull, cut off where it stops to matter.
    """

    explained: float
    held: float
    cost: float


def match_surface(figure: Figure, pose: Pose, surface_world: np.ndarray, hull_world: np.ndarray) -> SurfaceMatch:
    """Compare a body in a pose with samples of a hull's surface (m, 3) and of all of it (n, 3), metres, world frame."""
    placed, radii = place(State.of(pose), figure), figure.surface.radii
    _, _, distance = surface_distances(surface_world, placed)
    axes = (placed.P[:, None] + AXIS_SAMPLES[:, None] * (placed.Q - placed.P)[:, None]).reshape(-1, 3)
    offsets = axes[:, None] - hull_world
    nearest = np.sqrt(np.einsum("anj,anj->an", offsets, offsets).min(axis=1))
    outside = nearest - (radii[:, :1] + AXIS_SAMPLES * (radii[:, 1:] - radii[:, :1])).ravel()
    cost = np.clip(np.abs(distance), 0.0, FAR_M).mean() + np.clip(outside, 0.0, FAR_M).mean()
    return SurfaceMatch(float(np.mean(np.abs(distance) < NEAR_M)), float(np.mean(outside < NEAR_M / 2)), float(cost))


ELEVATIONS = (-0.95, -0.5, 0.0, 0.5)  # rad, of an arm at the start
SPREADS = (0.0, 0.2)  # rad, of a leg at the start
CROUCH = 0.85  # least height over the stature: a slight squat
FREE = PriorSettings(position_sd_m=0.3, rotation_sd=0.4, ball_sd=0.5, hinge_sd=0.5)
ITERATIONS, SAMPLES = 40, 400
SETS = 3  # in a row that must show the same heading
EXPLAINED, HELD = 0.65, 0.90
"""Least share of the hull's surface that lies on the body's, and of the figure's axes that lie in the hull."""
ARM_OFF_DEG, THIGH_OFF_DEG = 60.0, 40.0
LEFT_FOOT, RIGHT_FOOT = 13, 14


@dataclass(frozen=True, eq=False)
class Fitted:
    """A pose, how it matches the hull, and the log-likelihood ratio of its heading against the opposite one."""

    pose: Pose
    match: SurfaceMatch
    facing: float


class KnownBodySource:
    """A first pose of one known body, as soon as several frame sets in a row show it."""

    @property
    def needs_voxels(self) -> bool:
        return True

    def __init__(
        self,
        settings: TPoseSettings,
        body: Body,
        visibility: RigVisibility | None = None,
        girths: LimbGirths | None = None,
    ) -> None:
        self._settings, self._body, self._visibility, self._girths = settings, body, visibility, girths
        figure = Figure.of(body)
        self._figure = figure._replace(surface=(girths or LimbGirths()).on(figure.surface))
        self._agreed: list[np.ndarray] = []

    @property
    def is_held(self) -> bool:
        """Whether the last set showed the body near a T-pose."""
        return len(self._agreed) > 0

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the pose, or the reason why there is none yet."""
        found, reasons = [], {}
        for number in seen.voxels_of_bodies():
            try:
                found.append(self._fit(seen.of_body(number)))
            except PoseRejected as refusal:
                reasons[number] = refusal.reason
        if len(found) != 1:
            self._agreed.clear()
            if found:
                return InitialPose(reason=f"{len(found)} bodies could be the known one: one is followed, which?")
            return InitialPose(reason=reasons_of_bodies(reasons))
        return self._agree(found[0])

    def _agree(self, fitted: Fitted) -> InitialPose:
        """Return a pose once the sets before it showed the same heading."""
        ahead = fitted.pose.R_world_torso[:, 0]
        self._agreed = [other for other in self._agreed if other @ ahead > 0.7] + [ahead]
        if len(self._agreed) < SETS:
            return InitialPose(reason=f"the known body seen ({len(self._agreed)} of {SETS})")
        self._agreed.clear()
        return InitialPose(fitted.pose, self._body, girths=self._girths)

    def _fit(self, seen: HullProducts) -> Fitted:
        """Return the best fit to one body. Raises PoseRejected when it is not good enough."""
        voxels = seen.voxels
        if len(voxels) < FEWEST_VOXELS:
            raise PoseRejected("no hull" if len(voxels) == 0 else "the hull is too small")
        upright, crown = measure_upright_of_stature(voxels.points_world, self._body.stature, CROUCH, self._visibility)
        start = self._best_start(upright, crown, voxels)
        fits = [self._fitted(seen, voxels, upright, pose) for pose in (start, _turned_round(start))]
        other, best = sorted(fits, key=lambda fitted: fitted.facing)
        _refuse_far(best.pose)
        if best.match.explained < EXPLAINED or best.match.held < HELD:
            raise PoseRejected(
                f"the known body does not fit: it explains {100 * best.match.explained:.0f} % of the hull, "
                f"{100 * best.match.held:.0f} % of it is inside"
            )
        if 0.5 * (best.facing - other.facing) < self._settings.sureness:
            raise PoseRejected("front and back look alike: are the feet and the floor around them in view?")
        return best

    def _best_start(self, upright: Upright, crown: float, voxels: VoxelSamples) -> Pose:
        """Of many rough poses the one that matches the hull best; its heading is one of two."""
        surface = voxels.surface_points(SAMPLES)
        poses = [_rough_pose(self._body, upright, crown, *limbs) for limbs in product(ELEVATIONS, ELEVATIONS, SPREADS)]
        return min(poses, key=lambda pose: match_surface(self._figure, pose, surface, surface).cost)

    def _fitted(self, seen: HullProducts, voxels: VoxelSamples, upright: Upright, start: Pose) -> Fitted:
        settings = replace(ArticulatedSettings(), prior=FREE, max_iterations=ITERATIONS)
        points = seen.centerline.points_world
        points = points[np.isfinite(points).all(axis=1)]
        pose = fit_articulated(self._body, start, points, 0.0, voxels, settings=settings).pose
        match = match_surface(self._figure, pose, voxels.surface_points(1000), voxels.hull_points(1500))
        return Fitted(pose, match, _facing(self._body, pose, upright))


def _refuse_far(pose: Pose) -> None:
    """Raises PoseRejected when an arm or a thigh is too far from where a T-pose has it."""
    for name, joint, out in (("left", 1, 1.0), ("right", 2, -1.0)):
        arm = np.degrees(np.arccos(np.clip(out * pose.R_joints[joint][1, 1], -1.0, 1.0)))
        if arm > ARM_OFF_DEG:
            raise PoseRejected(f"too far from a T-pose: the {name} arm is {arm:.0f} degrees off")
        thigh = np.degrees(np.arccos(np.clip(pose.R_joints[joint + 2][2, 2], -1.0, 1.0)))
        if thigh > THIGH_OFF_DEG:
            raise PoseRejected(f"too far from a T-pose: the {name} thigh is {thigh:.0f} degrees off")


def _facing(body: Body, pose: Pose, upright: Upright) -> float:
    """Log-likelihood ratio of the pose's heading, from the feet about its ankles and the head about its shoulders."""
    ahead = pose.R_world_torso[:2, 0]
    own = upright if ahead @ upright.forward_world > 0.0 else upright.turned_round()
    axes = np.array([own.forward_world, [-own.forward_world[1], own.forward_world[0]]])
    points = (forward(body, pose)[:, :2] - own.centre_world) @ axes.T
    shoulders = float(points[3:5, 0].mean())
    return evidence_of_feet(own, [points[LEFT_FOOT], points[RIGHT_FOOT]]) + evidence_of_head(own, shoulders)


def _rough_pose(body: Body, upright: Upright, crown: float, left: float, right: float, spread: float) -> Pose:
    """Upright, under the hull's crown, arms raised by two angles, legs spread by one."""
    angles = T_POSE_ANGLES.copy()
    for name, value in (
        ("left_shoulder_x", left),
        ("right_shoulder_x", np.pi - right),
        ("left_hip_x", spread),
        ("right_hip_x", -spread),
    ):
        angles[ANGLE_NAMES.index(name)] = value
    height = upright.floor_world + crown - body.lengths[HEAD] - body.half_lengths[0]
    x, y = upright.forward_world
    R_world_torso = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    return Pose.from_angles(np.r_[upright.centre_world, height], R_world_torso, angles)


def _turned_round(pose: Pose) -> Pose:
    """Return the mirrored pose, turned by half a turn: from afar the same."""
    half_turn = rotation_matrix(np.array([0.0, 0.0, np.pi]))
    return Pose.from_angles(pose.position_world, half_turn @ pose.R_world_torso, mirror_angles(pose.angles()))
