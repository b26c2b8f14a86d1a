"""Measures how well a camera's background fits the room now: figures with units, for the diagnostics.

:class:`ConditionWatch` collects them from the silhouette pipeline, twice a second by the frames' stamps; what they mean
is said by :mod:`.background.causes`. No silhouette depends on either.
"""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
from scipy.special import chdtri, ndtr

from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE
from capture_rig.stamps import NS, StampThrottle
from mocap_packets.silhouette import Silhouette

from .background.kernels import BEYOND_NOISE, HIGHEST, SCALE
from .background.verdict import PERSON, describe_regions, find_regions
from .frame_source import LASTING_S, REPORT_PERIOD_S
from .silhouettes.pipeline import TYPICAL_LEVEL, Parts, SilhouettePipeline

CHANNELS = ("blue", "green", "red")
RECENT_S = 10 * LASTING_S  # switches of the light within this count together; else what lasts for LASTING_S counts


@dataclass(frozen=True)
class Condition:
    """How well a background fits; the fields are keys of the diagnostics, shares are of 1. None: not measured."""

    light_gain: float | None = None  # how many times brighter than learned the scene is, all channels together
    light_gains: str = ""  # the same of each channel of a colour camera: blue, green, red
    light_unevenness: float | None = None  # standard deviation of that over the picture, share
    light_flicker: float | None = None  # standard deviation of the light from frame to frame, share
    light_switches: int | None = None  # how often the light changed suddenly
    light_switches_recent: int | None = None  # the same in the last RECENT_S
    noise_levels: float | None = None  # standard deviation of a pixel of middle grey, grey levels
    noise_learned_levels: float | None = None  # the same when the background was learned
    displacement_px: float | None = None  # by how much the background was moved to follow the picture
    displacement_left_px: float | None = None  # standard deviation of what is left of it
    background_doubtful: float | None = None  # share of the pixels that are white or black
    things_share: float | None = None  # share of the picture where things moved or were taken away: background now
    things_places: str = ""  # where: columns, rows, share
    things_absorbed: int | None = None  # how many times things became background ...
    things_given_back: int | None = None  # ... and were as learned again
    restless_foreground: float | None = None  # share that keeps changing where no other camera sees anybody
    unexplained_foreground: float | None = None  # share that is no background, no person and no shadow
    person_faint: float | None = None  # share of the person that differs by less than 4 sigmas from the background
    person_maybe_shadow: float | None = None  # share of the person that may be floor in shadow
    shadow_share: float | None = None  # share of the foreground that was taken for shadow
    background_static_foreground: float | None = None  # share that has not moved for minutes
    background_static_places: str = ""  # where

    def values(self) -> dict[str, object]:
        """Return the keys of the diagnostics; those of what was not measured are there, and empty."""
        return {key: "" if value is None else value for key, value in asdict(self).items()}

    def figures(self) -> dict[str, Any]:
        """Return the figures that :func:`.background.causes.find_causes` judges."""
        figures = asdict(self)
        gains = [float(gain) for gain in self.light_gains.split()]
        if gains:
            mean = sum(gains) / len(gains)
            named = zip(CHANNELS, gains, strict=True)
            figures["light_tint"] = max(abs(gain / mean - 1) for gain in gains)
            figures["light_colours"] = ", ".join(f"{name} {100 * (gain - 1):+.0f} %" for name, gain in named)
        if self.light_gain is not None:
            figures["light_change"] = self.light_gain - 1
            figures["light_times"] = max(self.light_gain, 1 / self.light_gain) - 1
        if self.noise_levels is not None:
            figures["noise_times"] = self.noise_levels / (self.noise_learned_levels or self.noise_levels)
        if not self.things_places:
            figures["things_share"] = None
        if not self.background_static_places:
            figures["background_static_foreground"] = None
        shadow, maybe = self.shadow_share or 0.0, self.person_maybe_shadow or 0.0
        return figures | {"shadow_share": shadow, "maybe_shadow": maybe, "most_shadow": max(shadow, maybe)}


def measured_certainty(parts: Parts | None, picture_px: int, faint_below: int | None) -> dict[str, float]:
    """Return what a silhouette leaves open, by the fields of :class:`Condition`: without a person only what is
    unexplained. ``faint_below`` : distance of a pixel that hardly differs; None where distances are not measured."""
    if parts is None:
        return {"unexplained_foreground": 0.0}
    explained = cv2.bitwise_or(parts.person, parts.shadow)
    found = {"unexplained_foreground": cv2.countNonZero(cv2.subtract(parts.foreground, explained)) / picture_px}
    pixels = cv2.countNonZero(parts.person)
    if pixels < PERSON * picture_px:
        return found
    if faint_below is not None:
        near = cv2.threshold(parts.distance, faint_below, 255, cv2.THRESH_BINARY_INV)[1]
        found["person_faint"] = cv2.countNonZero(cv2.bitwise_and(near, parts.person)) / pixels
    doubted = cv2.inRange(parts.levels, SHADOW_CANDIDATE + 1, FOREGROUND - 1)
    return found | {"person_maybe_shadow": cv2.countNonZero(doubted) / pixels}


def _spans(history: deque[tuple[int, Any]], stamp_ns: int, value: Any, span_s: float) -> bool:
    """Add a value; return whether the history, cut to about ``span_s``, is so long. A clock set back begins anew."""
    if history and stamp_ns < history[-1][0]:
        history.clear()
    history.append((stamp_ns, value))
    while len(history) > 1 and (stamp_ns - history[1][0]) * NS >= span_s:
        history.popleft()
    return (stamp_ns - history[0][0]) * NS >= span_s


class ConditionWatch:
    """Collects the condition of one pipeline's background. ``found`` may be read on any thread.

    :meth:`of_background` belongs to the thread that subtracts frames, :meth:`add` to the one that segments them.
    """

    def __init__(self, pipeline: SilhouettePipeline) -> None:
        self._pipeline, self._throttle = pipeline, StampThrottle(REPORT_PERIOD_S)
        self._shape = pipeline.image_shape
        beyond = round(SCALE * float(chdtri(pipeline.channels, 2 * ndtr(-BEYOND_NOISE))))
        self._faint_below = min(beyond, int(HIGHEST) - 1) if pipeline.measures_distance else None
        self._lasting: deque[tuple[int, tuple[float, ...]]] = deque()
        self._switches: deque[tuple[int, int]] = deque()
        self._things_known, self._places = (0, 0), ""
        self.found = Condition()

    def of_background(self, stamp_ns: int) -> Condition | None:
        """Return the figures of the background in the frame of ``stamp_ns``, the last one that the pipeline subtracted;
        None where it is not yet time to."""
        if self._throttle.step_s(stamp_ns) <= 0:
            return None
        state, moved = self._pipeline.background.state, self._pipeline.moved
        things = {} if moved is None else self._things()
        return Condition(
            light_gain=state.light.brightness,
            light_gains=" ".join(f"{gain:.3f}" for gain in state.light.gain) if len(state.light.gain) > 1 else "",
            light_unevenness=state.light.unevenness,
            light_flicker=state.flicker,
            light_switches=state.switches,
            light_switches_recent=self._recent_switches(stamp_ns, state.switches),
            noise_levels=state.noise.sigma(TYPICAL_LEVEL),
            noise_learned_levels=state.learned_noise.sigma(TYPICAL_LEVEL),
            displacement_px=self._pipeline.scale * state.displacement.most_px(self._shape),
            displacement_left_px=self._pipeline.scale * state.left_px,
            background_doubtful=state.doubtful,
            restless_foreground=0.0 if moved is None else moved.dynamic_share,
            **things,
        )

    def add(self, background: Condition, stamp_ns: int, silhouette: Silhouette) -> None:
        """Add the silhouette of that frame, the last one that the pipeline segmented."""
        found = measured_certainty(self._pipeline.parts, self._pipeline.looked_at_px, self._faint_below)
        anything = silhouette.foreground_fraction + silhouette.candidate_fraction
        now = (background.restless_foreground or 0.0, found["unexplained_foreground"], found.get("person_faint", 0.0))
        restless, unexplained, faint = self._lasts(stamp_ns, now)
        self.found = replace(
            background,
            restless_foreground=restless,
            unexplained_foreground=unexplained,
            person_faint=faint if "person_faint" in found else None,
            person_maybe_shadow=found.get("person_maybe_shadow"),
            shadow_share=silhouette.candidate_fraction / anything if anything >= PERSON else None,
        )

    def _lasts(self, stamp_ns: int, now: tuple[float, ...]) -> tuple[float, ...]:
        """Return the least of each share in the last LASTING_S; 0 while that is not over."""
        if not _spans(self._lasting, stamp_ns, now, LASTING_S):
            return (0.0,) * len(now)
        return tuple(map(min, zip(*(shares for _, shares in self._lasting), strict=True)))

    def _recent_switches(self, stamp_ns: int, switches: int) -> int:
        _spans(self._switches, stamp_ns, switches, RECENT_S)
        return switches - self._switches[0][1]

    def _things(self) -> dict[str, Any]:
        """Return the figures of what moved; places are looked for only when something was absorbed or given back."""
        moved = self._pipeline.moved
        assert moved is not None
        if self._things_known != (moved.absorbed, moved.reverted):
            self._things_known = (moved.absorbed, moved.reverted)
            self._places = describe_regions(find_regions(moved.replaced > 0, 0.0, self._pipeline.scale), self._shape)
        return {
            "things_share": moved.share,
            "things_places": self._places,
            "things_absorbed": moved.absorbed,
            "things_given_back": moved.reverted,
            "background_static_foreground": float(moved.static.mean()),
            "background_static_places": describe_regions(find_regions(moved.static, 0.0, moved.block_px), self._shape),
        }
