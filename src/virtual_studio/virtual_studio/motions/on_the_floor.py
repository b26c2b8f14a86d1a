"""Lying down and getting up."""

from __future__ import annotations

import numpy as np

from ..body import VolumetricBody
from .crossing import posture
from .everyday import STANDING
from .keys import Key, activity_of, hold
from .limbs import Array, both_sides, legs
from .timeline import Timeline

ON_THE_BACK = -np.pi / 2


def lie_down(person: VolumetricBody) -> Timeline:
    """Squats, sits down on the floor, lies on the back for two seconds, and gets up the same way."""
    squatting = posture(legs(1.45, 0.75, 0.75, apart=0.14), _arms(1.3, out=0.25))
    seated = posture(legs(2.10, -0.75, -0.35, apart=0.10), _arms(0.2, out=0.35))
    half = posture(legs(2.00, -1.10, -1.0, apart=0.08), _arms(-0.1, out=0.5))
    flat = posture(legs(1.535, -1.535, ON_THE_BACK, apart=0.08), _arms(0.0, out=0.55))
    down = [
        (0.0, STANDING, 0.0),
        (1.1, squatting, 0.75),
        (2.1, seated, -0.35),
        (2.8, half, -1.0),
        (3.5, flat, ON_THE_BACK),
        (5.5, flat, ON_THE_BACK),
    ]
    up = [(6.4, half, -1.0), (7.2, seated, -0.35), (8.3, squatting, 0.75), (9.4, STANDING, 0.0)]
    return Timeline((hold(0.9, STANDING), activity_of([Key(*key) for key in down + up], 10.0)))


def _arms(raised: float, out: float) -> Array:
    return both_sides(shoulder_x=-np.pi / 2 + out, shoulder_z=-raised, shoulder_y=0.2, elbow=-0.25)
