"""The size of one person: limb lengths and the ratios that place shoulders and hips (thesis Table 5.3, corrected).

A body file (YAML) holds full stick lengths by name, shoulder width, the two ratios, metres, and optionally the build,
which shapes the surface (`body_surface`). The limbs' ``thickness`` of older files is ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.files import read_text, write_text
from capture_rig.yaml_file import format_mapping, parse_mapping

from .rotations import Array
from .skeleton import STICK_NAMES

# Thresholds: from the thesis (d_s, d_H); Bell, Pedersen & Brand 1990.
SHOULDER_HEIGHT_RATIO = 0.8
HIP_WIDTH_RATIO = 0.7
"""The thesis's d_s and d_H, for when nothing was measured."""

# Segment lengths over stature: Drillis & Contini (1966), as in Winter, Biomechanics and Motor Control of Human
# Movement, fig. 4.1: heights of hip .530, shoulder .818, chin .870, knee .285, ankle .039; upper arm .186,
# forearm .146, hand .108; biacromial breadth .259, pelvic breadth .191.
_HIP, _SHOULDER, _NECK, _KNEE, _ANKLE = 0.530, 0.818, 0.870, 0.285, 0.039
_UPPER_ARM, _FOREARM, _HAND = 0.186, 0.146, 0.108
_BIACROMIAL, _PELVIC = 0.259, 0.191
_HIP_CENTRES_OVER_PELVIS = 0.72
"""Distance of the hip joint centres over the pelvic breadth: Bell, Pedersen & Brand (1990), 14 % medial each side."""
TYPICAL_STATURE_M = 1.75
STATURES_M = (0.5, 2.6)
"""The smallest and the greatest person."""
BUILD_NUMBERS = 14
"""Number of parameters of a body's surface beside its lengths (`body_surface`)."""

BEND_NUMBERS = 7
"""Number of parameters of the trunk's bend (`trunk_bend`)."""

_LIMBS = ((1,), (2, 3), (4, 5), (6, 7), (8, 9))
_STICK_POINTS = ((-1, -1), (2, 1), (3, 7), (4, 8), (5, 9), (6, 10), (7, 11), (8, 12), (9, 13), (10, 14))


@dataclass(frozen=True, eq=False)
class Body:
    """Sizes of the stick figure.

    half_lengths (10,)      lambda_i^(2), HALF the length of each stick, metres, order of `skeleton.STICK_NAMES`
    half_shoulder_width     lambda_0^(1) = w, half the distance of the shoulders, metres
    shoulder_height_ratio   d_s: height of the shoulders above the torso's centre over half its length
    hip_width_ratio         d_H: distance of the hips over that of the shoulders
    build (BUILD_NUMBERS,)  how the surface differs from the average of these lengths, in units of how people differ
    bend (BEND_NUMBERS,)    how the trunk is bent in one instant; see `trunk_bend`
    unbent                  the same body at rest; None of a body that is

    Raises InputError when a size is not a positive finite number.
    """

    half_lengths: Array
    half_shoulder_width: float
    shoulder_height_ratio: float = SHOULDER_HEIGHT_RATIO
    hip_width_ratio: float = HIP_WIDTH_RATIO
    build: Array = field(default_factory=lambda: np.zeros(BUILD_NUMBERS))
    bend: Array = field(default_factory=lambda: np.zeros(BEND_NUMBERS))
    unbent: Body | None = None

    def __post_init__(self) -> None:
        if self.unbent is None:  # else its sizes are those of a body that was checked
            self._check()

    def _check(self) -> None:
        half_lengths = np.array(self.half_lengths, dtype=np.float64)
        if half_lengths.shape != (10,):
            raise InputError(f"a body has 10 stick lengths, not an array of shape {half_lengths.shape}")
        build = np.array(self.build, dtype=np.float64)
        if build.shape != (BUILD_NUMBERS,) or not np.isfinite(build).all():
            raise InputError(f"a build has {BUILD_NUMBERS} finite numbers, not {self.build}")
        object.__setattr__(self, "half_lengths", half_lengths)
        object.__setattr__(self, "build", build)
        if not (np.isfinite(half_lengths) & (half_lengths > 0.0)).all():
            for name, value in zip(STICK_NAMES, half_lengths, strict=True):
                _check_size(f"half length of {name}", value)
        for name in ("half_shoulder_width", "shoulder_height_ratio", "hip_width_ratio"):
            object.__setattr__(self, name, _check_size(name, getattr(self, name)))

    @property
    def straight(self) -> Body:
        """The body with its trunk at rest: itself when it is."""
        return self.unbent or self

    def bent(self, bend: Array) -> Body:
        """Return this body with its trunk bent so (BEND_NUMBERS,), rad and m."""
        rest = self.straight
        ratios = rest.shoulder_height_ratio, rest.hip_width_ratio
        own_bend = np.array(bend, dtype=np.float64)
        return Body(rest.half_lengths, rest.half_shoulder_width, *ratios, rest.build, own_bend, rest)

    @cached_property
    def lengths(self) -> Array:
        """(10,) full stick lengths, metres."""
        return 2.0 * self.half_lengths if self.unbent is None else self.unbent.lengths

    @cached_property
    def stick_origins_torso(self) -> Array:
        """(10, 3) start of each stick that begins on the torso, torso frame, metres; zero for forearms and calves."""
        if self.unbent is not None:
            from .trunk_bend import bend_derivatives

            return self.unbent.stick_origins_torso + bend_derivatives(self.unbent).origins @ self.bend
        h, w = self.half_lengths[0], self.half_shoulder_width
        shoulder, hip = self.shoulder_height_ratio * h, self.hip_width_ratio * w
        origins = np.zeros((10, 3))
        origins[0], origins[1] = (0, 0, -h), (0, 0, h)
        origins[2], origins[3] = (0, w, shoulder), (0, -w, shoulder)
        origins[4], origins[5] = (0, hip, -h), (0, -hip, -h)
        return origins

    @cached_property
    def torso_points(self) -> Array:
        """(6, 3) torso centre, neck, shoulders, hips in the torso frame (order of `skeleton.TORSO_POINTS`), metres."""
        return np.vstack([np.zeros(3), self.stick_origins_torso[1:6]])

    @cached_property
    def stature(self) -> float:
        """Standing height over the ankles' floor height, by the same anthropometric ratios, metres."""
        if self.unbent is not None:
            return self.unbent.stature
        standing = self.lengths[0] + self.lengths[1] + self.lengths[[4, 5]].mean() + self.lengths[[8, 9]].mean()
        return float(standing / (1.0 - _ANKLE))

    @classmethod
    def from_stature(cls, stature_m: float) -> Body:
        """Return an average adult of this standing height (Drillis & Contini 1966 in Winter, fig. 4.1), metres.

        The neck point lies at the chin's height, hands are stretched (the forearm stick ends at the finger tip).
        Raises InputError outside 0.5 to 2.6 m.
        """
        stature_m = _check_size("stature_m", stature_m)
        low, high = STATURES_M
        if not low <= stature_m <= high:
            remedy = f"Give it in metres, {low} to {high}."
            raise InputError(f"a stature of {stature_m:g} m is not a person's", remedy=remedy)
        thigh, calf = _HIP - _KNEE, _KNEE - _ANKLE
        forearm = _FOREARM + _HAND
        torso = _NECK - _HIP
        lengths = np.array([torso, 1.0 - _NECK, _UPPER_ARM, _UPPER_ARM, thigh, thigh, forearm, forearm, calf, calf])
        shoulder_ratio = (_SHOULDER - 0.5 * (_NECK + _HIP)) / (0.5 * torso)
        hip_ratio = _HIP_CENTRES_OVER_PELVIS * _PELVIC / _BIACROMIAL
        return cls(0.5 * lengths * stature_m, 0.5 * _BIACROMIAL * stature_m, shoulder_ratio, hip_ratio)

    @classmethod
    def from_points(cls, points_world: Array) -> Body:
        """Return the body measured on reference points (F, 15, 3) (or one frame (15, 3)), metres, NaN where unknown.

        Median limb lengths over the frames, left and right pooled; d_s and d_H are measured too.
        Raises InputError when a limb is never seen.
        """
        points = np.asarray(points_world, float)
        points = points[None] if points.ndim == 2 else points
        if points.ndim != 3 or points.shape[1:] != (15, 3):
            raise InputError(f"reference points have shape {points.shape}", remedy="Expected (frames, 15, 3).")
        middle_hips = points[:, 5:7].mean(1)
        spine = points[:, 2] - middle_hips
        torso = _median_length(spine, "torso")
        lengths = np.full(10, torso)
        for limb in _LIMBS:
            segments = np.concatenate([points[:, _STICK_POINTS[j][1]] - points[:, _STICK_POINTS[j][0]] for j in limb])
            lengths[list(limb)] = _median_length(segments, STICK_NAMES[limb[0]].removeprefix("left_"))
        shoulder_width = _median_length(points[:, 3] - points[:, 4], "shoulders")
        hip_width = _median_length(points[:, 5] - points[:, 6], "hips")
        centre = 0.5 * (points[:, 2] + middle_hips)
        up = spine / np.linalg.norm(spine, axis=1, keepdims=True)
        rise = np.einsum("fi,fi->f", points[:, 3:5].mean(1) - centre, up)
        shoulder_ratio = max(float(np.nanmedian(rise)) / (0.5 * torso), 1e-3)
        return cls(0.5 * lengths, 0.5 * shoulder_width, shoulder_ratio, hip_width / shoulder_width)


def _median_length(segments: Array, name: str) -> float:
    lengths = np.linalg.norm(segments, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    if lengths.size == 0:
        raise InputError(f"no frame shows both ends of the {name}", remedy="Give frames in which every limb is seen.")
    return float(np.median(lengths))


def _check_size(name: str, value: float) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}, not a number", remedy="Give a positive number.") from None
    if not np.isfinite(number) or number <= 0.0:
        raise InputError(f"{name} is {number:g}", remedy="Give a positive, finite number.")
    return number


KEYS = ("lengths", "shoulder_width", "shoulder_height_ratio", "hip_width_ratio")
OPTIONAL_KEYS = ("units", "source", "thickness", "build")
MOST_BODY_BYTES = 64 << 10  # one person's has 1 KB; bodies come as messages too, and parsing is slow
MAX_LENGTH_M, MAX_BUILD = 2.0, 6.0
_REMEDY = f"A body file is a mapping with the keys {', '.join(KEYS)}."


def load_body(path: str | Path) -> Body:
    """Reads a body file. Raises InputError naming file, key, value and remedy for anything that does not fit."""
    return parse_body(read_text(path, _REMEDY, MOST_BODY_BYTES), str(path))


def save_body(body: Body, path: str | Path, source: str = "") -> None:
    """Write a body so that :func:`load_body` returns the same numbers; `source` : origin of the sizes.

    All or nothing. Raises InputError when the file cannot be written.
    """
    write_text(path, format_body(body, source))


def parse_body(text: str, where: str) -> Body:
    """Return the body of a body file's text. Raises InputError naming `where`, key, value and remedy."""
    if len(text) > MOST_BODY_BYTES:
        raise InputError(f"has {len(text)} characters, too many for a body", where=where, remedy=_REMEDY)
    document = parse_mapping(text, where, _REMEDY)
    _check_keys(document, KEYS, OPTIONAL_KEYS, where)
    if document.get("units", "metres") != "metres":
        raise InputError(f"units is {document['units']!r}", where=where, remedy="Write all sizes in metres.")
    lengths = document["lengths"]
    if not isinstance(lengths, Mapping):
        raise InputError(f"lengths is {lengths!r}", where=where, remedy="Give one length for each stick by name.")
    _check_keys(lengths, STICK_NAMES, (), f"{where}: lengths")
    values = [_number(lengths[name], f"{where}: lengths.{name}", MAX_LENGTH_M) for name in STICK_NAMES]
    width = _number(document["shoulder_width"], f"{where}: shoulder_width", MAX_LENGTH_M)
    ratios = [_number(document[key], f"{where}: {key}", 5.0) for key in KEYS[2:]]
    build = _build(document.get("build"), where)
    return Body(0.5 * np.array(values), 0.5 * width, ratios[0], ratios[1], build)


def _build(given: Any, where: str) -> np.ndarray:
    """Return the build in a file, or the average one."""
    if given is None:
        return np.zeros(BUILD_NUMBERS)
    numbers = [v for v in given if isinstance(v, int | float) and np.isfinite(v)] if isinstance(given, list) else []
    if len(numbers) != BUILD_NUMBERS or np.abs(numbers).max() > MAX_BUILD:
        remedy = f"Give {BUILD_NUMBERS} numbers of at most {MAX_BUILD:g}, or leave the key out."
        raise InputError(f"build is {given!r}", where=where, remedy=remedy)
    return np.array(numbers, float)


def format_body(body: Body, source: str = "") -> str:
    """Return a body file's text, from which :func:`parse_body` returns the same numbers."""
    document: dict[str, Any] = {"units": "metres"}
    if source:
        document["source"] = source
    document["lengths"] = {name: float(v) for name, v in zip(STICK_NAMES, body.lengths, strict=True)}
    document["shoulder_width"] = 2.0 * body.half_shoulder_width
    document["shoulder_height_ratio"] = body.shoulder_height_ratio
    document["hip_width_ratio"] = body.hip_width_ratio
    if body.build.any():
        document["build"] = body.build.tolist()
    return format_mapping(document)


def _check_keys(given: Mapping[str, Any], needed: tuple[str, ...], optional: tuple[str, ...], where: str) -> None:
    for key in needed:
        if key not in given:
            raise InputError(f"key '{key}' is missing", where=where, remedy=f"Needed: {', '.join(needed)}.")
    for key in given:
        if key not in needed + optional:
            raise InputError(f"key '{key}' is not known", where=where, remedy=f"Known: {', '.join(needed + optional)}.")


def _number(value: Any, where: str, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"value {value!r} is not a number", where=where, remedy="Give a positive number.")
    if not 0.0 < value <= high:
        raise InputError(
            f"value {value:g} is out of range",
            where=where,
            remedy=f"Give a number above 0 and at most {high:g} (metres for lengths).",
        )
    return float(value)
