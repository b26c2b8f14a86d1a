"""Watches whether the background still fits the room, on a sparse grid of pixels, twice a second by the frames' stamps.

:class:`BackgroundWatch` measures; :func:`concerns` says what speaks against the background in use, with remedies. The
thresholds were chosen on the rooms of test/test_camera_background_watch.py: people who walk, jog and stand, and lamps.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from capture_rig.stamps import StampThrottle
from capture_rig.verdict import REDO, USABLE, Finding

from ..frame_source import Image, Mask
from ..settings import BackgroundWatchSettings
from ..sources.frame_checks import MIN_LIT_LEVEL, grid_step
from .adaptation.light import MOST_GAIN
from .model import BackgroundLimits, BackgroundModel, Provenance
from .verdict import ImageRegion, describe_regions, find_regions

PERIOD_S = 0.5
# Thresholds: chosen with the rooms of test_camera_background_watch.py.
DRIFT_TIME_S = 10.0  # the drift is the mean over about so long; a person passes faster
MAX_STEP_S = 2.0  # a gap between frames counts as this
NEAR_RATIO = 0.3  # a pixel that is brighter or darker by more shows something else than the background
LEAST_SEEN = 0.5  # of the lit pixels have to show the background, or the light is not measured
ALWAYS = 0.9  # of the time a pixel that is called static was foreground of one and the same grey level
FADE_TIME_S = 60.0  # that grey level may change with the light over about so long
SMALLEST_STATIC_PLACE = 2e-3  # of the grid's pixels: four or five of them


@dataclass(frozen=True)
class BackgroundFit:
    """What was measured so far.

    gain_drift : by which share the typical pixel is brighter than it was learned, on top of the drift that is followed;
        None until it was measured long enough.
    tolerance : the drift, as a share, at which half of all pixels would be foreground.
    static_share : share of the pixels that have been the same foreground for ``static_s`` at least.
    static_places : where those are.
    """

    gain_drift: float | None = None
    tolerance: float = math.inf
    static_share: float = 0.0
    static_places: tuple[ImageRegion, ...] = ()


class BackgroundWatch:
    """Follows how well the frames of an active camera still fit its background.

    Two figures are taken. The drift of the light is the median ratio, frame to background, of all lit pixels that may
    be background: a person in the room covers the smaller part. Foreground that never moves is a pixel's share of the
    time in which it was foreground of one grey level, an exponential mean: a walking person covers no pixel for long,
    and a person who dances on the spot changes the pixels that they cover. The wall clock plays no part: the same
    footage gives the same figures at every speed.
    """

    def __init__(
        self, background: BackgroundModel, limits: BackgroundLimits, settings: BackgroundWatchSettings | None = None
    ) -> None:
        """``limits``: the grey levels of the background as it was learned."""
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
        self._drift, self._drift_s = 0.0, 0.0
        self._throttle = StampThrottle(PERIOD_S, longest_s=MAX_STEP_S)
        self.found = BackgroundFit(tolerance=self._tolerance)

    def update(self, image: Image, stamp_ns: int, gain: float = 1.0, background: Mask | None = None) -> None:
        """Take a frame (H, W) or (H, W, 3) of ``stamp_ns`` into account if it is time to.

        gain : how much brighter than learned the scene is already taken to be. background (H, W) : 255 where the frame
        shows the background, as it is followed; None where it is not followed: then the limits say so.
        """
        step_s = self._throttle.step_s(stamp_ns) if image.shape == self._limits.lo.shape else 0.0
        if not step_s:
            return
        seen = np.ascontiguousarray(image[self._grid])
        self._follow_light(seen, gain, step_s)
        shows = None if background is None else background[self._grid]
        self._follow_foreground(seen, shows, step_s)
        self.found = self._summary()

    def _follow_light(self, seen: Image, gain: float, step_s: float) -> None:
        ratio = seen[self._lit] / (self._mean[self._lit] * np.float32(gain))
        near = np.abs(ratio - 1) < NEAR_RATIO
        if not len(ratio) or near.mean() < LEAST_SEEN:
            return
        self._drift_s += step_s
        weight = max(step_s / DRIFT_TIME_S, step_s / self._drift_s)  # a plain mean at first
        self._drift += min(weight, 1.0) * (float(np.median(ratio[near])) - 1 - self._drift)

    def _follow_foreground(self, seen: Image, background: Mask | None, step_s: float) -> None:
        if background is None:
            lo, hi = (np.ascontiguousarray(limit[self._grid]) for limit in (self._limits.lo, self._limits.hi))
            background = cv2.inRange(seen, lo, hi)
        change = seen - self._stays
        other = np.abs(change) > self._half
        self._stays += np.where(other, 1.0, min(step_s / FADE_TIME_S, 1.0)).astype(np.float32) * change
        changed = other if other.ndim == 2 else other.any(axis=2)
        same = (background == 0) & ~changed
        self._always += np.float32(-math.expm1(-step_s / self._static_time_s)) * (same - self._always)

    def _summary(self) -> BackgroundFit:
        static = self._always > ALWAYS
        places = find_regions(static, SMALLEST_STATIC_PLACE, self._step) if static.any() else []
        known = self._drift_s >= DRIFT_TIME_S
        return BackgroundFit(self._drift if known else None, self._tolerance, float(static.mean()), tuple(places))


# --- concerns: the background is old, of another camera or setting, or the light changed

REMEDY = "clear the room and run sagoma background"
SAME_NUMBER = 0.01  # cameras give back what was set with so much error, relative
UNITS = {"exposure_us": "us", "gain": ""}


def age_h(provenance: Provenance, now_s: float) -> float | None:
    """Hours since a background was learned, None where that is unknown; ``now_s`` is the system's clock."""
    try:
        created = datetime.datetime.fromisoformat(provenance.created)
    except ValueError:
        return None
    return max(now_s - created.timestamp(), 0.0) / 3600


def concerns(
    provenance: Provenance,
    camera: Mapping[str, str],
    watched: BackgroundFit,
    settings: BackgroundWatchSettings,
    shape: tuple[int, ...],
    now_s: float | None = None,
    corrected: float | None = None,
) -> tuple[Finding, ...]:
    """Return what speaks against the background in use, the worst first; () when nothing does.

    camera : the details of the connected source. shape : of its images.
    now_s : the system's clock, s; None for footage, whose background is as old as itself.
    corrected : by which factor the light is followed now; None where it is not followed.
    """
    found = [*other_setting(provenance, camera, corrected)]
    if corrected is None:
        found += _drifted(watched, settings)
    found += _static(watched, settings, shape)
    age = None if now_s is None else age_h(provenance, now_s)
    if age is not None and 0 < settings.age_h < age:
        found.append(Finding(USABLE, f"the background is {age:.0f} h old", REMEDY, "background.old"))
    return tuple(found)


def unfit(provenance: Provenance, camera: Mapping[str, str]) -> Finding | None:
    """Return why a background cannot serve a camera: learned with another one, or at quite another exposure.

    What is unknown of either is not compared; None when nothing speaks against it.
    """
    learned, serial = provenance.camera_serial, camera.get("camera_serial", "")
    if learned and serial and learned != serial:
        what = f"the background was learned with camera {learned}, this is {serial}"
        return Finding(REDO, what, REMEDY, "background.other_camera")
    then, now = (_positive(text) for text in (provenance.exposure_us, camera.get("exposure_us", "")))
    if then and now and not 1 / MOST_GAIN < now / then < MOST_GAIN:
        what = f"the exposure is {now:g} us, the background was learned at {then:g} us: that cannot be corrected"
        return Finding(REDO, what, f"{REMEDY}, or set the exposure back", "background.other_exposure")
    return None


def other_setting(
    provenance: Provenance, camera: Mapping[str, str], corrected: float | None = None
) -> tuple[Finding, ...]:
    """Return the settings that the background was not learned at; what is unknown of either is not compared.

    corrected : as in :func:`concerns`.
    """
    found = []
    for key, unit in UNITS.items():
        now = camera.get(key, "")
        then = getattr(provenance, key)
        if then and now and not _same(then, now):
            name, unit = key.partition("_")[0], f" {unit}".rstrip()
            what = f"the {name} is {now}{unit}, the background was learned at {then}{unit}"
            if corrected is not None:
                what += f" (corrected by x {corrected:.2f})"
            found.append(Finding(USABLE, what, f"{REMEDY}, or set the {name} back", f"background.{name}"))
    return tuple(found)


def _drifted(watched: BackgroundFit, settings: BackgroundWatchSettings) -> list[Finding]:
    drift, limit = watched.gain_drift, settings.drift * watched.tolerance
    if drift is None or not settings.drift or abs(drift) <= limit:
        return []
    what = f"the light changed by {100 * drift:+.1f} %, the background bears {100 * watched.tolerance:.1f} %"
    remedy = f"{REMEDY}, or let it follow the light (background_model.rule: adaptive)"
    return [Finding(USABLE, what, remedy, "light.drifted")]


def _static(watched: BackgroundFit, settings: BackgroundWatchSettings, shape: tuple[int, ...]) -> list[Finding]:
    if watched.static_share <= settings.static_share or not watched.static_places:
        return []
    where = describe_regions(watched.static_places, shape)
    what = f"something has been in the picture for {settings.static_s / 60:.0f} minutes without moving: {where}"
    return [Finding(USABLE, what, f"take it away, or {REMEDY}", "background.static")]


def _same(then: str, now: str) -> bool:
    try:
        a, b = float(then), float(now)
    except ValueError:
        return then == now
    return abs(a - b) <= SAME_NUMBER * max(abs(a), abs(b), 1.0)


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if value > 0 else None
