"""Judges a background that was just learned: good, usable or redo, with reasons and remedies.

:func:`judge_background` measures the figures; :mod:`.causes` says what they mean. Was the room empty? A person who
stood still did not move, but was not in the background before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.verdict import Finding, Verdict, judge

from ..settings import BackgroundSettings
from ..sources.frame_checks import WHITE_LEVEL
from .adaptive import AdaptiveBackground
from .causes import find_causes
from .expected_image import samples_of
from .kernels import STEP_PX
from .model import BackgroundModel, Provenance

# Thresholds: judgement: no measurement beside the built rooms of test_camera_background_verdict.py, in which they hold.
BLACK_LEVEL, DIM_LEVEL = 16.0, 35.0  # grey levels of the brightest hundredth, of the typical pixel
THIN_OF_HEIGHT = 1 / 60  # narrower changes are edges that shifted a little
MOST_CHANGED = 0.3  # of the pixels; more is no person, but other lights or a camera that was moved


def judge_background(
    model: BackgroundModel, brightness: Sequence[float], before: BackgroundModel | None = None
) -> Verdict:
    """Judge ``model``.

    brightness : of each frame that it was learned from, relative to the first. before : the background to replace.
    """
    figures = _picture_figures(model) | _steadiness_figures(brightness)
    if before is not None and before.shape == model.shape:
        figures |= _changes(model, before)
    return judge(find_causes(figures))


def describe_background(model: BackgroundModel) -> str:
    """Return one line on a background: the verdict on it and where it comes from.

    One that was not learned here, but read from a film or a still, is judged by what can be seen of it.
    """
    about = model.provenance
    noise = "assumed" if about.frames == 1 else "mean"
    verdict = f"{about.verdict or judge_background(model, ())}; "
    turned = "".join(f"; {finding.line}" for finding in turn_findings(about))
    return (
        f"{verdict}{about.frames} frames of {about.source}, {noise} noise {about.mean_noise:.2f} grey levels, "
        f"{100 * model.moving_share:.2f} % of the pixels moved{turned}"
    )


def turn_findings(about: Provenance) -> tuple[Finding, ...]:
    """Return a finding on the background of a camera that was moved after its calibration."""
    return find_causes({"turn_deg": float(np.degrees(np.linalg.norm(about.turn_rad)))})


def _picture_figures(model: BackgroundModel) -> dict[str, Any]:
    """Return the figures of the picture itself: exposure, number of frames, movement, noise."""
    frames, level, noise = model.provenance.frames, float(np.median(model.mean)), float(np.median(model.sigma))
    moved, black = find_regions(model.moving_pixels), float(np.percentile(model.mean, 99)) <= BLACK_LEVEL
    figures: dict[str, Any] = {
        "black": black,
        "white_share": float((model.mean >= WHITE_LEVEL).mean()),
        "level": level,
        "dim_by": None if black else DIM_LEVEL - level,
        "moved_share": sum(region.share for region in moved),
        "moved_places": describe_regions(moved, model.shape),
        "frames": frames,
        "noise_error": (2 * (frames - 1)) ** -0.5 if frames > 1 else 1.0,
    }
    return figures if frames == 1 else figures | {"noise_levels": noise}


def _steadiness_figures(brightness: Sequence[float]) -> dict[str, Any]:
    if len(brightness) < 3:
        return {}
    values, time = np.array(brightness), np.linspace(-0.5, 0.5, len(brightness))
    slope, level = np.polyfit(time, values, 1)
    drift = float(slope / level)
    return {"flicker": float(np.std(values - level - slope * time) / level), "drift": drift, "drifted": abs(drift)}


def _changes(model: BackgroundModel, before: BackgroundModel) -> dict[str, Any]:
    """Return the regions of things that were not in the background ``before``."""
    created, changed = before.provenance.created, changed_regions(model, before)
    return {
        "since": f" of {created}" if created else " before",
        "changed_share": sum(region.share for region in changed),
        "changed_places": describe_regions(changed, model.shape),
    }


def changed_regions(model: BackgroundModel, before: BackgroundModel) -> list[ImageRegion]:
    """Return where ``model`` shows something else than the background ``before``, the largest region first.

    It is what ``before`` calls foreground in a frame that shows ``model``, whose light it follows. None where most of
    the picture changed, or its size did.
    """
    if model.shape != before.shape:
        return []
    frame = np.rint(model.mean).astype(np.uint8)
    samples, background = samples_of(frame), AdaptiveBackground(before, BackgroundSettings())
    background.update(frame, samples, 0)
    foreground = (background.distance(frame, samples) > background.threshold).astype(np.uint8)
    side = max(2 * round(THIN_OF_HEIGHT * len(foreground) / 2) + 1, 3)
    changed = cv2.morphologyEx(foreground, cv2.MORPH_OPEN, np.ones((side, side), np.uint8)) > 0
    return [] if changed.mean() > MOST_CHANGED else find_regions(np.asarray(changed), PERSON, STEP_PX)


# --- regions of the image: boxes around marked pixels, and words for them

BRIDGE_OF_HEIGHT = 1 / 30  # marked pixels this near to each other are one region
HAND = 2e-4  # of the squared image height, or of the pixels: a hand at 10 m is larger
PERSON = 15 * HAND  # a person seen from the side, half hidden, is larger
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


def find_regions(marked: npt.NDArray[np.bool_], smallest: float = HAND, step_px: int = 1) -> list[ImageRegion]:
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
