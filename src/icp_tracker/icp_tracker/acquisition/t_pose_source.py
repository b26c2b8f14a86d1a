"""The first pose from a T-pose (or an A-pose) that a person holds: every body in the volume is examined."""

from __future__ import annotations

from collections import deque

import numpy as np

from capture_rig.stamps import NS_PER_S
from capture_rig.visibility import RigVisibility
from mocap_packets.hull import HullProducts
from stick_figure.body import Body
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES, L_CALF, L_THIGH, angles_of_sides

from .body_sizes import ANKLE, MEAN_OVER_STATURE, estimate_body
from .initial_pose import InitialPose
from .t_pose_measures import LEVEL, TPose, TPoseSettings, measure_t_pose
from .upright import SHINS, TRUNK, PoseRejected, reasons_of_bodies

# Thresholds: measured by python bench/acquisition.py (how many are found).
SAME_PLACE_M = 0.3  # a body that moves farther between two sets is another person
STILL_M_S = 0.25  # who moves faster does not stand still
SURENESS = 5.0  # least log-likelihood ratio of the heading that was found against the opposite one
JITTER_M = 0.03  # the middle of a hull's trunk jitters by so much though nobody moves
TRUNK_HALF_WIDTH = 0.12  # over the stature


class TPoseSource:
    """A first pose as soon as one body has shown the pose in several frame sets in a row, standing still."""

    def __init__(
        self, settings: TPoseSettings, visibility: RigVisibility | None = None, known: Body | None = None
    ) -> None:
        """``known`` : whose pose it is; None: the body is measured."""
        self._settings, self._visibility, self._known = settings, visibility, known
        self._held: deque[tuple[int, TPose]] = deque(maxlen=settings.hold_sets)

    @property
    def is_held(self) -> bool:
        """Whether the last set showed a T-pose."""
        return len(self._held) > 0

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the pose and the measured body, or the reason why there is none yet."""
        measured, reason = find_t_pose(seen, self._settings, self._visibility)
        if measured is None:
            self._held.clear()
            return InitialPose(reason=reason)
        last = self._held[-1][1] if self._held else measured
        if np.linalg.norm(last.body.centre_world - measured.body.centre_world) > SAME_PLACE_M:
            self._held.clear()
        self._held.append((seen.stamp_ns, measured))
        reason = self._not_yet()
        if reason:
            return InitialPose(reason=reason)
        held = _turned_alike([m for _, m in self._held])
        self._held.clear()
        if self._known is not None:
            return InitialPose(pose_of(held, self._known), self._known)
        estimate = estimate_body(held)
        return InitialPose(pose_of(held, estimate.body), estimate.body, "", estimate)

    def _not_yet(self) -> str:
        """Why the sets so far are not enough; empty when they are."""
        speed, way = _movement(self._held)
        if speed > STILL_M_S and way > JITTER_M:
            return f"stand still: moving at {speed:.1f} m/s"
        if len(self._held) < self._settings.hold_sets:
            name = "T-pose" if self._settings.arms == LEVEL else "A-pose"
            return f"{name} seen, hold it ({len(self._held)} of {self._settings.hold_sets})"
        if _sureness(self._held) < SURENESS:
            return "front and back look alike: are the feet and the floor around them in view?"
        return ""


def find_t_pose(
    seen: HullProducts, settings: TPoseSettings, visibility: RigVisibility | None = None
) -> tuple[TPose | None, str]:
    """Return the one body that stands in the pose; or None, and of each body the reason why it does not."""
    found, reasons = [], {}
    for number, voxels in seen.voxels_of_bodies().items():
        try:
            found.append(measure_t_pose(voxels, settings, visibility))
        except PoseRejected as refusal:
            reasons[number] = refusal.reason
    if len(found) == 1:
        return found[0], ""
    if found:
        return None, f"{len(found)} bodies in a T-pose: one is followed, which?"
    return None, reasons_of_bodies(reasons)


def pose_of(held: list[TPose], body: Body) -> Pose:
    """Return the pose at the measured place and heading: arms and legs as they are held, the trunk upright.

    A hull's depth is worse than its height, so the arms' sweep is that of both together.
    """
    last = held[-1]
    x, y = last.body.forward_world / np.linalg.norm(last.body.forward_world)
    R_world_torso = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    sweep = float(np.median([0.5 * (m.arms[0].sweep + m.arms[1].sweep) for m in held]))
    elevations = np.median([[arm.elevation for arm in m.arms] for m in held], axis=0)
    spread = float(np.median([m.legs.spread for m in held]))
    angles = angles_of_sides(*(_angles(elevation, sweep, spread) for elevation in elevations))
    legs = MEAN_OVER_STATURE[ANKLE] * last.stature + (body.lengths[L_THIGH] + body.lengths[L_CALF]) * np.cos(spread)
    height = last.body.floor_world + legs + body.half_lengths[0]
    return Pose.from_angles(np.r_[_trunk_middle(last), height], R_world_torso, angles)


def _angles(elevation: float, sweep: float, spread: float) -> np.ndarray:
    """Return (18,) angles with the left arm and the left leg as given; the inverse kinematics of thesis Table 5.4."""
    angles = T_POSE_ANGLES.copy()
    x, y, z = np.tan(sweep), 1.0, np.tan(elevation)
    angles[ANGLE_NAMES.index("left_shoulder_x")] = np.arctan2(z, y)
    angles[ANGLE_NAMES.index("left_shoulder_z")] = np.arctan2(-x, np.hypot(y, z))
    angles[ANGLE_NAMES.index("left_hip_x")] = spread
    return angles


def _trunk_middle(measured: TPose) -> np.ndarray:
    """Return where the trunk's axis stands (2,), world, metres.

    The trunk's surface lies ahead of its joints, that of the shins behind theirs: halfway between is the axis.
    """
    body = measured.body
    trunk = body.between(*TRUNK)
    ahead, across = trunk[np.abs(trunk[:, 1]) < TRUNK_HALF_WIDTH * body.stature, :2].mean(axis=0)
    ahead = 0.5 * (ahead + float(np.median(body.between(*SHINS)[:, 0])))
    left = np.array([-body.forward_world[1], body.forward_world[0]])
    return body.centre_world + ahead * body.forward_world + across * left


def _movement(held: deque[tuple[int, TPose]]) -> tuple[float, float]:
    """Speed of the trunk over the held sets, m/s, and the way it went, m: a straight line through its places."""
    stamps = np.array([stamp for stamp, _ in held], dtype=np.float64)
    if len(held) < 3 or np.ptp(stamps) == 0.0:
        return 0.0, 0.0
    t = (stamps - stamps.mean()) / NS_PER_S
    places = np.array([m.body.centre_world for _, m in held])
    speed = float(np.linalg.norm(t @ (places - places.mean(axis=0)) / (t @ t)))
    return speed, speed * float(np.ptp(t))


def _sureness(held: deque[tuple[int, TPose]]) -> float:
    """Mean log-likelihood ratio of the heading that most of it speaks for."""
    reference = held[0][1].body
    signed = [np.sign(m.body.forward_world @ reference.forward_world) * m.facing for _, m in held]
    return float(abs(np.mean(signed)))


def _turned_alike(held: list[TPose]) -> list[TPose]:
    """Return the sets, all turned to the heading that the evidence of all of them speaks for."""
    total = sum(m.facing * m.body.forward_world for m in held)
    return [m if m.body.forward_world @ total > 0.0 else m.turned_round() for m in held]
