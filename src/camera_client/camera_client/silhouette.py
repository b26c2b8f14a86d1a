"""From a frame to the silhouette of the person, on the undistorted canvas (thesis 6.1, 6.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from .background_model import BackgroundModel, check_shape, shape_text
from .colour_shadow import ColourShadow
from .components import keep_person, majority
from .floor_shadow import FloorShadow
from .frame_source import Image, Mask
from .settings import BackgroundSettings, SilhouetteSettings

EMPTY, FULL = "empty", "full"


class ShadowTest(Protocol):
    """Tells which foreground pixels show only the background in shadow."""

    def shadow(self, image: Image, mask: Mask) -> Mask:
        """(H, W) uint8: 255 at pixels of ``mask`` that are shadow, else 0."""


class NoShadow:
    """Finds no shadow anywhere."""

    def shadow(self, image: Image, mask: Mask) -> Mask:
        return np.zeros_like(mask)


@dataclass(frozen=True, eq=False)
class Silhouette:
    """What a camera sees of the person.

    ``mask`` (h, w) uint8, 0 or 255, on the padded undistorted canvas; ``image_mask`` (H, W) the same in the camera's
    own pixels; ``foreground_fraction`` the share of the image that is foreground; ``flags`` may hold "empty" or
    "full": such a mask is what was seen, and probably not a person.
    """

    mask: Mask
    image_mask: Mask
    foreground_fraction: float
    flags: tuple[str, ...]


class SilhouettePipeline:
    """The chain subtract, filter, remove shadow, keep the person, undistort, for one camera and background.

    Raises InputError when background and camera differ in image size.
    """

    def __init__(
        self,
        camera: CameraModel,
        background: BackgroundModel,
        settings: SilhouetteSettings | None = None,
        background_settings: BackgroundSettings | None = None,
    ) -> None:
        settings, background_settings = settings or SilhouetteSettings(), background_settings or BackgroundSettings()
        check_shape(background, (camera.height, camera.width, *background.shape[2:]), f"camera {camera.name}")
        self._settings, self._shape = settings, background.shape
        self._limits = background.limits(background_settings)
        self._view = camera.undistorted_view()
        self._shadow = _shadow_test(camera, background, settings, background_settings.sigma_floor)
        side = 2 * round(settings.closing * camera.height / 2) + 1
        self._closing = np.ones((side, side), np.uint8)

    def run(self, image: Image) -> Silhouette:
        """The silhouette in ``image`` (H, W) or (H, W, 3) uint8. Raises InputError for another size or type."""
        self._check(image)
        mask = majority(self._limits.subtract(image), self._settings.median_px)
        mask = cv2.subtract(mask, self._shadow.shadow(image, mask))
        mask = self._keep_person(mask)
        fraction = cv2.countNonZero(mask) / mask.size
        return Silhouette(self._view.undistort_mask(mask), mask, fraction, self._flags(fraction))

    def _check(self, image: Image) -> None:
        if image.shape != self._shape or image.dtype != np.uint8:
            raise InputError(
                f"an image of {shape_text(image.shape)} {image.dtype} came, expected {shape_text(self._shape)} uint8",
                remedy="The camera's region or pixel format has changed; configure again.",
            )

    def _keep_person(self, mask: Mask) -> Mask:
        s, height = self._settings, mask.shape[0]
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, self._closing)
        area = height * height
        return keep_person(mask, s.min_area * area, s.near * height, s.max_hole * area)

    def _flags(self, fraction: float) -> tuple[str, ...]:
        if fraction < self._settings.empty_below:
            return (EMPTY,)
        return (FULL,) if fraction > self._settings.full_above else ()


def _shadow_test(
    camera: CameraModel, background: BackgroundModel, settings: SilhouetteSettings, sigma_floor: float
) -> ShadowTest:
    colour = len(background.shape) == 3
    if colour and settings.colour_shadow.enabled:
        return ColourShadow(background, sigma_floor, settings.colour_shadow)
    if not colour and settings.floor_shadow.enabled:
        return FloorShadow(camera, background, sigma_floor, settings.floor_shadow)
    return NoShadow()
