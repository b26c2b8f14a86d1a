"""Is a background that was just learned good enough to work with, and if not, what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.verdict import REDO, USABLE, Finding, Verdict, judge

from ..frame_source import Image
from ..sources.frame_checks import MIN_LIT_LEVEL, WHITE_LEVEL, grid_sample
from .model import BackgroundModel

# --- Where in the image something is: boxes around what was marked, and words for them.

BRIDGE_OF_HEIGHT = 1 / 30  # what is marked this near to each other is one place
SMALLEST_PLACE = 2e-4  # of the pixels; fewer are marked by chance
MAX_PLACES = 3


@dataclass(frozen=True)
class ImageRegion:
    """A box of columns ``left`` to ``right`` and rows ``top`` to ``bottom``, px; ``share`` of the image is marked."""

    left: int
    right: int
    top: int
    bottom: int
    share: float

    def __str__(self) -> str:
        return f"{self.left}..{self.right}, {self.top}..{self.bottom}: {100 * self.share:.1f} %"


def find_regions(
    marked: npt.NDArray[np.bool_], smallest: float = SMALLEST_PLACE, step_px: int = 1
) -> list[ImageRegion]:
    """Where ``marked`` (h, w) is true, the largest place first.

    smallest : share of the pixels below which a place is left out.
    step_px : ``marked`` has a pixel for each square of so many of the image, whose pixels the boxes are given in.
    """
    mask = marked.astype(np.uint8)
    reach = 2 * round(BRIDGE_OF_HEIGHT * mask.shape[0] / 2) + 1
    together = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(together)
    pixels = np.bincount(labels[mask > 0], minlength=count)
    places = []
    for label in sorted(range(1, count), key=lambda label: -pixels[label]):
        if pixels[label] < smallest * mask.size:
            break
        x, y, width, height = (step_px * int(n) for n in stats[label][:4])
        places.append(ImageRegion(x, x + width - 1, y, y + height - 1, float(pixels[label] / mask.size)))
    return places


def describe_regions(places: Sequence[ImageRegion], shape: tuple[int, ...]) -> str:
    """ "lower left at 5..43, 70..109: 8.1 %" for the largest of ``places`` in an image of ``shape``."""
    what = ", ".join(f"{_whereabouts(place, shape)} at {place}" for place in places[:MAX_PLACES])
    if len(places) <= MAX_PLACES:
        return what
    return f"{len(places)} places ({100 * sum(place.share for place in places):.1f} %), the largest {what}"


def _whereabouts(place: ImageRegion, shape: tuple[int, ...]) -> str:
    """ "lower left" for a box there; thirds of the image."""
    row = ("upper", "", "lower")[min(int(1.5 * (place.top + place.bottom) / shape[0]), 2)]
    column = ("left", "", "right")[min(int(1.5 * (place.left + place.right) / shape[1]), 2)]
    return f"{row} {column}".strip() or "in the middle"


# --- Was the room empty while the background was learned? Who stood still did not move, but was not there before.

CHANGE_LEVELS, CHANGE_SIGMAS = 10.0, 5.0  # a pixel shows something else when it differs by as much as both say
THIN_OF_HEIGHT = 1 / 60  # narrower changes are edges that shifted a little
SMALLEST_CHANGE = 2e-3  # of the pixels; a person who is far away covers more
MOST_CHANGED = 0.3  # of the pixels; more is no person, but other lights or a camera that was moved


def changed_regions(model: BackgroundModel, before: BackgroundModel) -> list[ImageRegion]:
    """Where ``model`` shows something else than the background ``before``, the largest place first.

    The light may be brighter or darker as a whole. None where most of the picture changed, or its size did.
    """
    if model.shape != before.shape:
        return []
    lit = before.mean >= MIN_LIT_LEVEL
    gain = float(np.median(model.mean[lit] / before.mean[lit])) if lit.any() else 1.0
    if gain <= 0:
        return []
    change = np.abs(model.mean / gain - before.mean)
    differs = change > np.maximum(CHANGE_LEVELS, CHANGE_SIGMAS * np.hypot(model.sigma / gain, before.sigma))
    differs &= np.maximum(model.mean, gain * before.mean) < WHITE_LEVEL  # what was cut off cannot be compared
    changed = _without_thin(differs if differs.ndim == 2 else differs.any(axis=2))
    return [] if changed.mean() > MOST_CHANGED else find_regions(changed, SMALLEST_CHANGE)


def emptiness_findings(model: BackgroundModel, before: BackgroundModel | None) -> list[Finding]:
    """A finding where something stands that the background ``before`` did not have."""
    places = [] if before is None else changed_regions(model, before)
    if before is None or not places:
        return []
    since = f" of {before.provenance.created}" if before.provenance.created else ""
    what = f"something else than in the background{since}: {describe_regions(places, model.shape)}"
    remedy = "if somebody stood there, clear the room and learn again; moved furniture is all right"
    return [Finding(USABLE, what, remedy)]


def _without_thin(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    side = max(2 * round(THIN_OF_HEIGHT * mask.shape[0] / 2) + 1, 3)
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray(opened > 0)


FEW_FRAMES = 25  # sigma is known to 14 %
HIGH_NOISE, LOW_NOISE = 6.0, 0.3  # grey levels, of the typical pixel
MOVED_SHARE, MOVED_MUCH_SHARE = 0.001, 0.02  # of the pixels
WHITE_SHARE, WHITE_MUCH_SHARE = 0.02, 0.3
BLACK_LEVEL, DIM_LEVEL = 16.0, 35.0  # grey levels of the brightest hundredth, of the typical pixel
FLICKER, DRIFT = 0.01, 0.03  # relative: standard deviation between frames, change from first to last


class LearningJudge:
    """Watches the frames that a background is learned from, and judges it."""

    def __init__(self) -> None:
        self._first: npt.NDArray[np.float32] | None = None
        self._brightness: list[float] = []  # of each frame, relative to the first

    def add(self, image: Image) -> None:
        """Take one frame (H, W) or (H, W, 3)."""
        sample = grid_sample(image).astype(np.float32)
        if self._first is None:
            self._first = sample
        if sample.shape == self._first.shape:
            lit = self._first >= MIN_LIT_LEVEL
            self._brightness.append(float(np.median(sample[lit] / self._first[lit])) if lit.any() else 1.0)

    def verdict(self, model: BackgroundModel, before: BackgroundModel | None = None) -> Verdict:
        """On the model learned from the frames so far; ``before`` is the background that it is to replace."""
        return judge(
            [
                *_light(model),
                *_frames(model),
                *_moved(model),
                *emptiness_findings(model, before),
                *_noise(model),
                *_steadiness(self._brightness),
            ]
        )


def _light(model: BackgroundModel) -> list[Finding]:
    if float(np.percentile(model.mean, 99)) <= BLACK_LEVEL:
        return [Finding(REDO, "the image is black", "take the lens cap off, or switch the light on")]
    white, found = float((model.mean >= WHITE_LEVEL).mean()), []
    if white > WHITE_SHARE:
        found.append(
            Finding(
                REDO if white > WHITE_MUCH_SHARE else USABLE,
                f"{100 * white:.0f} % of the image is white",
                "shorten the exposure or lower the gain",
            )
        )
    typical = float(np.median(model.mean))
    if typical < DIM_LEVEL:
        found.append(
            Finding(
                USABLE,
                f"the image is dim, {typical:.0f} grey levels on the median",
                "lengthen the exposure, open the iris, or add light",
            )
        )
    return found


def _frames(model: BackgroundModel) -> list[Finding]:
    frames = model.provenance.frames
    if frames >= FEW_FRAMES:
        return []
    error = 100 / np.sqrt(2 * max(frames - 1, 1))
    return [Finding(USABLE, f"{frames} frames tell the noise to {error:.0f} % only", "set background_frames to 100")]


def _moved(model: BackgroundModel) -> list[Finding]:
    places = find_regions(model.moving_pixels)
    share = sum(place.share for place in places)
    if share <= MOVED_SHARE:
        return []
    what = describe_regions(places, model.shape)
    return [
        Finding(
            REDO if share > MOVED_MUCH_SHARE else USABLE,
            f"something moved: {what}",
            "clear the scene, see that the camera stands firm, and call again",
        )
    ]


def _noise(model: BackgroundModel) -> list[Finding]:
    typical = float(np.median(model.sigma))
    if typical > HIGH_NOISE:
        return [
            Finding(
                USABLE,
                f"the noise is high, {typical:.1f} grey levels on the median",
                "lower the gain and add light; check that the camera stands firm",
            )
        ]
    if typical < LOW_NOISE:
        return [
            Finding(
                USABLE,
                f"the noise is suspiciously low, {typical:.2f} grey levels on the median",
                "check that the camera sends new pictures and does not smooth them",
            )
        ]
    return []


def _steadiness(brightness: list[float]) -> list[Finding]:
    if len(brightness) < 3:
        return []
    values, time = np.array(brightness), np.linspace(-0.5, 0.5, len(brightness))
    slope, level = np.polyfit(time, values, 1)
    flicker, drift, found = float(np.std(values - level - slope * time) / level), float(slope / level), []
    if flicker > FLICKER:
        found.append(
            Finding(
                USABLE,
                f"the brightness flickers by {100 * flicker:.1f} %",
                "expose for whole periods of the lamps: 10 ms at 50 Hz, 8.33 ms at 60 Hz",
            )
        )
    if abs(drift) > DRIFT:
        found.append(
            Finding(
                USABLE,
                f"the brightness changed by {100 * drift:+.1f} % while it was learned",
                "wait until lamps are warm and automatic exposure is off",
            )
        )
    return found
