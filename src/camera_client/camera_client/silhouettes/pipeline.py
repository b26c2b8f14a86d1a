"""Segments a frame: the silhouette of the person on the undistorted canvas (thesis 6.1, 6.3).

:meth:`SilhouettePipeline.run` is the recipe: subtract the background, filter, find shadow, keep the person, trim the
outline, mark what may be floor in shadow, undistort.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE
from capture_rig.rig import Volume
from mocap_packets.silhouette import Silhouette
from mocap_packets.support import ForegroundSupport

from ..background.light_drift import LightDrift
from ..background.model import BackgroundLimits, BackgroundModel, check_shape, shape_text
from ..background.moved_things import MovedThings
from ..frame_source import Image, Mask
from ..settings import BackgroundSettings, SilhouetteSettings
from .masks import BLOCK_PX, Box, BoxUndistorter, ForegroundLocator, keep_person, majority, majority_count, trim_outline
from .shadows import ALIGNMENT_PX, AttenuationMarker, make_shadow_test

EMPTY, FULL = "empty", "full"
LEAST_GAIN = 0.005  # shadow tests need it no finer
MIN_AREA = 2e-4  # of the squared image height; smaller components are dropped: a hand at 10 m is larger
EMPTY_BELOW, FULL_ABOVE = 2e-4, 0.6  # share of foreground at which a mask is flagged: no person looks like that


class SilhouettePipeline:
    """The chain subtract, filter, look for shadow, keep the person, undistort, for one camera and background.

    After the subtraction all work happens in a box around the places where foreground is dense. But for noise too thin
    to be a part of a person, the result is that of the whole image.
    Raises InputError when background and camera differ in image size.
    """

    def __init__(
        self,
        camera: CameraModel,
        background: BackgroundModel,
        settings: SilhouetteSettings | None = None,
        background_settings: BackgroundSettings | None = None,
        volume: Volume | None = None,
    ) -> None:
        """``volume``: the capture volume; what may be floor far from it stays the person."""
        settings, background_settings = settings or SilhouetteSettings(), background_settings or BackgroundSettings()
        check_shape(background, (camera.height, camera.width, *background.shape[2:]), f"camera {camera.name}")
        self._camera, self._settings, self._shape = camera.name, settings, background.shape
        self._limits = background.limits(background_settings)
        self._drift: LightDrift | None = None
        if background_settings.drift.mode == "slow":
            self._drift = LightDrift(background, self._limits, background_settings, BLOCK_PX)
        self.moved: MovedThings | None = None
        if background_settings.moved_things:
            self.moved = MovedThings(camera, np.maximum(background.sigma, background_settings.sigma_floor))
        self._shadow = make_shadow_test(camera, background, settings, background_settings.sigma_floor)
        self._attenuation = AttenuationMarker(camera, background, volume) if settings.shadow == "mark" else None
        self._mean = np.rint(background.mean).clip(0, 255).astype(np.uint8)
        self._alignment_px = math.lcm(self._shadow.alignment_px, ALIGNMENT_PX)
        min_area_px = MIN_AREA * camera.height**2
        self._locator = ForegroundLocator(self._shape, min_area_px, majority_count(settings.median_px))
        self._undistorter = BoxUndistorter(camera.undistorted_view())
        self._levels = np.zeros(self._shape[:2], np.uint8)
        side = 2 * round(settings.closing * camera.height / 2) + 1
        self._closing = np.ones((side, side), np.uint8)
        self._margin_px = 2 * (side // 2) + 2  # what closing looks at

    @property
    def limits(self) -> BackgroundLimits:
        """The grey levels that count as background now; moved in place where drift is followed."""
        return self._limits

    @property
    def gain(self) -> float:
        """How much brighter than learned the scene is now, as far as slow drift was followed; 1 without."""
        return 1.0 if self._drift is None else self._drift.gain

    def run(self, image: Image, stamp_ns: int | None = None) -> Silhouette:
        """Return the silhouette in ``image`` (H, W) or (H, W, 3) uint8. Raises InputError for another size or type.

        Slow drift of the light is followed (when the settings ask for it) by the frames' ``stamp_ns``, so that the same
        footage gives the same silhouettes at every speed.
        """
        self._check(image)
        box, raw = self._subtract(image, stamp_ns)
        if self._drift is not None and stamp_ns is not None:
            self._drift.follow(image, self._locator.buffer, self._locator.dense, stamp_ns)
        if box.empty:
            return self._silhouette(stamp_ns, np.zeros((0, 0), np.uint8), box)
        image = self._as_learned(image)
        shadow = self._shadow.shadow(image, raw, box)
        person = self._keep_person(cv2.subtract(raw, shadow))
        if self._settings.outline_contrast > 0:
            person = trim_outline(person, image[box.slices], self._mean[box.slices], self._settings.outline_contrast)
        if self._attenuation is None:
            return self._silhouette(stamp_ns, person, box)
        levels = np.maximum(person, np.minimum(shadow, np.uint8(SHADOW_CANDIDATE)))
        return self._silhouette(stamp_ns, levels, box, self._attenuation.mark(image, person, shadow, box))

    def _as_learned(self, image: Image) -> Image:
        """As bright as it would be under the light that the background was learned in."""
        if abs(self.gain - 1) < LEAST_GAIN:
            return image
        return cv2.convertScaleAbs(image, alpha=1 / self.gain)

    def _check(self, image: Image) -> None:
        if image.shape != self._shape or image.dtype != np.uint8:
            raise InputError(
                f"an image of {shape_text(image.shape)} {image.dtype} came, expected {shape_text(self._shape)} uint8",
                remedy="The camera's region or pixel format has changed; configure again.",
            )

    def take_support(self, report: ForegroundSupport) -> None:
        """Take what the other cameras see. From any thread."""
        if self.moved is not None:
            self.moved.take_report(report)

    def _subtract(self, image: Image, stamp_ns: int | None) -> tuple[Box, Mask]:
        """A box of the image that holds all foreground which survives the majority filter, and that foreground."""
        within, side = self._locator.buffer, self._settings.median_px
        cv2.inRange(image, self._limits.lo, self._limits.hi, dst=within)
        if self.moved is not None and stamp_ns is not None:
            foreground = cv2.bitwise_not(within)
            self.moved.update(image, foreground, self._mean, stamp_ns)
            self.moved.forgive(image, foreground)
            cv2.bitwise_not(foreground, dst=within)
        dense = self._locator.box()
        if dense.empty:
            return Box(0, 0, 0, 0), np.zeros((0, 0), np.uint8)
        survivors = dense.grown(BLOCK_PX, self._shape)
        seen = survivors.grown(side // 2, self._shape)
        filtered = majority(cv2.bitwise_not(within[seen.slices]), side)
        box = survivors.grown(self._margin_px, self._shape, self._alignment_px)
        mask = np.zeros((box.bottom - box.top, box.right - box.left), np.uint8)
        mask[survivors.relative_to(box).slices] = filtered[survivors.relative_to(seen).slices]
        return box, mask

    def _keep_person(self, mask: Mask) -> Mask:
        s, height = self._settings, self._shape[0]
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, self._closing)
        area = height * height
        return keep_person(mask, MIN_AREA * area, s.near * height, s.max_hole * area)

    def _silhouette(
        self, stamp_ns: int | None, levels: Mask, box: Box, canvas_levels: Mask | None = None
    ) -> Silhouette:
        """Back to the whole image, and onto the canvas, there with ``canvas_levels`` if any."""
        image_mask = np.zeros(self._shape[:2], np.uint8)
        image_mask[box.slices] = levels
        source = image_mask
        if canvas_levels is not None:
            source = self._levels
            source[box.slices] = canvas_levels
        anything, person = int(np.count_nonzero(levels)), int(np.count_nonzero(levels == FOREGROUND))
        fraction = person / image_mask.size
        canvas = self._undistorter.undistort(source, box)
        self._levels[box.slices] = 0  # as it was
        candidates = (anything - person) / image_mask.size
        flags = self._flags(fraction)
        return Silhouette(canvas, image_mask, fraction, flags, candidates, self._camera, stamp_ns)

    def _flags(self, fraction: float) -> tuple[str, ...]:
        if fraction < EMPTY_BELOW:
            return (EMPTY,)
        return (FULL,) if fraction > FULL_ABOVE else ()


# --- the picture to look at

PERSON_BGR, CANDIDATE_BGR = (0, 255, 0), (0, 140, 255)
LINE_PX = 2


def outline(image: Image, mask: Mask) -> Image:
    """Draw the outlines of a silhouette into its image.

    Gives the image (H, W[, 3]) at half size, BGR, the person's outline green, that of shadow candidates orange.
    ``mask`` (H, W) is :attr:`mocap_packets.silhouette.Silhouette.image_mask`, of two or three levels.
    """
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for level, colour in ((SHADOW_CANDIDATE, CANDIDATE_BGR), (FOREGROUND, PERSON_BGR)):
        contours, _ = cv2.findContours(cv2.inRange(mask, level, level), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(shown, contours, -1, colour, LINE_PX)
    return np.asarray(cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
