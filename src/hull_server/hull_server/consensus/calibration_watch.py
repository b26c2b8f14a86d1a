"""Does every camera still stand where its calibration says? Asked of the silhouettes, all the time.

Long before a camera that was bumped does so much harm that it is left out, the planes that touch the body tell that it
stands badly, and by how many degrees: within seconds when it is much, within minutes when it is little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from capture_rig import Rig

from ..settings import CalibrationSettings
from ..views import Masks, RigViews
from .calibration_evidence import Standing, find_standings
from .silhouette_tangents import TangentFinder, Tangents

SLOW_EVERY = 10  # of so many looks one is remembered for long
SLOW_LOOKS = 60
ASKED_EVERY = 3  # looks
FEWEST_CAMERAS = 3
FEWEST = 12  # differences of a camera; fewer tell nothing
SIGMAS = 3.0
SYSTEMATIC_RAD = np.radians(0.08)  # of every angle: lenses, and silhouettes that err in one direction for long
CONFIRMED = 4  # times in a row before a camera is named; once is enough ...
NEWS_RAD = np.radians(0.5)  # when the body's outline has moved by less, its silhouettes err as they did before
GROSS = 4.0  # ... when it is off by so many times what is allowed
ENOUGH_CAMERAS = 5  # each one less makes it harder to tell whose fault a difference is: twice as much is allowed
FITTING = 0.5  # share of the camera's differences that its turn must explain
CLEARER = 3.0  # its evidence is above that of every other explanation by so much
EARLY = 0.1  # share of the period by which a frame set may come early: stamps jitter
NS = 1e-9


@dataclass(frozen=True, eq=False)
class Calibration:
    """How well the cameras stand. Angles in radians, by camera; of cameras that were measured only.

    push_rad : by how much each camera is turned from where its calibration says it stands, if it alone is; sd_rad : the
    standard deviation of that; roll_rad : the part about its optical axis. suspects : cameras that certainly stand
    badly, and why, in words a user can act on.
    """

    push_rad: Mapping[str, float] = field(default_factory=dict)
    sd_rad: Mapping[str, float] = field(default_factory=dict)
    roll_rad: Mapping[str, float] = field(default_factory=dict)
    suspects: Mapping[str, str] = field(default_factory=dict)


class CalibrationWatch:
    """Watches over the calibration of one rig. Not for two threads at a time. The same sets give the same results."""

    def __init__(self, rig: Rig, views: RigViews, settings: CalibrationSettings | None = None) -> None:
        """Compute what depends on the calibration only."""
        self.settings, self.names = settings or CalibrationSettings(), views.names
        self._finder = TangentFinder(rig, views)
        self._recent: deque[Tangents] = deque(maxlen=max(round(self.settings.memory_s / self.settings.period_s), 1))
        self._lasting: deque[Tangents] = deque(maxlen=SLOW_LOOKS)
        self._looks, self._last_ns = 0, -1
        self._known: list[Standing] = []  # by the lasting evidence
        self._in_a_row = [0] * len(views.names)
        self.calibration = Calibration()

    def look(self, masks: Masks, stamp_ns: int) -> Calibration:
        """Take one frame set's canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, if it is time to.

        Sets in which nobody is seen change nothing.
        """
        if not self.settings.enabled or len(self.names) < FEWEST_CAMERAS or not self._is_time(stamp_ns):
            return self.calibration
        tangents = self._finder.find(masks)
        if tangents.first.size and self._is_news(tangents):
            self._recent.append(tangents)
            if self._looks % SLOW_EVERY == 0:
                self._lasting.append(tangents)
                self._known = find_standings(self._lasting, len(self.names), SLOW_EVERY * self.settings.period_s)
            self._looks += 1
            if self._looks % ASKED_EVERY == 0:
                self.calibration = self._ask()
        return self.calibration

    def _is_time(self, stamp_ns: int) -> bool:
        if 0 <= self._last_ns <= stamp_ns < self._last_ns + (1 - EARLY) * self.settings.period_s / NS:
            return False
        self._last_ns = stamp_ns
        return True

    def _is_news(self, tangents: Tangents) -> bool:
        """Whether the body has moved since the last set that was taken: one that stands still tells the same again."""
        if not self._recent:
            return True
        moved_rad = np.abs(tangents.angles - self._recent[-1].angles)
        known = np.isfinite(moved_rad)
        return not known.any() or float(np.median(moved_rad[known])) > NEWS_RAD

    def _ask(self) -> Calibration:
        """Weigh the recent and the lasting evidence of every camera."""
        recent = find_standings(self._recent, len(self.names), self.settings.period_s)
        present = sum(standing.count >= FEWEST for standing in recent)
        lenience = 2.0 ** max(ENOUGH_CAMERAS - present, 0)
        allowed_rad = np.radians(self.settings.limit_deg) * lenience
        standings: dict[str, Standing] = {}
        suspects: dict[str, str] = {}
        for camera, name in enumerate(self.names):
            if max(recent[camera].count, self._known[camera].count) < FEWEST:
                continue
            excess_rad, standings[name] = self._worst(recent, camera, allowed_rad, CLEARER * lenience)
            self._in_a_row[camera] = self._in_a_row[camera] + 1 if excess_rad > allowed_rad else 0
            if self._in_a_row[camera] >= CONFIRMED or excess_rad > GROSS * allowed_rad:
                suspects[name] = self._reason(name, standings[name])
        return Calibration(
            push_rad={name: standing.size_rad for name, standing in standings.items()},
            sd_rad={name: standing.sd_rad for name, standing in standings.items()},
            roll_rad={name: float(standing.turn_rad[2]) for name, standing in standings.items()},
            suspects=suspects,
        )

    def _worst(self, recent: list[Standing], camera: int, allowed_rad: float, clearer: float) -> tuple[float, Standing]:
        """By how much a camera certainly stands badly, and how; how it stands as far as known, when it does not."""
        now, known = recent[camera], self._known[camera]
        excess_rad, excess_known_rad = _excess_rad(recent, camera, clearer), _excess_rad(self._known, camera, clearer)
        if excess_rad > allowed_rad:
            return excess_rad, now
        stands_well_now = now.size_rad + 2 * now.sd_rad < allowed_rad
        if excess_known_rad > allowed_rad and not stands_well_now:
            return excess_known_rad, known
        return 0.0, min((now, known), key=lambda standing: standing.sd_rad)

    def _reason(self, name: str, standing: Standing) -> str:
        aside, about = np.degrees(np.hypot(*standing.turn_rad[:2])), np.degrees(abs(standing.turn_rad[2]))
        size = np.degrees(standing.size_rad)
        return (
            f"{name} stands {size:.1f} degrees from where its calibration says ({aside:.1f} aside, {about:.1f} "
            f"about its axis), as the other {len(self.names) - 1} show: was it moved? Put it back, or calibrate it "
            "again"
        )


def _excess_rad(standings: list[Standing], camera: int, clearer: float) -> float:
    """By how much the camera certainly stands badly; 0 unless no other explanation is nearly as good."""
    mine = standings[camera]
    rivals = [mine.gain_growth, *(s.gain for other, s in enumerate(standings) if other != camera)]
    if mine.count < FEWEST or mine.fitting < FITTING or mine.gain - max(rivals) < clearer:
        return 0.0
    return mine.size_rad - SIGMAS * float(np.hypot(mine.sd_rad, SYSTEMATIC_RAD))
