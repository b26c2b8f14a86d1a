"""Scenes for the hull server's tests: capsule bodies, camera rings, exact silhouettes, and the float64 oracle."""

from functools import lru_cache

import cv2
import numpy as np

from capture_rig import CameraModel, Rig, Volume
from capture_rig.camera import looking_at
from hull_server.grid import BrickVolume, VoxelGrid
from virtual_studio.people import Capsules
from virtual_studio.rendering.capsules import silhouette
from virtual_studio.rig import pixel_rays

VOLUME = Volume(np.array([-1.0, -1.0, -0.05]), np.array([1.0, 1.0, 2.1]))


def capsule_person(yaw: float = 0.0, x: float = 0.0, y: float = 0.0) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """A person of capsules (start, end, radius), metres, one arm raised to the side, one leg forward."""
    joints = {
        "hip": (0, 0, 0.95),
        "neck": (0, 0, 1.45),
        "head": (0, 0, 1.68),
        "ls": (0, 0.19, 1.40),
        "rs": (0, -0.19, 1.40),
        "le": (0, 0.47, 1.42),
        "lh": (0.05, 0.78, 1.45),
        "re": (0.05, -0.28, 1.12),
        "rh": (0.18, -0.32, 0.88),
        "lk": (0.05, 0.13, 0.50),
        "lf": (0.0, 0.15, 0.08),
        "rk": (0.18, -0.12, 0.52),
        "rf": (0.20, -0.13, 0.09),
    }
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    at = {name: turn @ np.array(p, float) + [x, y, 0] for name, p in joints.items()}
    limbs = [
        ("hip", "neck", 0.14),
        ("neck", "head", 0.09),
        ("neck", "ls", 0.07),
        ("neck", "rs", 0.07),
        ("ls", "le", 0.05),
        ("le", "lh", 0.04),
        ("rs", "re", 0.05),
        ("re", "rh", 0.04),
        ("hip", "lk", 0.08),
        ("lk", "lf", 0.06),
        ("hip", "rk", 0.08),
        ("rk", "rf", 0.06),
    ]
    return [(at[a], at[b], r) for a, b, r in limbs]


def walking_person(share: float) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """The person at a share of a lap in a circle of half a metre, turning."""
    angle = 2 * np.pi * share
    return capsule_person(angle, 0.5 * np.cos(angle), 0.5 * np.sin(angle))


def rotated_mask(rig: Rig, name: str, mask: np.ndarray, rotation_deg) -> np.ndarray:
    """The mask (h, w) of a camera after a rotation about its own axes (x right, y down, z forward): pixels move by
    K R K^-1; outlines are as sharp as before."""
    K = rig.camera(name).undistorted_view().camera.K
    H = K @ cv2.Rodrigues(np.radians(np.array(rotation_deg, float)))[0] @ np.linalg.inv(K)
    return np.where(cv2.warpPerspective(mask, H, mask.shape[::-1]) > 127, np.uint8(255), np.uint8(0))


def look_at(
    name: str, centre: np.ndarray, target: np.ndarray, focal_px: float, size: tuple[int, int], D=(0, 0, 0, 0, 0)
) -> CameraModel:
    """A camera at ``centre`` (3,) that looks at ``target`` (3,), upright."""
    T = looking_at(centre, target)
    K = np.array([[focal_px, 0, (size[0] - 1) / 2], [0, focal_px * 1.01, (size[1] - 1) / 2 + 3], [0, 0, 1.0]])
    return CameraModel(name, size[0], size[1], K, "plumb_bob", np.array(D, float), T)


def ring_rig(
    cameras: int = 5,
    *,
    size: tuple[int, int] = (320, 240),
    focal_px: float = 235.0,
    seed: int = 0,
    distortion: bool = True,
    volume: Volume = VOLUME,
) -> Rig:
    """Cameras around the origin at 3 to 4 m, unevenly placed; distortion gives padded canvases with blind borders."""
    rng = np.random.default_rng(seed)
    models = []
    for index in range(cameras):
        angle = 2 * np.pi * (index + rng.uniform(-0.2, 0.2)) / cameras
        radius, height = rng.uniform(2.9, 3.8), rng.uniform(0.8, 2.4)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        target = np.array([*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.8, 1.1)])
        D = (rng.uniform(-0.2, -0.05), rng.uniform(0.0, 0.08), 3e-4, -3e-4, 0.0) if distortion else (0,) * 5
        models.append(look_at(f"cam{index + 1:02d}", centre, target, focal_px, size, D))
    return Rig(tuple(models), volume)


def silhouettes(rig: Rig, body: list[tuple[np.ndarray, np.ndarray, float]]) -> dict[str, np.ndarray]:
    """The exact silhouettes (h, w) uint8 0/255 of a capsule body on every camera's canvas, 0 where unseen."""
    starts, ends, radii = (np.array(part, float) for part in zip(*body, strict=True))
    capsules = Capsules(starts, ends, np.column_stack([radii, radii]), np.ones(len(radii)))
    masks = {}
    for camera in rig.cameras:
        view = camera.undistorted_view()
        masks[camera.name] = np.where(view.seen, silhouette(view.camera, _rays(view.camera), capsules), np.uint8(0))
    return masks


def volume_of(dense: np.ndarray, voxel: float = 0.02) -> BrickVolume:
    """A hull of the voxels (x, y, z) bool that are set."""
    return BrickVolume.from_dense(VoxelGrid(np.array([-1.0, -2.0, 0.5]), voxel, dense.shape), dense)


_rays = lru_cache(maxsize=16)(pixel_rays)


def distance_to_axes(points: np.ndarray, body: list[tuple[np.ndarray, np.ndarray, float]]) -> np.ndarray:
    """(parts, n) distance of points (n, 3) from the axis of each capsule."""
    distances = []
    for start, end, _ in body:
        along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        distances.append(np.linalg.norm(points - start - along[:, None] * (end - start), axis=1))
    return np.array(distances)


def carve_brute_force(rig: Rig, masks: dict, voxel: float, min_seeing: int, vetoes: int = 0) -> np.ndarray:
    """The rule, voxel by voxel in float64, written for clarity: (nx, ny, nz) bool; ``vetoes`` : most of a voxel."""
    counts = np.ceil((rig.volume.high - rig.volume.low) / voxel - 1e-9).astype(int)
    axes = [rig.volume.low[a] + (np.arange(counts[a]) + 0.5) * voxel for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    vetoing, seeing = np.zeros((2, len(points)), int)
    for camera in rig.cameras:
        if camera.name not in masks:
            continue
        view = camera.undistorted_view()
        in_camera = points @ camera.R_camera_world.T + camera.t_camera_world
        in_front = np.flatnonzero(in_camera[:, 2] > 0)
        homogeneous = in_camera[in_front] @ view.camera.K.T
        pixel = np.floor(homogeneous[:, :2] / homogeneous[:, 2:] + 0.5)
        h, w = view.seen.shape
        inside = (pixel >= 0).all(1) & (pixel[:, 0] < w) & (pixel[:, 1] < h)
        u, v = pixel[inside].astype(int).T
        voxels = in_front[inside]
        seen, level = view.seen[v, u], masks[camera.name][v, u]
        vetoing[voxels[seen & (level == 0)]] += 1
        seeing[voxels[seen & (level > 127)]] += 1  # what lies between is uncertain: no say
    return ((vetoing <= vetoes) & (seeing >= min_seeing)).reshape(counts)
