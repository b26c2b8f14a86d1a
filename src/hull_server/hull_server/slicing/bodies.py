"""Separates bodies: measures the parts of the hull that do not touch, joins those that are one person, numbers persons.

Where a camera misses a belt or a thigh, a person's hull is torn into parts that stand one above the other. Different
persons do not, and two trunks side by side are a chest's depth apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.stamps import NS_PER_S
from mocap_packets.fit import GONE_AFTER_S

from ..grid import Array, VoxelGrid
from ..settings import BodySettings
from .voxel_runs import HullRuns

NOBODY = -1
STEP_M = 0.5  # a step: parts one above the other, across the floor; a hand from its trunk; a body between two sets
BESIDE_M = 0.25  # a person's parts side by side have middles no farther apart: a chest's depth (ANSUR II, 95th perc.)


@dataclass(frozen=True, eq=False)
class HullParts:
    """The p parts of a hull that do not touch, in the order of their first voxels. Metres, map frame.

    litres : (p,). centroid_world, low_world, high_world : (p, 3) centre of mass and box.
    """

    litres: Array
    centroid_world: Array
    low_world: Array
    high_world: Array

    def __len__(self) -> int:
        return len(self.litres)


@dataclass(frozen=True, eq=False)
class Bodies(HullParts):
    """The b persons of a hull: its parts that are large enough for a body's, joined where they are one's.

    number : (b,) int32: 0, 1, ...; a person keeps the same number (see :class:`BodyTracker`).
    number_of_part : (p,) int32, the number of the body that each part of the hull belongs to: for a small one, that of
        the nearest large part; NOBODY for parts farther than STEP_M from every large one's box, and for all where there
        is no body. It numbers the rows of centerline, voxels and contour rays.
    """

    number: npt.NDArray[np.int32]
    number_of_part: npt.NDArray[np.int32]


class BodyTracker:
    """Numbers bodies consistently from set to set.

    Each set's bodies get the numbers of the nearest bodies of the set before, by distance across the floor (legs may be
    missing), the nearest pair first, none farther than STEP_M; the others get the lowest free numbers, larger bodies
    first. A body that is not seen keeps its place and number for GONE_AFTER_S.

    Two people who touch are one part of the hull, thus one body with one of their numbers. When they part, each gets
    the nearest number: the hull alone does not identify them.
    """

    def __init__(self, settings: BodySettings) -> None:
        self._settings = settings
        self._known: dict[int, tuple[int, Array]] = {}  # number: stamp when last seen, and centroid_world (3,)

    def step(self, stamp_ns: int, runs: HullRuns, grid: VoxelGrid) -> Bodies:
        """Number the bodies of one hull. A stamp before the last one forgets all bodies."""
        parts = measure_parts(runs, grid)
        order = np.argsort(-parts.litres, kind="stable")
        chosen = order[parts.litres[order] >= self._settings.min_litres]
        whose = _whose(parts, chosen)
        bodies = _joined(parts, chosen, whose)
        number = self._numbers(stamp_ns, bodies.centroid_world)
        number_of_part = np.full(len(parts), NOBODY, np.int32)
        if len(chosen) > 0:
            nearest, gap_m = _nearest_box(parts, chosen)
            number_of_part = np.where(gap_m <= STEP_M, number[whose[nearest]], NOBODY).astype(np.int32)
        return Bodies(**vars(bodies), number=number, number_of_part=number_of_part)

    def _numbers(self, stamp_ns: int, centroid_world: Array) -> npt.NDArray[np.int32]:
        self._known = {
            n: known for n, known in self._known.items() if 0 <= stamp_ns - known[0] <= GONE_AFTER_S * NS_PER_S
        }
        numbers = np.full(len(centroid_world), NOBODY, np.int32)
        pairs = sorted(
            (float(np.linalg.norm((place - centroid_world[body])[:2])), number, body)
            for number, (_, place) in self._known.items()
            for body in range(len(centroid_world))
        )
        for distance, number, body in pairs:
            if distance <= STEP_M and numbers[body] == NOBODY and number not in numbers:
                numbers[body] = number
        for newcomer in np.flatnonzero(numbers == NOBODY):
            numbers[newcomer] = next(n for n in count() if n not in self._known and n not in numbers)
        self._known |= {int(n): (stamp_ns, centroid) for n, centroid in zip(numbers, centroid_world, strict=True)}
        return numbers


def _whose(parts: HullParts, chosen: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return to which person (m,) 0, 1, ... each of the chosen parts belongs, in the order of the persons' first."""
    low, high = parts.low_world[chosen, 2], parts.high_world[chosen, 2]
    middle, height = parts.centroid_world[chosen, :2], high - low
    apart_m = np.linalg.norm(middle[:, None] - middle, axis=-1)
    shared_m = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    is_above = shared_m < 0.5 * np.minimum(height[:, None], height)
    joined = apart_m < np.where(is_above, STEP_M, BESIDE_M)
    for through in range(len(chosen)):  # transitive closure (Warshall 1962)
        joined |= joined[:, through, None] & joined[through]
    first = np.where(joined, np.arange(len(chosen)), len(chosen)).min(axis=1, initial=len(chosen))
    return np.asarray(np.unique(first, return_inverse=True)[1])


def _joined(parts: HullParts, chosen: npt.NDArray[np.int64], whose: npt.NDArray[np.int64]) -> HullParts:
    """Return the persons that the chosen parts make up."""
    persons, mine = int(whose.max(initial=-1)) + 1, parts.litres[chosen]
    litres = np.bincount(whose, mine, persons).astype(np.float64)
    moment, low, high = np.zeros((persons, 3)), np.full((persons, 3), np.inf), np.full((persons, 3), -np.inf)
    np.add.at(moment, whose, mine[:, None] * parts.centroid_world[chosen])
    np.minimum.at(low, whose, parts.low_world[chosen])
    np.maximum.at(high, whose, parts.high_world[chosen])
    return HullParts(litres, moment / litres[:, None], low, high)


def measure_parts(runs: HullRuns, grid: VoxelGrid) -> HullParts:
    """Measure volume, place and extent of every part of the hull, however small."""
    sums, low, high = _sum_parts(runs, int(runs.part.max(initial=-1)) + 1)
    corner, size = grid.origin + runs.low * grid.voxel_size, grid.voxel_size
    return HullParts(
        litres=sums[:, 0] * (grid.voxel_volume_m3 * 1e3),
        centroid_world=corner + (sums[:, 1:] / sums[:, :1] + 0.5) * size,
        low_world=corner + low * size,
        high_world=corner + high * size,
    )


@njit(cache=True, nogil=True)
def _sum_parts(runs, parts):  # type: ignore[no-untyped-def]
    """Sum 1, x, y, z over the voxels of each part (p, 4); find its lowest voxel and the one beyond its highest."""
    words, _, starts, ends, first, part = runs
    layers, rows, _ = words.shape
    sums = np.zeros((parts, 4))
    low, high = np.full((parts, 3), 1 << 30), np.zeros((parts, 3), np.int64)
    for s in range(layers):
        for r in range(rows):
            for run in range(first[s * rows + r], first[s * rows + r + 1]):
                p, n = part[run], float(ends[run] - starts[run])
                sums[p, 0] += n
                sums[p, 1] += n * 0.5 * (starts[run] + ends[run] - 1)
                sums[p, 2] += n * r
                sums[p, 3] += n * s
                low[p, 0], high[p, 0] = min(low[p, 0], starts[run]), max(high[p, 0], ends[run])
                low[p, 1], high[p, 1] = min(low[p, 1], r), max(high[p, 1], r + 1)
                low[p, 2], high[p, 2] = min(low[p, 2], s), max(high[p, 2], s + 1)
    return sums, low, high


def _nearest_box(parts: HullParts, chosen: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], Array]:
    """Find the nearest of the chosen parts (p,), by the gap between boxes, then by centroids; and that gap (p,), m."""
    low, high, centroid = parts.low_world[:, None], parts.high_world[:, None], parts.centroid_world[:, None]
    gaps = np.maximum(np.maximum(low - parts.high_world[chosen], parts.low_world[chosen] - high), 0.0)
    apart = np.linalg.norm(centroid - parts.centroid_world[chosen], axis=-1)
    gap_m = np.linalg.norm(gaps, axis=-1)
    nearest = np.lexsort((apart, gap_m), axis=-1)[:, 0]
    nearest[chosen] = np.arange(len(chosen))
    return nearest, gap_m[np.arange(len(nearest)), nearest]
