"""The joints of HumanEva's ground truth (Sigal, Balan & Black 2010) from motion capture, at fractional mocap frames.

These are the points of the authors' 3D error measure. Rotations there are written with a matrix that turns z towards
-x for a positive angle; here every turned stick is written out as its direction instead.

A segment NAME of Vicon's body model has an origin NAMEO and a point on each axis: NAMEA on x, NAMEL on y, NAMEP on z.
Between two mocap frames its origin moves on a straight line and its axes on the shortest turn (slerp), as in the
authors' code.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.rigid import nearest_rotation

from .formats import COPY_AGAIN, Instants, Mocap, between, read_mp

SQUARE_TOLERANCE = 0.02
"""How far from square three axis points may stand, as the sine of an angle, before the frame counts as damaged."""


@dataclass(frozen=True, eq=False)
class SegmentFrames:
    """Origin (F, 3) mm and rotation R_world_segment (F, 3, 3) of a segment; ``known`` (F,) : frames with both."""

    origin_mm: np.ndarray
    R_world_segment: np.ndarray
    known: np.ndarray

    def at(self, *local_mm: np.ndarray | float) -> np.ndarray:
        """World points (F, 3), mm, of local coordinates x, y, z, each (F,) or one number."""
        local = np.stack(np.broadcast_arrays(*local_mm, self.known)[:3], axis=-1)
        return self.origin_mm + np.einsum("fij,fj->fi", self.R_world_segment, local)


def segment(mocap: Mocap, at: Instants, name: str, origin: str = "") -> SegmentFrames:
    """Return the frame of segment ``name``; its origin is the point labelled ``origin`` where that is given."""
    tracks = [mocap.track_mm(name + letter) for letter in "OALP"]
    centre = mocap.track_mm(origin) if origin else tracks[0]
    (R_lower, square_lower), (R_upper, square_upper) = (_axes(*(t[r] for t in tracks)) for r in (at.lower, at.upper))
    seen = np.isfinite([between(track, at) for track in (*tracks, centre)]).all(axis=(0, 2))
    start = Rotation.from_matrix(R_lower)
    turn = (start.inv() * Rotation.from_matrix(R_upper)).as_rotvec()
    R = (start * Rotation.from_rotvec(at.fraction[:, None] * turn)).as_matrix()
    return SegmentFrames(between(centre, at), R, seen & square_lower & square_upper)


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
    return nearest_rotation(axes), square


_LABELS = """
RASI, LASI, RPSI, LPSI, C7, T10, RBAK, STRN, CLAV, LSHO, RSHO, LUPA, RUPA, LELB, RELB, LFRM LFRA,
RFRM RFRA, LWRA, RWRA, LWRB, RWRB, LFIN, RFIN, LTHI, RTHI, LKNE, RKNE, LTIB, RTIB, LANK, RANK, LHEE,
RHEE, LTOE, RTOE, LFHD, RFHD, LBHD, RBHD
"""
MARKERS = tuple(" ".join(_LABELS.split()).split(", "))
"""The 39 markers on the body, two of them with two names; a frame without any of them is not used."""
PELVIS_SHIFT_MM = -50.0
HEAD_MM = 316.103
"""From the thorax's origin to the top of the head: one constant for all subjects."""
MARKER_RADIUS_MM = 7.0
MEASURES = ("LShoulderOffset", "RShoulderOffset")


def markers_mm(mocap: Mocap) -> list[np.ndarray]:
    """The tracks (T, 3), mm, of the 39 markers; NaN where one was not seen. Raises InputError for a missing one."""
    return [mocap.track_mm(*names.split()) for names in MARKERS]


def measures(static: Mocap, mp: Path) -> tuple[float, dict[str, float]]:
    """Return a subject's sizes, mm, from the trial in which it stands still and from its ``.mp`` file: radius of the
    chest, and each shoulder's offset."""
    widths_mm = np.linalg.norm(static.track_mm("LSHO") - static.track_mm("RSHO"), axis=1)
    if np.isnan(widths_mm).all():
        what = "both shoulder markers (LSHO, RSHO) are never seen together"
        raise InputError(what, where=str(static.path), remedy=COPY_AGAIN)
    offset = read_mp(mp, MEASURES)
    return float(np.nanmean(widths_mm)) / 2 - MARKER_RADIUS_MM, {name[0]: offset[name] for name in MEASURES}


def joints(
    mocap: Mocap, positions: np.ndarray, chest_radius_mm: float, shoulder_offset_mm: dict[str, float]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the joints at 1-based mocap positions (F,) of a subject of these sizes: points by name, each (F, 3) mm,
    Vicon's world; and where the motion capture is complete (F,)."""
    at = Instants.of(positions, len(mocap.points_mm))
    points, used = _trunk(mocap, at, chest_radius_mm)
    for side in "LR":
        for limb, segments in (_leg(mocap, at, side), _arm(mocap, at, side, shoulder_offset_mm[side])):
            points |= {side + name: point for name, point in limb.items()}
            used += segments
    seen = np.isfinite([between(track, at) for track in markers_mm(mocap)]).all(axis=(0, 2))
    return points, np.all([at.inside, seen, *(s.known for s in used)], axis=0)


def _trunk(mocap: Mocap, at: Instants, chest_radius_mm: float) -> tuple[dict[str, np.ndarray], list[SegmentFrames]]:
    pelvis, head = segment(mocap, at, "PEL"), segment(mocap, at, "HED", origin="TRXO")
    thorax_mm = between(mocap.track_mm("TRXO"), at)
    torso_mm = mean_distance_mm(mocap.track_mm("TRXO"), mocap.track_mm("PELO"), at)
    # the torso's axis starts 50 mm behind the pelvis's origin and leans back by half the chest's radius
    lean = np.arctan2(chest_radius_mm / 2, torso_mm)
    top_mm = pelvis.at(PELVIS_SHIFT_MM - torso_mm * np.sin(lean), 0.0, torso_mm * np.cos(lean))
    points = {
        "Pelvis": pelvis.at(PELVIS_SHIFT_MM, 0.0, 0.0),
        "Neck": (top_mm + thorax_mm) / 2,
        "Head": head.at(0.0, 0.0, HEAD_MM),
    }
    return points, [pelvis, head]


def _leg(mocap: Mocap, at: Instants, side: str) -> tuple[dict[str, np.ndarray], list[SegmentFrames]]:
    hip, knee, ankle = (mocap.track_mm(side + label) for label in ("FEP", "FEO", "TIO"))
    thigh = segment(mocap, at, f"{side}FE", origin=f"{side}FEP")
    calf = segment(mocap, at, f"{side}TI", origin=f"{side}FEO")
    thigh_end = thigh.at(0.0, 0.0, -mean_distance_mm(hip, knee, at))
    points = {
        "Hip": thigh.origin_mm,
        "Knee": (thigh_end + calf.origin_mm) / 2,
        "Ankle": calf.at(0.0, 0.0, -mean_distance_mm(knee, ankle, at)),
    }
    return points, [thigh, calf]


def _arm(
    mocap: Mocap, at: Instants, side: str, shoulder_offset_mm: float
) -> tuple[dict[str, np.ndarray], list[SegmentFrames]]:
    shoulder, elbow, wrist = (mocap.track_mm(side + label) for label in ("CLO", "HUO", "RAO"))
    upper = segment(mocap, at, f"{side}HU", origin=f"{side}CLO")
    fore = segment(mocap, at, f"{side}RA", origin=f"{side}HUO")
    upper_mm, fore_mm = mean_distance_mm(shoulder, elbow, at), mean_distance_mm(elbow, wrist, at)
    # the upper arm is turned back about the shoulder by half its offset, the forearm goes along and is turned forward
    turn = np.arctan2(shoulder_offset_mm / 2, upper_mm)
    upper_end = upper.at(-upper_mm * np.sin(turn), 0.0, -upper_mm * np.cos(turn))
    moved = upper_end - upper.at(0.0, 0.0, -upper_mm)
    points = {
        "Shoulder": upper.origin_mm,
        "Elbow": (upper_end + fore.origin_mm + moved) / 2,
        "Wrist": moved + fore.at(fore_mm * np.sin(turn), 0.0, -fore_mm * np.cos(turn)),
    }
    return points, [upper, fore]
