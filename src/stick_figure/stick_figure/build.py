"""How people's surfaces differ: the capsules of any build, by the body's lengths and a few numbers.

The table ``builds.csv`` (made by ``models/body_builds.py``) is a Gaussian over the surfaces of 40 rendered people in 12
poses each (MakeHuman's mesh with random phenotypes, adolescent to old, CC0), found by expectation maximisation from
rays along their outlines against their true bones, hands and feet in frames of their own. Girths of 6 per cent and the
studio's people, whose flesh is centred on the bones, widen it. Each of the eight numbers of a capsule (start and end in
the stick's frame, both radii) is

    of_length * length + stature * (of_stature + slopes . (lengths / stature - mean) + modes . build)

where ``length`` is that of the stick, for numbers along it. ``build`` is what the lengths do not tell (girths, the
trunk's depth, where flesh lies about the bones), in units of how people differ: independent, of standard deviation 1.
"""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .body import BUILD_NUMBERS, Body
from .skeleton import (
    HEAD,
    L_CALF,
    L_FOREARM,
    L_THIGH,
    L_UPPER_ARM,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    R_UPPER_ARM,
    STICK_AXIS,
    STICK_SIGN,
    TORSO,
)

# Thresholds: made by python models/body_builds.py, fitted to rendered mesh people of 40 bodies that no test shows and
# the spread of the studio's capsule people, from rays along their outlines; the least radius: judgement.
TABLE = Path(__file__).with_name("builds.csv")
NUMBERS = ("start_x", "start_y", "start_z", "end_x", "end_y", "end_z", "start_radius", "end_radius")
LENGTHS: tuple[str, ...] = (
    *("head", "torso", "shoulder_rise", "half_shoulder_width", "upper_arm", "forearm", "half_hip_width"),
    *("thigh", "calf"),
)
PARTS = {
    "side": (TORSO, TORSO),
    "spine": (TORSO,),
    "girdle": (TORSO, TORSO),
    "head": (HEAD,),
    "upper_arm": (L_UPPER_ARM, R_UPPER_ARM),
    "forearm": (L_FOREARM, R_FOREARM),
    "hand": (L_FOREARM, R_FOREARM),
    "thigh": (L_THIGH, R_THIGH),
    "calf": (L_CALF, R_CALF),
    "foot": (L_CALF, R_CALF),
}
"""The capsules: the sticks they are fixed to, the left one first."""
CAPSULES = sum(len(sticks) for sticks in PARTS.values())
END_CAPSULES, END_STICKS = (10, 11, 16, 17), (L_FOREARM, R_FOREARM, L_CALF, R_CALF)
"""Hands and feet among the capsules, left first, and their sticks."""
_ARM_STICKS = (L_UPPER_ARM, R_UPPER_ARM, L_FOREARM, R_FOREARM)
GIRTH_SD = 0.1
"""Spread of a person's radii about what their girth says, over the radius."""
_LEAST_RADIUS = 0.002  # over the stature: no build makes a limb thinner


class Builds(NamedTuple):
    """The table: for each part (p) and number (8) of_length, of_stature (p, 8), slopes (p, 8, lengths), modes
    (p, 8, BUILD_NUMBERS); ``mean`` (lengths,) of the lengths over the stature."""

    of_length: np.ndarray
    of_stature: np.ndarray
    slopes: np.ndarray
    modes: np.ndarray
    mean: np.ndarray


@lru_cache(maxsize=1)
def builds() -> Builds:
    """Read the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        mean, *rows = list(csv.reader(file))[1:]
    names = [(part, number) for part in PARTS for number in NUMBERS]
    if [tuple(row[:2]) for row in rows] != names:
        raise ValueError(f"{TABLE} does not have the rows {PARTS} times {NUMBERS}")
    values, first = np.array([row[2:] for row in rows], float).reshape(len(PARTS), len(NUMBERS), -1), 2 + len(LENGTHS)
    slopes, modes = values[..., 2:first], values[..., first : first + BUILD_NUMBERS]
    return Builds(values[..., 0], values[..., 1], slopes, modes, np.array(mean[4 : 4 + len(LENGTHS)], float))


def capsule_numbers(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return the stick (k,) of each capsule and its numbers (k, 8): start and end (3 each, m, in the stick's frame
    from its start), radii (m) at start and end."""
    table, stature = builds(), body.stature
    shape = table.of_stature + table.slopes @ (_lengths(body) / stature - table.mean) + table.modes @ body.build
    return capsules_of(body, table.of_length, stature * shape)


def build_of_girth(girth: float) -> np.ndarray:
    """Return the likeliest build (BUILD_NUMBERS,) of people whose radii are ``girth`` times the average, each of them
    give or take GIRTH_SD: the conditional mean of the table's Gaussian."""
    table = builds()
    radii = table.of_stature[:, 6:].ravel()
    modes = table.modes[:, 6:].reshape(len(radii), -1) / (GIRTH_SD * radii[:, None])
    wanted = np.full(len(radii), (girth - 1.0) / GIRTH_SD)
    build: np.ndarray = np.linalg.solve(np.eye(BUILD_NUMBERS) + modes.T @ modes, modes.T @ wanted)
    return build


def capsules_of(body: Body, of_length: np.ndarray, more: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the stick (k,) of each capsule and its numbers (k, 8) m, from those of the left side and the middle:
    ``of_length`` (p, 8) of the sticks' lengths and ``more`` (p, 8), m."""
    sticks, capsules = [], []
    for part, fractions, others in zip(PARTS.items(), of_length, more, strict=True):
        name, own = part
        for side, stick in enumerate(own):
            numbers = fractions * length_along(name, stick, body) + others
            if side == 1:
                mirrored = mirrored_axis(stick)
                numbers[[mirrored, 3 + mirrored]] *= -1.0
            numbers[6:] = np.maximum(numbers[6:], _LEAST_RADIUS * body.stature)
            sticks.append(stick)
            capsules.append(numbers)
    return np.array(sticks), np.array(capsules)


def mirrored_axis(stick: int) -> int:
    """Return the axis of a right stick's frame that points the other way than in the left one's."""
    return 2 if stick in _ARM_STICKS else 1  # arms' frames both have y along the arm


def _lengths(body: Body) -> np.ndarray:
    """The body's lengths (9,), m, in the order of LENGTHS."""
    lengths, width = body.lengths, body.half_shoulder_width
    rise = (1.0 + body.shoulder_height_ratio) * body.half_lengths[TORSO]
    upper_arm, forearm = lengths[[L_UPPER_ARM, R_UPPER_ARM]].mean(), lengths[[L_FOREARM, R_FOREARM]].mean()
    thigh, calf = lengths[[L_THIGH, R_THIGH]].mean(), lengths[[L_CALF, R_CALF]].mean()
    hip = body.hip_width_ratio * width
    return np.array([lengths[HEAD], lengths[TORSO], rise, width, upper_arm, forearm, hip, thigh, calf])


def length_along(part: str, stick: int, body: Body) -> np.ndarray:
    """What the numbers (8,) of a capsule go along with, m, with the stick's direction; 0 across it and for radii."""
    along, axis = np.zeros(len(NUMBERS)), STICK_AXIS[stick]
    along[[axis, 3 + axis]] = STICK_SIGN[stick] * body.lengths[stick]
    if part == "girdle":  # reaches towards the shoulder
        along[[1, 4]] = body.half_shoulder_width
    return along
