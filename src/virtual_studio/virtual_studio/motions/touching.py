"""Arms that touch the body, where silhouettes merge: on the chest, clasped, on the hips."""

from __future__ import annotations

import numpy as np

from ..body import VolumetricBody
from .everyday import STANDING
from .keys import Key, activity_of, hold
from .limbs import ARM, Array, both_sides, reaching, with_left, with_right
from .timeline import Timeline

CHEST_M, BELLY_M, HIP_M = 0.132, 0.105, 0.165
"""Where the built-in body's skin is before the torso's axis at chest and belly, and beside it at the hips, for the
reference stature and an average build."""
FOREARM_M = 0.048


def arm_on_chest(person: VolumetricBody) -> Timeline:
    """The left forearm lies across the chest for two seconds, then the right arm hangs along the trunk."""
    across = with_left(STANDING, forearm_across(person, height=0.05), ARM)
    beside = 0.05 + 0.25 * max(person.build - 1.0, 0.0)
    along = with_right(STANDING, both_sides(shoulder_x=-np.pi / 2 + beside, elbow=-0.02, shoulder_z=0.02), ARM)
    keys = [
        Key(0.0, STANDING),
        Key(0.6, across),
        Key(2.6, across),
        Key(3.2, STANDING),
        Key(3.8, along),
        Key(5.0, along),
        Key(5.6, STANDING),
    ]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 6.2)))


def hands_clasped(person: VolumetricBody) -> Timeline:
    """Both hands meet before the belly, then before the face."""
    s = person.scale
    belly = _with_arms(
        reaching(person.body, ((BELLY_M * person.build + 0.14) * s, 0.032 * s, -0.08 * s), (0.0, 0.45 * s, -0.25 * s))
    )
    face = _with_arms(reaching(person.body, (0.30 * s, 0.044 * s, 0.32 * s), (0.25 * s, 0.35 * s, -0.20 * s)))
    keys = [Key(0.0, STANDING), Key(0.7, belly), Key(2.7, belly), Key(3.4, face), Key(4.4, face), Key(5.2, STANDING)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 5.8)))


def hands_on_hips(person: VolumetricBody) -> Timeline:
    """Arms akimbo: the hands at the hips, elbows out; loops that a hull fills."""
    s, h = person.scale, person.body.half_lengths[0]
    side = (HIP_M * person.build + 0.030) * s
    akimbo = _with_arms(reaching(person.body, (0.03 * s, side, -0.62 * h), (-0.12 * s, 0.60 * s, 0.05 * s)))
    keys = [Key(0.0, STANDING), Key(0.7, akimbo), Key(3.2, akimbo), Key(3.9, STANDING)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 4.5)))


def forearm_across(person: VolumetricBody, height: float) -> Array:
    """Angles (18,) with both forearms across the chest, the hands' tips past its middle; height over the centre, m."""
    s = person.scale
    before = (CHEST_M + FOREARM_M) * person.build * s
    return reaching(person.body, (before, -0.09 * s, height * s), (0.04 * s, 0.40 * s, -0.12 * s))


def _with_arms(arms: Array) -> Array:
    return with_right(with_left(STANDING, arms, ARM), arms, ARM)
