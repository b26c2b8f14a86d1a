"""The stick figure stick by stick, for libraries that want a model built joint by joint."""

from __future__ import annotations

import numpy as np

from stick_figure.body import Body
from stick_figure.skeleton import STICK_AXIS, STICK_SIGN

POINT_ENDS = (
    (0, "centre"),
    (1, "end"),
    (1, "start"),
    (2, "start"),
    (3, "start"),
    (4, "start"),
    (5, "start"),
    (2, "end"),
    (3, "end"),
    (4, "end"),
    (5, "end"),
    (6, "end"),
    (7, "end"),
    (8, "end"),
    (9, "end"),
)
"""(stick, which end) of each reference point."""


def local_ends(body: Body, stick: int) -> dict[str, np.ndarray]:
    """Start and end of a stick (and the torso's centre) in its own frame, m."""
    if stick == 0:
        half = np.array([0.0, 0.0, body.half_lengths[0]])
        return {"start": -half, "end": half, "centre": np.zeros(3)}
    return {"start": np.zeros(3), "end": along_stick(stick, body.lengths[stick])}


def along_stick(stick: int, length: float) -> np.ndarray:
    """The vector (3,) along a stick in its own frame."""
    return STICK_SIGN[stick] * length * np.eye(3)[STICK_AXIS[stick]]
