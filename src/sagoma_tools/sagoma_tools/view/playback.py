"""A recorded take on the page: where it is, who was where, and its angles as curves."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from motion_export.motion import Motion, point_deviations
from stick_figure.skeleton import ANGLE_NAMES

from ..recording.reader import SIDECAR_RIG
from ..recording.recorded_motion import recorded_motions
from ..takes.take import Take
from .scene import Figure

LEFT, RIGHT = "#4f9cf0", "#f08a4f"
PAGES = ("shoulder", "elbow", "hip", "knee")
PLOT_POINTS = 1000
"""Of a curve: more than a page is wide."""


@dataclass
class Playback:
    """Plays in real time, again and again, from the first pose on; second 0 is the take's first frame set.

    begins_ns : stamp of second 0. seconds : how long the take is. position_s : what is shown now.
    """

    take: Take
    motions: dict[str, Motion]
    begins_ns: int
    seconds: float
    rig: Rig | None = None
    playing: bool = True
    position_s: float = 0.0
    _moved_s: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, take: Take) -> Playback:
        """Read a take. Raises InputError when it cannot be read or holds nobody."""
        rig = None
        if (take.path / SIDECAR_RIG).exists():
            try:
                rig = load_rig(take.path / SIDECAR_RIG)
            except InputError:
                rig = None  # the motion can be seen without the cameras
        motions = recorded_motions(take.path)
        first_ns = min(motion.start_ns for motion in motions.values())
        last_ns = max(motion.start_ns + round(motion.times_s[-1] * 1e9) for motion in motions.values())
        begins_ns, ends_ns = first_ns, last_ns
        if take.summary is not None:
            quality = take.summary.quality
            begins_ns, ends_ns = min(first_ns, quality.begins_ns), max(last_ns, quality.ends_ns)
        seconds = max((ends_ns - begins_ns) / 1e9, 1e-3)
        return cls(take, motions, begins_ns, seconds, rig, position_s=(first_ns - begins_ns) / 1e9)

    def jump(self, seconds: float) -> None:
        """Go on from there."""
        self.position_s, self._moved_s = min(max(seconds, 0.0), self.seconds), time.monotonic()

    def figures_at(self, now_s: float) -> dict[str, Figure]:
        """Move on to this moment, unless paused, and return everybody who was there then."""
        if self.playing:
            self.position_s = (self.position_s + max(now_s - self._moved_s, 0.0)) % self.seconds
        self._moved_s = now_s
        stamp_ns, figures = self.begins_ns + round(self.position_s * 1e9), {}
        for body_id, motion in self.motions.items():
            frame = motion.frame_at(stamp_ns)
            if frame is not None:
                sigma = point_deviations(motion.covariance[frame])
                figures[body_id] = Figure(motion.points_world[frame], sigma, str(motion.states[frame]))
        return figures

    def plots(self) -> Iterator[tuple[str, np.ndarray, dict[tuple[str, str], np.ndarray]]]:
        """Yield title, times (n,) s and curves of the first person: (name, colour) -> degrees (n,)."""
        body_id, motion = next(iter(self.motions.items()))
        step = max(1, len(motion) // PLOT_POINTS)
        times_s = motion.times_s[::step] + (motion.start_ns - self.begins_ns) / 1e9
        whose = f" of {body_id}" if len(self.motions) > 1 else ""
        for joint in PAGES:
            curves = {
                (name.replace("_", " "), LEFT if name.startswith("left") else RIGHT): np.rad2deg(
                    motion.angles[::step, k]
                )
                for k, name in enumerate(ANGLE_NAMES)
                if joint in name
            }
            yield f"{joint}{whose}, degrees", times_s, curves
