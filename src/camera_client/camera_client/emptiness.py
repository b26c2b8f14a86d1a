"""Was the room empty while the background was learned? Who stood still did not move, but was not there before."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.verdict import USABLE, Finding

from .background_model import BackgroundModel
from .frame_checks import MIN_LIT_LEVEL, WHITE_LEVEL
from .places import Place, find_places, tell_places

CHANGE_LEVELS, CHANGE_SIGMAS = 10.0, 5.0  # a pixel shows something else when it differs by as much as both say
THIN_OF_HEIGHT = 1 / 60  # narrower changes are edges that shifted a little
SMALLEST_CHANGE = 2e-3  # of the pixels; a person who is far away covers more
MOST_CHANGED = 0.3  # of the pixels; more is no person, but other lights or a camera that was moved


def changed_places(model: BackgroundModel, before: BackgroundModel) -> list[Place]:
    """Where ``model`` shows something else than the background ``before``, the largest place first.

    The light may be brighter or darker as a whole. None where most of the picture changed, or its size did.
    """
    if model.shape != before.shape:
        return []
    lit = before.mean >= MIN_LIT_LEVEL
    gain = float(np.median(model.mean[lit] / before.mean[lit])) if lit.any() else 1.0
    if gain <= 0:
        return []
    change = np.abs(model.mean / gain - before.mean)
    differs = change > np.maximum(CHANGE_LEVELS, CHANGE_SIGMAS * np.hypot(model.sigma / gain, before.sigma))
    differs &= np.maximum(model.mean, gain * before.mean) < WHITE_LEVEL  # what was cut off cannot be compared
    changed = _without_thin(differs if differs.ndim == 2 else differs.any(axis=2))
    return [] if changed.mean() > MOST_CHANGED else find_places(changed, SMALLEST_CHANGE)


def judge_emptiness(model: BackgroundModel, before: BackgroundModel | None) -> list[Finding]:
    """A finding where something stands that the background ``before`` did not have."""
    places = [] if before is None else changed_places(model, before)
    if before is None or not places:
        return []
    since = f" of {before.provenance.created}" if before.provenance.created else ""
    what = f"something else than in the background{since}: {tell_places(places, model.shape)}"
    remedy = "if somebody stood there, clear the room and learn again; moved furniture is all right"
    return [Finding(USABLE, what, remedy)]


def _without_thin(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    side = max(2 * round(THIN_OF_HEIGHT * mask.shape[0] / 2) + 1, 3)
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray(opened > 0)
