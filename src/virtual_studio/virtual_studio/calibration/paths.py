"""How hands move a board: from one place to the next with a rest at each, or on a smooth curve; never quite still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..motions.timeline import ease
from .board_caster import Array

Path = Callable[[float], Array]
"""Time, s, to a pose (4, 4)."""

TREMOR_M, TREMOR_RAD = 0.0007, 0.003
"""Standard deviations of a hand's tremor."""
TREMOR_HZ = (0.7, 1.9, 3.1)


@dataclass(frozen=True, eq=False)
class Station:
    """A place where a board is held: ``T`` (4, 4), for ``rest_s`` after ``travel_s`` on the way there."""

    T: Array
    travel_s: float
    rest_s: float


def pose(R: Array, position: Array) -> Array:
    """(4, 4) of a rotation (3, 3) and a position (3,), m."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, position
    return T


def duration_of(stations: Sequence[Station]) -> float:
    """Seconds until the last station's rest is over; the way to the first one is not travelled."""
    return sum(station.travel_s + station.rest_s for station in stations) - stations[0].travel_s


def rests_of(stations: Sequence[Station]) -> Array:
    """(n,) the middle of each station's rest, s."""
    ends = np.cumsum([s.rest_s + s.travel_s for s in stations]) - stations[0].travel_s
    return ends - [s.rest_s / 2 for s in stations]


def along(stations: Sequence[Station]) -> Path:
    """The path through stations, with ease; it stays at the first before and at the last after it."""
    arrivals = np.cumsum([s.rest_s + s.travel_s for s in stations]) - stations[0].travel_s
    arrivals -= [s.rest_s for s in stations]

    def at(t: float) -> Array:
        after = int(np.searchsorted(arrivals, t))
        if after == 0 or after == len(stations):
            return stations[min(after, len(stations) - 1)].T
        before, to = stations[after - 1], stations[after]
        share = ease((t - arrivals[after]) / to.travel_s + 1.0)
        return between(before.T, to.T, share)

    return at


def between(a: Array, b: Array, share: float) -> Array:
    """The pose that lies between two: turned about one axis, moved along a line."""
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
    R = a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return pose(R, (1.0 - share) * a[:3, 3] + share * b[:3, 3])


def with_tremor(path: Path, seed: int) -> Path:
    """The same path as a hand goes it."""
    rng = np.random.default_rng(seed)
    frequencies = np.array(TREMOR_HZ)[:, None] * rng.uniform(0.85, 1.15, (len(TREMOR_HZ), 6))
    phases = rng.uniform(0.0, 2.0 * np.pi, frequencies.shape)
    amplitudes = np.repeat([TREMOR_M, TREMOR_RAD], 3) * np.sqrt(2.0 / len(TREMOR_HZ))

    def at(t: float) -> Array:
        shake = amplitudes * np.sin(2.0 * np.pi * frequencies * t + phases).sum(axis=0)
        T = path(t)
        return pose(T[:3, :3] @ Rotation.from_rotvec(shake[3:]).as_matrix(), T[:3, 3] + shake[:3])

    return at
