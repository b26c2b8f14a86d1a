"""Grey levels of a silhouette, shared by camera clients, messages and the hull server.

A silhouette is evidence: a level stands for a kind of pixel and its certainty. Sixteen levels: background; uncertain,
where the camera does not vote; four of shadow candidates, nine of pixels that are the person or floor in shadow; and
foreground. Everything above ``SHADOW_CANDIDATE`` is the person by the judgement of a single camera.
"""

from __future__ import annotations

BACKGROUND = 0
UNCERTAIN = 47
"""Looks much like the background, and even more like the people in the room: the camera neither confirms nor denies."""
SHADOW_CANDIDATE = 127
"""Most likely only floor or wall in shadow, as its texture is still seen; the highest level of this kind."""
FOREGROUND = 255

# Thresholds: steps of a tenth; judgement.
ATTENUATION_EDGES = (0.4, 0.44, 0.485, 0.535, 0.59, 0.65, 0.715, 0.785, 0.865, 0.97)
"""Attenuation step d: ATTENUATION_EDGES[d] to [d + 1] times as bright as the background; each a tenth brighter."""
ATTENUATED_LEVELS = tuple(range(135, 248, 14))
"""Levels of the steps 0 to 8: the person by one camera's judgement, or the floor behind it in shadow."""
CANDIDATE_LEVELS = tuple(range(67, 128, 20))
"""Levels of shadow candidates: of the steps 0 and 1, 2 and 3, 4 and 5, 6 to 8."""
STEPS_OF_CANDIDATE = ((0, 1), (2, 3), (4, 5), (6, 8))
"""First and last attenuation step that each of them stands for."""
LEVELS = (BACKGROUND, UNCERTAIN, *CANDIDATE_LEVELS, *ATTENUATED_LEVELS, FOREGROUND)
"""All sixteen, ascending."""

FLOOR_REACH_M = 0.5
"""Pixels may be floor in shadow within the capture volume and this far around it."""


def candidate_level(step: int) -> int:
    """Return the level of a shadow candidate of an attenuation step."""
    return next(level for level, (_, last) in zip(CANDIDATE_LEVELS, STEPS_OF_CANDIDATE, strict=True) if step <= last)


def attenuation_step(ratio: float) -> int | None:
    """The attenuation step of a pixel ``ratio`` times as bright as the background; None where no shadow is like it."""
    step = sum(ratio >= edge for edge in ATTENUATION_EDGES) - 1
    return step if 0 <= step < len(ATTENUATED_LEVELS) else None
