"""Finds what may be only shadow: by the floor's texture, and in colour images, anywhere, by the chromaticity.

A single camera decides what is most likely shadow (:class:`FloorShadow`, :class:`ColourShadow`), and writes into the
silhouette how dark everything is that might be floor in shadow (:class:`AttenuationMarker`); the hull server resolves
it with all cameras.
"""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.kernel import njit
from capture_rig.mask_levels import (
    ATTENUATED_LEVELS,
    ATTENUATION_EDGES,
    FLOOR_REACH_M,
    FOREGROUND,
    SHADOW_CANDIDATE,
    attenuation_step,
    candidate_level,
)
from capture_rig.rig import Volume

from ..background.kernels import F32, OPTIONS, WITHIN_NOISE
from ..background.training_verdict import HAND, PERSON
from ..frame_source import Image, Mask
from .evidence import COLOUR_SHARE, Scene
from .masks import Box, enlarged, halve, majority
from .texture import blocks_that_fit, lose_texture, shadow_sums, sum_by_label

# Thresholds: chosen by the silhouettes of shadows on rendered and real clips; python bench/rooms.py scores them today.
FLOOR_DARKEST, COLOUR_DARKEST = 0.45, ATTENUATION_EDGES[0]  # a shadow leaves at least this share of the brightness,
LIGHTEST = ATTENUATION_EDGES[-1]  # ... and at most this: less cannot be told from noise
PERSISTENCE = 0.3  # in a shadow at least this share of the floor's texture is still seen; smooth clothes show none
MIN_AREA = PERSON / 2  # share of height^2; smaller patches are not taken for shadow
TINT = 0.05  # share of the light that it lost by which a shadow is tinted: other lamps and walls have other colours
MIN_CONTRAST = 20.0  # sigmas; a background hardly brighter than black looks like dark clothes: colour tells nothing
GRID_PX = 8  # the floor's outline in the image needs no finer grid
MAX_FLOOR_DISTANCE_M = 20.0
BLOCK_OF_HEIGHT = 1 / 120  # sums are formed over square blocks of this share of the image height
MIN_WINDOW_PX = 5  # a window a pixel larger tells texture from brightness; 3 x 3 pixels hold too little texture
TEXTURE_BLOCKS = 7  # a square of so many blocks decides whether texture persists
PATCH_PERSISTENCE = 0.4, 1.5  # the whole patch keeps a share of it between these, ...
MIN_EVIDENCE_SIGMAS = 10.0  # ... and not by chance: a floor so plain that its texture could not be seen proves nothing
MIN_PATCH_WINDOWS = 10  # fewer windows agree by chance
SHADOW_REACH_M = 1.5  # around the capture volume: a person's shadow by a lamp at 50 degrees
WALL_DARKEST = 0.6  # a shadow off the floor leaves more: a hole in the person costs more than a shadow beside them
TEXTURE_WINDOW_PX = 9  # of the halved image
TEXTURE_LEFT = 0.1  # of a texture that noise does not hide, the share that shows it still there
HALVED_NOISE = 0.5  # of the variance is left in a mean of four pixels: neighbours are not independent (Bayer, codecs)
PATCH_SIGMAS, PATCH_LEFT = 2.0, 0.5  # half of its texture tells a shadow from none when it stands out by so many sigmas
LEAST_PATCH = 4 * HAND  # share of height^2, about a forearm: smaller patches are shadow only near larger ones
_THREE = np.ones((3, 3), np.uint8)


class FloorShadow:
    """Tells which foreground pixels of a grey image show only the floor in shadow.

    Around each pixel, in a small window, image x and background mu have means X and M; a = X / M is how much darker it
    is here. A shadow keeps the floor's texture, x - X = a (mu - M) + noise; a body covers it and brings its own. Two
    numbers tell them apart, summed over the neighbourhood where x is darker at all and the pixel's ray meets the floor
    (bodies above the horizon are never touched):

    - what is left, the mean square of (x - X) - a (mu - M), is noise in a shadow, and more on edges and textures;
    - the persistence, the regression of x - X on a (mu - M), is 1 in a shadow and 0 on smooth clothes.

    Both also hold for each connected patch as a whole, or the patch is none: by chance they hold in small ones. The
    border of a shadow, where windows reach out of it, is thin, and goes with its patch; so do pixels beside it that are
    as dark against the floor as it is there, where windows reach into the body.

    alignment_px : parts of the image that begin at multiples of this give what the whole image gives.
    """

    def __init__(self, camera: CameraModel, volume: Volume | None = None) -> None:
        """``volume``: the capture volume; far from it rays meet walls before the floor."""
        self.alignment_px = self._block = max(2 * round(BLOCK_OF_HEIGHT * camera.height / 2), 2)
        self._window = side = max(self._block + 1, MIN_WINDOW_PX)
        self._border = np.ones((2 * side + 1, 2 * side + 1), np.uint8)
        self._floor = floor_pixels(camera, volume, SHADOW_REACH_M)
        self._min_area_px = max(MIN_AREA * camera.height**2, MIN_PATCH_WINDOWS * side**2)

    def shadow(self, scene: Scene, mask: Mask) -> Mask:
        """255 at pixels of ``mask`` (h, w) where the image, in grey, fits the shadowed floor, else 0."""
        found, looked_at = np.zeros_like(mask), cv2.bitwise_and(mask, self._floor[scene.at])
        box, grey = Box.around(looked_at), scene.grey
        if not box.empty:
            at = box.grown(self._block, mask.shape, self._block).slices
            found[at] = self._patches(grey.image[at], grey.expected[at], mask[at], looked_at[at], grey.sigma)
        return found

    def _patches(self, image: Image, expected: np.ndarray, mask: Mask, looked_at: Mask, sigma: float) -> Mask:
        dark, sums = shadow_sums(image, expected, looked_at, self._window, self._block, FLOOR_DARKEST, LIGHTEST)
        found, blocks = np.zeros_like(mask), self._large_patches(sigma, sums)
        box = Box.around(blocks)
        if box.empty:
            return found
        box = Box(*(self._block * side for side in box)).grown(2 * len(self._border), mask.shape, self._block)
        part, halved, blocks = box.slices, box.divided(2).slices, blocks[box.divided(self._block).slices]
        looked_at, shape = looked_at[part], looked_at[part].shape
        candidates = cv2.bitwise_and(enlarged(dark[halved], 2, shape), looked_at)
        patches = cv2.bitwise_and(enlarged(blocks, self._block, shape), candidates)
        patches = cv2.morphologyEx(patches, cv2.MORPH_OPEN, _THREE)
        patches = cv2.bitwise_or(patches, self._borders(patches, candidates, mask[part]))
        rims = self._rims(image[part], expected[part], patches, looked_at, sigma)
        found[part] = cv2.bitwise_or(patches, rims)
        return found

    def _rims(self, image: Image, expected: np.ndarray, patches: Mask, looked_at: Mask, sigma: float) -> Mask:
        """Pixels beside a patch that are as dark, against the floor, as the patch is near them: windows that reach into
        the body fit nothing."""
        beside = cv2.bitwise_and(looked_at, cv2.subtract(cv2.dilate(patches, self._border), patches))
        own, seen, there = patches[::2, ::2] > 0, image[::2, ::2], expected[::2, ::2]
        X, M = (cv2.blur(np.where(own, each, np.float32(0)), self._border.shape) for each in (seen, there))
        off = X / np.maximum(M, np.float32(1e-3)) * there - seen
        near = np.where(np.abs(off) <= WITHIN_NOISE * sigma, np.uint8(255), np.uint8(0))
        fits = majority(cv2.bitwise_and(enlarged(near, 2, patches.shape), beside), 3)
        fits = cv2.morphologyEx(cv2.bitwise_or(fits, patches), cv2.MORPH_OPEN, _THREE)
        return cv2.bitwise_and(fits, looked_at)

    def _large_patches(self, sigma: float, sums: np.ndarray) -> Mask:
        """255 at the blocks of patches that are large and, as a whole, keep the floor's texture beyond chance."""
        limit, least_px = (WITHIN_NOISE * sigma) ** 2, 0.5 * self._block**2
        fits = blocks_that_fit(sums, limit, np.float32(PERSISTENCE), least_px, TEXTURE_BLOCKS // 2)
        patches, labels = cv2.connectedComponents(fits, connectivity=4)
        if patches == 1:
            return fits
        area_px, left, kept, there = np.zeros((4, patches))
        sum_by_label(labels, sums, (area_px, left, kept, there))
        least, most = PATCH_PERSISTENCE
        chance = np.sqrt(there * left / np.maximum(area_px, 1))  # standard deviation of `kept` if nothing were shared
        large = (area_px >= self._min_area_px) & (kept >= least * there) & (kept <= most * there)
        large &= kept >= MIN_EVIDENCE_SIGMAS * chance
        large[0] = False  # what does not fit
        return (large.view(np.uint8) * np.uint8(255))[labels]

    def _borders(self, patches: Mask, candidates: Mask, mask: Mask) -> Mask:
        """Candidates beside a patch that are too thin to be a part of a body."""
        rest = cv2.subtract(mask, patches)
        thin = cv2.subtract(rest, cv2.morphologyEx(rest, cv2.MORPH_OPEN, self._border))
        return cv2.bitwise_and(cv2.bitwise_and(thin, candidates), cv2.dilate(patches, self._border))


def floor_pixels(camera: CameraModel, volume: Volume | None = None, reach_m: float = 0.0) -> Mask:
    """(H, W) uint8: 255 where a pixel's ray meets the floor z = 0 within 20 m, else 0.

    With a ``volume``, only where it does so inside it or not farther than ``reach_m`` (and a pixel or two) around it.
    """
    u, v = np.meshgrid(np.arange(0, camera.width, GRID_PX), np.arange(0, camera.height, GRID_PX))
    rays = camera.rays_world(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(*u.shape, 3)
    height_m = camera.centre_world[2]
    meets = (height_m > 0) & (-rays[..., 2] * MAX_FLOOR_DISTANCE_M > height_m)
    if volume is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            floor_world = camera.centre_world[:2] - rays[..., :2] * (height_m / rays[..., 2:])
        low, high = volume.low[:2] - reach_m, volume.high[:2] + reach_m
        meets &= ((low <= floor_world) & (floor_world <= high)).all(axis=-1)
    grid = np.where(meets, np.uint8(255), np.uint8(0))
    if volume is not None:
        grid = cv2.dilate(grid, _THREE)  # the grid is coarse: rather a pixel too many
    return enlarged(grid, GRID_PX, (camera.height, camera.width))


# --- colour images


class ColourShadow:
    """Tells which foreground pixels of a colour image show only the background in shadow.

    With x the pixel, mu its background and s the noise's sigma, the brightness factor is the a that minimises
    sum ((x - a mu) / s)^2 over the channels, and the chromaticity distance is the root of that minimum (Horprasert,
    Harwood and Davis 1999, eq. 4-6). A shadow is lit by other surfaces, whose colour differs from the lamp's: what it
    lost of the light may be tinted by a share of it. Most clothes are grey, or nearly black: where the background is
    so too, all of them have the colour of its shadow, and colour says nothing. There the floor's texture decides, as
    in a mono image (:class:`FloorShadow`).

    The test runs at half resolution, on means of 2 x 2 pixels: Bayer sensors and 4:2:0 video hold no finer colour.
    """

    def __init__(self, camera: CameraModel, volume: Volume | None = None) -> None:
        """``volume``: the capture volume; far from it rays meet walls before the floor."""
        self._floor_shadow = FloorShadow(camera, volume)
        self.alignment_px = self._floor_shadow.alignment_px
        self._near = np.ones((2 * TEXTURE_WINDOW_PX + 1,) * 2, np.uint8)
        on_floor = halve(floor_pixels(camera, volume, SHADOW_REACH_M)) > 127
        self._darkest = np.where(on_floor, np.float32(COLOUR_DARKEST), np.float32(WALL_DARKEST))

    def shadow(self, scene: Scene, mask: Mask) -> Mask:
        """255 at pixels of ``mask`` (h, w) where the colour image fits the shadowed background, else 0."""
        half = halve(mask)
        top, left = scene.at[0].start // 2, scene.at[1].start // 2
        darkest = self._darkest[top : top + half.shape[0], left : left + half.shape[1]]
        noise = np.stack([scene.noise.read, scene.noise.slope]) * HALVED_NOISE
        codec_variance = np.zeros((0, 0), np.float32)
        if scene.codec_sigma is not None:
            codec_variance = np.square(np.float32(COLOUR_SHARE) * halve(scene.codec_sigma))
        found = find_darkened(scene.image, scene.expected, half, noise, codec_variance, darkest)
        found = cv2.morphologyEx(found, cv2.MORPH_OPEN, _THREE)  # the person's edge is a blend that looks like shadow
        self._drop_lost_texture(scene, found)
        found = cv2.bitwise_and(enlarged(found, 2, mask.shape), mask)
        return cv2.bitwise_or(found, self._floor_shadow.shadow(scene, mask))

    def _drop_lost_texture(self, scene: Scene, found: Mask) -> None:
        """Write 0 into ``found`` where the background has a texture that the image lost, at a pixel or in a patch as
        a whole: something stands before it; and where a patch is small and alone."""
        box = Box.around(found)
        if box.empty:
            return
        box = box.grown(TEXTURE_WINDOW_PX, found.shape)
        part, both = found[box.slices], tuple(slice(2 * side.start, 2 * side.stop) for side in box.slices)
        image, expected = scene.grey.image[both], scene.grey.expected[both]
        variance = HALVED_NOISE * scene.sigma**2
        sums = np.zeros((4, *part.shape), np.float32)
        lose_texture(image, expected, part, TEXTURE_WINDOW_PX, WITHIN_NOISE**2 * variance, TEXTURE_LEFT, sums)
        count, labels = cv2.connectedComponents(part, connectivity=4)
        area, _, shared, power = per_label = np.zeros((4, count))
        sum_by_label(labels, sums, tuple(per_label))
        lost = (power > (PATCH_SIGMAS / PATCH_LEFT) ** 2 * variance) & (shared < PATCH_LEFT * power)
        large = ~lost & (area >= LEAST_PATCH * self._darkest.shape[0] ** 2)
        large[0] = True  # what is in no patch
        if large.all():
            return
        large[0] = False
        near = cv2.dilate(large.view(np.uint8)[labels], self._near)
        beside = np.zeros(count, bool)
        beside[labels[near > 0]] = True
        part[(lost | ~beside)[labels]] = 0


@njit(**OPTIONS, crops=True)
def find_darkened(image, expected, mask, noise, codec_variance, darkest):  # type: ignore[no-untyped-def]
    """Return (h, w) uint8: 255 where the colour of 2 x 2 pixels is that of the darkened background, else 0.

    image (2 h, 2 w, 3) uint8, expected (2 h, 2 w, 3) float32; mask (h, w) uint8 : not 0 at what is looked at. An odd
    side is continued. noise (2, 3) : read and slope, as of :class:`..background.noise.Noise`; codec_variance (h, w) :
    variance beyond it, or (0, 0). darkest (h, w) float32 : share of the brightness that is left at least.

    Grey clothes as bright must differ from it by more than it may differ itself; see :class:`ColourShadow`.
    """
    bottom, right = image.shape[0] - 1, image.shape[1] - 1
    found = np.zeros(mask.shape, np.uint8)
    x, mu, variance = np.empty(3), np.empty(3), np.empty(3)
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            if mask[i, j] == 0:
                continue
            more = codec_variance[i, j] if codec_variance.size else F32(0)
            power = shared = 0.0
            for c in range(3):
                y, v, z, w = 2 * i, 2 * j, min(2 * i + 1, bottom), min(2 * j + 1, right)
                x[c] = 0.25 * (F32(image[y, v, c]) + F32(image[y, w, c]) + F32(image[z, v, c]) + F32(image[z, w, c]))
                mu[c] = 0.25 * (expected[y, v, c] + expected[y, w, c] + expected[z, v, c] + expected[z, w, c])
                variance[c] = noise[0, c] + noise[1, c] * mu[c] + more
                power += mu[c] * mu[c] / variance[c]
                shared += x[c] * mu[c] / variance[c]
            factor = shared / max(power, 1e-9)
            if power < MIN_CONTRAST**2 or factor < darkest[i, j] or factor > LIGHTEST:
                continue
            distance2 = grey2 = 0.0
            mean = (mu[0] + mu[1] + mu[2]) / 3.0
            for c in range(3):
                tint, departure = TINT * (1.0 - factor) * mu[c], x[c] - factor * mu[c]
                distance2 += departure * departure / (variance[c] + tint * tint)
                departure = factor * (mean - mu[c])
                grey2 += departure * departure / (variance[c] + tint * tint)
            if distance2 <= WITHIN_NOISE**2 < grey2:
                found[i, j] = 255
    return found


# --- how dark everything is that may be floor in shadow: several cameras can tell, one cannot

RATIO_SCALE = 200.0  # grey levels that stand for an unchanged brightness: steps of half a percent
ALIGNMENT_PX = 2


class AttenuationMarker:
    """Writes into a silhouette how dark everything is that may be floor in shadow (``capture_rig.mask_levels``).

    A single camera cannot tell a dark sock from the shadow beside it. Several can: shadow lies on the floor, where all
    cameras see the same place equally dark. So every shadow candidate, and every pixel of the person whose ray meets
    the floor, says how bright it is, as a share of what the background was, in few steps. Brightness is the mean of
    2 x 2 pixels, of colours with BT.601's weights: wider windows would mix legs with the shadow beside them.
    """

    def __init__(self, camera: CameraModel, volume: Volume | None = None) -> None:
        """``volume``: the capture volume; pixels whose ray meets the floor far from it stay the person."""
        self._floor = floor_pixels(camera, volume, FLOOR_REACH_M)
        steps = [attenuation_step(ratio / RATIO_SCALE) for ratio in range(256)]
        attenuated = [FOREGROUND if step is None else ATTENUATED_LEVELS[step] for step in steps]
        candidate = [SHADOW_CANDIDATE if step is None else candidate_level(step) for step in steps]
        self._levels = np.array([attenuated, candidate], np.uint8)

    def mark(self, scene: Scene, person: Mask, candidates: Mask) -> Mask:
        """Return the levels (h, w) of ``person`` and ``candidates``, both 0 or 255; what is both is the person."""
        grey, levels = scene.grey, person.copy()
        mark_attenuation(grey.image, grey.expected, person, candidates, self._floor[scene.at], self._levels, levels)
        return levels


@njit(**OPTIONS, crops=True)
def mark_attenuation(image, expected, person, candidates, floor, levels, out):  # type: ignore[no-untyped-def]
    """Write levels into ``out`` (h, w) at candidates and where the person may be floor, by 2 x 2 pixels' brightness.

    image (h, w) uint8, expected (h, w) float32, the part's first row and column being even; person, candidates, floor
    (h, w) uint8 : not 0. levels (2, 256) : of the person and of candidates, RATIO_SCALE times as bright as expected.
    """
    height, width = person.shape
    wanted = np.empty(width, np.uint8)
    for y in range(0, height, ALIGNMENT_PX):
        z = min(y + 1, height - 1)
        above, below = candidates[y], candidates[z]
        for x in range(width):
            wanted[x] = above[x] | below[x] | (person[y, x] & floor[y, x]) | (person[z, x] & floor[z, x])
        for x in range(0, width, ALIGNMENT_PX):
            w = min(x + 1, width - 1)
            if wanted[x] | wanted[w] == 0:
                continue
            seen = np.float32(image[y, x]) + np.float32(image[y, w]) + np.float32(image[z, x]) + np.float32(image[z, w])
            there = max(expected[y, x] + expected[y, w] + expected[z, x] + expected[z, w], np.float32(4))
            ratio = int(min(np.float32(RATIO_SCALE) * seen / there + np.float32(0.5), np.float32(255)))
            for v, u in ((y, x), (y, w), (z, x), (z, w)):
                if person[v, u]:
                    out[v, u] = levels[0, ratio] if floor[v, u] else FOREGROUND
                elif candidates[v, u]:
                    out[v, u] = levels[1, ratio]
