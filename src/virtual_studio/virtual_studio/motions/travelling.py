"""Turning and going places: round on the spot, out of the volume and back, running in a circle."""

from __future__ import annotations

import numpy as np

from ..body import VolumetricBody
from .everyday import STANDING, STEP_HZ, walking, walking_lean
from .keys import hold
from .limbs import Array, both_sides, left, right
from .timeline import Activity, Timeline

AWAY_RAD = -0.28
"""Heading on which somebody leaves: between two cameras of the studio's rings."""
TURN_S, AWAY_S = 1.5, 3.0
RUN_HZ, RUN_RAD_S = 1.5, 2.6


def turn_on_spot(person: VolumetricBody) -> Timeline:
    """Two whole turns to the left, stepping, in five seconds."""
    return Timeline((hold(0.9, STANDING), Activity(5.0, stepping, turning=4 * np.pi / 5.0), hold(0.8, STANDING)))


def leave_and_return(person: VolumetricBody) -> Timeline:
    """Walks out of the volume, turns there, walks back in, and turns to where it began."""

    def turned(angle: float) -> Activity:
        return Activity(TURN_S, stepping, turning=angle / TURN_S)

    def ahead() -> Activity:
        return Activity(AWAY_S, walking, lean=walking_lean)

    return Timeline(
        (
            hold(0.9, STANDING),
            turned(AWAY_RAD),
            ahead(),
            turned(np.pi),
            ahead(),
            turned(-np.pi - AWAY_RAD),
            hold(1.2, STANDING),
        )
    )


def run(person: VolumetricBody) -> Timeline:
    """Jogs in a circle."""
    return Timeline((hold(0.9, STANDING), Activity(6.0, _running, lean=_running_lean, turning=RUN_RAD_S)))


def stepping(t: float) -> Array:
    """Angles (18,) of steps on the spot at time t, s."""
    angles = STANDING.copy()
    for phase, leg in ((0.0, left), (np.pi, right)):
        step = (0.5 + 0.5 * np.cos(2 * np.pi * STEP_HZ * t + phase)) ** 2
        angles[leg("hip_y")] -= 0.35 * step
        angles[leg("knee")] += 0.60 * step
    return angles


def _running(t: float) -> Array:
    angles = both_sides(shoulder_x=-np.pi / 2 + 0.35, shoulder_y=0.1, hip_x=0.04)
    for phase, leg, arm in ((0.0, left, right), (np.pi, right, left)):
        swing = 2 * np.pi * RUN_HZ * t + phase
        angles[leg("hip_y")] = -0.26 - 0.30 * np.sin(swing) - 0.30 * (0.5 + 0.5 * np.cos(swing)) ** 2
        angles[leg("knee")] = 0.25 + 1.35 * (0.5 + 0.5 * np.cos(swing + 0.4)) ** 2
        angles[arm("shoulder_z")] = 0.05 - 0.60 * np.sin(swing)
        angles[arm("elbow")] = -1.45 - 0.20 * np.sin(swing)
    return angles


def _running_lean(t: float) -> Array:
    swing = 2 * np.pi * RUN_HZ * t
    return np.array([-0.10 + 0.03 * np.sin(swing), 0.12, -0.14 * np.sin(swing)])
