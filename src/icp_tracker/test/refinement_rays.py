"""Rays that touch a body's surface, made by hand: tangents from cameras around it to its capsules."""

from dataclasses import replace

import numpy as np

from icp_tracker.articulated_fit import ArticulatedSettings, make_data
from mocap_packets.hull import NO_VOXELS, ContourRays
from stick_figure.body_surface import BodySurface
from stick_figure.kinematics import sticks
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES

CAMERAS = np.array(
    [[4 * np.cos(a), 4 * np.sin(a), h] for a, h in zip(np.arange(6) * np.pi / 3, [1, 2.4] * 3, strict=True)]
)


def capsules_world(body, surface, pose):
    """Ends (k, 3) twice of the capsules in the world, from the sticks' places and rotations alone."""
    starts = sticks(body, pose)[:, 0]
    R = [pose.R_world_torso] + [pose.R_world_torso @ pose.R_joints[m] for m in range(5)]
    for h, angle in enumerate(pose.hinges):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) if h < 2 else np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        R.append(R[2 + h] @ turn)
    R = np.array(R)[surface.stick]
    place = lambda local: starts[surface.stick] + np.einsum("kij,kj->ki", R, local)  # noqa: E731
    return place(surface.start), place(surface.end)


def tangent_rays(body, surface, pose, rng, each=24, sd_m=0.0):
    """The same rays as data of the all-joints solve."""
    rays = rays_on(body, surface, pose, rng, each, sd_m)
    return make_data(np.zeros((1, 3)), 0.0, NO_VOXELS, ArticulatedSettings(), rays).contour_rays


def rays_on(body, surface, pose, rng, each=24, sd_m=0.0):
    """Up to ``each`` rays a capsule, along its sides and round its ends, those that pass through no other capsule;
    shifted by noise across."""
    P, Q = capsules_world(body, surface, pose)
    rows = []
    for k in range(len(P)):
        for _ in range(each):
            point, direction, normal = _touching(P[k], Q[k], surface.radii[k], rng)
            others = np.arange(len(P)) != k
            if _clear(point, direction, P[others], Q[others], surface.radii[others]):
                rows.append(np.r_[point + rng.normal(0.0, sd_m) * normal, direction, normal])
    rows = np.array(rows)[rng.permutation(len(rows))]
    n = len(rows)
    return ContourRays(rows[:, :3], rows[:, 3:6], rows[:, 6:], np.full(n, 0.02), np.full(n, 0.005), np.zeros(n))


def grazing_rays(body, pose, rng, each=24):
    """Rays on the body of average build in a pose, with stretches and noise as the hull server gives them."""
    rays = rays_on(body, BodySurface.of(body), pose, rng, each)
    n = len(rays)
    return replace(rays, half_lengths=np.full(n, 0.1), sigma=np.full(n, 0.003))


def _touching(p, q, radii, rng):
    """A ray from some camera that touches a capsule: where, its direction, and the normal there."""
    u, side, camera = rng.choice([rng.uniform(), 0.0, 1.0], p=[0.7, 0.15, 0.15]), rng.choice([-1.0, 1.0]), None
    camera = CAMERAS[rng.integers(len(CAMERAS))]
    centre, radius = p + u * (q - p), radii @ [1 - u, u]
    round_the_end = 0.0 if 0.0 < u < 1.0 else (2.0 * u - 1.0) * rng.uniform(0.1, 1.0)
    direction = centre - camera
    for _ in range(8):  # the normal is across the ray, the ray leads to the point that it touches
        direction = direction / np.linalg.norm(direction)
        normal = _cross(q - p, direction)
        along = _cross(direction, normal)
        normal, along = side * normal / np.linalg.norm(normal), along / np.linalg.norm(along)
        normal = np.sqrt(1.0 - round_the_end**2) * normal + round_the_end * along
        direction = centre + radius * normal - camera
    return centre + radius * normal, direction / np.linalg.norm(direction), normal


def _cross(a, b):
    """Cross product; numpy's takes ten times as long for two vectors."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _clear(point, direction, P, Q, radii):
    """Whether a ray passes outside all capsules."""
    samples = np.linspace(0.0, 1.0, 21)
    axis = P[:, None] + samples[:, None] * (Q - P)[:, None] - point
    distance = np.linalg.norm(axis - (axis @ direction)[..., None] * direction, axis=2)
    return (distance > radii[:, :1] * (1.0 - samples) + radii[:, 1:] * samples).all()


def moving_pose(rng):
    """A pose with joints anywhere in the inner part of their ranges, elbows and knees bent."""
    angles = T_POSE_ANGLES.copy()
    middle, reach = 0.5 * (ANGLE_LOW + ANGLE_HIGH), 0.5 * (ANGLE_HIGH - ANGLE_LOW)
    for k, name in enumerate(ANGLE_NAMES):
        if "shoulder_x" in name:
            angles[k] += rng.uniform(-1.2, 0.5) * (1 if name.startswith("left") else -1)
        elif "shoulder" in name or "hip" in name:
            angles[k] = rng.uniform(-0.5, 0.5)
        elif "elbow" in name or "knee" in name:
            angles[k] = np.clip(middle[k] + rng.uniform(-0.5, 0.5) * reach[k], -1.9, 1.9)
    return Pose.from_angles([0.0, 0.0, 1.1], np.eye(3), angles)
