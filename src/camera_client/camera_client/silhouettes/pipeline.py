"""Segments a frame: the silhouette of the person on the undistorted canvas (thesis 6.1, 6.3).

:meth:`SilhouettePipeline.run` is the recipe: follow the background, measure every pixel's distance from it, decide with
the neighbourhood, find shadow, keep the person, trim the outline, mark what may be floor in shadow, mark where the
background looks like the people, undistort.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
from ..background.adaptive import AdaptiveBackground
from ..background.expected_image import Corners, Samples, samples_of
from ..background.fixed import FixedBackground
from ..background.kernels import BLOCK_PX, HIGHEST, STEP_PX
from ..background.model import BackgroundModel, check_shape, shape_text
from ..background.moved_things import MovedThings
from ..background.noise import Noise
from ..background.verdict import HAND
from ..frame_source import Image, Mask
from ..settings import BackgroundSettings, SilhouetteSettings
from ..sources.frame_checks import grid_sample, is_black
from .appearance import PeopleColours
from .components import PeopleRule, keep_people
from .evidence import CLEAR, EvidenceFilter, codec_error_sigma, least_evidence
from .masks import Box, BoxUndistorter, ForegroundLocator, Spans, majority, majority_count, trim_outline
from .shadows import ALIGNMENT_PX, HALVED_NOISE, AttenuationMarker, ColourShadow, FloorShadow, Scene, enlarged
from .texture import halve

EMPTY, FULL = "empty", "full"
# Thresholds: REACH_BLOCKS from the reach of the evidence; else judgement.
REACH_BLOCKS = 2  # around blocks of foreground, a person's thin ends may be: three times the evidence's reach
TYPICAL_LEVEL = HIGHEST / 2  # grey level at which one number stands for the noise
UNTIMED_HZ = 60.0  # rate of frames that come without stamps
FULL_ABOVE = 0.6  # share of foreground at which a mask is flagged: no person looks like that


@dataclass(frozen=True, eq=False)
class Difference:
    """Where a frame differs from the background as it looked then: all that its silhouette is made of.

    image : as it is looked at, (h, w[, 3]) uint8; samples, distance : of it, and how far each is from the background.
    scene : what is in the ``box`` around all foreground, None where there is none; closely : how far each of its pixels
    is from the background, change : in whole grey levels of the channel that differs most. spans : of it that is looked
    at. nobody : blocks in which the other cameras saw nobody then, None where that is not asked.
    """

    now_ns: int
    shows_scene: bool
    image: Image
    samples: Samples
    distance: Mask
    noise: Noise
    box: Box
    scene: Scene | None
    closely: Mask
    change: Mask
    spans: Spans
    nobody: npt.NDArray[np.bool_] | None


class Parts(NamedTuple):
    """What a silhouette was made of, all (h, w) uint8 in a box around all foreground.

    distance : SCALE z^2 of each pixel from the background. foreground : all of it, 255; person, shadow : what was made
    of it, 255.
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
        self._shape, self._colour = background.shape, len(background.shape) == 3
        self.background: AdaptiveBackground | FixedBackground
        if background_settings.rule == "adaptive":
            alignment = alignment or PictureAlignment(camera, background.mean, float(np.median(background.sigma)))
            self.background = AdaptiveBackground(background, background_settings, alignment)
        else:
            self.background = FixedBackground(background, background_settings)
        self.moved: MovedThings | None = None
        if background_settings.moved_things:
            sigma = np.maximum(background.sigma, background_settings.sigma_floor)
            self.moved = MovedThings(whole, sigma, self.scale)
        self.channels = len(background.shape[2:]) * 3 or 1
        self.looked_at_px = camera.width * camera.height
        self._shadow: FloorShadow | ColourShadow | None = None
        if settings.shadow != "keep":
            self._shadow = ColourShadow(camera, volume) if self._colour else FloorShadow(camera, volume)
        self._attenuation = AttenuationMarker(camera, volume) if settings.shadow == "mark" else None
        self._alignment_px = math.lcm(self._shadow.alignment_px if self._shadow else 1, ALIGNMENT_PX)
        height = camera.height
        min_area_px = HAND * height**2
        self._people = PeopleRule(min_area_px, settings.near * height, settings.max_hole * height**2)
        least_px = majority_count()
        self._locator = ForegroundLocator(self._shape, min_area_px, least_px, self.background.step_px)
        side = 2 * round(settings.closing * camera.height / 2) + 1
        self._closing = np.ones((side, side), np.uint8)
        self._margin_px = 2 * (side // 2) + 2  # what closing looks at
        self.measures_distance = background_settings.rule == "adaptive"
        """Whether the background says how far a pixel is from it, not only on which side."""
        self._evidence = EvidenceFilter(camera.height) if self.measures_distance else None
        self._colours = PeopleColours(self._shape) if self.measures_distance else None
        self.parts: Parts | None = None
        """Of the last silhouette, on the thread that segments; None without foreground."""
        self._untimed_ns = 0
        self._dark_room = is_black(grid_sample(background.mean))

    def run(self, image: Image, stamp_ns: int | None = None) -> Silhouette:
        """Return the silhouette in ``image`` (H, W) or (H, W, 3) uint8. Raises InputError for another size or type.

        What changes is followed by the frames' ``stamp_ns``, so that the same footage gives the same silhouettes at
        every speed; frames without one count as UNTIMED_HZ.
        """
        return self.segment(self.subtract(image, stamp_ns))

    def subtract(self, image: Image, stamp_ns: int | None = None) -> Difference:
        """Begin a frame, as :meth:`run` says: follow the background, find where the image differs from it."""
        if image.shape != self._frame_shape or image.dtype != np.uint8:
            raise InputError(
                f"an image of {shape_text(image.shape)} {image.dtype} came, "
                f"expected {shape_text(self._frame_shape)} uint8",
                remedy="The camera's region or pixel format has changed; configure again.",
            )
        self._untimed_ns += round(1e9 / UNTIMED_HZ)
        now_ns = self._untimed_ns if stamp_ns is None else stamp_ns
        image = halve(image) if self._halves else image
        samples = samples_of(image)
        shows_scene = self._dark_room or not is_black(grid_sample(image))
        if shows_scene:  # a covered lens says nothing of light and noise
            self.background.follow(image, samples, now_ns)
        distance = self.background.distance(image, samples)
        box = self._find_foreground(image, samples, distance, now_ns if shows_scene else None)
        if shows_scene:
            self.background.note_foreground(self._locator.dense)
        noise, scene = self.background.noise, None
        closely = change = np.zeros((0, 0), np.uint8)
        spans = self._locator.spans(box.slices, REACH_BLOCKS)
        if not box.empty:
            expected, (closely, change) = self.background.look(image, box, spans[0])
            if self.moved is not None:
                self.moved.clear_absorbed(image, closely, self.background.light.brightness, box=box)
            scene = Scene(image[box.slices], expected, noise, box.slices)
        nobody = None if self.moved is None else self.moved.others.unseen_s > 0
        return Difference(
            now_ns, shows_scene, image, samples, distance, noise, box, scene, closely, change, spans, nobody
        )

    def segment(self, found: Difference) -> Silhouette:
        """Finish a frame, as :meth:`run` says: cut the silhouette out. On one thread, in the frames' order; the next
        frames may be subtracted on another one meanwhile, which changes nothing."""
        self.parts, box, scene = None, found.box, found.scene
        levels, cut, whole = np.zeros(self._shape[:2], np.uint8), np.zeros((0, 0), np.uint8), box
        if scene is not None:
            scene = replace(scene, codec_sigma=codec_error_sigma(found.change, scene.noise))
            raw = self._decide(found, scene)
            shadow = self._shadow.shadow(scene, raw) if self._shadow else np.zeros_like(raw)
            closed = cv2.morphologyEx(cv2.subtract(raw, shadow), cv2.MORPH_CLOSE, self._closing)
            kept = keep_people(closed, self._people)
            person, cut = self._trim_outline(kept, found.change)
            marked = person if self._attenuation is None else self._attenuation.mark(scene, person, shadow)
            self.parts, levels[box.slices] = Parts(found.closely, raw, kept, shadow), marked
            if self._colours is not None and found.shows_scene:
                self._colours.learn(found.image, marked, box, found.nobody, found.now_ns)
        if self._colours is not None:
            least = least_evidence(found.noise.sigma(TYPICAL_LEVEL), found.noise)
            uncertain = self._colours.mark_uncertain(found.samples, found.distance, levels, least, CLEAR * least)
            whole = box.joined(uncertain)
        levels, whole = self._in_image(levels, whole, box, cut)
        canvas = self._undistorter.undistort(levels, whole)
        person_px, candidate_px = (
            0 if whole.empty else cv2.countNonZero(cv2.inRange(levels[whole.slices], above + 1, most))
            for above, most in ((SHADOW_CANDIDATE, FOREGROUND), (UNCERTAIN, SHADOW_CANDIDATE))
        )
        fraction = person_px / levels.size
        flags = (EMPTY,) if fraction < HAND else (FULL,) if fraction > FULL_ABOVE else ()
        return Silhouette(canvas, levels, fraction, flags, candidate_px / levels.size)

    def take_support(self, report: ForegroundSupport) -> None:
        """Take what the other cameras see. From any thread."""
        if self.moved is not None:
            self.moved.others.add(report)

    def _find_foreground(self, image: Image, samples: Samples, distance: Mask, stamp_ns: int | None) -> Box:
        """Return a box around all that may be foreground by the samples' ``distance``, and write 0 into that where the
        image looks as it was absorbed. stamp_ns : None of a frame that does not show the scene."""
        limit, step_px = self.background.threshold, self.background.step_px
        if self.moved is not None:
            light = self.background.light.brightness
            if stamp_ns is not None and self.moved.is_due(stamp_ns):
                sigma, thinned = self.background.noise.sigma(TYPICAL_LEVEL), distance[:: STEP_PX // step_px]
                foreground = cv2.threshold(thinned[:, :: STEP_PX // step_px], limit, 255, cv2.THRESH_BINARY)[1]
                self.moved.update(image, samples, foreground, self._look_at, stamp_ns, light, sigma)
            self.moved.clear_absorbed(image, distance, light, step_px)
        cv2.threshold(distance, limit, 255, cv2.THRESH_BINARY_INV, dst=self._locator.buffer)
        dense = self._locator.box()
        if dense.empty:
            return Box(0, 0, 0, 0)
        return dense.grown(BLOCK_PX + self._margin_px, self._shape, self._alignment_px)

    def _look_at(self, image: Image, box: Corners) -> tuple[npt.NDArray[np.float32], Mask]:
        """Return what is expected in a box, and the foreground of every pixel, that was absorbed as well."""
        whole = np.tile([0, box[3] - box[1]], (box[2] - box[0], 1))
        expected, (distance, _) = self.background.look(image, box, whole)
        return expected, np.asarray(cv2.threshold(distance, self.background.threshold, 255, cv2.THRESH_BINARY)[1])

    def _decide(self, found: Difference, scene: Scene) -> Mask:
        """Return the foreground of a part, by its neighbourhood's evidence, or by the majority (the thesis's rules)."""
        if self._evidence is None:
            mask = cv2.threshold(found.closely, self.background.threshold, 255, cv2.THRESH_BINARY)[1]
            return majority(mask)
        return self._evidence.decide(found.closely, found.change, scene, found.spans)

    def _trim_outline(self, kept: Mask, change: Mask) -> tuple[Mask, Mask]:
        """Return the person, and which pixels of the image around them, where that is finer, are only background."""
        fine = trim_outline(kept, change, self._settings.outline_contrast, self._colour, self.scale)
        if self.scale == 1:
            return fine, np.zeros((0, 0), np.uint8)
        return kept, cv2.subtract(enlarged(kept, self.scale, fine.shape), fine)

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


# --- pictures that are finer than the hull: looked at in half of the size, but for the outlines


def halved_background(model: BackgroundModel) -> BackgroundModel:
    """Return the background of images at half the size."""
    noise = math.sqrt(HALVED_NOISE)
    sigma = np.float32(noise) * np.sqrt(halve(np.square(model.sigma)))
    halved = BackgroundModel(halve(model.mean), sigma, model.provenance)
    return halved.with_provenance(mean_noise=noise * model.provenance.mean_noise)


# --- the picture to look at

PERSON_BGR, CANDIDATE_BGR = (0, 255, 0), (0, 140, 255)
LINE_PX = 2


def outline(image: Image, mask: Mask) -> Image:
    """Draw the outlines of a silhouette into its image.

    Gives the image (H, W[, 3]), which may come at half size, at half size, BGR, the person's outline green, that of
    shadow candidates orange. ``mask`` (H, W) is :attr:`mocap_packets.silhouette.Silhouette.image_mask`.
    """
    if image.shape[:2] != mask.shape:
        image = np.asarray(cv2.resize(image, mask.shape[::-1], interpolation=cv2.INTER_NEAREST))
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for above, most, colour in (
        (UNCERTAIN, SHADOW_CANDIDATE, CANDIDATE_BGR),
        (SHADOW_CANDIDATE, FOREGROUND, PERSON_BGR),
    ):
        contours, _ = cv2.findContours(cv2.inRange(mask, above + 1, most), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(shown, contours, -1, colour, LINE_PX)
    return np.asarray(cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
