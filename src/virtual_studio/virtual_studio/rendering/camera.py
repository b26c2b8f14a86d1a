"""Renders one camera's view of the room and a body in it: light, exact silhouette, and the sensor's grey levels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig

from ..people import Capsules
from ..rig import RoomView, pixel_rays, view_room
from .capsules import draw_capsules, floor_shadow, shadow_lookup, silhouette

Image = NDArray[np.uint8]
"""A picture: (h, w) grey, or (h, w, 3) BGR."""
Light = NDArray[np.float32]
"""(h, w) light that reaches a camera's pixels, 0..1; (h, w, 3) BGR in colour."""

WHITE = 240.0
"""Grey level of a perfectly white surface in full light."""
_NOISE_SAMPLES = 1 << 22
BANDS = 8  # of rows that a rolling shutter exposes at once here: 2 ms apart, in which a running hand moves 1 cm


class VirtualCamera:
    """Renders the room with a body and its shadow through one camera; static parts are computed once."""

    def __init__(self, camera: CameraModel, view: RoomView | None = None, standing: Capsules | None = None) -> None:
        """``view`` : its view of a room that differs from the usual one (`scene.room.view_room`); ``standing`` : things
        in the room that hide people behind them, with their shadow."""
        self.camera = camera
        self._view, self._depth = view or view_room(camera), None
        if standing is not None:
            self._view, self._depth = _furnished(camera, self._view, standing)
        lookup = shadow_lookup(self._view.floor_xy)
        self._shadow_map = cv2.convertMaps(lookup[..., 0], lookup[..., 1], cv2.CV_16SC2)

    def empty_room(self) -> Light:
        """Returns the light of the empty room."""
        return self._view.grey

    def render(self, capsules: Capsules, shadow: NDArray[np.float32] | None) -> tuple[Light, Image]:
        """Returns light and exact silhouette (h, w), 0 or 255, of a body and, if given, its `floor_shadow`."""
        light = self.shaded_room(shadow)
        _, mask = draw_capsules(self.camera, self._view.rays, capsules, light, self._depth)
        return light, mask

    def shaded_room(self, shadow: NDArray[np.float32] | None) -> Light:
        """Returns the light of the room with a `floor_shadow` alone in it."""
        return self._view.grey.copy() if shadow is None else self._view.grey * self._on_floor(shadow)

    def empty_room_colour(self) -> Light:
        """Returns the light (h, w, 3), BGR, of the empty room."""
        return self._view.colour

    def render_colour(
        self, capsules: Capsules, albedo_bgr: NDArray[np.float64], shadow: NDArray[np.float32] | None
    ) -> tuple[Light, Image]:
        """Renders in colour: returns light (h, w, 3), and the same silhouette as `render`; albedo_bgr (P, 3)."""
        channels = []
        for room, albedo in zip(np.moveaxis(self._view.colour, 2, 0), albedo_bgr.T, strict=True):
            light = room.copy() if shadow is None else room * self._on_floor(shadow)
            dyed = capsules._replace(albedo=albedo.copy())
            _, mask = draw_capsules(self.camera, self._view.rays, dyed, light, self._depth)
            channels.append(light)
        return np.stack(channels, axis=2), mask

    def _on_floor(self, shadow: NDArray[np.float32]) -> Light:
        """The share of light that a floor shadow leaves each pixel (h, w)."""
        share = cv2.remap(shadow, *self._shadow_map, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 1.0)
        return np.asarray(share, np.float32)


class ExactSilhouettes:
    """Renders a rig's silhouettes alone, without light, shadow or video, for benchmarks of hull and tracker."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._cameras = [(camera, pixel_rays(camera), camera.undistorted_view()) for camera in rig.cameras]
        self._hiding: Capsules | None = None
        self._depths: dict[str, NDArray[np.float32]] = {}  # of hiding things, if any

    def render(self, capsules: Capsules, hiding: Capsules | None = None) -> dict[str, Image]:
        """Returns each camera's undistorted mask (h, w), 0 or 255, by name.

        ``hiding`` : things in the room that hide people and are not part of the silhouette.
        """
        if hiding is not self._hiding:
            self._hiding, self._depths = hiding, {}
            if hiding is not None:
                dark = {c.name: np.zeros((c.height, c.width), np.float32) for c, *_ in self._cameras}
                self._depths = {c.name: draw_capsules(c, rays, hiding, dark[c.name])[0] for c, rays, _ in self._cameras}
        return {
            c.name: view.undistort_mask(silhouette(c, rays, capsules, self._depths.get(c.name)))
            for c, rays, view in self._cameras
        }

    def expose(
        self, capsules_at: Callable[[float], Capsules], time_s: float, later_s: Mapping[str, float]
    ) -> dict[str, Image]:
        """Returns each camera's undistorted mask of a moving body, where cameras expose one after another.

        capsules_at : the body at a time, s. later_s : of each camera after ``time_s``. A rolling shutter's image
        consists of BANDS bands of rows, each of the time of its middle row.
        """
        masks = {}
        for camera, rays, view in self._cameras:
            begin_s, image = time_s + later_s[camera.name], np.empty((camera.height, camera.width), np.uint8)
            for rows in np.array_split(np.arange(camera.height), BANDS if camera.line_time_s else 1):
                capsules = capsules_at(begin_s + camera.line_time_s * (float(rows.mean()) - 0.5 * (camera.height - 1)))
                image[rows] = silhouette(camera, rays, capsules)[rows]
            masks[camera.name] = view.undistort_mask(image)
        return masks


def _furnished(camera: CameraModel, view: RoomView, standing: Capsules) -> tuple[RoomView, NDArray[np.float32]]:
    """The room with things in it, on which no shadow falls, and their depth (h, w) along the rays, m."""
    columns, rows = np.moveaxis(shadow_lookup(view.floor_xy), 2, 0)
    share = cv2.remap(floor_shadow(standing), columns, rows, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 1.0)
    light = np.asarray(view.grey * share, np.float32)
    depth, mask = draw_capsules(camera, view.rays, standing, light)
    floor_xy = np.where(mask[..., None] > 0, np.float32(np.nan), view.floor_xy)
    return replace(view, grey=light, floor_xy=floor_xy), depth


@dataclass(frozen=True)
class Sensor:
    """Turns light into grey levels, with the sensor's noise and the lamps' flicker.

    noise: standard deviation of each pixel's noise, grey levels; flicker: relative standard deviation of the whole
    frame's brightness. Both follow from (seed, camera, frame), so any frame can be made again on its own.
    """

    noise: float = 3.0
    flicker: float = 0.005
    seed: int = 0

    def expose(self, light: Light, camera: int, frame: int) -> Image:
        """Returns the picture (h, w[, 3]) that a camera's sensor takes of light in one frame."""
        rng = np.random.Generator(np.random.SFC64([self.seed, camera, frame]))
        gain = WHITE * (1.0 + self.flicker * rng.standard_normal())
        samples, left = self._normal_samples, _NOISE_SAMPLES - light.size
        start = int(rng.integers(left if left > 0 else _NOISE_SAMPLES))
        noise = samples[start : start + light.size] if left > 0 else np.resize(np.roll(samples, -start), light.size)
        noise = noise.reshape(light.shape)
        picture = np.maximum(cv2.addWeighted(light, gain, noise, self.noise, 0.0), 0.0)
        return np.asarray(cv2.convertScaleAbs(picture), np.uint8)

    @cached_property
    def _normal_samples(self) -> NDArray[np.float32]:
        """Standard normal numbers; each frame takes a stretch from a random start, which costs nothing."""
        return np.random.Generator(np.random.SFC64(self.seed)).standard_normal(_NOISE_SAMPLES, dtype=np.float32)
