"""The virtual studio: the rig (a ring of cameras around the volume, one on the ceiling) and the room around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


def ring(n: int, ceiling: bool = True, size: tuple[int, int] = (WIDTH_PX, HEIGHT_PX)) -> Rig:
    """Places n cameras around the volume, about 3.2 m from its centre, and optionally one above it.

    size : width and height of their images, pixels, across the same view; of another shape, cut or widened at top and
    bottom.

    Two cameras that face each other see the same outline, so an even ring has its second half turned by a quarter of
    the spacing. Cameras are named cam01, cam02, ...; the one on the ceiling comes last.
    """
    if not 1 <= n <= 32:
        raise InputError(f"a ring of {n} cameras", remedy="Give 1 to 32 cameras.")
    cameras = []
    for index, azimuth in enumerate(azimuths(n)):
        height = HEIGHTS_M[index % len(HEIGHTS_M)]
        across = np.sqrt(DISTANCES_M[index % len(DISTANCES_M)] ** 2 - (height - LOOK_AT_WORLD[2]) ** 2)
        position = np.array([across * np.cos(azimuth), across * np.sin(azimuth), height])
        cameras.append(_camera(index, position, FOCAL_PX, DISTORTION, size))
    if ceiling:
        cameras.append(_camera(n, CEILING_POSITION_WORLD, CEILING_FOCAL_PX, CEILING_DISTORTION, size))
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
    """Return the camera with its focal length scaled."""
    K = camera.K.copy()
    K[:2, :2] *= factor
    return replace(camera, K=K)


def with_camera(rig: Rig, number: int, camera: CameraModel) -> Rig:
    """Return the rig with one camera exchanged."""
    cameras = list(rig.cameras)
    cameras[number] = camera
    return Rig(tuple(cameras), rig.volume)


def _camera(index: int, position: Array, focal: float, distortion: Array, size: tuple[int, int]) -> CameraModel:
    """Return a camera whose lens differs a little from its neighbours', as real ones do; ``focal`` : in pixels of an
    image WIDTH_PX wide."""
    rng, times = np.random.default_rng(1000 + index), size[0] / WIDTH_PX
    fx, fy = times * focal * (1.0 + 0.006 * rng.standard_normal(2))
    cx, cy = (np.array(size) - 1) / 2 + times * 3.0 * rng.standard_normal(2)
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    D = distortion * (1.0 + 0.03 * rng.standard_normal(5))
    T = looking_at(position, LOOK_AT_WORLD, roll_rad=0.02 * rng.standard_normal())
    return CameraModel(f"cam{index + 1:02d}", *size, K, "plumb_bob", D, T)


# --- The empty room: floor, four walls and a ceiling with textures, as a camera's own lens sees it.


HALF_WIDTH_M, HEIGHT_M = 4.6, 3.8
FLOOR, CEILING = 4, 5
WALL_GREYS = (0.64, 0.59, 0.67, 0.62)
FLOOR_GREY, CEILING_GREY = 0.56, 0.72
DOOR_Y_M, DOOR_HEIGHT_M, CORRIDOR_GREY = (0.6, 1.5), 2.05, 0.22
"""The door of wall +x, and the space behind it."""
TINTS_BGR = np.array(
    [
        [1.06, 1.01, 0.93],
        [0.93, 1.07, 1.00],
        [1.12, 0.98, 0.90],
        [0.96, 0.99, 1.05],
        [0.74, 0.98, 1.28],
        [1.0, 1.0, 1.0],
    ],
    np.float32,
)
"""Blue, green and red over grey of walls +x -x +y -y, floor (wood) and ceiling; each has a mean of 1."""


@dataclass(frozen=True, eq=False)
class RoomView:
    """A camera's view of the empty room.

    rays (h, w, 3) unit viewing directions, world frame; grey (h, w) reflected light 0..1; floor_xy (h, w, 2) the
    pixel's place on the floor, metres, NaN elsewhere; surface (h, w) the surface's number, a row of `TINTS_BGR`.
    """

    rays: Array
    grey: NDArray[np.float32]
    floor_xy: NDArray[np.float32]
    surface: NDArray[np.int64]

    @property
    def colour(self) -> NDArray[np.float32]:
        """Reflected light (h, w, 3), BGR, whose mean over the channels is `grey`."""
        return self.grey[..., None] * TINTS_BGR[self.surface]


def pixel_rays(camera: CameraModel) -> Array:
    """Returns the unit viewing directions (h, w, 3) of a camera's pixels, world frame."""
    y, x = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays_world(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 3))


def view_room(camera: CameraModel) -> RoomView:
    """Returns the room through a camera, lens distortion included. The camera must be inside the room."""
    h, w = camera.height, camera.width
    pixels = pixel_rays(camera)
    rays = pixels.reshape(-1, 3)
    distance, surface = _first_surface(camera.centre_world, rays)
    hits = camera.centre_world + distance[:, None] * rays
    grey = np.zeros(len(rays))  # black where the lens model reaches nothing
    for s in range(6):
        on = (surface == s) & np.isfinite(distance)
        grey[on] = _paint(s, hits[on])
    floor = np.where((surface == FLOOR)[:, None], hits[:, :2], np.nan)
    floor_xy = floor.reshape(h, w, 2).astype(np.float32)
    return RoomView(pixels, grey.reshape(h, w).astype(np.float32), floor_xy, surface.reshape(h, w))


def open_door(camera: CameraModel, view: RoomView, share: float = 1.0) -> RoomView:
    """Returns the room with the door of wall +x open by a share of its width: a dim corridor is seen behind it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (HALF_WIDTH_M - camera.centre_world[0]) / view.rays[..., 0]
        y, z = (camera.centre_world[axis] + distance * view.rays[..., axis] for axis in (1, 2))
    left, right = DOOR_Y_M
    open_ = (view.surface == 0) & (y > left) & (y < left + share * (right - left)) & (z < DOOR_HEIGHT_M)
    corridor = CORRIDOR_GREY * (1.0 + 0.25 * np.clip(z, 0.0, DOOR_HEIGHT_M) / DOOR_HEIGHT_M)
    return replace(view, grey=np.where(open_, corridor, view.grey).astype(np.float32))


def _first_surface(origin: Array, rays: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distance (n,) to the first surface from inside the room, and its number: walls +x -x +y -y, floor, ceiling."""
    planes = [(0, HALF_WIDTH_M), (0, -HALF_WIDTH_M), (1, HALF_WIDTH_M), (1, -HALF_WIDTH_M), (2, 0.0), (2, HEIGHT_M)]
    with np.errstate(divide="ignore"):
        distances = np.stack([(place - origin[axis]) / rays[:, axis] for axis, place in planes], axis=1)
    distances[~(distances > 0)] = np.inf
    surface = distances.argmin(axis=1)
    return distances[np.arange(len(rays)), surface], surface


def _paint(surface: int, points: Array) -> Array:
    """Reflected light 0..1 at points (n, 3) of one surface."""
    x, y, z = points.T
    fall_off = 1.0 - 0.035 * (x**2 + y**2) ** 0.5
    if surface == FLOOR:
        boards = 0.03 * (np.floor(x / 0.14) % 3 - 1) + 0.05 * _noise(4.0 * x, 22.0 * y)
        joint = np.where(np.abs(x / 0.14 % 1.0 - 0.5) > 0.47, -0.06, 0.0)
        return (FLOOR_GREY + boards + joint + 0.05 * _noise(1.2 * x, 1.2 * y + 9)) * fall_off
    if surface == CEILING:
        lamp = (np.abs(x % 1.8 - 0.9) < 0.25) & (np.abs(y % 2.4 - 1.2) < 0.5)
        return np.where(lamp, 0.92, CEILING_GREY + 0.04 * _noise(2 * x, 2 * y))
    along = y if surface < 2 else x
    grey = WALL_GREYS[surface] + 0.05 * _noise(1.7 * along + 31 * surface, 1.7 * z) + 0.02 * _noise(15 * along, 15 * z)
    skirting = z < 0.10
    panel = (np.abs(along % 2.3 - 1.15) < 0.55) & (np.abs(z - 1.55) < 0.42)  # pictures and windows
    frame = panel & ~((np.abs(along % 2.3 - 1.15) < 0.50) & (np.abs(z - 1.55) < 0.37))
    grey = np.where(panel, 0.46 + 0.22 * (0.5 + 0.5 * _noise(3 * along + 7, 3 * z + surface)), grey)
    grey = np.where(frame, 0.80, grey)
    return np.where(skirting, 0.45, grey) * (0.90 + 0.04 * z)


def _noise(u: Array, v: Array) -> Array:
    """Smooth value noise (n,) in [-1, 1]: a hash at whole numbers, blended in between; the same for every camera."""
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    fu, fv = u - i, v - j
    fu, fv = fu * fu * (3 - 2 * fu), fv * fv * (3 - 2 * fv)
    low = _hash(i, j) * (1 - fu) + _hash(i + 1, j) * fu
    high = _hash(i, j + 1) * (1 - fu) + _hash(i + 1, j + 1) * fu
    return low * (1 - fv) + high * fv


def _hash(i: NDArray[np.int64], j: NDArray[np.int64]) -> Array:
    n = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    n = ((n ^ (n >> 13)) * 1274126177) & 0xFFFFFFFF
    return ((n ^ (n >> 16)) & 0xFFFF) / 32767.5 - 1.0
