"""Does the background still fit the room? Watched on a sparse grid of pixels, twice a second by the frames' stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from .background_model import BackgroundLimits, BackgroundModel
from .frame_checks import MIN_LIT_LEVEL, grid_step
from .frame_source import Image
from .places import Place, find_places
from .settings import BackgroundWatchSettings

LOOK_S = 0.5
DRIFT_TIME_S = 10.0  # the drift is the mean over about so long; a person passes faster
MAX_STEP_S = 2.0  # a gap between frames counts as this
NEAR_RATIO = 0.3  # a pixel that is brighter or darker by more shows something else than the background
LEAST_SEEN = 0.5  # of the lit pixels have to show the background, or the light is not measured
ALWAYS = 0.9  # of the time a pixel that is called static was foreground of one and the same grey level
FADE_TIME_S = 60.0  # that grey level may change with the light over about so long
SMALLEST_STATIC_PLACE = 2e-3  # of the grid's pixels: four or five of them


@dataclass(frozen=True)
class Watched:
    """What the watch has found so far.

    gain_drift : by which share the typical pixel is brighter than it was learned, on top of the drift that is followed;
        None until it was measured long enough.
    tolerance : the drift, as a share, at which half of all pixels would be foreground.
    static_share : share of the pixels that have been the same foreground for ``static_s`` at least.
    static_places : where those are.
    """

    gain_drift: float | None = None
    tolerance: float = math.inf
    static_share: float = 0.0
    static_places: tuple[Place, ...] = ()


class BackgroundWatch:
    """Follows how well the frames of an active camera still fit its background.

    Two figures are taken. The drift of the light is the median ratio, frame to background, of all lit pixels that may
    be background: somebody in the room covers the smaller part. Foreground that never moves is a pixel's share of the
    time in which it was foreground of one grey level, an exponential mean: a walking person covers no pixel for long,
    and whoever dances on the spot changes the pixels that they cover. Nothing is known of the wall clock: the same
    footage gives the same figures at every speed.
    """

    def __init__(
        self, background: BackgroundModel, limits: BackgroundLimits, settings: BackgroundWatchSettings | None = None
    ) -> None:
        """``limits``: the grey levels of the background in use; they may be moved in place by whoever follows drift."""
        settings = settings or BackgroundWatchSettings()
        self._step = grid_step(background.shape)
        self._grid = (slice(self._step // 2, None, self._step),) * 2
        self._limits = limits
        self._mean = background.mean[self._grid]
        self._lit = self._mean >= MIN_LIT_LEVEL
        self._half = (limits.hi[self._grid].astype(np.float32) - limits.lo[self._grid]) / 2
        relative = self._half[self._lit] / self._mean[self._lit]
        self._tolerance = float(np.median(relative)) if len(relative) else math.inf
        self._static_time_s = settings.static_s / -math.log(1 - ALWAYS)
        self._always = np.zeros(self._mean.shape[:2], np.float32)
        self._stays = self._mean.copy()  # the grey level that a pixel has had for some time
        self._drift, self._drift_s, self._last_ns = 0.0, 0.0, 0
        self.found = Watched(tolerance=self._tolerance)

    def look(self, image: Image, stamp_ns: int, gain: float = 1.0) -> None:
        """Take a frame (H, W) or (H, W, 3) of ``stamp_ns``; most are not looked at.

        gain : how much brighter than learned the scene is already taken to be.
        """
        if not self._last_ns or stamp_ns < self._last_ns:
            self._last_ns = stamp_ns
            return
        step_s = (stamp_ns - self._last_ns) * 1e-9
        if step_s < LOOK_S or image.shape != self._limits.lo.shape:
            return
        self._last_ns = stamp_ns
        step_s, seen = min(step_s, MAX_STEP_S), np.ascontiguousarray(image[self._grid])
        self._follow_light(seen, gain, step_s)
        self._follow_foreground(seen, step_s)
        self.found = self._summary()

    def _follow_light(self, seen: Image, gain: float, step_s: float) -> None:
        ratio = seen[self._lit] / (self._mean[self._lit] * np.float32(gain))
        near = np.abs(ratio - 1) < NEAR_RATIO
        if not len(ratio) or near.mean() < LEAST_SEEN:
            return
        self._drift_s += step_s
        weight = max(step_s / DRIFT_TIME_S, step_s / self._drift_s)  # a plain mean at first
        self._drift += min(weight, 1.0) * (float(np.median(ratio[near])) - 1 - self._drift)

    def _follow_foreground(self, seen: Image, step_s: float) -> None:
        lo, hi = (np.ascontiguousarray(limit[self._grid]) for limit in (self._limits.lo, self._limits.hi))
        change = seen - self._stays
        other = np.abs(change) > self._half
        self._stays += np.where(other, 1.0, min(step_s / FADE_TIME_S, 1.0)).astype(np.float32) * change
        changed = other if other.ndim == 2 else other.any(axis=2)
        same = (cv2.inRange(seen, lo, hi) == 0) & ~changed
        self._always += np.float32(-math.expm1(-step_s / self._static_time_s)) * (same - self._always)

    def _summary(self) -> Watched:
        static = self._always > ALWAYS
        places = find_places(static, SMALLEST_STATIC_PLACE, self._step) if static.any() else []
        known = self._drift_s >= DRIFT_TIME_S
        return Watched(self._drift if known else None, self._tolerance, float(static.mean()), tuple(places))
