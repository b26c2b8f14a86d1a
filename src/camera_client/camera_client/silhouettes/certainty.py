"""Measures how sure a silhouette is: what differs from the background and is no person, what of the person is faint.

A few times a second by the frames' stamps; no silhouette depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
from scipy.special import chdtri, ndtr

from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE
from capture_rig.stamps import StampThrottle

from ..background.kernels import BEYOND_NOISE, SCALE
from ..background.verdict import LEAST_PERSON
from ..frame_source import REPORT_PERIOD_S, Mask


@dataclass(frozen=True)
class Certainty:
    """What a silhouette leaves open.

    unexplained : share of the picture that is foreground, but neither the person nor a shadow that was found. faint :
    share of the person's pixels that differ from the background by less than BEYOND_NOISE. maybe_shadow : share of the
    person's pixels that may be floor in shadow as well. None where nobody is found, or nothing measures it.
    """

    unexplained: float = 0.0
    faint: float | None = None
    maybe_shadow: float | None = None


class CertaintyMeter:
    """Measures one silhouette in REPORT_PERIOD_S. ``found`` is the last result; frames come on one thread."""

    def __init__(self, picture_px: int, channels: int, distances: bool) -> None:
        """``distances`` : the background tells how far a pixel is from it, not only on which side."""
        self._picture_px, self._throttle = picture_px, StampThrottle(REPORT_PERIOD_S)
        level = 2.0 * float(ndtr(-BEYOND_NOISE))
        self._faint = min(round(SCALE * float(chdtri(channels, level))), 254) if distances else None
        self.found = Certainty()

    def is_due(self, stamp_ns: int) -> bool:
        """Whether a frame of this stamp is to be measured; asked once a frame."""
        return self._throttle.step_s(stamp_ns) > 0

    def note_nothing(self) -> None:
        """Take a frame that shows nothing but background."""
        self.found = Certainty()

    def note(self, distance: Mask, raw: Mask, person: Mask, shadow: Mask, levels: Mask) -> None:
        """Take a part (h, w) of a frame that holds all foreground.

        distance : SCALE z^2. raw : all foreground, 255. person, shadow : what was made of it, 255. levels : of the
        person with its attenuation (``capture_rig.mask_levels``).
        """
        explained = cv2.bitwise_or(person, shadow)
        unexplained = cv2.countNonZero(cv2.subtract(raw, explained)) / self._picture_px
        pixels = cv2.countNonZero(person)
        if pixels < LEAST_PERSON * self._picture_px:
            self.found = Certainty(unexplained)
            return
        faint = None
        if self._faint is not None:
            near = cv2.threshold(distance, self._faint, 255, cv2.THRESH_BINARY_INV)[1]
            faint = cv2.countNonZero(cv2.bitwise_and(near, person)) / pixels
        doubted = cv2.inRange(levels, SHADOW_CANDIDATE + 1, FOREGROUND - 1)
        self.found = Certainty(unexplained, faint, cv2.countNonZero(doubted) / pixels)
