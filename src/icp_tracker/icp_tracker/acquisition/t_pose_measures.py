"""The measures of a T-pose (arms level) or of an A-pose (arms lowered by 45 degrees) on one body's hull."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from capture_rig.visibility import RigVisibility

from .body_parts import Arm, Legs, facing, find_arms, find_legs
from .truncation import TRUNK_REACH
from .upright import FEWEST_OF_A_PART, FEWEST_VOXELS, PoseRejected, Upright, measure_upright, reject_leaning

LEVEL, LOWERED = "level", "lowered"
LOWERED_BY = np.pi / 4
ARMPIT = (-0.10, -0.06)  # over the stature, from the arms' height: here the trunk's sides end
# Thresholds: measured by python bench/acquisition.py (how many are found).
LARGEST_TILT = 0.33  # rad, of an arm from where it should be
LARGEST_SWEEP = 0.45  # rad, of both arms ahead or behind: elbows that are bent a little swing their forearms ahead
SPAN, ASYMMETRY = (0.80, 1.25), 0.10  # over the stature: of both arms, least and largest; of their reach
NO_WIDTH = float("nan")


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


@dataclass(frozen=True, eq=False)
class TPose:
    """What the hull of a T-pose measures.

    body : the voxels in the body's frame. arms : left and right. legs : both. facing : log-likelihood ratio that the
    frame's x axis is forward. chest_half_width : m, half the trunk's width below the armpits, NaN
    where lowered arms hide it.
    """

    body: Upright
    arms: tuple[Arm, Arm]
    legs: Legs
    facing: float
    chest_half_width: float

    @property
    def stature(self) -> float:
        """Height of the crown over the floor, metres."""
        return self.body.stature

    def turned_round(self) -> TPose:
        """Return the same taken back to front."""
        arms = (self.arms[1].turned_round(), self.arms[0].turned_round())
        return replace(self, body=self.body.turned_round(), arms=arms, facing=-self.facing)

    @property
    def span(self) -> float:
        """Length of both arms and the shoulders between them, along the arms, metres."""
        return sum(arm.length_from(0.0) for arm in self.arms)


def measure_t_pose(
    voxels_world: np.ndarray | None, settings: TPoseSettings | None = None, visibility: RigVisibility | None = None
) -> TPose:
    """Measure a T-pose on the hull voxels (m, 3) of one body, metres, z up.

    visibility : of the rig; None: everything is seen. Raises PoseRejected, with the reason, for what is no T-pose.
    Which way the body faces is a likelihood: whether it is enough is for the caller to say.
    """
    settings = settings or TPoseSettings()
    if voxels_world is None or len(voxels_world) == 0:
        raise PoseRejected("no hull")
    if len(voxels_world) < FEWEST_VOXELS:
        raise PoseRejected(f"the hull is too small: {len(voxels_world)} voxels, {FEWEST_VOXELS} needed")
    voxels_world = np.asarray(voxels_world, dtype=np.float64)
    body = measure_upright(voxels_world, settings.stature_low_m, settings.stature_high_m, visibility)
    legs = find_legs(body)
    reject_leaning(body)
    arms = find_arms(body)
    width = _chest_half_width(body, arms) if settings.arms == LEVEL else NO_WIDTH
    measured = TPose(body, arms, legs, facing(body, arms), width)
    _refuse_arms(measured, settings)
    return measured if measured.facing >= 0.0 else measured.turned_round()


def _refuse_arms(measured: TPose, settings: TPoseSettings) -> None:
    arms, stature, span = measured.arms, measured.stature, measured.span
    expected = 0.0 if settings.arms == LEVEL else -LOWERED_BY
    for arm in arms:
        if abs(arm.elevation - expected) > LARGEST_TILT:
            kind = "level" if settings.arms == LEVEL else "lowered by 45 degrees"
            raise PoseRejected(f"arms not {kind}: one slopes by {np.degrees(arm.elevation):.0f} degrees")
    ahead = 0.5 * (arms[0].sweep + arms[1].sweep)
    if abs(ahead) > LARGEST_SWEEP:
        raise PoseRejected(f"arms not straight sideways: they lie {np.degrees(abs(ahead)):.0f} degrees ahead or behind")
    if not SPAN[0] <= span / stature <= SPAN[1]:
        what = "arms not stretched" if span < stature else "more than one body, or not upright"
        raise PoseRejected(f"{what}: they span {span:.2f} m at a stature of {stature:.2f} m")
    if abs(arms[0].tip - arms[1].tip) > ASYMMETRY * stature:
        raise PoseRejected(f"arms of unequal reach: {arms[0].tip:.2f} m and {arms[1].tip:.2f} m")


def _chest_half_width(body: Upright, arms: tuple[Arm, Arm]) -> float:
    height = 0.5 * (arms[0].height + arms[1].height) / body.stature
    chest = body.between(height + ARMPIT[0], height + ARMPIT[1])
    chest = chest[np.abs(chest[:, 1]) < TRUNK_REACH * body.stature]
    if len(chest) < 2 * FEWEST_OF_A_PART:
        return NO_WIDTH
    return 0.5 * (float(np.ptp(np.percentile(chest[:, 1], [2, 98]))) + body.pitch / 2)
