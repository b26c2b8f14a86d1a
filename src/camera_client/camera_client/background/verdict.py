"""Judges a background that was just learned: good, usable or redo, with reasons and remedies.

The recipe is :func:`judge_background`. Each finding looks for one fault: black, white or dim picture, too few frames,
movement while it was learned, a person who stood still all the time (against the background before), noise, and lamps
that flicker or warm up. The thresholds were set on rendered and recorded rooms: tests/test_camera_background_verdict.py
holds what each has to find and has to pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.verdict import GOOD, REDO, USABLE, Finding, Verdict, judge

from ..sources.frame_checks import MIN_LIT_LEVEL, WHITE_LEVEL
from .model import BackgroundModel, Provenance

# Thresholds: FEW_FRAMES from the noise of a standard deviation, 1/sqrt(2 (n - 1)) = 14 %; else chosen with the rooms
# of test_camera_background_verdict.py.
FEW_FRAMES = 25  # sigma is known to 14 %
HIGH_NOISE, LOW_NOISE = 6.0, 0.3  # grey levels, of the typical pixel
MOVED_SHARE, MOVED_MUCH_SHARE = 0.001, 0.02  # of the pixels
WHITE_SHARE, WHITE_MUCH_SHARE = 0.02, 0.3
BLACK_LEVEL, DIM_LEVEL = 16.0, 35.0  # grey levels of the brightest hundredth, of the typical pixel
FLICKER, DRIFT = 0.01, 0.03  # relative: standard deviation between frames, change from first to last
LIGHT_CHANGED = 0.05  # relative: more than lamps and mains do by themselves
NOISE_GREW = 2.0  # times: faint clothes need twice the contrast
REPORTED_TURN_DEG = 0.2  # as the default of camera_moved.limit_deg


def judge_background(
    model: BackgroundModel, brightness: Sequence[float], before: BackgroundModel | None = None
) -> Verdict:
    """Judge ``model``.

    brightness : of each frame that it was learned from, relative to the first. before : the background to replace.
    """
    return judge(
        [
            *_exposure_findings(model),
            *_frame_count_findings(model),
            *_movement_findings(model),
            *_emptiness_findings(model, before),
            *_light_findings(model, before),
            *_noise_findings(model),
            *_steadiness_findings(brightness),
        ]
    )


def describe_background(model: BackgroundModel) -> str:
    """Return one line on a background: the verdict on it and where it comes from.

    One that was not learned here, but read from a film or a still, is judged by what can be seen of it.
    """
    about = model.provenance
    noise = "assumed" if about.frames == 1 else "mean"
    verdict = f"{about.verdict or judge_background(model, ())}; "
    turned = "".join(f"; {finding.what}: {finding.remedy}" for finding in turn_findings(about))
    return (
        f"{verdict}{about.frames} frames of {about.source}, {noise} noise {about.mean_noise:.2f} grey levels, "
        f"{100 * model.moving_share:.2f} % of the pixels moved{turned}"
    )


def turn_findings(about: Provenance) -> tuple[Finding, ...]:
    """Return a finding on the background of a camera that was moved after its calibration."""
    turn_deg = float(np.degrees(np.linalg.norm(about.turn_rad)))
    if turn_deg < REPORTED_TURN_DEG:
        return ()
    what = f"since it was calibrated the camera has turned by {turn_deg:.1f} degrees"
    return (Finding(USABLE, what, "calibrate it again", "moved.turned"),)


def _exposure_findings(model: BackgroundModel) -> list[Finding]:
    if float(np.percentile(model.mean, 99)) <= BLACK_LEVEL:
        return [Finding(REDO, "the image is black", "take the lens cap off, or switch the light on", "levels.black")]
    found = []
    white, typical = float((model.mean >= WHITE_LEVEL).mean()), float(np.median(model.mean))
    if white > WHITE_SHARE:
        grade = REDO if white > WHITE_MUCH_SHARE else USABLE
        what = f"{100 * white:.0f} % of the image is white"
        found.append(Finding(grade, what, "shorten the exposure or lower the gain", "levels.white"))
    if typical < DIM_LEVEL:
        what = f"the image is dim, {typical:.0f} grey levels on the median"
        found.append(Finding(USABLE, what, "lengthen the exposure, open the iris, or add light", "levels.dim"))
    return found


def _frame_count_findings(model: BackgroundModel) -> list[Finding]:
    frames = model.provenance.frames
    if frames >= FEW_FRAMES:
        return []
    what = f"{frames} frames measure the noise to {100 / np.sqrt(2 * max(frames - 1, 1)):.0f} % only"
    if frames == 1:
        what = "a single picture does not tell the noise, which is assumed"
    return [Finding(USABLE, what, "set background_frames to 100", "training.few_frames")]


def _movement_findings(model: BackgroundModel) -> list[Finding]:
    regions = find_regions(model.moving_pixels)
    share = sum(region.share for region in regions)
    if share <= MOVED_SHARE:
        return []
    grade = REDO if share > MOVED_MUCH_SHARE else USABLE
    what = f"something moved: {describe_regions(regions, model.shape)}"
    remedy = "clear the scene, see that the camera stands firm, and call again"
    return [Finding(grade, what, remedy, "training.movement")]


def _noise_findings(model: BackgroundModel) -> list[Finding]:
    typical = float(np.median(model.sigma))
    if model.provenance.frames == 1:
        return []
    if typical > HIGH_NOISE:
        what = f"the noise is high, {typical:.1f} grey levels on the median"
        return [Finding(USABLE, what, "lower the gain and add light; check that the camera stands firm", "noise.high")]
    if typical < LOW_NOISE:
        what = f"the noise is suspiciously low, {typical:.2f} grey levels on the median"
        remedy = "check that the camera sends new pictures and does not smooth them"
        return [Finding(USABLE, what, remedy, "noise.low")]
    return []


def _steadiness_findings(brightness: Sequence[float]) -> list[Finding]:
    if len(brightness) < 3:
        return []
    values, time = np.array(brightness), np.linspace(-0.5, 0.5, len(brightness))
    slope, level = np.polyfit(time, values, 1)
    flicker, drift, found = float(np.std(values - level - slope * time) / level), float(slope / level), []
    if flicker > FLICKER:
        what = f"the brightness flickers by {100 * flicker:.1f} %"
        remedy = "expose for whole periods of the lamps: 10 ms at 50 Hz, 8.33 ms at 60 Hz"
        found.append(Finding(USABLE, what, remedy, "light.flicker"))
    if abs(drift) > DRIFT:
        what = f"the brightness changed by {100 * drift:+.1f} % while it was learned"
        remedy = "wait until lamps are warm and automatic exposure is off"
        found.append(Finding(USABLE, what, remedy, "light.drift"))
    return found


# --- was the room empty? A person who stood still did not move, but was not in the background before

CHANGE_LEVELS, CHANGE_SIGMAS = 10.0, 5.0  # a pixel shows something else when it differs by as much as both say
THIN_OF_HEIGHT = 1 / 60  # narrower changes are edges that shifted a little
SMALLEST_CHANGE = 2e-3  # of the pixels; a person who is far away covers more
MOST_CHANGED = 0.3  # of the pixels; more is no person, but other lights or a camera that was moved


def _emptiness_findings(model: BackgroundModel, before: BackgroundModel | None) -> list[Finding]:
    """Return a finding where something stands that the background ``before`` did not have."""
    regions = [] if before is None else changed_regions(model, before)
    if before is None or not regions:
        return []
    since = f" of {before.provenance.created}" if before.provenance.created else ""
    what = f"something else than in the background{since}: {describe_regions(regions, model.shape)}"
    remedy = "if a person stood there, clear the room and learn again; moved furniture is all right"
    return [Finding(USABLE, what, remedy, "training.something_else")]


def changed_regions(model: BackgroundModel, before: BackgroundModel) -> list[ImageRegion]:
    """Return where ``model`` shows something else than the background ``before``, the largest region first.

    The light may be brighter or darker as a whole. None where most of the picture changed, or its size did.
    """
    if model.shape != before.shape:
        return []
    gain = light_gain(model, before)
    if gain <= 0:
        return []
    change = np.abs(model.mean / gain - before.mean)
    differs = change > np.maximum(CHANGE_LEVELS, CHANGE_SIGMAS * np.hypot(model.sigma / gain, before.sigma))
    differs &= np.maximum(model.mean, gain * before.mean) < WHITE_LEVEL  # what was cut off cannot be compared
    mask = (differs if differs.ndim == 2 else differs.any(axis=2)).astype(np.uint8)
    side = max(2 * round(THIN_OF_HEIGHT * mask.shape[0] / 2) + 1, 3)
    changed = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((side, side), np.uint8)) > 0
    return [] if changed.mean() > MOST_CHANGED else find_regions(np.asarray(changed), SMALLEST_CHANGE)


def light_gain(model: BackgroundModel, before: BackgroundModel) -> float:
    """Return how many times brighter than ``before`` the scene is: the median of all lit pixels."""
    lit = before.mean >= MIN_LIT_LEVEL
    return float(np.median(model.mean[lit] / before.mean[lit])) if lit.any() else 1.0


def _light_findings(model: BackgroundModel, before: BackgroundModel | None) -> list[Finding]:
    """Return what changed of light and noise since the background before: worth knowing, and no fault."""
    if before is None or model.shape != before.shape:
        return []
    gain, found = light_gain(model, before), []
    since = f" of {before.provenance.created}" if before.provenance.created else " before"
    if abs(gain - 1) > LIGHT_CHANGED:
        kind = "brighter" if gain > 1 else "darker"
        what = f"the light is {100 * abs(gain - 1):.0f} % {kind} than in the background{since}"
        found.append(Finding(GOOD, what, "nothing is to be done", f"light.{kind}"))
    if min(model.provenance.frames, before.provenance.frames) >= FEW_FRAMES:
        times = float(np.median(model.sigma)) / max(float(np.median(before.sigma)), LOW_NOISE)
        if times > NOISE_GREW:
            what = f"the noise is {times:.1f} times that of the background{since}"
            found.append(Finding(GOOD, what, "less gain, more light, a higher bit rate of a codec", "noise.higher"))
    return found


# --- regions of the image: boxes around marked pixels, and words for them

BRIDGE_OF_HEIGHT = 1 / 30  # marked pixels this near to each other are one region
SMALLEST_REGION = 2e-4  # of the pixels; fewer are marked by chance
MAX_REGIONS = 3


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

    def whereabouts(self, shape: tuple[int, ...]) -> str:
        """ "lower left" of an image of that shape; in thirds."""
        row = ("upper", "", "lower")[min(int(1.5 * (self.top + self.bottom) / shape[0]), 2)]
        column = ("left", "", "right")[min(int(1.5 * (self.left + self.right) / shape[1]), 2)]
        return f"{row} {column}".strip() or "in the middle"


def find_regions(
    marked: npt.NDArray[np.bool_], smallest: float = SMALLEST_REGION, step_px: int = 1
) -> list[ImageRegion]:
    """Return where ``marked`` (h, w) is true, the largest region first.

    smallest : share of the pixels below which a region is left out.
    step_px : ``marked`` has a pixel for each square of so many of the image, whose pixels the boxes are given in.
    """
    mask = marked.astype(np.uint8)
    reach = 2 * round(BRIDGE_OF_HEIGHT * mask.shape[0] / 2) + 1
    together = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(together)
    pixels = np.bincount(labels[mask > 0], minlength=count)
    regions = []
    for label in sorted(range(1, count), key=lambda label: -pixels[label]):
        if pixels[label] < smallest * mask.size:
            break
        x, y, width, height = (step_px * int(n) for n in stats[label][:4])
        regions.append(ImageRegion(x, x + width - 1, y, y + height - 1, float(pixels[label] / mask.size)))
    return regions


def describe_regions(regions: Sequence[ImageRegion], shape: tuple[int, ...]) -> str:
    """ "lower left at 5..43, 70..109: 8.1 %" for the largest of ``regions`` in an image of ``shape``."""
    what = ", ".join(f"{region.whereabouts(shape)} at {region}" for region in regions[:MAX_REGIONS])
    if len(regions) <= MAX_REGIONS:
        return what
    return f"{len(regions)} places ({100 * sum(region.share for region in regions):.1f} %), the largest {what}"
