"""Rigs of the virtual studio: a ring of cameras around the volume, and one on the ceiling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel, looking_at
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume

Array = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 640, 480
LOOK_AT_WORLD = np.array([0.0, 0.0, 0.95])
HEIGHTS_M = (1.25, 2.10, 1.55, 2.30, 1.80, 1.20, 2.00)
DISTANCES_M = (3.25, 3.15, 3.35, 3.20, 3.10)
CEILING_POSITION_WORLD = np.array([0.15, -0.10, 3.45])
FOCAL_PX, CEILING_FOCAL_PX = 468.0, 330.0
DISTORTION, CEILING_DISTORTION = np.array([-0.185, 0.084, 3e-4, -2e-4, 0.0]), np.array([-0.22, 0.06, -2e-4, 2e-4, 0.0])
VOLUME = Volume(np.array([-1.4, -1.4, -0.05]), np.array([1.4, 1.4, 2.30]))


def ring(n: int, ceiling: bool = True) -> Rig:
    """Places n cameras around the volume, about 3.2 m from its centre, and optionally one above it.

    Two cameras that face each other see the same outline, so an even ring has its second half turned by a quarter of
    the spacing. Cameras are named cam01, cam02, ...; the one on the ceiling comes last.
    """
    if not 1 <= n <= 32:
        raise InputError(f"a ring of {n} cameras", remedy="Give 1 to 32 cameras.")
    cameras = [_ring_camera(i, n) for i in range(n)]
    if ceiling:
        cameras.append(_camera(n, CEILING_POSITION_WORLD, LOOK_AT_WORLD, CEILING_FOCAL_PX, CEILING_DISTORTION))
    return Rig(tuple(cameras), VOLUME)


def azimuths(n: int) -> Array:
    """Returns the directions (n,) of the ring's cameras, rad."""
    spacing = 2 * np.pi / n
    angles = np.array([0.35 + spacing * i for i in range(n)])
    if n % 2 == 0:
        angles[n // 2 :] += 0.25 * spacing
    return angles


def tilted(camera: CameraModel, up_rad: float) -> CameraModel:
    """Return the camera looking higher (negative: lower) than at the room's middle, its horizon level."""
    place = camera.centre_world
    away = np.linalg.norm((LOOK_AT_WORLD - place)[:2])
    pitch = np.arctan2(LOOK_AT_WORLD[2] - place[2], away) + up_rad
    target = np.array([*LOOK_AT_WORLD[:2], place[2] + away * np.tan(pitch)])
    return replace(camera, T_camera_world=looking_at(place, target))


def narrowed(camera: CameraModel, factor: float) -> CameraModel:
    """Return the camera with so many times the focal length."""
    K = camera.K.copy()
    K[:2, :2] *= factor
    return replace(camera, K=K)


def with_camera(rig: Rig, number: int, camera: CameraModel) -> Rig:
    """Return the rig with one camera exchanged."""
    cameras = list(rig.cameras)
    cameras[number] = camera
    return Rig(tuple(cameras), rig.volume)


def _ring_camera(index: int, n: int) -> CameraModel:
    azimuth = azimuths(n)[index]
    height = HEIGHTS_M[index % len(HEIGHTS_M)]
    across = np.sqrt(DISTANCES_M[index % len(DISTANCES_M)] ** 2 - (height - LOOK_AT_WORLD[2]) ** 2)
    position = np.array([across * np.cos(azimuth), across * np.sin(azimuth), height])
    return _camera(index, position, LOOK_AT_WORLD, FOCAL_PX, DISTORTION)


def _camera(index: int, position: Array, look_at: Array, focal: float, distortion: Array) -> CameraModel:
    """Return a camera whose lens differs a little from its neighbours', as real ones do."""
    rng = np.random.default_rng(1000 + index)
    fx, fy = focal * (1.0 + 0.006 * rng.standard_normal(2))
    cx, cy = np.array([WIDTH_PX - 1, HEIGHT_PX - 1]) / 2 + 3.0 * rng.standard_normal(2)
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    D = distortion * (1.0 + 0.03 * rng.standard_normal(5))
    T = looking_at(position, look_at, roll_rad=0.02 * rng.standard_normal())
    return CameraModel(f"cam{index + 1:02d}", WIDTH_PX, HEIGHT_PX, K, "plumb_bob", D, T)
