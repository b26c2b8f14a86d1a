"""The body's surface: tapered capsules fixed to the sticks, which silhouettes and hulls are compared with.

Radii and offsets follow the body's lengths and its build, and anatomy where it matters: the trunk is wider than deep
and lies in front of the line from hips to neck, the thigh bulges forward, the calf backward; feet point forward of the
ankles. Each of the eight numbers of a capsule (start and end in the stick's frame, both radii) is

    of_length * length + stature * (of_stature + slopes . (lengths / stature - mean) + modes . build)

where ``length`` is that of the stick, for numbers along it. ``build`` holds the differences of people of equal lengths
(girths, the trunk's depth, flesh about the bones): independent, of standard deviation 1.

The table ``builds.csv`` (made by ``models/body_builds.py``) is a Gaussian over the surfaces of 40 rendered people in 12
poses each (MakeHuman's mesh with random phenotypes, adolescent to old, CC0), found by expectation maximisation from
rays along their outlines against their true bones, hands and feet in frames of their own. Girths of 6 per cent and the
studio's people, whose flesh is centred on the bones, widen it.

Mass and inertia of the sticks, for physics: segments' shares of the mass are those of de Leva (J. Biomech. 29, 1996,
table 4: Zatsiorsky's data, mean of women and men), spread evenly over the segment's capsules.
"""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel

from .body import BUILD_NUMBERS, Body
from .rotations import Array
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
EXTREMITY_CAPSULES, EXTREMITY_STICKS = (10, 11, 16, 17), (L_FOREARM, R_FOREARM, L_CALF, R_CALF)
"""Hands and feet among the capsules, left first, and their sticks."""
_ARM_STICKS = (L_UPPER_ARM, R_UPPER_ARM, L_FOREARM, R_FOREARM)
GIRTH_SD = 0.1
"""Standard deviation of a person's radii about those of the girth, over the radius."""
_LEAST_RADIUS = 0.002  # over the stature: no build makes a limb thinner

AVERAGE_BMI = 22.0
"""kg/m^2, the middle of the WHO's normal range."""
MASS_SHARES = np.array([43.015, 6.81, 2.63, 2.63, 14.47, 14.47, 2.085, 2.085, 5.90, 5.90])
MASS_SHARES /= MASS_SHARES.sum()
"""(10,) of the sticks: trunk, head with neck, upper arms, thighs, forearms with hands, calves with feet."""
DISCS = 64  # into which a capsule is cut: its inertia is then right to a thousandth


class BodySurface(NamedTuple):
    """Capsules as arrays: stick (k,) each is fixed to, start and end (k, 3) m in that stick's frame from its start,
    radii (k, 2) m at start and end."""

    stick: np.ndarray
    start: np.ndarray
    end: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(body: Body) -> BodySurface:
        """Return the surface of a body."""
        stick, numbers = capsule_numbers(body)
        start, end, radii = (np.ascontiguousarray(part) for part in np.split(numbers, [3, 6], axis=1))
        return BodySurface(stick, start, end, radii)


@kernel
def place_capsules(capsules, G, A, P, Q):
    """World ends P, Q (k, 3) of the capsules, from stick frames G (10, 3, 3) and stick starts A (10, 3)."""
    for k in range(capsules.stick.shape[0]):
        j = capsules.stick[k]
        for i in range(3):
            P[k, i] = A[j, i]
            Q[k, i] = A[j, i]
            for q in range(3):
                P[k, i] += G[j, i, q] * capsules.start[k, q]
                Q[k, i] += G[j, i, q] * capsules.end[k, q]


@kernel
def nearest_capsule(x, y, z, P, Q, radii, capsule, along, distance):
    """Find the capsule nearest to each point (n,): its index, the place along its axis, and the signed distance (n,) m
    from its surface, negative inside. Branch-free inside, so it is vectorised."""
    distance[:] = np.inf
    for k in range(P.shape[0]):
        a0, a1, a2 = P[k, 0], P[k, 1], P[k, 2]
        d0, d1, d2 = Q[k, 0] - a0, Q[k, 1] - a1, Q[k, 2] - a2
        inverse = 1.0 / (d0 * d0 + d1 * d1 + d2 * d2)
        r0, dr = radii[k, 0], radii[k, 1] - radii[k, 0]
        for i in range(x.shape[0]):
            p, q, r = x[i] - a0, y[i] - a1, z[i] - a2
            u = (p * d0 + q * d1 + r * d2) * inverse
            u = u if u > 0.0 else 0.0
            u = u if u < 1.0 else 1.0
            p -= u * d0
            q -= u * d1
            r -= u * d2
            e = np.sqrt(p * p + q * q + r * r) - (r0 + u * dr)
            nearer = e < distance[i]
            distance[i] = e if nearer else distance[i]
            along[i] = u if nearer else along[i]
            capsule[i] = k if nearer else capsule[i]


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
    shape = table.of_stature + table.slopes @ (lengths_of(body) / stature - table.mean) + table.modes @ body.build
    return capsules_of(body, table.of_length, stature * shape)


def build_of_girth(girth: float) -> np.ndarray:
    """Return the most likely build (BUILD_NUMBERS,) of radii that are ``girth`` times the average, standard deviation
    GIRTH_SD: the conditional mean of the table's Gaussian."""
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


def lengths_of(body: Body) -> np.ndarray:
    """Return the body's lengths (9,), m, in the order of LENGTHS."""
    lengths, width = body.lengths, body.half_shoulder_width
    rise = (1.0 + body.shoulder_height_ratio) * body.half_lengths[TORSO]
    upper_arm, forearm = lengths[[L_UPPER_ARM, R_UPPER_ARM]].mean(), lengths[[L_FOREARM, R_FOREARM]].mean()
    thigh, calf = lengths[[L_THIGH, R_THIGH]].mean(), lengths[[L_CALF, R_CALF]].mean()
    hip = body.hip_width_ratio * width
    return np.array([lengths[HEAD], lengths[TORSO], rise, width, upper_arm, forearm, hip, thigh, calf])


def length_along(part: str, stick: int, body: Body) -> np.ndarray:
    """Return the length (8,) m, signed by the stick's direction, that scales each number; 0 across it and for radii."""
    along, axis = np.zeros(len(NUMBERS)), STICK_AXIS[stick]
    along[[axis, 3 + axis]] = STICK_SIGN[stick] * body.lengths[stick]
    if part == "girdle":  # reaches towards the shoulder
        along[[1, 4]] = body.half_shoulder_width
    return along


class SegmentInertia(NamedTuple):
    """Mass, kg; centre of mass (3,) m, in the stick's frame from its start; inertia (3, 3) kg m^2 about the centre."""

    mass: float
    centre: Array
    inertia: Array


def segment_inertias(body: Body, mass_kg: float | None = None) -> list[SegmentInertia]:
    """Return the inertia of each stick of a body; ``mass_kg`` : of the person, else that of an average BMI."""
    surface, mass = BodySurface.of(body), AVERAGE_BMI * body.stature**2 if mass_kg is None else mass_kg
    found = []
    for stick, share in enumerate(MASS_SHARES):
        own = surface.stick == stick
        solids = [
            _capsule(*ends) for ends in zip(surface.start[own], surface.end[own], surface.radii[own], strict=True)
        ]
        volumes = np.array([volume for volume, _, _ in solids])
        masses, centres = share * mass * volumes / volumes.sum(), np.array([centre for _, centre, _ in solids])
        centre = masses @ centres / masses.sum()
        about_own = sum(m * per_mass for m, (_, _, per_mass) in zip(masses, solids, strict=True))
        offsets = centres - centre
        moved = np.einsum("k,ki,kj->ij", masses, offsets, offsets)
        found.append(SegmentInertia(float(share * mass), centre, about_own + np.trace(moved) * np.eye(3) - moved))
    return found


def _capsule(start: Array, end: Array, radii: Array) -> tuple[float, Array, Array]:
    """Return the volume, m^3, of a tapered capsule, its centre (3,) m, and its inertia about that (3, 3) m^2 per kg."""
    length = max(float(np.linalg.norm(end - start)), 1e-9)
    direction = (end - start) / length
    edges = np.linspace(-radii[0], length + radii[1], DISCS + 1)
    s, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    beyond = np.maximum(np.maximum(-s, s - length), 0.0)  # in the ball at either end
    square = np.interp(s, (0.0, length), radii) ** 2 - beyond**2
    share = square / square.sum()
    middle, axial = float(share @ s), 0.5 * float(share @ square)
    across = 0.5 * axial + float(share @ (s - middle) ** 2)
    inertia = across * np.eye(3) + (axial - across) * np.outer(direction, direction)
    return float(np.pi * width * square.sum()), start + middle * direction, inertia
