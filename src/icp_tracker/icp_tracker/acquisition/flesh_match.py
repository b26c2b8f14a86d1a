"""How well a pose's flesh and a hull agree, both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.pose import Pose

from ..flesh import Flesh, nearest_flesh, place_flesh

NEAR_M = 0.06  # flesh and hull surface this near to each other agree
FAR_M = 0.15  # farther is no worse
AXIS_SAMPLES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


@dataclass(frozen=True)
class FleshMatch:
    """explained : share of the hull's surface that lies on the flesh. held : share of the flesh's axes that lie in the
    hull. cost : m, mean distance of surface to flesh and of axes to hull, cut off where it stops to matter."""

    explained: float
    held: float
    cost: float


def match_flesh(body: Body, flesh: Flesh, pose: Pose, surface_world: np.ndarray, hull_world: np.ndarray) -> FleshMatch:
    """Compare a body in a pose with samples of a hull's surface (m, 3) and of all of it (n, 3), metres, world frame."""
    P, Q = _placed(body, flesh, pose)
    distance = _surface_distances(P, Q, flesh, surface_world)
    axes = (P[:, None] + AXIS_SAMPLES[:, None] * (Q - P)[:, None]).reshape(-1, 3)
    radii = (flesh.radii[:, :1] + AXIS_SAMPLES * (flesh.radii[:, 1:] - flesh.radii[:, :1])).ravel()
    offsets = axes[:, None] - hull_world
    outside = np.sqrt(np.einsum("anj,anj->an", offsets, offsets).min(axis=1)) - radii
    cost = np.clip(np.abs(distance), 0.0, FAR_M).mean() + np.clip(outside, 0.0, FAR_M).mean()
    return FleshMatch(float(np.mean(np.abs(distance) < NEAR_M)), float(np.mean(outside < NEAR_M / 2)), float(cost))


def _placed(body: Body, flesh: Flesh, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """World ends (k, 3) of the capsules."""
    G, axes = np.empty((10, 3, 3)), np.empty((18, 3))
    A, B = np.empty((10, 3)), np.empty((10, 3))
    kernels.stick_frames(pose.R_world_torso, pose.R_joints, pose.hinges, G, axes)
    kernels.stick_ends(G, pose.position_world, body.lengths, body.stick_origins_torso, A, B)
    P, Q = np.empty_like(flesh.start), np.empty_like(flesh.end)
    place_flesh(flesh, G, A, P, Q)
    return P, Q


def _surface_distances(P: np.ndarray, Q: np.ndarray, flesh: Flesh, points_world: np.ndarray) -> np.ndarray:
    """Signed distance (m,) of points to the flesh, metres, negative inside."""
    x, y, z = (np.ascontiguousarray(column) for column in points_world.T)
    capsule, along, distance = np.zeros(len(x), np.int64), np.empty(len(x)), np.empty(len(x))
    nearest_flesh(x, y, z, P, Q, flesh.radii, capsule, along, distance)
    return distance
