"""Moving stick figures and the noisy points on them: the synthetic experiment of the thesis (reprinted article, 4).

From each frame of a motion, 300 points spread evenly over the sticks by length, then Gaussian noise of a sixth of the
hips' distance on each axis. (The article says "an amplitude of half the hips distance": as a standard deviation that
would leave joint angles three times worse than the ones it reports, even with the true assignment; as three standard
deviations it fits them.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capture_rig.rigid import rotation_matrix
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.kinematics import forward, sticks
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS, T_POSE_S

FPS = 40.0
POINTS = 300
STATURE_M = 1.75
SIGMA_OVER_HIPS = 1.0 / 6.0
RANDOM_SECONDS = 4.0
# a range of motion well inside the joints' (rad), in the order of the angles
_MIDDLE = np.array(
    [0.0, 0.2, -0.4, np.pi + 0.4, -0.35, -0.35, 0.1, -0.1, -1.0, -1.0, 0.2, -0.2, -0.45, -0.45, 0.9, 0.9, 0.0, 0.0]
)
_SWING = np.array([0.4, 0.4, 1.0, 1.0, 0.65, 0.65, 0.7, 0.7, 0.9, 0.9, 0.3, 0.3, 0.85, 0.85, 0.8, 0.8, 0.3, 0.3])


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion with its body, at `FPS`."""

    name: str
    body: Body
    poses: tuple[Pose, ...]

    @cached_property
    def points_world(self) -> np.ndarray:
        """(F, 15, 3) m, the true reference points."""
        return np.array([forward(self.body, pose) for pose in self.poses])

    @property
    def sigma_m(self) -> float:
        """The protocol's noise, m on each axis."""
        return SIGMA_OVER_HIPS * 2.0 * self.body.hip_width_ratio * self.body.half_shoulder_width


def studio_clip(name: str, seconds: float) -> Clip:
    """A motion of the virtual studio, from the end of its T-pose on."""
    body = Body.from_stature(STATURE_M)
    return Clip(name, body, MOTIONS[name](body, seconds + T_POSE_S, FPS).poses[round(T_POSE_S * FPS) :])


def _random_motion(seed: int) -> list[Pose]:
    rng = np.random.default_rng(seed)
    t = np.arange(round(FPS * RANDOM_SECONDS)) / FPS
    frequency, phase = rng.uniform(0.1, 0.9, (24, 3, 1)), rng.uniform(0, 2 * np.pi, (24, 3, 1))
    wave = np.sin(2 * np.pi * frequency * t + phase).mean(1).T
    angles, positions, turns = _MIDDLE + _SWING * wave[:, :18], [0, 0, 1.2] + 0.5 * wave[:, 18:21], wave[:, 21:]
    return [
        Pose.from_angles(p, rotation_matrix(r * [0.15, 0.15, 1.5]), a)
        for p, r, a in zip(positions, turns, angles, strict=True)
    ]


def random_clip(seed: int) -> Clip:
    """Every joint swinging at random, through most of its range."""
    return Clip(f"random {seed}", Body.from_stature(STATURE_M), tuple(_random_motion(seed)))


@dataclass(frozen=True, eq=False)
class SpreadPoints:
    """Where the points sit on a body's sticks: stick (n,), place along it (n,) between 0 and 1."""

    body: Body
    stick: np.ndarray
    place: np.ndarray

    @classmethod
    def on(cls, body: Body, count: int = POINTS) -> SpreadPoints:
        """About ``count`` points, evenly by length."""
        numbers = np.maximum(2, np.round(count * body.lengths / body.lengths.sum()).astype(int))
        places = np.concatenate([(np.arange(n) + 0.5) / n for n in numbers])
        return cls(body, np.repeat(np.arange(10), numbers), places)

    def placed(self, pose: Pose) -> np.ndarray:
        """(n, 3) m, world, without noise."""
        ends = sticks(self.body, pose)[self.stick]
        return ends[:, 0] + self.place[:, None] * (ends[:, 1] - ends[:, 0])

    def jacobian(self, pose: Pose) -> np.ndarray:
        """(n, 3, 24) derivative of `placed` with respect to the pose's tangent."""
        _, axes, A, B = kernels.place_sticks(pose.arrays, self.body.lengths, self.body.stick_origins_torso)
        ends = np.zeros((10, 2, 3, 24))
        columns, slots = np.empty((3, 11)), np.empty(11, np.int64)
        for j in range(10):
            for e, end in enumerate((A[j], B[j])):
                n = kernels.point_jacobian(j, end, pose.position_world, A, axes, columns, slots)
                ends[j, e][:, slots[:n]] = columns[:, :n]
        at, place = ends[self.stick], self.place[:, None, None]
        return (1.0 - place) * at[:, 0] + place * at[:, 1]


def clouds(clip: Clip, seed: int, count: int = POINTS) -> list[np.ndarray]:
    """Noisy points (n, 3) m of every frame, in the order of `SpreadPoints` (no tracker may use the order)."""
    rng, spread = np.random.default_rng(seed), SpreadPoints.on(clip.body, count)
    return [spread.placed(pose) + clip.sigma_m * rng.normal(size=(len(spread.stick), 3)) for pose in clip.poses]
