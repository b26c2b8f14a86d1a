"""Segments a frame: the silhouette of the person on the undistorted canvas (thesis 6.1, 6.3).

:meth:`SilhouettePipeline.subtract` and :meth:`SilhouettePipeline.segment` are the recipe, step by step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE, UNCERTAIN
from capture_rig.rig import Volume
from capture_rig.visibility import may_be_halved, of_shape
from mocap_packets.silhouette import ForegroundSupport, Silhouette

from ..alignment import PictureAlignment
from ..background.adaptive import AdaptiveBackground, Background
from ..background.expected_image import Samples, samples_of
from ..background.fixed import FixedBackground
from ..background.kernels import BLOCK_PX
from ..background.model import BackgroundModel, check_shape, shape_text
from ..background.moved_things import MovedThings
from ..background.noise import Noise
from ..background.training_verdict import HAND
from ..frame_source import Image, Mask
from ..settings import BackgroundSettings, SilhouetteSettings
from ..sources.frame_checks import grid_sample, is_black
from .appearance import PeopleColours
from .components import PeopleRule, components_on, keep_people
from .evidence import CLEAR, EvidenceFilter, Part, Scene, least_evidence
from .masks import Box, BoxUndistorter, ForegroundLocator, enlarged, halve, majority, majority_count, trim_outline
from .shadows import ALIGNMENT_PX, HALVED_NOISE, AttenuationMarker, ColourShadow, FloorShadow

EMPTY, FULL = "empty", "full"
# Thresholds: REACH_BLOCKS from the reach of the evidence; else judgement.
REACH_BLOCKS = 2  # around blocks of foreground, a person's thin ends may be: three times the evidence's reach
UNTIMED_HZ = 60.0  # rate of frames that come without stamps
FULL_ABOVE = 0.6  # share of foreground at which a mask is flagged: no person looks like that


@dataclass(frozen=True, eq=False)
class Difference:
    """Where a frame differs from the background as it looked then: all that its silhouette is made of.

    image : as it is looked at, (h, w[, 3]) uint8; samples, distance : of it, and how far each is from the background.
    box : around all foreground, and the ``part`` in it, None where it is empty. nobody : blocks in which the other
    cameras saw nobody then, None where that is not asked. unsupported : that of the moved things then.
    """

    stamp_ns: int
    shows_scene: bool
    image: Image
    samples: Samples
    distance: Mask
    noise: Noise
    nobody: npt.NDArray[np.bool_] | None
    unsupported: Mask | None
    box: Box
    part: Part | None


class Labels(NamedTuple):
    """What became of the pixels of a part, all (h, w) uint8.

    distance : SCALE z^2 of each from the background. foreground : all of it, 255; person, shadow : what was made of it,
    255.
    """

    distance: Mask
    foreground: Mask
    person: Mask
    shadow: Mask


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
        alignment: PictureAlignment | None = None,
    ) -> None:
        """``volume``: the capture volume; what may be floor far from it stays the person. ``alignment``: of pictures
        with the background, where there is one already."""
        settings, background_settings = settings or SilhouetteSettings(), background_settings or BackgroundSettings()
        whole, given = camera, of_shape(camera, background.shape)
        check_shape(background, (given.height, given.width, *background.shape[2:]), f"camera {camera.name}")
        self._settings, self._frame_shape = settings, background.shape
        self.image_shape = camera.height, camera.width
        """Of the camera (H, W): as large as masks are."""
        self._undistorter = BoxUndistorter(camera.undistorted_view())
        self._halves = given is camera and may_be_halved(camera, volume)
        if self._halves:
            background, alignment = halved_background(background), None
        camera = of_shape(camera, background.shape)
        self.scale = 1 if camera is whole else 2
        """Pixels of the camera, in each direction, to one that is looked at."""
        self._shape = background.shape
        self.channels, self.looked_at_px = background.channels, camera.width * camera.height
        self._dark_room, self._untimed_ns = is_black(grid_sample(background.mean)), 0
        # background subtraction
        self.measures_distance = background_settings.rule == "adaptive"
        """Whether the background says how far a pixel is from it, not only on which side."""
        self.background: Background
        if self.measures_distance:
            alignment = alignment or PictureAlignment(camera, background.mean, float(np.median(background.sigma)))
            self.background = AdaptiveBackground(background, background_settings, alignment)
        else:
            self.background = FixedBackground(background, background_settings)
        self.moved: MovedThings | None = None
        if background_settings.moved_things:
            sigma = np.maximum(background.sigma, background_settings.sigma_floor)
            self.moved = MovedThings(whole, sigma, self.scale)
        min_area_px = HAND * camera.height**2
        self._locator = ForegroundLocator(self._shape, min_area_px, majority_count(), self.background.step_px)
        # segmentation
        self._evidence = EvidenceFilter(camera.height) if self.measures_distance else None
        self._shadow: FloorShadow | ColourShadow | None = None
        if settings.shadow != "keep":
            self._shadow = (FloorShadow if self.channels == 1 else ColourShadow)(camera, volume)
        self._alignment_px = self._shadow.alignment_px if self._shadow else ALIGNMENT_PX
        side = 2 * round(settings.closing * camera.height / 2) + 1
        self._closing = np.ones((side, side), np.uint8)
        self._margin_px = BLOCK_PX + 2 * (side // 2) + 2  # what closing looks at
        max_hole_px = settings.max_hole * camera.height**2
        self._people = PeopleRule(min_area_px, settings.near * camera.height, max_hole_px)
        self._attenuation = AttenuationMarker(camera, volume) if settings.shadow == "mark" else None
        self._colours = PeopleColours(self._shape) if self.measures_distance else None
        self.labels: Labels | None = None
        """Of the last silhouette, on the thread that segments; None without foreground."""

    def run(self, image: Image, stamp_ns: int | None = None) -> Silhouette:
        """Return the silhouette in ``image`` (H, W) or (H, W, 3) uint8. Raises InputError for another size or type.

        What changes is followed by the frames' ``stamp_ns``, so that the same footage gives the same silhouettes at
        every speed; frames without one count as UNTIMED_HZ.
        """
        return self.segment(self.subtract(image, stamp_ns))

    def add_support(self, report: ForegroundSupport) -> None:
        """Take what the other cameras see. From any thread."""
        if self.moved is not None:
            self.moved.others.add(report)

    # --- background subtraction

    def subtract(self, image: Image, stamp_ns: int | None = None) -> Difference:
        """Begin a frame, as :meth:`run` says: follow the background, find where the image differs from it."""
        if image.shape != self._frame_shape or image.dtype != np.uint8:
            raise InputError(
                f"an image of {shape_text(image.shape)} {image.dtype} came, "
                f"expected {shape_text(self._frame_shape)} uint8",
                remedy="The camera's region or pixel format has changed; configure again.",
            )
        self._untimed_ns += round(1e9 / UNTIMED_HZ)
        stamp_ns = self._untimed_ns if stamp_ns is None else stamp_ns
        image = halve(image) if self._halves else image
        background, moved, samples = self.background, self.moved, samples_of(image)
        shows_scene = self._dark_room or not is_black(grid_sample(image))
        # compensate illumination and movements of the camera, measure the noise; a covered lens says nothing of them
        if shows_scene:
            background.update(image, samples, stamp_ns)
        # squared Mahalanobis distance of samples from the background
        distance = background.distance(image, samples)
        # without things that were moved or taken away
        if moved is not None:
            if shows_scene:
                moved.update(image, samples, distance, background, stamp_ns)
            moved.clear_absorbed(image, distance, background.light.brightness, background.step_px)
        # a box around what is dense, and the distance of all pixels in it
        dense = self._locator.find(distance, background.threshold)
        if shows_scene:
            background.add_foreground(self._locator.dense)
        box = dense.grown(self._margin_px, self._shape, self._alignment_px)
        part = None if box.empty else self._compare_box(image, box)
        nobody, things = (None, None) if moved is None else (moved.others.unseen_s > 0, moved.unsupported)
        return Difference(stamp_ns, shows_scene, image, samples, distance, background.noise, nobody, things, box, part)

    def _compare_box(self, image: Image, box: Box) -> Part:
        spans = self._locator.spans(box.slices, REACH_BLOCKS)
        expected, (distance, change) = self.background.compare(image, box, spans[0])
        if self.moved is not None:
            self.moved.clear_absorbed(image, distance, self.background.light.brightness, box=box)
        scene = Scene(image[box.slices], expected, change, self.background.noise, box.slices)
        return Part(scene, distance, spans)

    # --- segmentation

    def segment(self, found: Difference) -> Silhouette:
        """Finish a frame, as :meth:`run` says: cut the silhouette out. On one thread, in the frames' order; the next
        frames may be subtracted on another one meanwhile, which changes nothing."""
        levels, cut, box = np.zeros(self._shape[:2], np.uint8), np.zeros((0, 0), np.uint8), found.box
        self.labels = None
        if found.part is not None:
            self.labels, levels[box.slices], cut = self._segment_part(found.part, found.unsupported)
        uncertain = self._mark_uncertain(found, levels)
        levels, whole = self._in_image(levels, box.joined(uncertain), box, cut)
        canvas = self._undistorter.undistort(levels, whole)
        person_px, candidate_px = (
            0 if whole.empty else cv2.countNonZero(cv2.inRange(levels[whole.slices], above + 1, most))
            for above, most in ((SHADOW_CANDIDATE, FOREGROUND), (UNCERTAIN, SHADOW_CANDIDATE))
        )
        fraction = person_px / levels.size
        flags = (EMPTY,) if fraction < HAND else (FULL,) if fraction > FULL_ABOVE else ()
        return Silhouette(canvas, levels, fraction, flags, candidate_px / levels.size)

    def _segment_part(self, part: Part, unsupported: Mask | None) -> tuple[Labels, Mask, Mask]:
        """Return labels and levels (h, w), and which pixels of the image, where it is finer, are only background."""
        scene = part.scene
        # likelihood ratio test with the neighbourhood, smoothed along edges; of the thesis's rules, a median filter
        if self._evidence is not None:
            foreground = self._evidence.decide(part)
        else:
            foreground = majority(cv2.threshold(part.distance, self.background.threshold, 255, cv2.THRESH_BINARY)[1])
        # shadow suppression
        shadow = self._shadow.shadow(scene, foreground) if self._shadow else np.zeros_like(foreground)
        # morphological closing
        closed = cv2.morphologyEx(cv2.subtract(foreground, shadow), cv2.MORPH_CLOSE, self._closing)
        # connected components of people, holes filled; of things that no other camera sees, this one has no vote
        things = None if unsupported is None else components_on(closed, unsupported[scene.at])
        person = keep_people(closed if things is None else cv2.subtract(closed, things), self._people)
        # outline at a share of the contrast
        trimmed, cut = self._trim_outline(person, scene.change)
        # levels of what may be floor in shadow
        levels = trimmed if self._attenuation is None else self._attenuation.mark(scene, trimmed, shadow)
        if things is not None:
            levels = np.where(things > 0, np.uint8(UNCERTAIN), levels)
        return Labels(part.distance, foreground, person, shadow), levels, cut

    def _mark_uncertain(self, found: Difference, levels: Mask) -> Box:
        """Learn the people's colours, and mark where the background looks like them; return a box around that."""
        if self._colours is None:
            return Box(0, 0, 0, 0)
        if found.part is not None and found.shows_scene:
            self._colours.learn(found.image, levels[found.box.slices], found.box, found.nobody, found.stamp_ns)
        least = least_evidence(found.noise.typical_sigma, found.noise)
        return self._colours.mark_uncertain(found.samples, found.distance, levels, least, CLEAR * least)

    # --- pictures that are finer than the hull: looked at in half of the size, but for the outlines

    def _trim_outline(self, person: Mask, change: Mask) -> tuple[Mask, Mask]:
        """Return the person, and which pixels of the image around them, where that is finer, are only background."""
        fine = trim_outline(person, change, self._settings.outline_contrast, self.channels > 1, self.scale)
        if self.scale == 1:
            return fine, np.zeros((0, 0), np.uint8)
        return person, cv2.subtract(enlarged(person, self.scale, fine.shape), fine)

    def _in_image(self, levels: Mask, whole: Box, box: Box, cut: Mask) -> tuple[Mask, Box]:
        """Return levels in the image's own pixels, and the box ``whole`` outside of which they are 0; ``cut`` : 255 at
        those of ``box`` that are only background."""
        if self.scale == 1:
            return levels, whole
        found, scale = np.zeros(self.image_shape, np.uint8), self.scale
        whole_fine, fine = (Box(*(scale * side for side in each)).grown(0, self.image_shape) for each in (whole, box))
        part = found[whole_fine.slices]
        part[:] = enlarged(levels[whole.slices], scale, part.shape)
        if not box.empty:
            part = found[fine.slices]
            part[:] = cv2.subtract(part, cut[: part.shape[0], : part.shape[1]])
        return found, whole_fine


def halved_background(model: BackgroundModel) -> BackgroundModel:
    """Return the background of images at half the size."""
    noise = math.sqrt(HALVED_NOISE)
    sigma = np.float32(noise) * np.sqrt(halve(np.square(model.sigma)))
    halved = BackgroundModel(halve(model.mean), sigma, model.provenance)
    return halved.with_provenance(mean_noise=noise * model.provenance.mean_noise)
