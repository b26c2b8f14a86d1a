"""Data association: which parts of the hull, and which rows of parts that persons share, belong to whom.

A person's body in its expected pose explains the points inside it and near its surface, and the contour rays that graze
it. A part of the hull belongs to everybody of whom it holds a good share. Persons who touch share a part: each row of
it (centerline point, surface voxel, contour ray) goes to the person who explains it clearly better, else to both. So do
rows that nobody explains, which may be a lost limb. Of the skeletons that a detector found in an image each person gets
the nearest one, if any is near.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mocap_packets.hull import HullProducts
from stick_figure.body import Body
from stick_figure.least_squares.contour_factor import SLACK_M, match_rays
from stick_figure.least_squares.keypoint_factor import Keypoints, offsets_m
from stick_figure.least_squares.posed_model import BodyModel, PosedModel, PoseState, place, surface_distances
from stick_figure.pose import Pose

from ..articulated_fit import POINT_GATE_M, ray_arrays

REACH_M = 0.35  # body surface and half a limb: a skeleton that is farther from a person is another's
NEAR_M = 0.05  # a point this near to a body is explained: predictions err, and hulls of few cameras are wide
OWN_SHARE = 0.2  # of the points that a person explains: a part of the hull that holds more is the person's
PART_SHARE = 0.08  # of a part's points: fewer are a neighbour's hand (four persons in one wide hull explain 0.15 each)
SAMPLES = 600  # voxels of the hull by which its parts are assigned
CLEARLY_M = 0.03  # margin that assigns a row to the nearer body: twice the error of a good prediction
ELSEWHERE_M = 0.15  # margin beyond which it cannot be the other person's lost limb: the length of a hand
# standard deviation added to a ray within CLEARLY_M of both bodies, the error of a prediction, so that it does not hold
# a hand on the other's outline (0.01 to 0.1 tried with bench/people.py together_ and the meeting as footage; from 0.015
# to 0.03 fewest hands stay there)
UNCLEAR_SD_M = 0.02


class Expected(NamedTuple):
    """A person's body in the pose that is expected in a frame set."""

    person: int
    body: Body
    pose: Pose

    @property
    def posed(self) -> PosedModel:
        """The body's model in this pose."""
        return place(PoseState(*self.pose.arrays), BodyModel.of(self.body))


@dataclass(frozen=True, eq=False)
class Association:
    """Which parts of one hull belong to whom.

    parts : the numbers of the parts of each person who has any. shared : the persons of each part that has several.
    """

    parts: Mapping[int, tuple[int, ...]]
    shared: Mapping[int, tuple[int, ...]]

    @property
    def claimed(self) -> frozenset[int]:
        """The parts that belong to somebody."""
        return frozenset(part for parts in self.parts.values() for part in parts)

    def sharers(self, person: int) -> tuple[int, ...]:
        """Return everybody else with whom a person shares a part."""
        together = {other for persons in self.shared.values() if person in persons for other in persons}
        return tuple(sorted(together - {person}))


def associate_parts(seen: HullProducts, bodies: Sequence[int], expected: Sequence[Expected]) -> Association:
    """Find the parts of each person who is expected in the hull."""
    packet = seen.voxels if len(seen.voxels) else seen.centerline
    every = max(len(packet) // SAMPLES, 1)
    points, body = np.ascontiguousarray(packet.points_world[::every]), packet.body[::every]
    totals = np.array([np.count_nonzero(body == part) for part in bodies])
    parts: dict[int, tuple[int, ...]] = {}
    for one in expected:
        near = surface_distances(points, one.posed)[2] < NEAR_M
        counts = np.array([np.count_nonzero(near & (body == part)) for part in bodies])
        own = (counts >= OWN_SHARE * counts.sum()) & (counts >= PART_SHARE * totals) & (counts > 0)
        if own.any():
            parts[one.person] = tuple(part for part, is_own in zip(bodies, own, strict=True) if is_own)
    holders = {part: tuple(sorted(p for p, own in parts.items() if part in own)) for part in bodies}
    return Association(parts, {part: persons for part, persons in holders.items() if len(persons) > 1})


def associate_rows(
    seen: HullProducts, association: Association, expected: Sequence[Expected]
) -> dict[int, HullProducts]:
    """Return every person's rows, numbered as one body's.

    All voxels of a shared part stay samples of each person's hull; voxels that another person explains are not surface
    samples of this one.
    """
    together = [one for one in expected if association.sharers(one.person)]
    distances = {one.person: _Distances.of(seen, one.posed) for one in together}
    rows = {}
    for person, parts in association.parts.items():
        own = _rows_of(seen, parts)
        if sharers := association.sharers(person):
            others = [distances[other].of_rows(own) for other in sharers]
            own = _of_person(own, distances[person].of_rows(own), others)
        rows[person] = own.products
    return rows


def associate_skeletons(keypoints: Keypoints, expected: Sequence[Expected]) -> dict[int, Keypoints]:
    """Return the detections of each person who has any: of each image at most one skeleton, each given to one person.

    The distance of a skeleton is the median offset of its joints, as left and right may be exchanged and some joints
    wrong. A skeleton farther than REACH_M from everybody is dropped.
    """
    near = list[tuple[float, int, int, int]]()
    for one in expected:
        offsets = offsets_m(keypoints, one.posed)
        for skeleton in np.unique(keypoints.skeleton).tolist():
            own = keypoints.skeleton == skeleton
            apart = float(np.linalg.norm(np.median(offsets[own], axis=0)))
            if apart < REACH_M:
                near.append((apart, one.person, int(keypoints.camera[own][0]), skeleton))
    skeletons: dict[tuple[int, int], int] = {}  # by person and camera
    for _, person, camera, skeleton in sorted(near):
        if skeleton not in skeletons.values():
            skeletons.setdefault((person, camera), skeleton)
    owned = {person: [s for (p, _), s in skeletons.items() if p == person] for person, _ in skeletons}
    return {person: keypoints.chosen(np.isin(keypoints.skeleton, own)) for person, own in owned.items()}


class _Rows(NamedTuple):
    """Rows of some parts of a hull, and which rows of the whole they are."""

    products: HullProducts
    line: np.ndarray
    voxels: np.ndarray
    rays: np.ndarray


class _Distances(NamedTuple):
    """How far (m) one person's surface is from centerline points, surface voxels and contour rays."""

    line: np.ndarray
    voxels: np.ndarray
    rays: np.ndarray

    @classmethod
    def of(cls, seen: HullProducts, posed: PosedModel) -> _Distances:
        rays = seen.contour_rays
        separation = match_rays(ray_arrays(rays, np.ones(len(rays))), posed, SLACK_M).separation
        points = np.ascontiguousarray(seen.voxels.points_world)
        line = np.ascontiguousarray(seen.centerline.points_world)
        return cls(surface_distances(line, posed)[2], surface_distances(points, posed)[2], separation)

    def of_rows(self, rows: _Rows) -> _Distances:
        return _Distances(self.line[rows.line], self.voxels[rows.voxels], self.rays[rows.rays])


def _rows_of(seen: HullProducts, parts: tuple[int, ...]) -> _Rows:
    packets = (seen.centerline, seen.voxels, seen.contour_rays)
    line, voxels, rays = (np.logical_or.reduce([packet.body == part for part in parts]) for packet in packets)
    own = seen.of_rows(line, voxels, rays).as_one_body()
    return _Rows(own, line, voxels, rays)


def _of_person(rows: _Rows, own: _Distances, others: Sequence[_Distances]) -> _Rows:
    """Return the rows without those that are clearly another's; ambiguous rays get a larger sigma."""
    nearest = _Distances(*(np.min(kind, axis=0) for kind in zip(*others, strict=True)))
    line, on_surface, rays = (~_is_others(mine, theirs) for mine, theirs in zip(own, nearest, strict=True))
    either = np.abs(own.rays - nearest.rays)[rays] <= CLEARLY_M
    either &= np.minimum(own.rays, nearest.rays)[rays] < POINT_GATE_M
    seen = rows.products
    kept = seen.of_rows(line, np.ones(len(seen.voxels), bool), rays)
    voxels = replace(seen.voxels, surface=seen.voxels.surface & on_surface)
    sigma = kept.contour_rays.sigma
    unclear = np.hypot(sigma, UNCLEAR_SD_M)
    kept_rays = replace(kept.contour_rays, sigma=np.where(either, unclear, sigma))
    return rows._replace(products=replace(kept, voxels=voxels, contour_rays=kept_rays))


def _is_others(own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which rows another person explains clearly better, or is much nearer to."""
    explained = (others < POINT_GATE_M) & (others + CLEARLY_M < own)
    return np.asarray(explained | (others + ELSEWHERE_M < own))
