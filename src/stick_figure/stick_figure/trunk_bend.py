"""The trunk as one bends it: hips that turn and shoulders that move against the line from hips to neck.

The stick figure's torso is rigid; a person's is not. A pelvis turns and tilts against the chest, collar bones carry the
shoulder joints up and down, forward and back, and a back grows round. With the line from the middle of the hips to the
neck as the torso's axis, what is left of that in figure and surface are seven numbers (`BEND`): turn and tilt of the
line between the hips, each shoulder's place ahead and up, and the spine's flexion: by how much the pelvis is tilted
back against that line, as far as it is. A body holds them (`Body.bend`), zero in its rest. Starts of arms and thighs
move with them, and the trunk's surface; all to first order.

How far they go: chest against pelvis turns by 7 degrees to either side in walking and 35 at most, and leans by 5 and
25 (White & Panjabi, Clinical Biomechanics of the Spine); half of it is between the hips and the line to the neck. A
collar bone of 15 cm rises by 30 degrees with the arm (Inman, Saunders & Abbott 1944) and moves forward and back by 15.
From standing to a full bow the lumbar spine flexes by 50 to 60 degrees (White & Panjabi), half of it at either end of
the line; its joints lie some 5 cm behind the line, which flexion so makes shorter, and the trunk between the line's
ends goes back as an arc of that curvature does.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .body import BEND_NUMBERS, Body
from .body_surface import BodySurface
from .build import PARTS
from .skeleton import HEAD, L_THIGH, L_UPPER_ARM, R_THIGH, R_UPPER_ARM, TORSO

PELVIS_YAW, PELVIS_ROLL, LEFT_X, LEFT_Z, RIGHT_X, RIGHT_Z, FLEXION = range(BEND_NUMBERS)
# Thresholds: ranges of spine and collar bone (White & Panjabi; Inman et al. 1944), of three sizes the one that was
# best on the mesh_fit_ sets; rays from the cells of a body's surface; measured by python bench/people.py --ablation
# SESSION.
REST_SD = np.array([0.15, 0.12, 0.03, 0.04, 0.03, 0.04, 0.15])
"""How far they are from rest in daily movement: rad, rad, then m."""
RATE_SD = np.array([0.8, 0.65, 0.16, 0.2, 0.16, 0.2, 0.8])
"""How far they move in a second, as a random walk: rad and m over the square root of a second."""
WITH_THE_CHEST = 0.5
"""Share of the shoulders' movement that the chest between them takes part in; the rest is the collar bones'."""
SHORTER, SHOULDERS_BACK, UPPER_BACK, LOWER_BACK = 0.13, 0.09, 0.2, 0.1
"""Of the torso's length, for each rad of flexion: what the line from hips to neck loses, and how far shoulders and the
trunk's capsules go back. Of an arc whose chest turns 0.6 rad for each rad of the pelvis: .09 at the shoulders, .18 and
.08 of the line nearest to it; seen in 20 rendered people in the clips of the `mesh_fit_` sets: .09, .24 and .14; of the
line .13 (correlation .94)."""
_PART_OF_CAPSULE = tuple(part for part, own in PARTS.items() for _ in own)


@lru_cache(maxsize=8)
def bend_derivatives(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how starts of sticks (10, 3), starts and ends of the capsules (k, 3 each), m, torso frame, follow from
    the bend: (10, 3, 7), (k, 3, 7), (k, 3, 7); zero but for what is fixed to the torso."""
    surface, hip, half = BodySurface.of(body), body.hip_width_ratio * body.half_shoulder_width, body.half_shoulder_width
    origins = np.zeros((10, 3, BEND_NUMBERS))
    starts, ends = (np.zeros((len(surface.stick), 3, BEND_NUMBERS)) for _ in range(2))
    origins[L_UPPER_ARM, 0, LEFT_X] = origins[L_UPPER_ARM, 2, LEFT_Z] = 1.0
    origins[R_UPPER_ARM, 0, RIGHT_X] = origins[R_UPPER_ARM, 2, RIGHT_Z] = 1.0
    for stick, y in ((L_THIGH, hip), (R_THIGH, -hip)):
        origins[stick] = _with_pelvis(y)
    length = body.lengths[TORSO]
    chest, hips = -0.5 * SHORTER * length, 0.5 * SHORTER * length
    origins[[HEAD, L_UPPER_ARM, R_UPPER_ARM], 2, FLEXION] = chest
    origins[[L_THIGH, R_THIGH], 2, FLEXION] = hips
    origins[[L_UPPER_ARM, R_UPPER_ARM], 0, FLEXION] = -SHOULDERS_BACK * length
    for k, part in enumerate(_PART_OF_CAPSULE):
        if part in ("side", "spine"):
            starts[k, [0, 2], FLEXION] = -UPPER_BACK * length, chest
            ends[k, [0, 2], FLEXION] = -LOWER_BACK * length, hips
        elif part == "girdle":
            starts[k, [0, 2], FLEXION] = ends[k, [0, 2], FLEXION] = -SHOULDERS_BACK * length, chest
        if part == "side":
            starts[k] += WITH_THE_CHEST * _with_shoulders(surface.start[k, 1] / half)
            ends[k] += _with_pelvis(surface.end[k, 1])
        elif part == "girdle":
            ends[k] += _with_shoulders(surface.end[k, 1] / half)
    return origins, starts, ends


def _with_pelvis(y: float) -> np.ndarray:
    """(3, 7) of a point at y to the left between the hips."""
    moved = np.zeros((3, BEND_NUMBERS))
    moved[0, PELVIS_YAW], moved[2, PELVIS_ROLL] = -y, y
    return moved


def _with_shoulders(share: float) -> np.ndarray:
    """(3, 7) of a point so far out towards the left shoulder, -1 at the right one."""
    moved = np.zeros((3, BEND_NUMBERS))
    left, right = (share, 0.0) if share > 0.0 else (0.0, -share)
    moved[0, [LEFT_X, RIGHT_X]] = left, right
    moved[2, [LEFT_Z, RIGHT_Z]] = left, right
    return moved


@lru_cache(maxsize=8)
def bend_columns(body: Body) -> np.ndarray:
    """Return how neck, shoulders and hips (5, 3, 13) move in the torso's frame with its translation (3) and rotation
    (3), and with the bend (7)."""
    base, columns = body.torso_points[1:], np.zeros((5, 3, 6 + BEND_NUMBERS))
    columns[:, :, :3] = np.eye(3)
    for axis in range(3):
        columns[:, :, 3 + axis] = np.cross(np.eye(3)[axis], base)
    columns[:, :, 6:] = bend_derivatives(body)[0][1:6]
    return columns
