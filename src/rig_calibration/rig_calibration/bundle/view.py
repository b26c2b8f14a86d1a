"""A sighting and what it tells by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from capture_rig.camera import CameraModel

from ..boards.sighting import Sighting
from .rigid import Array
from .sighting_poses import SightingPoses, all_undistorted, poses_of
from .target_shape import LINE, TargetShape
from .view_graph import Key


@dataclass(frozen=True, eq=False)
class View:
    """A sighting, its corners without distortion (n, 2), and the poses of the target that it alone allows (None: it
    allows no conclusion by itself)."""

    sighting: Sighting
    shape: TargetShape
    ideal: Array
    poses: SightingPoses | None

    @property
    def key(self) -> Key:
        return self.sighting.target, self.sighting.moment

    @property
    def links(self) -> bool:
        """Can it tie its camera to others? A wand does so together with other moments, a board by its pose."""
        return self.poses is not None or self.shape.dimension == LINE


def views_of(
    sightings: Sequence[Sighting], cameras: Mapping[str, CameraModel], shapes: Mapping[str, TargetShape]
) -> list[View]:
    """The views of all sightings, in their order."""
    views = []
    for sighting, ideal in zip(sightings, all_undistorted(sightings, cameras), strict=True):
        shape = shapes[sighting.target]
        views.append(View(sighting, shape, ideal, poses_of(sighting.ids, ideal, cameras[sighting.camera], shape)))
    return views
