"""Tables of a rig's calibration: where each pixel's ray meets the floor, and what each mask level means there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig import Volume
from capture_rig.kernel import kernel
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, STEPS_OF_CANDIDATE, UNCERTAIN

from ..silhouette_batch import BLIND
from ..views import RigViews

UNSEEN, EMPTY, CANDIDATE, ATTENUATED, SURE = 0, 1, 2, 3, 4  # kinds of levels

Array = npt.NDArray[np.float64]


class FloorScene(NamedTuple):
    """Tables of the calibration.

    P (N, 3, 4), metres to pixels; centres (N, 3) of the cameras, metres; epipoles (N, N, 3): [j, i] is camera i's
    centre in camera j, homogeneous pixels; floor (N, 3, 3): pixels to (x, y, 1) on z = 0; low, high (3,) the volume,
    metres; kind (256,) of each level: UNSEEN, EMPTY, CANDIDATE, ATTENUATED or SURE; attenuation (256, 2): the least and
    greatest attenuation step that each level may stand for; whole (N, 4): left, top, right, bottom of a box of pixels
    all of which the camera sees.
    """

    P: Array
    centres: Array
    epipoles: Array
    floor: Array
    low: Array
    high: Array
    kind: npt.NDArray[np.int8]
    attenuation: npt.NDArray[np.int8]
    whole: npt.NDArray[np.int64]


def floor_scene(views: RigViews, volume: Volume) -> FloorScene:
    """Compute the tables of a rig's calibration."""
    centres = np.stack([-np.linalg.solve(P[:, :3], P[:, 3]) for P in views.P])
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    floor = [
        np.linalg.inv(P[:, [0, 1, 3]]) if abs(c[2]) > 1e-6 else np.full((3, 3), np.nan)
        for P, c in zip(views.P, centres, strict=True)
    ]
    kind = np.full(256, SURE, np.int8)
    kind[0], kind[BLIND], kind[UNCERTAIN] = EMPTY, UNSEEN, UNSEEN
    kind[list(CANDIDATE_LEVELS)], kind[list(ATTENUATED_LEVELS)] = CANDIDATE, ATTENUATED
    attenuation = np.zeros((256, 2), np.int8)
    attenuation[list(ATTENUATED_LEVELS)] = np.arange(len(ATTENUATED_LEVELS))[:, None]
    attenuation[list(CANDIDATE_LEVELS)] = STEPS_OF_CANDIDATE
    return FloorScene(
        P=np.ascontiguousarray(views.P),
        centres=centres,
        epipoles=np.einsum("jab,ib->jia", views.P, homogeneous),
        floor=np.stack(floor),
        low=np.array(volume.low, float),
        high=np.array(volume.high, float),
        kind=kind,
        attenuation=attenuation,
        whole=np.array([_whole_box(seen > 0) for seen in views.seen]),
    )


def _whole_box(seen: npt.NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return a box inside what a canvas (H, W) sees: its sides move inwards, the worst first, until all is seen."""
    left, top, right, bottom = 0, 0, seen.shape[1], seen.shape[0]
    while right > left and bottom > top:
        part = seen[top:bottom, left:right]
        blind = [1.0 - side.mean() for side in (part[:, 0], part[0], part[:, -1], part[-1])]
        worst = int(np.argmax(blind))
        if blind[worst] == 0.0:
            break
        left, top = left + (worst == 0), top + (worst == 1)
        right, bottom = right - (worst == 2), bottom - (worst == 3)
    return left, top, right, bottom


@kernel
def level_of(levels, x, y, depth):
    """Return the level (H, W) of a homogeneous pixel; BLIND behind the camera and outside its canvas."""
    if depth <= 0.0:
        return BLIND
    per_depth = 1.0 / depth
    u, v = math.floor(x * per_depth + 0.5), math.floor(y * per_depth + 0.5)
    if not (0.0 <= u < levels.shape[1] and 0.0 <= v < levels.shape[0]):
        return BLIND
    return int(levels[np.uint64(v), np.uint64(u)])
