"""Activities one after another: the T-pose, a blend, then each activity fading into the next; postures of the limbs.

An activity gives joint angles as a function of time, or goes through key postures. All angles stay inside the joint
ranges because every activity's do and fading is a weighted mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, L_FOREARM, L_UPPER_ARM, T_POSE_ANGLES, mirror_angles

from ..people import Capsules, together

Array = NDArray[np.float64]

T_POSE_S, BLEND_S, FADE_S = 1.0, 0.6, 0.6
STAND_S = 0.9
"""Standing before a motion begins."""


@dataclass(frozen=True, eq=False)
class Things:
    """Things beside the person.

    standing: part of the empty room, never moved. carried: another thing, one per frame (none: empty), which is part of
    the empty room until the person takes it in frame ``taken``, and belongs to the person's silhouette then.
    """

    standing: Capsules
    carried: tuple[Capsules, ...] = ()
    taken: int = 0

    def room(self, frame: int) -> Capsules:
        """Things that hide the person in a frame; the same object as long as they stay the same."""
        return self.untouched if self.carried and frame < self.taken else self.standing

    def foreground(self, person: Capsules, frame: int) -> Capsules:
        """The person with what it carries."""
        return together(person, self.carried[frame]) if self.carried and frame >= self.taken else person

    @cached_property
    def untouched(self) -> Capsules:
        """The things as they are before anybody comes."""
        return together(self.standing, self.carried[0]) if self.carried else self.standing


@dataclass(frozen=True, eq=False)
class Motion:
    """A sequence of poses at a fixed rate.

    poses: one per frame; angles (F, 18) rad, the angles they were made of; fps: frames a second; things: beside the
    person.
    """

    poses: tuple[Pose, ...]
    angles: Array
    fps: float
    things: Things | None = None


ANGLES, LEAN, LIFT, TURNING, WALKING = slice(18), slice(18, 21), 21, 22, 23
"""Parts of a `stance`."""


def stance(
    angles: Array,
    lean: Sequence[float] = (0.0, 0.0, 0.0),
    lift: float = 0.0,
    turning: float = 0.0,
    walking: float = 0.0,
) -> Array:
    """Makes the state of a body at an instant, (24,).

    angles: (18,) rad; lean: rotation vector of the torso in its heading frame; lift: metres of the lower foot above the
    floor; turning: rad/s of the heading; walking: share of the circle's walking speed (`everyday`).
    """
    return np.concatenate([angles, lean, [lift, turning, walking]])


@dataclass(frozen=True)
class Activity:
    """One thing to do for a while: a `stance` for the seconds since it began, down to -FADE_S while it fades in.

    own_clock: False hands the seconds since the motion began instead, so that steps keep their rhythm over rounds.
    """

    duration_s: float
    at: Callable[[float], Array]
    own_clock: bool = True


@dataclass(frozen=True)
class Timeline:
    """The T-pose for `t_pose_s` (for ever, if infinite), then the activities, over and over."""

    activities: tuple[Activity, ...]
    t_pose_s: float = T_POSE_S

    def at(self, t: float) -> Array:
        """Blends the activities (24,) at time t, s; two derivatives are continuous where the activities' are."""
        active = self._active(t)
        blend = (1.0 - sum(weight for _, _, weight in active)) * stance(T_POSE_ANGLES)
        for activity, local, weight in active:
            blend = blend + weight * activity.at(local if activity.own_clock else t)
        return blend

    def _active(self, t: float) -> list[tuple[Activity, float, float]]:
        """Return the activities at time t: each with its own time and its weight (the T-pose has the rest)."""
        start = ease((t - self.t_pose_s) / BLEND_S) if np.isfinite(self.t_pose_s) else 0.0
        if not self.activities or start == 0.0:
            return []
        ends = np.cumsum([activity.duration_s for activity in self.activities])
        phase = (t - self.t_pose_s) % ends[-1]
        current = int(np.searchsorted(ends, phase, side="right"))
        left = ends[current] - phase
        onward = ease(1.0 - left / FADE_S)
        activity, following = self.activities[current], self.activities[(current + 1) % len(ends)]
        active = [(activity, activity.duration_s - left, start * (1.0 - onward))]
        return active if onward == 0.0 else [*active, (following, -left, start * onward)]


def ease(x: float) -> float:
    """Goes from 0 to 1 with zero first and second derivative at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (x * (6.0 * x - 15.0) + 10.0)


def frame_count(seconds: float, fps: float) -> int:
    """Counts a motion's frames. Raises InputError for times that make none."""
    frames = round(seconds * fps)
    if frames < 1:
        raise InputError(f"{seconds:g} s at {fps:g} fps is no frame", remedy="Give a longer time.")
    return frames


def key_postures(duration_s: float, *keys: tuple) -> Activity:
    """Goes from key to key, smoothly and with a stop at each; holds the first before it and the last after it.

    keys: time (s since the activity began), angles (18,) rad and, if not 0, the torso's lean forward, rad.
    """
    times = [key[0] for key in keys]
    stances = [stance(key[1], (0.0, key[2] if len(key) > 2 else 0.0, 0.0)) for key in keys]

    def at(t: float) -> Array:
        after = int(np.searchsorted(times, t))
        if after == 0 or after == len(times):
            return stances[min(after, len(times) - 1)]
        fraction = ease((t - times[after - 1]) / (times[after] - times[after - 1]))
        return (1.0 - fraction) * stances[after - 1] + fraction * stances[after]

    return Activity(duration_s, at)


def hold(duration_s: float, angles: Array) -> Activity:
    """Stays in a posture (18,)."""
    return key_postures(duration_s, (0.0, angles))


# --- Joint angles for limbs: both sides from one, arms that reach a place, legs that stand under the body.

L_SHOULDER_POINT, L_ELBOW_POINT, L_HAND_POINT = 3, 7, 11
ARM = ("shoulder_x", "shoulder_z", "shoulder_y", "elbow")
NEARLY_STRAIGHT = 0.995


def both_sides(**left: float) -> Array:
    """Makes angles (18,) of both sides from the left side's (and the neck's): the right side mirrors it."""
    angles = np.zeros(18)
    for name, value in left.items():
        angles[ANGLE_NAMES.index(name if name.startswith("neck") else f"left_{name}")] = value
    right = np.array([name.startswith("right") for name in ANGLE_NAMES])
    return np.where(right, mirror_angles(angles), angles)


def left(name: str) -> int:
    """Returns the slot of a left joint's angle."""
    return ANGLE_NAMES.index(f"left_{name}")


def right(name: str) -> int:
    """Returns the slot of a right joint's angle."""
    return ANGLE_NAMES.index(f"right_{name}")


def with_left(angles: Array, other: Array, names: tuple[str, ...], side: Callable[[str], int] = left) -> Array:
    """Copies angles (18,) or a stance (24,), with the named joints of one side of another."""
    mixed, slots = angles.copy(), [side(name) for name in names]
    mixed[slots] = other[slots]
    return mixed


with_right = partial(with_left, side=right)


def posture(angles: Array, arms: Array) -> Array:
    """Combines angles (18,) or a stance (24,) with the arms of another."""
    return with_right(with_left(angles, arms, ARM), arms, ARM)


def reaching(body: Body, hand_torso: tuple[float, float, float], elbow_torso: tuple[float, float, float]) -> Array:
    """Finds angles (18,) with the left hand's tip at a place in the torso frame (m), and the right one mirrored.

    The elbow lies as near as it can to `elbow_torso`; a place out of reach is approached as far as the arm goes.
    """
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    shoulder, upper, fore = points[L_SHOULDER_POINT], body.lengths[L_UPPER_ARM], body.lengths[L_FOREARM]
    to_hand = np.array(hand_torso) - shoulder
    distance = np.clip(np.linalg.norm(to_hand), abs(upper - fore) / NEARLY_STRAIGHT, (upper + fore) * NEARLY_STRAIGHT)
    along = to_hand / np.linalg.norm(to_hand)
    aside = np.array(elbow_torso) - shoulder
    aside -= (aside @ along) * along
    aside /= np.linalg.norm(aside)
    foot = (upper**2 - fore**2 + distance**2) / (2.0 * distance)
    points[L_ELBOW_POINT] = shoulder + foot * along + np.sqrt(max(upper**2 - foot**2, 0.0)) * aside
    points[L_HAND_POINT] = shoulder + distance * along
    angles = inverse(body, points).angles()
    return both_sides(**{name: angles[left(name)] for name in ARM})


def legs(thigh: float, calf: float, lean: float = 0.0, apart: float = 0.04) -> Array:
    """Makes angles (18,) of legs under a torso that leans forward by `lean` rad, arms and neck zero.

    thigh: how far the knees are ahead of the hips, calf: how far the ankles are behind the knees, both rad from the
    vertical; apart: thighs outward, rad.
    """
    return both_sides(hip_x=apart, hip_y=-thigh - lean, knee=thigh + calf)
