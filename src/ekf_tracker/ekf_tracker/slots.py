"""Named slices of the filter's 48 error-state slots: 24 of the pose's tangent, then the same 24 of its velocity."""

from __future__ import annotations

import numpy as np

from stick_figure.kernels import HINGE_SLOT

POSE = slice(0, 24)
VELOCITY = slice(24, 48)
DIMENSION = 48

HINGES = HINGE_SLOT
"""(4,) tangent slots of left and right elbow, left and right knee."""


def per_slot(torso_position: float, torso_rotation: float, ball_joints: float, hinges: float) -> np.ndarray:
    """(24,) one number for every tangent slot, by the kind of its joint."""
    values = np.full(24, ball_joints)
    values[0:3] = torso_position
    values[3:6] = torso_rotation
    values[HINGES] = hinges
    return values
