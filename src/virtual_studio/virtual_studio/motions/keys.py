"""Postures that follow each other: an activity from key poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .timeline import Activity, Array, ease


@dataclass(frozen=True, eq=False)
class Key:
    """Be in a posture at a time (s since the activity began); angles (18,) rad, forward: lean of the torso, rad."""

    at_s: float
    angles: Array
    forward: float = 0.0


def activity_of(keys: Sequence[Key], duration_s: float, turning: float = 0.0) -> Activity:
    """Goes from key to key, smoothly and with a stop at each; holds the first before it and the last after it."""
    times = np.array([key.at_s for key in keys])

    def between(values: list, t: float) -> Any:
        after = int(np.searchsorted(times, t))
        if after == 0 or after == len(times):
            return values[min(after, len(times) - 1)]
        share = ease((t - times[after - 1]) / (times[after] - times[after - 1]))
        return (1.0 - share) * values[after - 1] + share * values[after]

    angles, leans = [key.angles for key in keys], [np.array([0.0, key.forward, 0.0]) for key in keys]
    return Activity(duration_s, lambda t: between(angles, t), lean=lambda t: between(leans, t), turning=turning)


def hold(duration_s: float, angles: Array, forward: float = 0.0) -> Activity:
    """Stays in a posture."""
    return activity_of([Key(0.0, angles, forward)], duration_s)
