"""The background of footage with people in it: what each pixel shows most of the time, and where that is not known.

Of a pixel's grey levels over time, the shortest interval that holds half of them (the shorth: Andrews et al., "Robust
Estimates of Location", 1972) is the background's as long as somebody stood there for less than half of the time. Where
a third of the time something else was seen, or no level came back, nothing is certain: the model's noise is as large as
the spread of all that was seen, so that a difference there says little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError

from ..frame_source import Image
from ..sources.frame_checks import MIN_LIT_LEVEL, grid_sample
from .model import SOFTWARE, BackgroundModel, Provenance

FEWEST_FRAMES = 20
SAME_SIGMAS = 4.0  # a level so near to the background's is the background's
CERTAIN_SHARE = 2 / 3  # of the time a background that is certain was seen
HALF_OF_NORMAL = 1.349  # sigmas that the middle half of a normal distribution spans
MOST_NOISY = 3.0  # times the typical noise: what varies more has several levels
BAND_ROWS = 64  # looked at together, so that memory stays small


def background_of_footage(frames: Sequence[Image], source: str) -> tuple[BackgroundModel, npt.NDArray[np.bool_]]:
    """Return the model of a scene that people walk through, and where (H, W) it is uncertain.

    frames : (H, W) or (H, W, 3) uint8, spread over the footage. Raises InputError for too few of them.
    """
    if len(frames) < FEWEST_FRAMES:
        what = f"{len(frames)} frames are too few to tell a background from the people before it"
        raise InputError(what, where=source, remedy=f"Give footage of at least {FEWEST_FRAMES} frames.")
    gains = _brightness(frames)
    mean, sigma = np.empty((2, *frames[0].shape), np.float32)
    uncertain = np.empty(frames[0].shape[:2], bool)
    for top in range(0, len(mean), BAND_ROWS):
        rows = slice(top, top + BAND_ROWS)
        levels = np.stack([frame[rows] / gain for frame, gain in zip(frames, gains, strict=True)]).astype(np.float32)
        mean[rows], sigma[rows], uncertain[rows] = _most_frequent(levels)
    noise = float(np.median(sigma[~uncertain])) if not uncertain.all() else float(np.median(sigma))
    return BackgroundModel(mean, sigma, Provenance(source, len(frames), noise, software=SOFTWARE)), uncertain


def _brightness(frames: Sequence[Image]) -> npt.NDArray[np.float32]:
    """Return how many times brighter each frame is than the median frame: exposure and white balance wander."""
    samples = np.stack([grid_sample(frame).astype(np.float32).reshape(-1) for frame in frames])
    typical = np.median(samples, axis=0)
    lit = typical >= MIN_LIT_LEVEL
    if not lit.any():
        return np.ones(len(frames), np.float32)
    return np.maximum(np.median(samples[:, lit] / typical[lit], axis=1), 0.1).astype(np.float32)


def _most_frequent(
    levels: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Return mean and standard deviation of what levels (n, h, w[, 3]) show most of the time, and where (h, w) that is
    uncertain."""
    n, half = len(levels), len(levels) // 2
    grey = levels if levels.ndim == 3 else levels.mean(axis=3)
    ordered = np.sort(grey, axis=0)
    widths = ordered[half:] - ordered[: n - half]
    first = widths.argmin(axis=0)[None]
    width = np.take_along_axis(widths, first, axis=0)[0]
    middle = 0.5 * (np.take_along_axis(ordered, first, axis=0) + np.take_along_axis(ordered, first + half, axis=0))[0]
    typical = max(float(np.median(width)) / HALF_OF_NORMAL, 0.5)
    near = np.abs(grey - middle) <= SAME_SIGMAS * np.clip(width / HALF_OF_NORMAL, typical, MOST_NOISY * typical)
    uncertain = near.mean(axis=0) < CERTAIN_SHARE
    weight = near.astype(np.float32)
    if levels.ndim == 4:
        weight = weight[..., None]
    count = np.maximum(weight.sum(axis=0), 1.0)
    mean = (weight * levels).sum(axis=0) / count
    sigma = np.sqrt((weight * (levels - mean) ** 2).sum(axis=0) / count)
    spread = levels.std(axis=0)
    unsure = uncertain if levels.ndim == 3 else uncertain[..., None]
    return mean, np.where(unsure, np.maximum(spread, sigma), sigma), uncertain
