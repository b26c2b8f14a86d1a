"""The silhouettes' rims as the tracker takes them: rays that touch the body's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class ContourRays:
    """Rays (n) from the cameras that graze the body. World frame, metres.

    points_world (n, 3) : the middle of the stretch of the ray that touches the hull; half_lengths (n,) : half that
    stretch. directions (n, 3) : unit, away from the camera. normals (n, 3) : unit, across the ray and out of the
    silhouette: the body's surface normal where the ray touches it. sigma (n,) : standard deviation of the ray along
    its normal. bodies (n,) : number of the body it touches.
    """

    points_world: np.ndarray
    directions: np.ndarray
    normals: np.ndarray
    half_lengths: np.ndarray
    sigma: np.ndarray
    bodies: np.ndarray

    @staticmethod
    def of(table: np.ndarray) -> ContourRays:
        """The rays of a structured array (n,): x y z dx dy dz nx ny nz half sigma body."""

        def columns(*names: str) -> np.ndarray:
            return np.stack([table[name].astype(np.float64) for name in names], axis=1)

        half, sigma, bodies = (table[name].astype(np.float64) for name in ("half", "sigma", "body"))
        return ContourRays(
            columns("x", "y", "z"), columns("dx", "dy", "dz"), columns("nx", "ny", "nz"), half, sigma, bodies
        )

    def __len__(self) -> int:
        return len(self.sigma)

    def of_body(self, number: int) -> ContourRays:
        """The rays that touch one body."""
        return self._at(self.bodies == number)

    def thinned(self, count: int) -> ContourRays:
        """At most ``count`` rays, evenly spread over the rows (which follow the outlines); the same ones every time."""
        if len(self) <= count:
            return self
        return self._at(np.arange(count) * len(self) // count)

    def _at(self, rows: np.ndarray) -> ContourRays:
        parts = (self.points_world, self.directions, self.normals, self.half_lengths, self.sigma, self.bodies)
        return ContourRays(*(np.ascontiguousarray(part[rows]) for part in parts))


NO_CONTOUR_RAYS = ContourRays(
    np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0)
)
