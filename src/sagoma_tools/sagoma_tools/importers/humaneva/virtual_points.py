"""Segment frames from the points that Vicon's body model adds to a ``.c3d``, at fractional mocap frames.

A segment NAME has an origin NAMEO and a point on each axis: NAMEA on x, NAMEL on y, NAMEP on z. Between two mocap
frames its origin moves on a straight line and its axes on the shortest turn (slerp), as in the authors' code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .c3d_file import Mocap

SQUARE_TOLERANCE = 0.02
"""How far from square three axis points may stand, as the sine of an angle, before the frame counts as damaged."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Fractional mocap frames: rows ``lower`` and ``upper`` (F,) of a file and the ``fraction`` (F,) between them.

    ``inside`` (F,) is False where the file does not reach; its rows are then clipped.
    """

    lower: np.ndarray
    upper: np.ndarray
    fraction: np.ndarray
    inside: np.ndarray

    @classmethod
    def of(cls, positions: np.ndarray, count: int) -> Instants:
        """Of 1-based positions (F,) in a file of ``count`` mocap frames."""
        lower, upper = np.floor(positions).astype(int) - 1, np.ceil(positions).astype(int) - 1
        inside = (lower >= 0) & (upper < count)
        last = count - 1
        return cls(lower.clip(0, last), upper.clip(0, last), positions - np.floor(positions), inside)


@dataclass(frozen=True, eq=False)
class Segment:
    """Origin (F, 3) mm and rotation R_world_segment (F, 3, 3) of a segment; ``known`` (F,) says where both are."""

    origin_mm: np.ndarray
    R_world_segment: np.ndarray
    known: np.ndarray

    def at(self, *local_mm: np.ndarray | float) -> np.ndarray:
        """World points (F, 3), mm, of local coordinates x, y, z, each (F,) or one number."""
        local = np.stack(np.broadcast_arrays(*local_mm, self.known)[:3], axis=-1)
        return self.origin_mm + np.einsum("fij,fj->fi", self.R_world_segment, local)


def segment(mocap: Mocap, at: Instants, name: str, origin: str = "") -> Segment:
    """The frame of segment ``name``, with its origin at the point labelled ``origin`` instead when that is given."""
    tracks = [mocap.track_mm(name + letter) for letter in "OALP"]
    centre = mocap.track_mm(origin) if origin else tracks[0]
    (R_lower, square_lower), (R_upper, square_upper) = (_axes(*(t[r] for t in tracks)) for r in (at.lower, at.upper))
    seen = np.all([present(track, at) for track in (*tracks, centre)], axis=0)
    start = Rotation.from_matrix(R_lower)
    turn = (start.inv() * Rotation.from_matrix(R_upper)).as_rotvec()
    R = (start * Rotation.from_rotvec(at.fraction[:, None] * turn)).as_matrix()
    return Segment(between(centre, at), R, seen & square_lower & square_upper)


def between(track_mm: np.ndarray, at: Instants) -> np.ndarray:
    """A track (T, 3) at instants (F,): (F, 3), on the straight line between its neighbours."""
    fraction = at.fraction[:, None]
    return (1 - fraction) * track_mm[at.lower] + fraction * track_mm[at.upper]


def present(track_mm: np.ndarray, at: Instants) -> np.ndarray:
    """(F,) whether a track (T, 3) was seen in both mocap frames around each instant: it is not (0, 0, 0) there."""
    seen = (track_mm != 0).any(axis=1)
    return seen[at.lower] & seen[at.upper]


def mean_distance_mm(a_mm: np.ndarray, b_mm: np.ndarray, at: Instants) -> np.ndarray:
    """(F,) distance of two tracks (T, 3), averaged over the two mocap frames around each instant."""
    distance = np.linalg.norm(a_mm - b_mm, axis=1)
    return (distance[at.lower] + distance[at.upper]) / 2


def _axes(origin: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (F, 3, 3) nearest to the axes that the points (F, 3) span, and whether those were square (F,)."""
    axes = np.stack([x - origin, y - origin, z - origin], axis=-1)
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    axes = np.where(length > 0, axes / np.where(length > 0, length, 1.0), np.eye(3))
    gram = np.einsum("fki,fkj->fij", axes, axes)
    square = (np.abs(gram - np.eye(3)).max(axis=(1, 2)) < SQUARE_TOLERANCE) & (np.linalg.det(axes) > 0)
    axes[~square] = np.eye(3)
    U, _, Vt = np.linalg.svd(axes)
    return U @ Vt, square
