"""What the silhouettes' rims say: rays that touch the body's surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..grid import Array

COLUMNS = 12  # of the table as the kernels fill it: point, direction, normal, half_length, sigma, part


@dataclass(frozen=True, eq=False)
class RimTable:
    """The n rim rays of one hull, by camera, then along its silhouette's outlines. Metres, map frame.

    A point on a silhouette's rim is the view of a ray that touches the body's surface somewhere without entering it.
    Where on the ray it touches is not known, only that it is where the ray grazes the hull.

    point_world : (n, 3) the middle of the longest stretch of the ray along the hull.
    direction : (n, 3) unit, along the ray, away from the camera.
    normal : (n, 3) unit, perpendicular to the ray, outward: the normal of the plane through the camera and the
        rim's tangent, and so of the body's surface where the ray touches it.
    half_length : (n,) half the length of that stretch, m.
    sigma : (n,) m, standard deviation of the ray's position along ``normal``, where the stretch is.
    camera : (n,) int32, the camera's place in the rig. part : (n,) int32, the part of the hull that the ray touches;
        see :class:`hull_server.slicing.bodies.Bodies`.
    """

    table: Array
    camera: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.table)

    @property
    def point_world(self) -> Array:
        return self.table[:, 0:3]

    @property
    def direction(self) -> Array:
        return self.table[:, 3:6]

    @property
    def normal(self) -> Array:
        return self.table[:, 6:9]

    @property
    def half_length(self) -> Array:
        return self.table[:, 9]

    @property
    def sigma(self) -> Array:
        return self.table[:, 10]

    @cached_property
    def part(self) -> npt.NDArray[np.int32]:
        return self.table[:, 11].astype(np.int32)


NO_RIMS = RimTable(np.zeros((0, COLUMNS)), np.zeros(0, np.int32))
