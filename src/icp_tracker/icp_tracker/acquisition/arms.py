"""The stretched arms of an upright body: which way each points, how far it reaches, how thick it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .refusal import Refusal
from .robust_line import line_through
from .upright import FEWEST_OF_A_PART, Upright

CLEARANCE = 0.20  # over the stature: beyond this distance from the spine only arms are left
HIGHEST, LOWEST = 1.10, 0.40  # heights over the stature between which a stretched arm may be
STEP = 0.035  # over the stature: length of the pieces an arm is cut into
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
    metres. thickness : (k, 2) metres, distance from the spine and vertical thickness of each piece.
    """

    elevation: float
    sweep: float
    tip: float
    height: float
    ahead: float
    thickness: np.ndarray

    def at(self, across_m: float, stature: float) -> tuple[float, float]:
        """Where the arm's line is at a distance from the spine: ahead and height, metres."""
        beyond = across_m - CLEARANCE * stature
        return self.ahead + beyond * np.tan(self.sweep), self.height + beyond * np.tan(self.elevation)

    def turned_round(self) -> Arm:
        """The same arm of the body taken the other way round."""
        return replace(self, sweep=-self.sweep, ahead=-self.ahead)

    def length_from(self, across_m: float) -> float:
        """Length of the arm's line from a distance from the spine to the tip, metres."""
        return (self.tip - across_m) * float(np.sqrt(1.0 + np.tan(self.elevation) ** 2 + np.tan(self.sweep) ** 2))


def find_arms(body: Upright) -> tuple[Arm, Arm]:
    """Left and right arm (of the body as it is turned). Raises Refusal where an arm is not straight and sideways."""
    parts = [_beside(body, side) for side in (1.0, -1.0)]
    stretched = [len(p) >= FEWEST_OF_A_PART and _tip(p, body) > SHORTEST * body.stature for p in parts]
    if not any(stretched):
        raise Refusal("arms not stretched sideways")
    if not all(stretched):
        raise Refusal("arms not stretched sideways: only one is")
    left, right = (_measure(part, body) for part in parts)
    return left, right


def _beside(body: Upright, side: float) -> np.ndarray:
    """(n, 3) voxels of an arm: ahead, across (positive away from the spine), up; metres."""
    across = side * body.local[:, 1]
    arm = (across > CLEARANCE * body.stature) & (body.height > LOWEST) & (body.height < HIGHEST)
    return body.local[arm] * [1.0, side, 1.0]


def _tip(arm: np.ndarray, body: Upright) -> float:
    return float(np.percentile(arm[:, 1], 100.0 - STRAY)) + body.pitch / 2


def _measure(arm: np.ndarray, body: Upright) -> Arm:
    H = body.stature
    pieces = _pieces(arm, STEP * H, PHANTOMS_FROM * H)
    if len(pieces) < 3:
        raise Refusal("arms not stretched sideways: they are broken off")
    across = pieces[:, 1] - CLEARANCE * H
    dx, x, off_ahead = line_through(across, pieces[:, 0])
    dz, z, off_up = line_through(across, pieces[:, 2])
    inner = across < INNER * H
    if inner.any():  # the shoulder lies on the upper arm's line, also where the forearm droops
        z = float(np.median((pieces[:, 2] - dz * across)[inner]))
    if off_up > BENT_UP * H or off_ahead > BENT_AHEAD * H:
        raise Refusal(f"an elbow is bent: the arm is {max(off_up, off_ahead):.2f} m off a straight line")
    near = np.abs(arm[:, 0] - x - dx * (arm[:, 1] - CLEARANCE * H)) < PHANTOMS_FROM * H
    thickness = _thickness(arm[near], STEP * H, body.pitch)
    if len(thickness) and np.median(thickness[:, 1]) > THICKEST * H:
        raise Refusal(f"no arms: what sticks out sideways is {np.median(thickness[:, 1]):.2f} m thick")
    return Arm(float(np.arctan(dz)), float(np.arctan(dx)), _tip(arm, body), float(z), float(x), thickness)


def _pieces(arm: np.ndarray, step: float, phantoms_from: float) -> np.ndarray:
    """Middles (k, 3) of an arm's pieces, spine to tip: in height halfway between top and bottom, else medians."""
    middles = []
    for piece in _cut(arm, step):
        middle = np.median(piece, axis=0)
        near = piece[np.abs(piece[:, 0] - middle[0]) < phantoms_from, 2]
        middles.append((middle[0], middle[1], 0.5 * (near.min() + near.max()) if len(near) else middle[2]))
    return np.array(middles).reshape(-1, 3)


def _thickness(arm: np.ndarray, step: float, pitch: float) -> np.ndarray:
    """Distance from the spine and vertical thickness of an arm's pieces (k, 2), metres."""
    pieces = [(np.median(piece[:, 1]), np.ptp(piece[:, 2]) + pitch / 2) for piece in _cut(arm, step)]
    return np.array(pieces).reshape(-1, 2)


def _cut(arm: np.ndarray, step: float) -> list[np.ndarray]:
    """The pieces of an arm that hold enough voxels, spine to tip."""
    if len(arm) == 0:
        return []
    number = ((arm[:, 1] - arm[:, 1].min()) / step).astype(int)
    pieces = [arm[number == k] for k in range(number.max() + 1)]
    return [piece for piece in pieces if len(piece) >= FEWEST_OF_A_PIECE]
