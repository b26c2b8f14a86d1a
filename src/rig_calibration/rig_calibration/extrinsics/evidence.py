"""What a rig is judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .figures import RigFigures
from .floor import FloorView
from .tape import TapeCheck


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that is known about a rig that was just calibrated.

    figures : its figures. widths_px : width of each camera's images. usable_volume : is there a place where enough
    cameras see a standing person? floor : how each camera that sees the floor board sees it. by_floor_alone : cameras
    that no carried board ties to the others. floor_known : False when z up is a guess. floor_guess : frames in
    which the carried board was taken to lie on the floor because nothing was below it. undecided : cameras of
    which nothing tells on which side of the board they stand. strays : by camera, frames in
    which the floor board lay elsewhere, and all its frames. left_out : by camera, why sightings were left out.
    scales : by target, its size relative to the first target's as the cameras see it, and that ratio's standard
    deviation. tape : what was measured by hand. floor_left_out : by camera, why its sighting
    of the floor board was left out.
    """

    figures: RigFigures
    widths_px: Mapping[str, int]
    usable_volume: bool = True
    floor: Mapping[str, FloorView] = field(default_factory=dict)
    by_floor_alone: frozenset[str] = frozenset()
    floor_known: bool = True
    floor_guess: tuple[int, ...] = ()
    undecided: tuple[str, ...] = ()
    strays: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    left_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    floor_left_out: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tape: tuple[TapeCheck, ...] = ()
