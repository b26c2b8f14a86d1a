"""A calibrated rig in figures: each camera's, and how the cameras stand together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.lens import Array

from ..bundle.solve import RigSolution
from .floor import FloorView
from .world import PlacedRig, centre_of


@dataclass(frozen=True)
class CameraFigures:
    """Figures of one camera.

    rms_px : of the corners' coordinates in the solution. detections : how many went into it. distance_m : from the
    volume's centre. height_m : of the lens above the floor. mm_per_px : what a pixel covers at the volume's centre.
    floor_angle_deg : at which it sees the floor board, from the board's normal; None when it does not see it.
    sd_centre_mm, sd_rotation_deg : standard deviation, in the worst direction.
    """

    name: str
    rms_px: float
    detections: int
    distance_m: float
    height_m: float
    mm_per_px: float
    floor_angle_deg: float | None
    sd_centre_mm: float
    sd_rotation_deg: float


@dataclass(frozen=True)
class RigFigures:
    """Figures of the whole rig.

    rms_px : over all cameras' coordinates. gaps_deg : by pair of neighbours in azimuth around the volume's centre.
    facing_deg : by pair of cameras, the angle between the directions in which they see the volume's centre (180: they
    look at each other). volume_m3, floor_m2 : as in CommonVolume.
    """

    cameras: tuple[CameraFigures, ...]
    rms_px: float
    gaps_deg: Mapping[tuple[str, str], float]
    facing_deg: Mapping[tuple[str, str], float]
    volume_m3: float
    floor_m2: tuple[float, ...]

    def camera(self, name: str) -> CameraFigures:
        """Return the figures of the camera called ``name``."""
        return next(camera for camera in self.cameras if camera.name == name)


def rig_figures(placed: PlacedRig, solution: RigSolution, floor: Mapping[str, FloorView]) -> RigFigures:
    """Compute all figures of the rig; ``floor`` for those that see the floor board."""
    centre, cameras = centre_of(placed.rig.volume), placed.rig.cameras
    counts = Counter(detection.camera for detection in solution.detections)
    weights = np.array([counts[camera.name] for camera in cameras], float)
    squares = np.array([solution.rms_px[camera.name] ** 2 for camera in cameras])
    return RigFigures(
        cameras=tuple(_camera_figures(c, centre, solution, counts[c.name], floor.get(c.name)) for c in cameras),
        rms_px=float(np.sqrt(np.average(squares, weights=weights))),
        gaps_deg=_gaps_deg(cameras, centre),
        facing_deg=_facing_deg(cameras, centre),
        volume_m3=placed.common.volume_m3,
        floor_m2=placed.common.floor_m2,
    )


def _camera_figures(
    camera: CameraModel, centre: Array, solution: RigSolution, detections: int, floor: FloorView | None
) -> CameraFigures:
    distance = float(np.linalg.norm(camera.centre_world - centre))
    sd_rotation, sd_centre = (
        _worst_sd(solution.covariance[camera.name][part, part]) for part in (slice(0, 3), slice(3, 6))
    )
    return CameraFigures(
        name=camera.name,
        rms_px=solution.rms_px[camera.name],
        detections=detections,
        distance_m=distance,
        height_m=float(camera.centre_world[2]),
        mm_per_px=1e3 * distance / float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])),
        floor_angle_deg=None if floor is None else float(np.rad2deg(floor.angle)),
        sd_centre_mm=1e3 * sd_centre,
        sd_rotation_deg=float(np.rad2deg(sd_rotation)),
    )


def _worst_sd(covariance: Array) -> float:
    """Standard deviation in the direction in which it is largest."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def _gaps_deg(cameras: Sequence[CameraModel], centre: Array) -> dict[tuple[str, str], float]:
    """Angles, deg, between neighbours around the centre; without those that look down steeply (no azimuth)."""
    offsets = {c.name: c.centre_world - centre for c in cameras}
    around = {name: np.arctan2(y, x) for name, (x, y, z) in offsets.items() if np.hypot(x, y) > abs(z) / 2}
    order = sorted(around, key=lambda name: (around[name], name))
    if len(order) < 2:
        return {}
    gaps = {
        (a, b): float(np.rad2deg((around[b] - around[a]) % (2 * np.pi)))
        for a, b in zip(order, order[1:] + order[:1], strict=True)
    }
    return gaps if len(order) > 2 else dict([min(gaps.items(), key=lambda item: item[1])])


def _facing_deg(cameras: Sequence[CameraModel], centre: Array) -> dict[tuple[str, str], float]:
    sight = {c.name: (centre - c.centre_world) / np.linalg.norm(centre - c.centre_world) for c in cameras}
    return {
        (a, b): float(np.rad2deg(np.arccos(np.clip(sight[a] @ sight[b], -1.0, 1.0))))
        for a, b in combinations(sorted(sight), 2)
    }
