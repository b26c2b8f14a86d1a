"""The first pose from a T-pose: standing upright, arms stretched sideways, level.

The hull alone gives stature, span and heading; the feet tell front from back (toes point forward of the ankles). The
body is an average adult of that stature whose arms are scaled to the measured span and raised to the measured height.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from stick_figure.body import Body
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import L_FOREARM, L_UPPER_ARM, R_FOREARM, R_UPPER_ARM

from .initial_pose import InitialPose

ARMS = [L_UPPER_ARM, R_UPPER_ARM, L_FOREARM, R_FOREARM]
# heights and widths over the stature (Drillis & Contini 1966, in Winter, fig. 4.1)
HIP_HEIGHT, WAIST_HEIGHT, CHEST_HEIGHT = 0.53, 0.55, 0.75
ARM_CLEARANCE = 0.20  # beyond this distance from the spine only arms are left
TORSO_HALF_WIDTH = 0.12
FOOT_HEIGHT, SHIN_LOW, SHIN_HIGH = 0.04, 0.10, 0.20
FOOT_HALF_WIDTH, FOOT_REACH = 0.04, 0.17  # a foot is 0.055 wide and 0.152 long
TRIMMED = 0.2  # per cent of the voxels that may be stray at either end
FEWEST_VOXELS, FEWEST_ARM_VOXELS = 200, 10


@dataclass(frozen=True)
class TPoseSettings:
    """What counts as a T-pose."""

    stature_low_m: float = setting(1.2, "least stature", unit="m", low=0.5, high=2.6)
    stature_high_m: float = setting(2.2, "largest stature", unit="m", low=0.5, high=2.6)
    slope: float = setting(0.25, "largest slope of an arm (tangent)", low=0.0, high=1.0)
    span_low: float = setting(0.80, "least span of the arms over the stature", low=0.1, high=2.0)
    span_high: float = setting(1.20, "largest span of the arms over the stature", low=0.1, high=2.0)
    asymmetry: float = setting(0.10, "largest difference of the arms' reach over the stature", low=0.0, high=1.0)
    toe_lead: float = setting(0.008, "least lead of the feet before the shins over the stature", low=0.0, high=1.0)
    hold_sets: int = setting(5, "frame sets in a row that must show the T-pose", low=1, high=1000)


@dataclass(frozen=True, eq=False)
class TPose:
    """What the hull of a T-pose measures. World frame, metres; ``reason`` says why it is none."""

    reason: str = ""
    floor: float = 0.0
    stature: float = 0.0
    span: float = 0.0
    arm_height: float = 0.0
    centre: np.ndarray | None = None
    forward: np.ndarray | None = None


class TPoseSource:
    """A first pose as soon as the hull has shown a T-pose in several frame sets in a row."""

    @property
    def needs_voxels(self) -> bool:
        return True

    def __init__(self, settings: TPoseSettings, body: Body | None = None) -> None:
        self._settings, self._body = settings, body
        self._seen: list[TPose] = []

    def look(self, points_world: np.ndarray, voxels_world: np.ndarray | None) -> InitialPose:
        """The pose and the measured body (or the one given at the start), or the reason why not."""
        measured = measure_t_pose(voxels_world, self._settings)
        if measured.reason:
            self._seen.clear()
            return InitialPose(reason=measured.reason)
        self._seen.append(measured)
        if len(self._seen) < self._settings.hold_sets:
            return InitialPose(reason=f"T-pose seen, hold it ({len(self._seen)} of {self._settings.hold_sets})")
        body = self._body or body_of(self._seen)
        self._seen.clear()
        return InitialPose(pose_of(measured, body), body)


def measure_t_pose(voxels_world: np.ndarray | None, settings: TPoseSettings | None = None) -> TPose:
    """Measure a T-pose on hull voxels (m, 3), z up; refuse, with the reason, what is none."""
    settings = settings or TPoseSettings()
    if voxels_world is None or len(voxels_world) == 0:
        return TPose("no hull")
    if len(voxels_world) < FEWEST_VOXELS:
        return TPose(f"the hull is too small: {len(voxels_world)} voxels, {FEWEST_VOXELS} needed")
    floor, top = np.percentile(voxels_world[:, 2], [TRIMMED, 100.0 - TRIMMED])
    stature = float(top - floor)
    if not settings.stature_low_m <= stature <= settings.stature_high_m:
        size = "small" if stature < settings.stature_low_m else "large"
        return TPose(f"the hull is too {size}: {stature:.2f} m high")
    height = (voxels_world[:, 2] - floor) / stature
    return _with_feet(voxels_world, height, _arms(voxels_world, height, float(floor), stature, settings), settings)


def _arms(voxels: np.ndarray, height: np.ndarray, floor: float, stature: float, settings: TPoseSettings) -> TPose:
    """Arm axis, span and arm height; ``forward`` is still one of two opposite directions."""
    flat = voxels[:, :2]
    upper = height > WAIST_HEIGHT
    torso = upper & (height < CHEST_HEIGHT)
    if torso.sum() < FEWEST_ARM_VOXELS:
        return TPose("no torso in the hull")
    centre = np.median(flat[torso], axis=0)
    axis = np.linalg.eigh(np.cov((flat[upper] - centre).T))[1][:, -1]
    along = (flat - centre) @ axis
    reach, heights = [], []
    for side in (1.0, -1.0):
        arm = upper & (side * along > ARM_CLEARANCE * stature)
        if arm.sum() < FEWEST_ARM_VOXELS:
            return TPose("arms not stretched sideways")
        slope, offset = np.polyfit(side * along[arm], voxels[arm, 2], 1)
        if abs(slope) > settings.slope:
            return TPose(f"arms not level: one slopes by {np.degrees(np.arctan(slope)):.0f} degrees")
        reach.append(float(np.percentile(side * along[arm], 100.0 - TRIMMED)))
        heights.append(offset + slope * ARM_CLEARANCE * stature)
    span = sum(reach)
    if not settings.span_low <= span / stature <= settings.span_high:
        return TPose(f"arms not stretched: they span {span:.2f} m at a stature of {stature:.2f} m")
    if abs(reach[0] - reach[1]) > settings.asymmetry * stature:
        return TPose(f"arms of unequal reach: {reach[0]:.2f} m and {reach[1]:.2f} m")
    return TPose(
        floor=floor, stature=stature, span=span, arm_height=float(np.mean(heights)), centre=centre,
        forward=np.array([axis[1], -axis[0]]),
    )  # fmt: skip


def _with_feet(voxels: np.ndarray, height: np.ndarray, arms: TPose, settings: TPoseSettings) -> TPose:
    """Turn ``forward`` to where the toes point, and centre the torso."""
    if arms.reason or arms.forward is None or arms.centre is None:
        return arms
    flat = voxels[:, :2]
    feet, shins = height < FOOT_HEIGHT, (height > SHIN_LOW) & (height < SHIN_HIGH)
    if feet.sum() < FEWEST_ARM_VOXELS or shins.sum() < FEWEST_ARM_VOXELS:
        return TPose("no feet in the hull")
    lead = _toe_lead(flat, feet, shins, arms.forward, arms.stature)
    if abs(lead) < settings.toe_lead * arms.stature:
        return TPose(f"front and back look alike: the feet lead the shins by {1e3 * abs(lead):.0f} mm only")
    forward = arms.forward if lead > 0.0 else -arms.forward
    across = (flat - arms.centre) @ np.array([-forward[1], forward[0]])
    trunk = (height > WAIST_HEIGHT) & (height < CHEST_HEIGHT) & (np.abs(across) < TORSO_HALF_WIDTH * arms.stature)
    return replace(arms, forward=forward, centre=flat[trunk].mean(0))


def _toe_lead(flat: np.ndarray, feet: np.ndarray, shins: np.ndarray, forward: np.ndarray, stature: float) -> float:
    """How far the feet lead their shins along ``forward``, metres, mean of both legs.

    Only voxels within a foot's length and breadth of a shin count: what else lies on the floor is shadow.
    """
    left = np.array([-forward[1], forward[0]])
    middle = np.median(flat[shins], axis=0)
    leads = []
    for side in (1.0, -1.0):
        shin = shins & (side * ((flat - middle) @ left) > 0.0)
        if not shin.any():
            continue
        from_shin = flat - np.median(flat[shin], axis=0)
        along, across = from_shin @ forward, from_shin @ left
        foot = feet & (np.abs(across) < FOOT_HALF_WIDTH * stature) & (np.abs(along) < FOOT_REACH * stature)
        if foot.any():
            leads.append(float(along[foot].mean()))
    return float(np.mean(leads)) if leads else 0.0


def body_of(measured: list[TPose]) -> Body:
    """An average adult of the measured stature, arms scaled to the measured span and set at the measured height."""
    stature = float(np.median([m.stature for m in measured]))
    span = float(np.median([m.span for m in measured]))
    arm_height = float(np.median([m.arm_height - m.floor for m in measured]))
    average = Body.from_stature(stature)
    model_span = 2.0 * average.half_shoulder_width + average.lengths[ARMS].sum()
    half_lengths = average.half_lengths.copy()
    half_lengths[ARMS] *= span / model_span
    half_torso = half_lengths[0]
    rise = arm_height - (HIP_HEIGHT * stature + half_torso)
    return Body(
        half_lengths,
        average.half_shoulder_width * span / model_span,
        float(np.clip(rise / half_torso, 0.5, 1.0)),
        average.hip_width_ratio * model_span / span,
    )


def pose_of(measured: TPose, body: Body) -> Pose:
    """The T-pose at the measured place and heading."""
    assert measured.forward is not None and measured.centre is not None
    x, y = measured.forward / np.linalg.norm(measured.forward)
    R_world_torso = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    height = measured.floor + HIP_HEIGHT * measured.stature + body.half_lengths[0]
    return Pose.from_angles(np.r_[measured.centre, height], R_world_torso, T_POSE_ANGLES)
