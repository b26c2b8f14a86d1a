"""How much is known of a camera: nothing, its lens, or its lens and its place in the room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rig import Volume


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of the camera ``name``.

    ``camera`` is None while the lens is unknown: silhouettes cannot be undistorted then. ``volume`` is the rig's
    capture volume, metres, map frame; it is None while the camera's place is unknown, and ``camera``'s pose then means
    nothing.
    """

    name: str
    camera: CameraModel | None = None
    volume: Volume | None = None

    @property
    def placed(self) -> bool:
        """Is the camera's place in the room known?"""
        return self.volume is not None


def unplaced_camera(name: str, width: int, height: int) -> CameraModel:
    """A camera of which only name and image size, px, are known, to be given its intrinsics."""
    return CameraModel(name, width, height, np.eye(3), "plumb_bob", np.zeros(5), np.eye(4))
