"""Views of the rig's cameras, and the rule and interface of all carving backends.

A camera *sees* a voxel when the voxel's centre lies in front of it and projects to a pixel, floor(x + 0.5), that is
inside the canvas and inside the original image (``seen``). Each camera's pixel there is evidence: foreground counts 1,
unseen and uncertain pixels count 0, and background counts minus infinity: it vetoes.
A voxel is occupied when the sum is at least ``min_seeing``. So with certain masks every camera that sees it must have
foreground there, and enough must see it (thesis 3.1 assumes that every camera sees the whole volume, which is not so
in real rigs). In a mask 0 is background, above 127 foreground, 2 to 127 uncertain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from capture_rig import InputError, Rig, Volume
from capture_rig.rig import MAX_CAMERAS
from capture_rig.visibility import min_seeing as min_seeing

from .grid import BrickVolume

Masks = Mapping[str, npt.NDArray[np.uint8]]
Box = tuple[int, int, int, int]
"""Left, top, right and bottom (exclusive), in pixels."""
Boxes = Mapping[str, Box]

MAX_CANVAS_PX = 32767


@dataclass(frozen=True, eq=False)
class RigViews:
    """The undistorted views of all cameras, in name order, on canvases padded to one common size.

    P : (N, 3, 4) projections of map points, metres, to canvas pixels.
    sizes : (N, 2) width and height of each camera's own canvas, pixels.
    seen : (N, H, W) uint8, 255 where the camera sees, 0 where it is blind or beyond its own canvas. W is a multiple
        of 32.
    """

    names: tuple[str, ...]
    P: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.int64]
    seen: npt.NDArray[np.uint8]

    @cached_property
    def number(self) -> dict[str, int]:
        """The index of each camera in all arrays."""
        return {name: index for index, name in enumerate(self.names)}

    @classmethod
    def from_rig(cls, rig: Rig) -> RigViews:
        """Compute the views of all cameras; InputError when the rig has too few or too many cameras, or an oversized
        canvas."""
        if not 2 <= len(rig.cameras) <= MAX_CAMERAS:
            raise InputError(
                f"the rig has {len(rig.cameras)} camera(s); a visual hull needs 2 to {MAX_CAMERAS}",
                remedy="Add the missing cameras to the rig file.",
            )
        views = [camera.undistorted_view() for camera in rig.cameras]
        sizes = np.array([(view.camera.width, view.camera.height) for view in views], np.int64)
        width, height = -(-int(sizes[:, 0].max()) // 32) * 32, int(sizes[:, 1].max())
        if max(width, height) > MAX_CANVAS_PX:
            raise InputError(
                f"an undistorted image of {width} x {height} pixels is too large",
                remedy=f"At most {MAX_CANVAS_PX} pixels a side: scale the images down.",
            )
        seen = np.zeros((len(views), height, width), np.uint8)
        for index, view in enumerate(views):
            seen[index, : view.camera.height, : view.camera.width] = np.where(view.seen, 255, 0)
        return cls(rig.names, np.stack([view.camera.P for view in views]), sizes, seen)

    @cached_property
    def focal_px(self) -> npt.NDArray[np.float64]:
        """The focal lengths (N,): the part of a projection's first row across the optical axis."""
        return np.linalg.norm(np.cross(self.P[:, 0, :3], self.P[:, 2, :3]), axis=1)

    def px_per_m(self, volume: Volume) -> npt.NDArray[np.float64]:
        """Return the scales (N,) in the middle of a volume, at least half a metre away."""
        middle = np.append((volume.low + volume.high) / 2, 1.0)
        return self.focal_px / np.maximum(self.P[:, 2] @ middle, 0.5)

    def present(self, masks: Masks) -> npt.NDArray[np.int64]:
        """Return the indices (n,) of the cameras that ``masks`` holds, ascending.

        Raises InputError for a camera that is not in the rig, or a mask that is not (h, w) uint8 of its canvas.
        """
        for name, mask in masks.items():
            if name not in self.number:
                raise InputError(f"there is no camera '{name}' in the rig", remedy=f"Known: {', '.join(self.names)}.")
            width, height = self.sizes[self.number[name]].tolist()
            if mask.shape != (height, width) or mask.dtype != np.uint8:
                raise InputError(
                    f"the mask is {mask.shape} {mask.dtype}, not ({height}, {width}) uint8",
                    where=name,
                    remedy="Send masks on the camera's undistorted canvas.",
                )
        return np.array([i for i, name in enumerate(self.names) if name in masks], np.int64)


# --- What every carving backend offers.


class CarveBackend(Protocol):
    """Carves the silhouettes of one frame set after another, by the rule of this module. One thread at a time.

    name : gl, sweep or cpu. device : description of the hardware it runs on.
    """

    name: str
    device: str

    def carve(self, masks: Masks, min_seeing: int, boxes: Boxes | None = None) -> BrickVolume:
        """Carve one canvas mask a camera; absent cameras do not count.

        boxes : that hold each camera's nonzero pixels, where they are known: the rest of a mask need not be read.
        """
        ...

    def close(self) -> None:
        """Release the backend's resources; it cannot be used afterwards."""
        ...
