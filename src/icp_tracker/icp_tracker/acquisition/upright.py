"""One body's voxels in a frame of its own: standing on a floor, the axis from hand to hand across.

Nothing here knows front from back: the frame's x axis is one of the two directions across the arms' axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.visibility import RigVisibility

from .truncation import HEAD, TYPICAL_STATURE_M, Stance, advice_text, cut_parts


class PoseRejected(Exception):
    """Raised inside a measurement as soon as it is clear that there is nothing to measure; ``reason`` says why."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def reasons_of_bodies(reasons: dict[int, str]) -> str:
    """Return one sentence for the reasons by which each body, by its number, was refused."""
    if len(reasons) == 1:
        return next(iter(reasons.values()))
    return "; ".join(f"body {number}: {reason}" for number, reason in sorted(reasons.items())) or "no hull"


FEWEST_VOXELS, FEWEST_OF_A_PART = 200, 8
TRIMMED = 0.2  # per cent of the voxels that may be stray at either end
FEET_LOST_M = 0.6  # a hull that ends no higher than at the knees may lack its feet
# Thresholds: measured by python bench/acquisition.py (how many are found).
SAGGING_M = 0.08  # cameras look down: a hull reaches this far below the soles
# heights over the stature between which a part of a standing body is looked for
HEAD_FROM, ARMS_FROM, TRUNK, SHINS, FEET_TO = 0.92, 0.45, (0.55, 0.75), (0.08, 0.20), 0.045
LEAN, HEAD_RADIUS = 0.13, 0.085  # over the stature: head off the feet; a head with what few cameras add to it
RAISED_HANDS_FROM = 0.3  # over the stature, from the spine: hands of arms a little above level
ONE_HEAD = 0.75  # share of the topmost voxels that are within that radius where there is one head


@dataclass(frozen=True, eq=False)
class Upright:
    """A standing body.

    local : (m, 3) voxels, x forward (or backward), y left, z up from the floor, metres, from the trunk's middle.
    centre_world (2,), forward_world (2,), floor_world : that frame, metres. stature, pitch : metres; pitch is the edge
    of a voxel.
    """

    local: np.ndarray
    centre_world: np.ndarray
    forward_world: np.ndarray
    floor_world: float
    stature: float
    pitch: float

    @property
    def height(self) -> np.ndarray:
        """(m,) heights over the stature."""
        return self.local[:, 2] / self.stature

    def between(self, low: float, high: float) -> np.ndarray:
        """Return (n, 3) the voxels between two heights over the stature."""
        return self.local[(self.height > low) & (self.height < high)]

    def turned_round(self) -> Upright:
        """Return the same body taken the other way round."""
        return replace(self, local=self.local * [-1.0, -1.0, 1.0], forward_world=-self.forward_world)


def measure_upright(
    voxels_world: np.ndarray, stature_low_m: float, stature_high_m: float, visibility: RigVisibility | None
) -> Upright:
    """Find floor, stature and the axis of the arms on hull voxels (m, 3) of one body, z up.

    Raises PoseRejected when the rig does not show all of it, or it is no single upright body.
    """
    pitch = pitch_of(voxels_world)
    reject_cut_off(voxels_world, pitch, visibility)
    low, high = np.percentile(voxels_world[:, 2], [TRIMMED, 100.0 - TRIMMED])
    low, high = low - pitch / 2, high + pitch / 2
    floor = _floor(low)
    stature = float(high - floor)
    if not stature_low_m <= stature <= stature_high_m:
        size = "small" if stature < stature_low_m else "large"
        raise PoseRejected(f"the hull is too {size}: {stature:.2f} m high")
    centre, axis = _arms_axis(voxels_world[:, :2], (voxels_world[:, 2] - floor) / stature)
    forward = np.array([axis[1], -axis[0]])
    flat = voxels_world[:, :2] - centre
    local = np.column_stack([flat @ forward, flat @ axis, voxels_world[:, 2] - floor])
    body = Upright(local, centre, forward, floor, stature, pitch)
    _refuse_several_heads(body)
    return body


def _floor(lowest: float) -> float:
    """Return the floor's height, world, metres: the map's floor where the hull sags below it."""
    return 0.0 if -SAGGING_M < lowest < 0.0 else float(lowest)


def pitch_of(voxels_world: np.ndarray) -> float:
    """Edge of a voxel, metres: the least distance of two layers."""
    layers = np.unique(np.round(voxels_world[:, 2], 4))
    return float(np.diff(layers).min()) if len(layers) > 1 else 0.0


def reject_cut_off(voxels_world: np.ndarray, pitch: float, visibility: RigVisibility | None) -> None:
    """Raises PoseRejected, with what to do, when some part of the body is where the rig does not show it."""
    if visibility is None:
        return
    stance = stance_of(voxels_world, pitch)
    parts = cut_parts(voxels_world, stance, pitch, visibility)
    if HEAD in parts:
        stance = replace(stance, stature=max(stance.stature, TYPICAL_STATURE_M))
    if parts:
        raise PoseRejected(advice_text(parts, stance, visibility))


def stance_of(voxels_world: np.ndarray, pitch: float) -> Stance:
    """Return about where a body stands, whatever its hull lacks: on the map's floor unless it is far above.

    The crown is over the body's middle: what is farther off and higher is a raised hand.
    """
    floor = _floor(np.percentile(voxels_world[:, 2], TRIMMED) - pitch / 2)
    floor = 0.0 if floor < FEET_LOST_M else floor
    place = np.median(voxels_world[:, :2], axis=0)
    column = np.linalg.norm(voxels_world[:, :2] - place, axis=1) < LEAN * TYPICAL_STATURE_M
    high = np.percentile(voxels_world[column if column.any() else slice(None), 2], 100.0 - TRIMMED)
    stature = max(float(high) + pitch / 2 - floor, 0.5 * TYPICAL_STATURE_M)
    axis = np.linalg.eigh(np.cov((voxels_world[:, :2] - place).T))[1][:, -1]
    return Stance(place, np.array([axis[1], -axis[0]]), floor, stature)


def _arms_axis(flat: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of the trunk (2,) and the longest horizontal direction (2,) of the upper body."""
    trunk = flat[(height > TRUNK[0]) & (height < TRUNK[1])]
    if len(trunk) < FEWEST_OF_A_PART:
        raise PoseRejected("no trunk in the hull")
    centre = np.median(trunk, axis=0)
    return centre, np.linalg.eigh(np.cov((flat[height > ARMS_FROM] - centre).T))[1][:, -1]


def _refuse_several_heads(body: Upright) -> None:
    head = body.between(HEAD_FROM, 2.0)[:, :2]
    head = head[np.linalg.norm(head, axis=1) < RAISED_HANDS_FROM * body.stature]
    if len(head) < FEWEST_OF_A_PART:
        raise PoseRejected("no head above the trunk")
    near = np.linalg.norm(head - np.median(head, axis=0), axis=1) < HEAD_RADIUS * body.stature
    if np.mean(near) < ONE_HEAD:
        raise PoseRejected("no single head at the top: more than one body, or hands beside the head?")


def reject_leaning(body: Upright) -> None:
    """Raises PoseRejected unless the head is above the feet."""
    feet = body.between(*SHINS)[:, :2]
    if len(feet) < FEWEST_OF_A_PART:
        raise PoseRejected("no feet in the hull")
    middle = np.percentile(feet, [5, 95], axis=0).mean(axis=0)  # halfway between the ends, stray points apart
    lean = float(np.linalg.norm(np.median(body.between(HEAD_FROM, 2.0)[:, :2], axis=0) - middle))
    if lean > LEAN * body.stature:
        raise PoseRejected(f"not upright: the head is {lean:.2f} m off the feet")
