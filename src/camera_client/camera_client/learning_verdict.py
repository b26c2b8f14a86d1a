"""Is a background that was just learned good enough to work with, and if not, what to do about it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig.verdict import REDO, USABLE, Finding, Verdict, judge

from .background_model import BackgroundModel
from .emptiness import judge_emptiness
from .frame_checks import MIN_LIT_LEVEL, WHITE_LEVEL, grid_sample
from .frame_source import Image
from .places import find_places, tell_places

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
                *judge_emptiness(model, before),
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
    places = find_places(model.moving_pixels)
    share = sum(place.share for place in places)
    if share <= MOVED_SHARE:
        return []
    what = tell_places(places, model.shape)
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
