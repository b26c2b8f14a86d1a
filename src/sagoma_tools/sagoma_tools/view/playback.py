"""A recorded take on the page: where it is, who was where, and its angles as curves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from motion_export.isb_angles import isb_angles
from motion_export.motion import NS_PER_S, Motion, point_deviations

from ..recording.reader import rig_in
from ..recording.recorded_motion import recorded_motions
from ..takes.take import Take
from .scene import Figure

Array = np.ndarray

SIDES = ("left", "right")
PLOTTED = {"knee_flexion": 1.0, "elbow_flexion": 1.0, "shoulder_elevation": -1.0, "hip_flexion": 1.0}
"""Angles that are drawn (docs/points.md), each with the sign that makes bent or raised limbs positive."""
HELD_S = 0.1
"""A pose is shown over so long a gap: sets that a graph at its limit leaves out, not a person who is lost."""
PLOT_POINTS = 1000
"""Of a curve: more than a page is wide."""


@dataclass
class Playback:
    """Plays in real time, again and again, from the first pose on; second 0 is the take's first frame set.

    begins_ns : stamp of second 0. seconds : how long the take is. first_pose_s : when somebody is tracked first.
    position_s : what is shown now.
    """

    take: Take
    motions: dict[str, Motion]
    begins_ns: int
    seconds: float
    first_pose_s: float
    rig: Rig | None = None
    playing: bool = True
    position_s: float = 0.0
    _moved_s: float | None = None
    _shown: dict[str, int | None] | None = None

    @classmethod
    def of(cls, take: Take) -> Playback:
        """Read a take. Raises InputError when it cannot be read or holds nobody."""
        rig = None
        with suppress(InputError):  # the motion can be seen without the cameras
            rig = load_rig(rig_file) if (rig_file := rig_in(take.path)) is not None else None
        motions = recorded_motions(take.path)
        first_ns = min(map(first_pose_ns, motions.values()))
        last_ns = max(motion.start_ns + round(motion.times_s[-1] * 1e9) for motion in motions.values())
        begins_ns, ends_ns = first_ns, last_ns
        if take.summary is not None:
            quality = take.summary.quality
            begins_ns, ends_ns = min(first_ns, quality.begins_ns), max(last_ns, quality.ends_ns)
        seconds = max((ends_ns - begins_ns) / 1e9, 1e-3)
        first_pose_s = (first_ns - begins_ns) / 1e9
        return cls(take, motions, begins_ns, seconds, first_pose_s, rig, position_s=first_pose_s)

    def jump(self, seconds: float) -> None:
        """Go on from there."""
        self.position_s = min(max(seconds, 0.0), self.seconds)
        self.stand()

    def stand(self) -> None:
        """Do not count the time until the next figures are asked for: nobody looks meanwhile."""
        self._moved_s = None

    def new_figures_at(self, now_s: float) -> dict[str, Figure] | None:
        """Move on to this moment, unless paused; return everybody who is there then, None when nothing has changed."""
        if self.playing and self._moved_s is not None:
            self.position_s += max(now_s - self._moved_s, 0.0)
            if self.position_s > self.seconds:
                self.position_s = self.first_pose_s
        self._moved_s = now_s
        stamp_ns = self.begins_ns + round(self.position_s * 1e9)
        frames = {body_id: last_frame(motion, stamp_ns) for body_id, motion in self.motions.items()}
        if frames == self._shown:
            return None
        self._shown = frames
        shown = ((body_id, self.motions[body_id], frame) for body_id, frame in frames.items() if frame is not None)
        return {
            body_id: Figure(motion.points_world[k], point_deviations(motion.covariance[k]), str(motion.states[k]))
            for body_id, motion, k in shown
        }

    def plots(self, body_id: str) -> Iterator[tuple[str, Array, Array]]:
        """Yield title, times (n,) s and the curves (2, n) degrees of a person's left and right side, NaN in gaps."""
        motion = self.motions[body_id]
        step = max(1, len(motion) // PLOT_POINTS)
        times_s = motion.times_s[::step] + (motion.start_ns - self.begins_ns) / 1e9
        angles = isb_angles(motion)
        for name, sign in PLOTTED.items():
            sides = np.stack([sign * angles[f"{side}_{name}"][::step] for side in SIDES])
            yield name.replace("_", " "), times_s, sides


def first_pose_ns(motion: Motion) -> int:
    """Return the stamp of the first frame in which a person is tracked."""
    return motion.start_ns + round(float(motion.times_s[np.argmax(motion.tracked)]) * NS_PER_S)


def last_frame(motion: Motion, stamp_ns: int) -> int | None:
    """Return a person's last tracked frame at a stamp, held over the sets that were left out."""
    now = round((stamp_ns - motion.start_ns) * motion.rate_hz / NS_PER_S)
    if not 0 <= now < len(motion):
        return None
    first = max(0, now - math.floor(HELD_S * motion.rate_hz))
    tracked = np.flatnonzero(motion.tracked[first : now + 1])
    return first + int(tracked[-1]) if len(tracked) else None
