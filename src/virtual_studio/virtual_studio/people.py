"""People of any size: a stick figure with volume, made of tapered capsules, each with its own grey; and their clothes.

A part is the hull of two spheres fixed to one stick. Sizes scale with the stature; the trunk is made of side-by-side
capsules, so that it is wider than deep. Feet have no joint: near the floor they lie level, lifted they follow the calf.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture_rig.session import WRIST_FRACTION
from stick_figure import kernels
from stick_figure.body import TYPICAL_STATURE_M, Body
from stick_figure.pose import Pose
from stick_figure.skeleton import (
    HEAD,
    L_CALF,
    L_FOREARM,
    L_THIGH,
    L_UPPER_ARM,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    R_UPPER_ARM,
    TORSO,
)

Array = NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])
ANKLE_HEIGHT = 0.039
"""Ankle over stature (Drillis & Contini 1966)."""
SKIN, HAIR, SHIRT, SLEEVE, TROUSERS, SHOES = 0.38, 0.09, 0.27, 0.30, 0.15, 0.11
"""Albedos: a person darker than the room, in clothes that differ from each other."""
LEVEL_FOOT_BELOW, FREE_FOOT_ABOVE = 0.05, 0.16
"""Ankle height over stature between which a foot turns from level to following its calf."""
FREE_FOOT_TILT, LEVEL_FOOT_TILT = 0.15, 0.40
"""Cosine of a calf's tilt between which its foot turns from following it (lying) to level (standing, squatting)."""
BUILDS = (0.6, 1.6)
"""Builds that people have, over the average's."""
ARMS, LEGS = [L_UPPER_ARM, R_UPPER_ARM, L_FOREARM, R_FOREARM], [L_THIGH, R_THIGH, L_CALF, R_CALF]


class Capsules(NamedTuple):
    """A body's parts in one pose: the hulls of the spheres (starts, radii[:, 0]) and (ends, radii[:, 1]).

    starts, ends (P, 3) world frame, metres; radii (P, 2) metres; albedo (P,) between 0 and 1.
    """

    starts: Array
    ends: Array
    radii: Array
    albedo: Array


def together(*bodies: Capsules) -> Capsules:
    """Returns the parts of several bodies as one."""
    return Capsules(*(np.concatenate(parts) for parts in zip(*bodies, strict=True)))


@dataclass(frozen=True)
class _Part:
    stick: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radii: tuple[float, float]
    albedo: float


@dataclass(frozen=True, eq=False)
class VolumetricBody:
    """A person of the given sizes; `place` puts the parts into a pose.

    build: thickness of trunk and limbs over the average's, 0.85 slim, 1.2 heavy; head and hands vary less, feet not.
    """

    body: Body
    build: float = 1.0

    @cached_property
    def scale(self) -> float:
        """Size of this person over the one the radii are drawn for."""
        return self.body.stature / TYPICAL_STATURE_M

    @cached_property
    def ankle_height(self) -> float:
        """Height of the ankles of a standing person, metres."""
        return ANKLE_HEIGHT * self.body.stature

    @cached_property
    def _parts(self) -> list[_Part]:
        thick, thin = self.scale * self.build, self.scale * (1.0 + 0.3 * (self.build - 1.0))
        trunk_and_head = [*_trunk(self.body, thick), *_head(self.body, thin)]
        return [*trunk_and_head, *_arms(self.body, thick, thin), *_legs(self.body, thick)]

    @cached_property
    def sticks(self) -> NDArray[np.int64]:
        """(p,) the stick of each part but the feet's, in the order of `place`."""
        return np.array([part.stick for part in self._parts])

    def radii_of(self, stick: int) -> Array:
        """Returns the radii (p, 2) of a stick's parts, m."""
        return np.array([part.radii for part in self._parts if part.stick == stick])

    def place(self, pose: Pose) -> Capsules:
        """Returns the parts in the world."""
        G, A, B = _frames(self.body, pose)
        parts, sticks = self._parts, self.sticks
        origins = A.copy()
        origins[TORSO] = pose.position_world
        starts = origins[sticks] + np.einsum("pij,pj->pi", G[sticks], np.array([part.start for part in parts]))
        ends = origins[sticks] + np.einsum("pij,pj->pi", G[sticks], np.array([part.end for part in parts]))
        feet = [self._foot(G[calf], B[calf]) for calf in (L_CALF, R_CALF)]
        return Capsules(
            starts=np.vstack([starts, *(foot[0] for foot in feet)]),
            ends=np.vstack([ends, *(foot[1] for foot in feet)]),
            radii=np.vstack([[part.radii for part in parts], self._foot_radii, self._foot_radii]),
            albedo=np.array([*(part.albedo for part in parts), *[SHOES] * 4]),
        )

    def contact_spheres(self, pose: Pose) -> tuple[Array, Array]:
        """Returns the spheres that may rest on the floor: centres (c, 3) m in the world, radii (c,) m.

        The first two are the feet: ankles, as high above the floor as of a standing person, or higher where a calf lies
        so low that its foot reaches farther down. The others end the parts above the knees.
        """
        G, A, B = _frames(self.body, pose)
        A[TORSO] = pose.position_world
        sticks, ends, radii = self._above_the_knees
        centres = A[sticks] + np.einsum("pij,pj->pi", G[sticks], ends)
        feet = []
        for calf in (L_CALF, R_CALF):
            starts, tips = self._foot(G[calf], np.zeros(3))
            lowest = np.minimum(starts[:, 2] - self._foot_radii[:, 0], tips[:, 2] - self._foot_radii[:, 1]).min()
            feet.append(max(self.ankle_height, -float(lowest)))
        return np.vstack([B[[L_CALF, R_CALF]], centres]), np.append(feet, radii)

    @cached_property
    def _foot_radii(self) -> Array:
        """Radii (2, 2) of a foot's two capsules, m."""
        return self.scale * np.array([(0.040, 0.030), (0.036, 0.024)])

    @cached_property
    def _above_the_knees(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Ends of those parts: sticks (e,), places (e, 3) m in the stick's frame, radii (e,) m."""
        parts = [part for part in self._parts if part.stick not in (L_CALF, R_CALF)]
        ends = np.array([end for part in parts for end in (part.start, part.end)])
        return np.repeat([part.stick for part in parts], 2), ends, np.array([part.radii for part in parts]).ravel()

    def _foot(self, R_world_calf: Array, ankle: Array) -> tuple[Array, Array]:
        """Starts and ends (2, 3) of a foot's two capsules: heel to toes, and its outer edge."""
        s, stature = self.scale, self.body.stature
        lifted = (ankle[2] / stature - LEVEL_FOOT_BELOW) / (FREE_FOOT_ABOVE - LEVEL_FOOT_BELOW)
        tilted = (LEVEL_FOOT_TILT - R_world_calf[2, 2]) / (LEVEL_FOOT_TILT - FREE_FOOT_TILT)
        free = np.clip(max(lifted, tilted), 0.0, 1.0)
        level = R_world_calf[:, 0] * np.array([1.0, 1.0, 1e-9])
        forward = _unit((1 - free) * _unit(level) + free * R_world_calf[:, 0])
        side = _unit(_cross(UP, forward) + 1e-9 * R_world_calf[:, 1])
        up = _cross(forward, side)
        sole = ankle - 0.030 * s * up
        starts = [sole - 0.035 * s * forward, sole]
        ends = [
            sole + 0.150 * s * forward - 0.010 * s * up + 0.02 * s * side,
            sole + 0.140 * s * forward - 0.014 * s * up - 0.02 * s * side,
        ]
        return np.array(starts), np.array(ends)


def person_of(stature_m: float, arms: float = 1.0, legs: float = 1.0) -> Body:
    """Returns a body of this standing height, m, with factors of the average lengths of arms and legs.

    The torso fills the rest of the stature.
    """
    average = Body.from_stature(stature_m)
    halves = average.half_lengths.copy()
    halves[ARMS] *= arms
    halves[LEGS] *= legs
    longer = 2.0 * float(np.sum(halves[[L_THIGH, L_CALF]] - average.half_lengths[[L_THIGH, L_CALF]]))
    halves[TORSO] -= 0.5 * longer
    return Body(halves, average.half_shoulder_width, average.shoulder_height_ratio, average.hip_width_ratio)


def people_of_sizes(count: int) -> tuple[VolumetricBody, ...]:
    """Returns up to four persons of different sizes and builds, the same ones every time."""
    sizes = ((1.78, 1.0, 1.0, 1.05), (1.64, 1.0, 0.98, 0.9), (1.70, 1.03, 1.0, 1.2), (1.60, 0.97, 1.02, 1.0))
    return tuple(VolumetricBody(person_of(*lengths), build) for *lengths, build in sizes[:count])


def _trunk(body: Body, s: float) -> list[_Part]:
    h, w = body.half_lengths[TORSO], body.half_shoulder_width
    shoulder, hip = body.shoulder_height_ratio * h, body.hip_width_ratio * w
    parts = [
        _Part(TORSO, (0, -0.45 * hip, -0.92 * h), (0, 0.45 * hip, -0.92 * h), (0.108 * s, 0.108 * s), TROUSERS),
        _Part(TORSO, (0.02 * s, 0, 0.1 * h), (0.02 * s, 0, 0.6 * shoulder), (0.100 * s, 0.098 * s), SHIRT),
        _Part(TORSO, (-0.01 * s, 0, 0.9 * shoulder), (0, 0, 1.05 * h), (0.066 * s, 0.054 * s), SHIRT),
    ]
    for side in (-1.0, 1.0):
        waist, chest = side * 0.050 * s, side * 0.42 * w
        parts += [
            _Part(TORSO, (0, side * 0.6 * hip, -0.85 * h), (0, waist, -0.35 * h), (0.100 * s, 0.094 * s), TROUSERS),
            _Part(TORSO, (0, waist, -0.45 * h), (0.01 * s, chest, 0.30 * h), (0.097 * s, 0.104 * s), SHIRT),
            _Part(TORSO, (0.01 * s, chest, 0.25 * h), (0, 0.95 * chest, 0.8 * shoulder), (0.104 * s, 0.086 * s), SHIRT),
            _Part(TORSO, (0, chest, 0.85 * shoulder), (0, side * w, shoulder), (0.078 * s, 0.060 * s), SHIRT),
            _Part(TORSO, (-0.01 * s, 0, 0.93 * h), (0, side * 0.8 * w, shoulder), (0.052 * s, 0.056 * s), SHIRT),
        ]
    return parts


def _head(body: Body, s: float) -> list[_Part]:
    length = body.lengths[HEAD]
    crown = length + 0.008 * s
    return [
        _Part(HEAD, (0, 0, -0.03 * s), (0.01 * s, 0, 0.40 * length), (0.056 * s, 0.052 * s), SKIN),
        _Part(HEAD, (0.022 * s, 0, 0.36 * length), (0.015 * s, 0, crown - 0.088 * s), (0.058 * s, 0.078 * s), SKIN),
        _Part(HEAD, (-0.014 * s, 0, crown - 0.105 * s), (0, 0, crown - 0.085 * s), (0.084 * s, 0.085 * s), HAIR),
    ]


def _arms(body: Body, s: float, hand: float) -> list[_Part]:
    """s, hand: scale of the arms' thickness and of the hands'."""
    parts = []
    for upper, fore in ((L_UPPER_ARM, L_FOREARM), (R_UPPER_ARM, R_FOREARM)):
        wrist, tip = WRIST_FRACTION * body.lengths[fore], body.lengths[fore]
        palm = wrist + 0.55 * (tip - wrist)
        parts += [
            _Part(upper, (0, 0, 0), (0, body.lengths[upper], 0), (0.058 * s, 0.044 * s), SLEEVE),
            _Part(fore, (0, 0, 0), (0, 0.35 * wrist, 0), (0.043 * s, 0.044 * s), SKIN),
            _Part(fore, (0, 0.35 * wrist, 0), (0, wrist, 0), (0.044 * s, 0.028 * s), SKIN),
        ]
        for side in (-0.018 * hand, 0.018 * hand):
            parts.append(_Part(fore, (0, wrist, 0.5 * side), (0, palm, side), (0.024 * hand, 0.022 * hand), SKIN))
            parts.append(_Part(fore, (0, palm, side), (0, tip, 0.3 * side), (0.021 * hand, 0.013 * hand), SKIN))
    return parts


def _legs(body: Body, s: float) -> list[_Part]:
    parts = []
    for thigh, calf in ((L_THIGH, L_CALF), (R_THIGH, R_CALF)):
        upper, lower = body.lengths[thigh], body.lengths[calf]
        parts += [
            _Part(thigh, (0, 0, 0), (0, 0, -0.45 * upper), (0.094 * s, 0.078 * s), TROUSERS),
            _Part(thigh, (0, 0, -0.45 * upper), (0, 0, -upper), (0.078 * s, 0.056 * s), TROUSERS),
            _Part(calf, (0, 0, 0), (-0.012 * s, 0, -0.32 * lower), (0.056 * s, 0.058 * s), TROUSERS),
            _Part(calf, (-0.012 * s, 0, -0.32 * lower), (0, 0, -lower), (0.058 * s, 0.040 * s), TROUSERS),
        ]
    return parts


def _frames(body: Body, pose: Pose) -> tuple[Array, Array, Array]:
    """Stick rotations (10, 3, 3), starts and ends (10, 3), world frame."""
    G, _, A, B = kernels.place_sticks(pose.arrays, body.lengths, body.stick_origins_torso)
    return G, A, B


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def _cross(a: Array, b: Array) -> Array:
    """Cross product; numpy's takes ten times as long for two vectors."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


# --- What they wear: clothes darker than the room, lighter, or of its own colour, in grey and in colour.


MEAN_SHADING = 0.62
"""Light that an upright body of albedo 1 reflects on average (`rendering.capsules.lambert`); the room's greys are
reflected light, so clothes of the room's colour have its grey over this as their albedo."""
SKIN_BGR, HAIR_BGR = (0.72, 0.93, 1.35), (0.8, 1.0, 1.2)
"""Blue, green and red over grey, each with a mean of 1."""

Bgr = tuple[float, float, float]


def cloth(light: float, bgr: Bgr = (1.0, 1.0, 1.0)) -> Array:
    """Returns the albedo (3,), BGR, of a cloth by its reflected light where walls reflect 0.6, and its colour with a
    mean of 1."""
    return light / MEAN_SHADING * np.array(bgr)


@dataclass(frozen=True, eq=False)
class Outfit:
    """What a person wears, albedos of each `cloth`; skin and hair stay a person's."""

    shirt: Array
    sleeve: Array
    trousers: Array
    shoes: Array

    def albedo_bgr(self, capsules: Capsules) -> NDArray[np.float64]:
        """Returns the albedo (P, 3), BGR, of each part of a body."""
        worn = {
            SKIN: SKIN * np.array(SKIN_BGR),
            HAIR: HAIR * np.array(HAIR_BGR),
            SHIRT: self.shirt,
            SLEEVE: self.sleeve,
            TROUSERS: self.trousers,
            SHOES: self.shoes,
        }
        return np.array([worn[albedo] for albedo in capsules.albedo])

    def dress(self, capsules: Capsules) -> Capsules:
        """Returns a body in these clothes, as a grey camera sees them."""
        return capsules._replace(albedo=self.albedo_bgr(capsules).mean(axis=1))


BLUE, GREEN, BROWN = (1.35, 0.95, 0.70), (0.85, 1.30, 0.85), (0.75, 0.95, 1.30)
OUTFITS: Mapping[str, Outfit] = {
    "dark": Outfit(cloth(0.10, BLUE), cloth(0.11, BLUE), cloth(0.06), cloth(0.05)),
    "middle": Outfit(cloth(0.36, GREEN), cloth(0.40, GREEN), cloth(0.30, BLUE), cloth(0.12, BROWN)),
    "light": Outfit(cloth(0.84), cloth(0.88), cloth(0.78, (0.92, 1.0, 1.08)), cloth(0.70)),
    "room": Outfit(cloth(0.60), cloth(0.60), cloth(0.55, (0.74, 0.98, 1.28)), cloth(0.52, (0.74, 0.98, 1.28))),
}
"""By their contrast in the studio's room, whose walls reflect 0.6 and whose floor, brown, 0.55."""
