"""Arms, legs and heading of an upright body: where each limb points, how far it reaches, which way front is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .truncation import HEAD_FROM
from .upright import FEET_TO, FEWEST_OF_A_PART, SHINS, PoseRejected, Upright

# --- lines


def line_through(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope and offset of a line through points, and their median distance from it along y.

    Medians over all pairs and points (Theil 1950, Sen 1968): a third of the points may be phantoms.
    """
    first, second = np.triu_indices(len(x), 1)
    slope = np.median((y[second] - y[first]) / (x[second] - x[first]))
    offset = np.median(y - slope * x)
    return float(slope), float(offset), float(np.median(np.abs(y - offset - slope * x)))


# Thresholds: a foot from Drillis & Contini; else measured by python bench/acquisition.py.
CLEARANCE = 0.20  # over the stature: beyond this distance from the spine only arms are left
HIGHEST, LOWEST = 1.10, 0.40  # heights over the stature between which a stretched arm may be
PIECE = 0.035  # over the stature: length of the pieces an arm is cut into
SHORTEST = 0.33  # over the stature: an arm whose tip is no farther from the spine is not stretched sideways
THICKEST = 0.13  # over the stature
FEWEST_OF_A_PIECE = 3
PHANTOMS_FROM = 0.05  # over the stature: farther before or behind the arm's line are phantoms
INNER = 0.12  # over the stature, from the clearance on: no farther than the elbow
# over the stature: pieces of a straight arm lie this near to a line, in height and, worse seen, ahead
BENT_UP, BENT_AHEAD = 0.02, 0.06
STRAY = 0.5  # per cent


@dataclass(frozen=True)
class Arm:
    """One arm, in the body's frame.

    elevation, sweep : rad, the arm's line above the horizontal, and ahead of the axis across. tip : distance of the
    finger tips from the spine, across, metres. height, ahead : where the line passes the clearance from the spine,
    metres.
    """

    elevation: float
    sweep: float
    tip: float
    height: float
    ahead: float

    def at(self, across_m: float, stature: float) -> tuple[float, float]:
        """Return where the arm's line is at a distance from the spine: ahead and height, metres."""
        beyond = across_m - CLEARANCE * stature
        return self.ahead + beyond * np.tan(self.sweep), self.height + beyond * np.tan(self.elevation)

    def turned_round(self) -> Arm:
        """Return the same arm of the body taken the other way round."""
        return replace(self, sweep=-self.sweep, ahead=-self.ahead)

    def length_from(self, across_m: float) -> float:
        """Length of the arm's line from a distance from the spine to the tip, metres."""
        return (self.tip - across_m) * float(np.sqrt(1.0 + np.tan(self.elevation) ** 2 + np.tan(self.sweep) ** 2))


def find_arms(body: Upright) -> tuple[Arm, Arm]:
    """Find left and right arm (of the body as it is turned). Raises PoseRejected unless both are straight, sideways."""
    parts = [_beside(body, side) for side in (1.0, -1.0)]
    stretched = [len(p) >= FEWEST_OF_A_PART and _tip(p, body) > SHORTEST * body.stature for p in parts]
    if not any(stretched):
        raise PoseRejected("arms not stretched sideways")
    if not all(stretched):
        raise PoseRejected("arms not stretched sideways: only one is")
    left, right = (_measure(part, body) for part in parts)
    return left, right


def _beside(body: Upright, side: float) -> np.ndarray:
    """Return (n, 3) voxels of an arm: ahead, across (positive away from the spine), up; metres."""
    across = side * body.local[:, 1]
    arm = (across > CLEARANCE * body.stature) & (body.height > LOWEST) & (body.height < HIGHEST)
    return body.local[arm] * [1.0, side, 1.0]


def _tip(arm: np.ndarray, body: Upright) -> float:
    return float(np.percentile(arm[:, 1], 100.0 - STRAY)) + body.pitch / 2


def _measure(arm: np.ndarray, body: Upright) -> Arm:
    H = body.stature
    pieces = _pieces(arm, PIECE * H, PHANTOMS_FROM * H)
    if len(pieces) < 3:
        raise PoseRejected("arms not stretched sideways: they are broken off")
    across = pieces[:, 1] - CLEARANCE * H
    dx, x, off_ahead = line_through(across, pieces[:, 0])
    dz, z, off_up = line_through(across, pieces[:, 2])
    inner = across < INNER * H
    if inner.any():  # the shoulder lies on the upper arm's line, also where the forearm droops
        z = float(np.median((pieces[:, 2] - dz * across)[inner]))
    if off_up > BENT_UP * H or off_ahead > BENT_AHEAD * H:
        raise PoseRejected(f"an elbow is bent: the arm is {max(off_up, off_ahead):.2f} m off a straight line")
    near = np.abs(arm[:, 0] - x - dx * (arm[:, 1] - CLEARANCE * H)) < PHANTOMS_FROM * H
    heights = [np.ptp(piece[:, 2]) + body.pitch / 2 for piece in _cut(arm[near], PIECE * H)]
    thickness = float(np.median(heights)) if heights else 0.0
    if thickness > THICKEST * H:
        raise PoseRejected(f"no arms: what sticks out sideways is {thickness:.2f} m thick")
    return Arm(float(np.arctan(dz)), float(np.arctan(dx)), _tip(arm, body), float(z), float(x))


def _pieces(arm: np.ndarray, step: float, phantoms_from: float) -> np.ndarray:
    """Middles (k, 3) of an arm's pieces, spine to tip: in height halfway between top and bottom, else medians."""
    middles = []
    for piece in _cut(arm, step):
        middle = np.median(piece, axis=0)
        near = piece[np.abs(piece[:, 0] - middle[0]) < phantoms_from, 2]
        middles.append((middle[0], middle[1], 0.5 * (near.min() + near.max()) if len(near) else middle[2]))
    return np.array(middles).reshape(-1, 3)


def _cut(arm: np.ndarray, step: float) -> list[np.ndarray]:
    """Return the pieces of an arm that hold enough voxels, spine to tip."""
    if len(arm) == 0:
        return []
    number = ((arm[:, 1] - arm[:, 1].min()) / step).astype(int)
    pieces = [arm[number == k] for k in range(number.max() + 1)]
    return [piece for piece in pieces if len(piece) >= FEWEST_OF_A_PIECE]


# --- legs

# heights over the stature between which legs are looked at, and one slice
LEGS_FROM, LEGS_TO, SLICE = 0.10, 0.40, 0.025
KNEES = (0.25, 0.45)  # heights over the stature: bent knees and a seat's edge show here
STRIDE, KNEES_AHEAD, DEEPEST = 0.14, 0.13, 0.32  # over the stature
WIDEST = 0.35  # tangent of the largest angle of a leg from the vertical


@dataclass(frozen=True)
class Legs:
    """Both legs' mean line in the body's frame: apart, half their distance on the floor, m; spread, rad, the angle of
    each from the vertical, outwards."""

    apart: float
    spread: float

    def apart_at(self, height_m: float) -> float:
        """Half the distance of the legs' lines at a height above the floor, metres."""
        return self.apart - height_m * float(np.tan(self.spread))


def find_legs(body: Upright) -> Legs:
    """Return the legs' lines. Raises PoseRejected when they are in stride or bent."""
    H = body.stature
    shins = body.between(*SHINS)
    feet = [
        np.median(shins[side * shins[:, 1] > 0.0], axis=0) for side in (1.0, -1.0) if (side * shins[:, 1] > 0).any()
    ]
    if len(feet) == 2 and abs(feet[0][0] - feet[1][0]) > STRIDE * H:
        raise PoseRejected(f"feet not side by side: one is {abs(feet[0][0] - feet[1][0]):.2f} m ahead of the other")
    knees = body.between(*KNEES)
    if not feet or len(knees) < FEWEST_OF_A_PART:
        raise PoseRejected("no legs in the hull")
    low, high = np.percentile(knees[:, 0], [4, 96])
    ahead = abs(float(np.median(knees[:, 0]) - np.mean([foot[0] for foot in feet])))
    if high - low > DEEPEST * H or ahead > KNEES_AHEAD * H:
        raise PoseRejected("legs not straight: sitting, or knees bent?")
    return _lines(body)


def _lines(body: Upright) -> Legs:
    H, slices = body.stature, []
    for low in np.arange(LEGS_FROM, LEGS_TO, SLICE):
        slab = body.between(low, low + SLICE)
        if len(slab) >= 2 * FEWEST_OF_A_PART:
            middle = float(np.percentile(slab[:, 1], [2, 98]).mean())
            across = np.abs(slab[:, 1] - middle)
            inner, outer = np.percentile(across, [3, 97])
            slices.append(((low + SLICE / 2) * H, 0.5 * (inner + outer)))
    if len(slices) < 3:
        raise PoseRejected("no legs in the hull")
    table = np.array(slices)
    slope, apart, _ = line_through(table[:, 0], table[:, 1])
    if abs(slope) > WIDEST:
        raise PoseRejected(f"legs too far apart: each by {np.degrees(np.arctan(abs(slope))):.0f} degrees")
    return Legs(apart, float(-np.arctan(slope)))


# --- which of the two directions across the arms' axis is forward
#
# Toes lie ahead of the ankles, and the head lies ahead of the shoulders. Each lead is an observation with a mean and a
# spread among people; their log-likelihood ratios for "forward" against "backward" add up.

SHIN = (0.10, 0.22)  # heights over the stature
FOOT_HALF_WIDTH, FOOT_REACH = 0.04, 0.17  # over the stature: a foot is 0.055 wide and 0.152 long (Drillis & Contini)
# over the stature: how far the middle of a foot lies ahead of the shin, how far the head ahead of the arms; both +-
FOOT_LEAD, FOOT_LEAD_SD = 0.040, 0.020
HEAD_LEAD, HEAD_LEAD_SD = 0.015, 0.017
LONG_FOOT = 0.20  # longer than a foot in a hull: a shadow on the floor, which is seldom symmetrical
SHOULDER = 0.10  # over the stature


def facing(body: Upright, arms: tuple[Arm, Arm]) -> float:
    """Log-likelihood ratio that the body's x axis points forward and not backward."""
    H = body.stature
    shins = body.between(*SHIN)
    halves = [shins[side * shins[:, 1] > 0.0, :2] for side in (1.0, -1.0)]
    shoulders = float(np.mean([arm.at(SHOULDER * H, H)[0] for arm in arms]))
    ankles = [np.median(half, axis=0) for half in halves if len(half) >= FEWEST_OF_A_PART]
    return evidence_of_feet(body, ankles) + evidence_of_head(body, shoulders)


def evidence_of_feet(body: Upright, ankles: list[np.ndarray]) -> float:
    """Log-likelihood ratio from the feet, given where the ankles (2,) are, ahead and across in the body's frame."""
    H, evidence = body.stature, 0.0
    feet = body.between(-1.0, FEET_TO)[:, :2]
    for ankle in ankles:
        ahead, across = (feet - ankle).T
        foot = ahead[(np.abs(across) < FOOT_HALF_WIDTH * H) & (np.abs(ahead) < FOOT_REACH * H)]
        if len(foot) >= FEWEST_OF_A_PART:
            heel, toe = np.percentile(foot, [3, 97])
            sd = FOOT_LEAD_SD * H + max(0.0, toe - heel - LONG_FOOT * H)
            evidence += _log_ratio(0.5 * (heel + toe), FOOT_LEAD * H, sd)
    return evidence


def evidence_of_head(body: Upright, shoulders_ahead_m: float) -> float:
    """Log-likelihood ratio from the head, given how far ahead in the body's frame the shoulders are."""
    H = body.stature
    head = body.between(HEAD_FROM, 2.0)
    head = head[np.abs(head[:, 1]) < SHOULDER * H]
    if len(head) < FEWEST_OF_A_PART:
        return 0.0
    return _log_ratio(float(np.median(head[:, 0])) - shoulders_ahead_m, HEAD_LEAD * H, HEAD_LEAD_SD * H)


def _log_ratio(lead: float, expected: float, sd: float) -> float:
    """Return the log-odds of a lead that is Gaussian about ``expected`` forwards, -``expected`` backwards."""
    return 2.0 * lead * expected / sd**2
