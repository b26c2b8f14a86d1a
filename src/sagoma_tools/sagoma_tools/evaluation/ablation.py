"""What each part of the tracker is worth: from the thesis's method to ours, one part more in every row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .chain import Configuration

SOLVE = "icp_tracker.articulated."
THESIS = "thesis: hierarchical ICP, identity model"


@dataclass(frozen=True)
class Part:
    """A part of the tracker, and how to do without it.

    without : settings (NODE.PARAMETER) that switch it off; feedback : False where doing without it means that each fit
    starts from the fit before instead of the filter's state.
    """

    name: str
    without: Mapping[str, Any] = field(default_factory=dict)
    feedback: bool = True


PARTS = (
    Part("all joints at once", {"icp_tracker.method": "hierarchical"}),
    Part("sticks inside the hull", {SOLVE + "volume.inside_worth": 0.0}),
    Part("the hull's surface on the flesh", {SOLVE + "volume.worth": 0.0}),
    Part("the silhouettes' rims tangent to the flesh", {SOLVE + "rim.worth": 0.0}),
    Part("fits start from the filter's state", feedback=False),
    Part("constant velocity", {"ekf_tracker.motion_model": "identity"}),
)
"""In the order in which the rows add them."""
ROWS = (THESIS, *(f"+ {part.name}" for part in PARTS))
"""Each row's name; the last one is all of it."""
OURS = ROWS[-1]


def ablation_rows(settings: Mapping[str, Any]) -> dict[str, Configuration]:
    """Name to configuration: the thesis's method first; each row adds one part; the last one is the settings' own."""
    return {name: _without(PARTS[count:], settings) for count, name in enumerate(ROWS)}


def thesis_configuration(settings: Mapping[str, Any]) -> Configuration:
    """The thesis's method: hierarchical ICP started from its own last pose (4.3), then the filter without a motion
    model (5.2)."""
    return _without(PARTS, settings)


def _without(parts: tuple[Part, ...], settings: Mapping[str, Any]) -> Configuration:
    changed = dict(settings)
    for part in parts:
        changed.update(part.without)
    return Configuration.of(changed, feedback=all(part.feedback for part in parts))
