"""Lets things that moved become background: doors, a chair put elsewhere or taken away; never a person.

Two rules, by physics (:mod:`.moved_evidence`). What the other cameras do not see and what keeps still, as a whole and
for seconds, is a thing. And where the background's picture has an outline that the camera's picture has no longer,
nothing stands. What was learned first is kept: a pixel is background when it looks as it was learned or as it was
absorbed, so that a door closed again is background at once.

Work is done on blocks of 8 x 8 pixels, a few times a second by the frames' stamps.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.stamps import StampThrottle

from ..frame_source import LASTING_S, Image, Mask
from .adaptive import Background
from .expected_image import Corners, Samples
from .kernels import BEYOND_NOISE, BLOCK_PX, STEP_PX, USUAL_S, clear_absorbed
from .moved_evidence import MAJORITY, WHOLE, Blocks, SupportHistory, counted, is_calm_inside, was_taken_away

# Thresholds: judgement: no measurement beside the built rooms of test_camera_moved_things.py, in which they hold.
SAMPLE_S = 0.2  # between updates of the blocks
BLOCK_SHARE = 64  # of 255: a quarter of a block is foreground; noise fills no such part
RESTLESS_SHARE = 24  # of 255: two samples of a block that differ: an edge of a person moved by a fraction of a pixel
STILL_S = LASTING_S  # unsupported and static this long: absorbed; like the learned background this long: reverted
OUTSIDE_STILL_S = 4 * STILL_S  # ... beside the volume, where nobody keeps all limbs still this long
REST_S = USUAL_S  # the picture has come to rest: outlines say enough; also the time constant of the picture that blocks
# are compared with: slower than sway, faster than daylight
MOST_BLOBS = 8  # judged at a time: bounds the work
COUNTED_S = STILL_S + SAMPLE_S  # times are counted up to a little more than the longest that is asked for


class MovedThings:
    """What was learned first, and what was absorbed since, of one camera. Frames come on one thread.

    replaced : (H, W) uint8, 255 where the background may also look as ``mean`` (H, W[, 3]) float32 says, grey levels of
    the light that the background was learned in.
    unsupported : (H, W) uint8, 255 where foreground has kept still, and the others have seen nobody, in the volume or
    beside it, for REST_S: likely a thing, to be absorbed if it stays so. None: nowhere.
    absorbed, reverted : how many times things were. others : what the other cameras see, by their reports.
    """

    def __init__(self, camera: CameraModel, noise: float | npt.NDArray[np.float32], scale: int = 1) -> None:
        """``noise``: grey levels, standard deviation of a pixel: of each (H, W[, 3]), or of all. ``scale``: pixels of
        the camera, in each direction, to one of the images."""
        self.others = SupportHistory(camera, scale * BLOCK_PX, COUNTED_S)
        self._shape = (-(-camera.height // scale), -(-camera.width // scale))
        learned = np.asarray(noise, np.float32)
        self._learned = np.broadcast_to(learned if learned.ndim < 3 else learned.max(axis=2), self._shape).copy()
        self._limit = _noise_limit(self._learned)
        self._noise = self._learned_sigma = float(np.median(noise))
        self._brightness = 1.0
        self.replaced = np.zeros(self._shape, np.uint8)
        self.mean: npt.NDArray[np.float32] = np.zeros(self._shape, np.float32)
        self.absorbed = self.reverted = 0
        self._restart()

    def _restart(self) -> None:
        """Reset all times, for instance when a clock was set back; absorbed blocks stay."""
        self.others.restart()
        blocks = self.others.blocks
        self._throttle = StampThrottle(SAMPLE_S)
        self._running: npt.NDArray[np.float32] | None = None
        self.unsupported: Mask | None = None
        self._last_ns = 0
        self._still_s, self._shown_s = (np.zeros(blocks, np.float32) for _ in range(2))
        self._learned_s, self._denied_s = (np.zeros(blocks, np.float32) for _ in range(2))
        self._absorbed = self._blocks_of(self.replaced[::STEP_PX, ::STEP_PX]) > 0
        self._gone = np.zeros(blocks, bool)  # absorbed by their outline, so that nothing stands there for certain
        self._update_box()
        self._samples = 0

    def _update_box(self) -> None:
        x, y, width, height = cv2.boundingRect(self.replaced)
        self._box = (y, x, y + height, x + width) if width else None

    @property
    def share(self) -> float:
        """Share of the picture that is absorbed."""
        return float(np.count_nonzero(self.replaced) / self.replaced.size)

    def clear_absorbed(
        self, image: Image, values: Mask, brightness: float = 1.0, step_px: int = 1, box: Corners | None = None
    ) -> None:
        """Write 0 into ``values``, of every ``step_px``-th row and column, where the frame looks as it was absorbed.

        brightness : how many times brighter than when the background was learned the scene is now. box : top, left,
        bottom, right of the part that ``values`` are of; all without one.
        """
        if self._box is None:
            return
        part, (v, u) = self._box, (0, 0)
        if box is not None:
            v, u = box[:2]
            part = (max(part[0], v), max(part[1], u), min(part[2], box[2]), min(part[3], box[3]))
        pixels, mean = (each.reshape(*self._shape, -1) for each in (image, self.mean))
        clear_absorbed(pixels, mean, self.replaced, self._limit, (brightness, step_px, v, u), part, values)

    def update(self, image: Image, samples: Samples, distance: Mask, background: Background, stamp_ns: int) -> None:
        """Take one frame (H, W[, 3]) of ``stamp_ns``; it is looked at if it is time to.

        samples (C, h, w) : every STEP_PX-th row and column of it. distance : of every ``step_px``-th pixel from the
        ``background``, also where that was absorbed.
        """
        if stamp_ns < self._last_ns:
            self._restart()
        step_s = self._throttle.step_s(stamp_ns)
        if step_s <= 0.0:
            return
        self._last_ns, self._brightness = stamp_ns, background.light.brightness
        if self.mean.shape != image.shape:
            self.mean = np.zeros(image.shape, np.float32)
        sigma = max(background.noise.typical_sigma, self._learned_sigma)
        if abs(sigma - self._noise) > 0.2 * self._noise:
            self._noise = sigma
            self._limit = _noise_limit(np.maximum(self._learned, np.float32(sigma)))
        self.others.update(stamp_ns)
        # which blocks show anything, and for how long they kept still
        every = STEP_PX // background.step_px
        foreground = cv2.threshold(distance[::every, ::every], background.threshold, 255, cv2.THRESH_BINARY)[1]
        unexplained = foreground.copy()
        self.clear_absorbed(image, unexplained, self._brightness, STEP_PX)
        shown = self._blocks_of(unexplained) >= BLOCK_SHARE
        self._shown_s = counted(self._shown_s, shown, step_s, COUNTED_S)
        self._update_running(samples, step_s)
        # what looks as it was learned is given back
        if self._box is not None:
            self._revert(image, self._blocks_of(foreground) >= BLOCK_SHARE, shown, step_s)
        nobody = (self.others.unseen_s >= REST_S) & (self.others.outside_s <= 0)
        likely = shown & nobody & (self._still_s >= REST_S)
        self.unsupported = np.where(self._to_pixels(likely), np.uint8(255), np.uint8(0)) if likely.any() else None
        # what nobody else sees, and what was taken away, is absorbed
        self._samples += 1
        self._absorb(shown, image, background)

    # --- what keeps still

    def _update_running(self, samples: Samples, step_s: float) -> None:
        """Follow the samples by a running mean, and begin anew in blocks that changed by more than noise."""
        if self._running is None:
            self._running = samples.astype(np.float32)
        rest = samples - self._running
        differs = (np.abs(rest) > self._limit[::STEP_PX, ::STEP_PX]).any(axis=0)
        self._running += np.float32(1.0 - np.exp(-step_s / REST_S)) * rest
        restless = self._blocks_of(np.where(differs, np.uint8(255), np.uint8(0))) >= RESTLESS_SHARE
        if restless.any():
            pixels = self._to_pixels(restless, BLOCK_PX // STEP_PX)[: samples.shape[1], : samples.shape[2]]
            np.copyto(self._running, samples, where=pixels)
        self._still_s = np.where(restless, np.float32(0), self._still_s + np.float32(step_s))

    # --- absorbing

    def _absorb(self, shown: Blocks, image: Image, background: Background) -> None:
        """Absorb blobs of the blocks ``shown`` that a rule allows."""
        rest_s = np.where(self.others.outside_s > 0, np.float32(OUTSIDE_STILL_S), np.float32(STILL_S))
        calm = shown & (self._shown_s >= STILL_S) & (self._still_s >= rest_s)
        body, unseen = shown & (self.others.body_s > 0), calm & (self.others.unseen_s >= STILL_S)
        if unseen.any():
            for blob in _blobs(shown, unseen):
                keeps_still = (blob & calm).sum() >= WHOLE * blob.sum()
                nobody = (blob & unseen).sum() >= MAJORITY * blob.sum()
                if keeps_still and nobody and (blob & body).sum() <= (1 - WHOLE) * blob.sum():
                    self._absorb_blob(image, blob & unseen)
        rested = shown & (np.minimum(self._still_s, self._shown_s) >= REST_S)
        if self._samples % round(REST_S / SAMPLE_S) == 0 and rested.any():
            # a person beside the place hides a part of the outline; first without persons, then with doubtful ones
            for blob in [*_blobs(shown & ~body, rested), *_blobs(shown, rested & body)]:
                if (blob & rested).sum() >= WHOLE * blob.sum() and self._was_taken_away(blob, image, background):
                    self._absorb_blob(image, blob)
                    self._gone |= blob

    def _was_taken_away(self, blob: Blocks, whole: Image, background: Background) -> bool:
        """Judge a blob by its outline and, unless the others say that nobody is there, by what is inside."""
        wide, beside = (cv2.dilate(blob.astype(np.uint8), np.ones((side, side), np.uint8)) for side in (5, 3))
        left, top, width, height = cv2.boundingRect(self._to_pixels(wide))
        box = top, left, top + height, left + width
        part = slice(top, top + height), slice(left, left + width)
        image, near = whole[part], self._to_pixels(beside)[part] > 0
        expected, (distance, _) = background.compare(whole, box, np.tile([0, width], (height, 1)))
        foreground = cv2.threshold(distance, background.threshold, 255, cv2.THRESH_BINARY)[1]
        self.clear_absorbed(whole, foreground, self._brightness, box=box)
        own = np.where(near, foreground, np.uint8(0))
        if not was_taken_away(own, foreground, image, expected, self._noise):
            return False
        nobody = (self.others.unseen_s[blob] >= REST_S).mean() >= WHOLE
        return bool(nobody) or is_calm_inside(own, image, self._noise)

    def _absorb_blob(self, image: Image, blob: Blocks) -> None:
        """Absorb a blob's blocks, and their static neighbours, as they look now."""
        around = cv2.dilate(blob.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        blocks = blob | (around & (self._still_s >= REST_S) & (self.others.body_s <= 0))
        if np.count_nonzero(blocks | self._absorbed) > MAJORITY * blocks.size:
            return
        pixels = self._to_pixels(blocks)
        self.mean[pixels], self.replaced[pixels] = image[pixels] / self._brightness, 255
        self._absorbed[blocks], self._learned_s[blocks] = True, 0.0
        self.absorbed += 1
        self._update_box()

    # --- giving back

    def _revert(self, image: Image, unlike_learned: Blocks, unexplained: Blocks, step_s: float) -> None:
        """Forget what was absorbed where the picture is as learned again, or where the others see a body in it.

        unlike_learned : blocks that differ from what was learned. unexplained : those that also differ from what was
        absorbed.
        """
        absorbed = self._absorbed
        matched = absorbed & unlike_learned & ~unexplained
        self._learned_s = np.where(absorbed & ~unlike_learned, self._learned_s + np.float32(step_s), np.float32(0))
        # a thing's own neighbours look as learned all the time; they go when the whole thing does
        beside = cv2.dilate((absorbed & unlike_learned).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        back = absorbed & (self._learned_s >= STILL_S) & ~beside
        self._denied_s = counted(self._denied_s, matched & self.others.sees_body & ~self._gone, step_s, COUNTED_S)
        back |= self._denied_s >= STILL_S
        if back.any():
            self._absorbed[back] = self._gone[back] = False
            self.replaced[self._to_pixels(back)] = 0
            self.reverted += int(cv2.connectedComponents(back.astype(np.uint8), connectivity=8)[0]) - 1
            self._update_box()
        # light moves on
        follows = self._to_pixels(matched & ~back & (self._still_s >= REST_S))
        if follows.any():
            share = np.float32(1.0 - np.exp(-step_s / REST_S))
            self.mean[follows] += share * (image[follows] / self._brightness - self.mean[follows])

    # --- pixels and blocks

    def _blocks_of(self, mask: Mask) -> npt.NDArray[np.uint8]:
        """Return the mean (0 to 255) of each block of a mask of samples (h, w)."""
        side = BLOCK_PX // STEP_PX
        height, width = (side * n for n in self.others.blocks)
        if mask.shape != (height, width):
            mask = cv2.copyMakeBorder(mask, 0, height - mask.shape[0], 0, width - mask.shape[1], cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(mask, (width // side, height // side), interpolation=cv2.INTER_AREA), np.uint8)

    def _to_pixels(self, blocks: npt.NDArray, side_px: int = BLOCK_PX) -> npt.NDArray:
        """Spread one value a block to the pixels (H, W), or to samples with other sides of the blocks."""
        return blocks.repeat(side_px, axis=0).repeat(side_px, axis=1)[: self._shape[0], : self._shape[1]]


def _blobs(blocks: Blocks, of_interest: Blocks) -> list[Blocks]:
    """Return the connected blobs of ``blocks`` that hold any ``of_interest``, the largest first, MOST_BLOBS at most."""
    count, labels = cv2.connectedComponents(blocks.astype(np.uint8), connectivity=8)
    sizes, wanted = (np.bincount(labels[kind], minlength=count) for kind in (blocks, blocks & of_interest))
    order = sorted((label for label in range(1, count) if wanted[label]), key=lambda label: -sizes[label])
    return [labels == label for label in order[:MOST_BLOBS]]


def _noise_limit(sigma: npt.NDArray[np.float32]) -> Mask:
    """Return by how many grey levels (H, W) uint8 noise of ``sigma`` makes a pixel differ at most."""
    return np.ceil(BEYOND_NOISE * sigma + 1.0).clip(0, 255).astype(np.uint8)
