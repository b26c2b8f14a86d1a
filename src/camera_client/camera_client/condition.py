"""Measures how well a camera's background fits the room now: figures with units, for the diagnostics.

:class:`ConditionWatch` collects them from the silhouette pipeline, twice a second by the frames' stamps;
:mod:`.background.causes` judges them. No silhouette depends on either.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
from scipy.special import chdtri, ndtr

from capture_rig.stamps import NS, StampThrottle

from .background.fixed import FixedBackground
from .background.kernels import BEYOND_NOISE, HIGHEST, SCALE
from .background.training_verdict import PERSON, describe_regions, find_regions
from .frame_source import LASTING_S, REPORT_PERIOD_S
from .silhouettes.pipeline import SilhouettePipeline

RECENT_S = 10 * LASTING_S  # switches of the light within this count together; else what lasts for LASTING_S counts


@dataclass(frozen=True)
class Condition:
    """How well a background fits; the fields are keys of the diagnostics, shares are of 1. None: not measured."""

    light_gain: float | None = None  # how many times brighter than learned the scene is, all channels together
    light_flicker: float | None = None  # standard deviation of the light from frame to frame, share
    light_switches_recent: int | None = None  # how often the light changed suddenly in the last RECENT_S
    noise_levels: float | None = None  # standard deviation of a pixel of middle grey, grey levels
    displacement_px: float | None = None  # by how much the background was moved to follow the picture
    displacement_left_px: float | None = None  # standard deviation of what is left of it
    background_doubtful: float | None = None  # share of the pixels that are white or black
    things_share: float | None = None  # share of the picture where things moved or were taken away: background now
    things_places: str = ""  # where: columns, rows, share
    things_absorbed: int | None = None  # how many times things became background ...
    things_given_back: int | None = None  # ... and were as learned again
    unexplained_foreground: float | None = None  # share that is no background, no person and no shadow
    person_faint: float | None = None  # share of the person that differs by less than 4 sigmas from the background

    def values(self) -> dict[str, object]:
        """Return the keys of the diagnostics, with empty values where nothing was measured."""
        return {key: "" if value is None else value for key, value in asdict(self).items()}

    def figures(self) -> dict[str, Any]:
        """Return the figures that :func:`.background.causes.find_causes` judges."""
        if self.light_gain is None:
            return asdict(self)
        times = max(self.light_gain, 1 / self.light_gain) - 1
        return asdict(self) | {"light_change": self.light_gain - 1, "light_times": times}


class ConditionWatch:
    """Collects the condition of one pipeline's background. ``found`` may be read on any thread.

    :meth:`of_background` belongs to the thread that subtracts frames, :meth:`add` to the one that segments them.
    """

    def __init__(self, pipeline: SilhouettePipeline) -> None:
        self._pipeline, self._throttle = pipeline, StampThrottle(REPORT_PERIOD_S)
        beyond = round(SCALE * float(chdtri(pipeline.channels, 2 * ndtr(-BEYOND_NOISE))))
        self._faint_below = min(beyond, int(HIGHEST) - 1)
        self._lasting: deque[tuple[int, tuple[float, ...]]] = deque()
        self._switches: deque[tuple[int, int]] = deque()
        self._things_known, self._places = (0, 0), ""
        self.found = Condition()

    def of_background(self, stamp_ns: int) -> Condition | None:
        """Return the figures of the background in the frame of ``stamp_ns``, the last one that the pipeline subtracted;
        None where it is not yet time to."""
        if self._throttle.step_s(stamp_ns) <= 0:
            return None
        background, scale = self._pipeline.background, self._pipeline.scale
        if isinstance(background, FixedBackground):
            return Condition(**self._things())
        lights, shift = background.lights, background.shift
        _spans(self._switches, stamp_ns, lights.switches, RECENT_S)
        return Condition(
            light_gain=background.light.brightness,
            light_flicker=math.sqrt(lights.flicker2),
            light_switches_recent=lights.switches - self._switches[0][1],
            noise_levels=background.noise.typical_sigma,
            displacement_px=scale * shift.total.most_px(self._pipeline.image_shape),
            displacement_left_px=scale * shift.left_px,
            background_doubtful=background.expected.doubtful,
            **self._things(),
        )

    def add(self, background: Condition, stamp_ns: int) -> None:
        """Add what the silhouette of that frame, the last one that the pipeline segmented, leaves open."""
        labels, unexplained, faint = self._pipeline.labels, 0, None
        if labels is not None:
            explained = cv2.bitwise_or(labels.person, labels.shadow)
            unexplained = cv2.countNonZero(cv2.subtract(labels.foreground, explained))
            pixels = cv2.countNonZero(labels.person)
            if self._pipeline.measures_distance and pixels >= PERSON * self._pipeline.looked_at_px:
                near = cv2.threshold(labels.distance, self._faint_below, 255, cv2.THRESH_BINARY_INV)[1]
                faint = cv2.countNonZero(cv2.bitwise_and(near, labels.person)) / pixels
        now = unexplained / self._pipeline.looked_at_px, faint or 0.0
        # the least of each in the last LASTING_S counts, 0 while that is not over
        lasts = _spans(self._lasting, stamp_ns, now, LASTING_S)
        least = [min(each) if lasts else 0.0 for each in zip(*(shares for _, shares in self._lasting), strict=True)]
        faint = None if faint is None else least[1]
        self.found = replace(background, unexplained_foreground=least[0], person_faint=faint)

    def _things(self) -> dict[str, Any]:
        """Return the figures of what moved; places are looked for only when something was absorbed or given back."""
        moved, shape = self._pipeline.moved, self._pipeline.image_shape
        if moved is None:
            return {}
        if self._things_known != (moved.absorbed, moved.reverted):
            self._things_known = (moved.absorbed, moved.reverted)
            self._places = describe_regions(find_regions(moved.replaced > 0, 0.0, self._pipeline.scale), shape)
        return {
            "things_share": moved.share,
            "things_places": self._places,
            "things_absorbed": moved.absorbed,
            "things_given_back": moved.reverted,
        }


def _spans(history: deque[tuple[int, Any]], stamp_ns: int, value: Any, span_s: float) -> bool:
    """Add a value; return whether the history, cut to about ``span_s``, is so long. A clock set back begins anew."""
    if history and stamp_ns < history[-1][0]:
        history.clear()
    history.append((stamp_ns, value))
    while len(history) > 1 and (stamp_ns - history[1][0]) * NS >= span_s:
        history.popleft()
    return (stamp_ns - history[0][0]) * NS >= span_s
