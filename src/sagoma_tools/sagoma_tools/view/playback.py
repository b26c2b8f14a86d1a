"""A recorded take on the page: where it is, who was where, and its angles as curves."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from motion_export.motion import Motion, point_deviations
from stick_figure.skeleton import ANGLE_NAMES

from ..recording.reader import SIDECAR_RIG
from ..recording.recorded_motion import recorded_motions
from .scene import Figure

LEFT, RIGHT = "#4f9cf0", "#f08a4f"
PAGES = ("shoulder", "elbow", "hip", "knee")
PLOT_POINTS = 1000
"""Of a curve: more than a page is wide."""


@dataclass
class Playback:
    """Plays in real time, again and again; :meth:`jump` goes elsewhere."""

    path: Path
    motions: dict[str, Motion]
    rig: Rig | None = None
    _began_s: float = field(default_factory=time.monotonic)
    position_s: float = 0.0

    @classmethod
    def of(cls, path: Path) -> Playback:
        """Read a take. Raises InputError when it cannot be read or holds nobody."""
        rig = None
        if (path / SIDECAR_RIG).exists():
            try:
                rig = load_rig(path / SIDECAR_RIG)
            except InputError:
                rig = None  # the motion can be seen without the cameras
        return cls(path, recorded_motions(path), rig)

    @property
    def begins_ns(self) -> int:
        """The stamp at which the first person begins."""
        return min(motion.start_ns for motion in self.motions.values())

    @property
    def seconds(self) -> float:
        """How long it takes."""
        ends = (m.start_ns - self.begins_ns + m.times_s[-1] * 1e9 for m in self.motions.values())
        return max(float(max(ends)) / 1e9, 1e-3)

    @property
    def summary(self) -> str:
        """Persons, length, rate, and how much of each was tracked."""
        rows = (
            f"{body_id}: {len(motion) / motion.rate_hz:.1f} s at {motion.rate_hz:g} Hz, "
            f"{100 * motion.tracked.mean():.0f} % tracked"
            for body_id, motion in self.motions.items()
        )
        return f"{self.path.name}: " + "; ".join(rows)

    def jump(self, seconds: float) -> None:
        """Go on from there."""
        self._began_s = time.monotonic() - seconds

    def figures_at(self, now_s: float) -> dict[str, Figure]:
        """Return everybody who was there at this moment of the take, and move on."""
        self.position_s = (now_s - self._began_s) % self.seconds
        figures = {}
        for body_id, motion in self.motions.items():
            frame = round((self.position_s - (motion.start_ns - self.begins_ns) / 1e9) * motion.rate_hz)
            if 0 <= frame < len(motion) and motion.tracked[frame]:
                sigma = point_deviations(motion.covariance[frame])
                figures[body_id] = Figure(motion.points_world[frame], sigma, str(motion.states[frame]))
        return figures

    def plots(self) -> Iterator[tuple[str, np.ndarray, dict[tuple[str, str], np.ndarray]]]:
        """Yield title, times (n,) s and curves of the first person: (name, colour) -> degrees (n,)."""
        motion = next(iter(self.motions.values()))
        step = max(1, len(motion) // PLOT_POINTS)
        for joint in PAGES:
            curves = {
                (name.replace("_", " "), LEFT if name.startswith("left") else RIGHT): np.rad2deg(
                    motion.angles[::step, k]
                )
                for k, name in enumerate(ANGLE_NAMES)
                if joint in name
            }
            yield f"{joint}, degrees", motion.times_s[::step], curves
