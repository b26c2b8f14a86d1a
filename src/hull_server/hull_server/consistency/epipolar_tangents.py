"""Planes through two cameras that touch the body: both must see the body between the same two.

All planes through the centres of two cameras turn about the line between them. The two outermost that touch the body
touch it at points that both cameras see on the rims of their silhouettes (frontier points: Rieger 1986; Cipolla,
Astrom and Giblin, "Motion from the frontier of curved surfaces", ICCV 1995). So both cameras must see these planes at
the same two angles, whatever the body's shape is. A difference tells of the calibration (Sinha, Pollefeys and McMillan,
"Camera network calibration from dynamic silhouettes", CVPR 2004), or of the silhouettes' rims.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import CameraModel, Rig
from capture_rig.mask_levels import FOREGROUND

from ..kernel import kernel
from ..views import RigViews

Array = npt.NDArray[np.float64]

MARGIN_PX = 4  # a rim nearer to where the camera sees nothing may be a cut
LEAST_ROWS = 10  # lower silhouettes are nobody
LEAST_SINE = 0.2  # rays nearer to the line between the cameras tell an angle badly
WIDEST_RAD = np.radians(150.0)  # a body that is seen over a wider angle is around that line
DOUBTFUL_PX = 3.0  # a rim that moves by more when doubtful pixels are counted is doubtful itself
AXES = 4  # unknowns of a camera: three angles, and how much larger its silhouette is all around


class Tangents(NamedTuple):
    """m planes, each touched by the silhouettes of two cameras at rays that should lie in one plane.

    first, second (m,) : indices of the cameras. difference_px (m,) : of the angles about the line between the cameras
    at which the rays lie, first minus second, over what a pixel of noise in both pictures makes of it. first_part,
    second_part (m, 4) : what turns of the cameras about their own axes (x right, y down, z forward; radians) and a
    silhouette that is larger by a pixel all around add to that difference. angles (n, n, 2) : at which each camera sees
    the planes through it and each other one, radians; NaN where it cannot tell.
    """

    first: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    difference_px: Array
    first_part: Array
    second_part: Array
    angles: Array


class _Contacts(NamedTuple):
    """Where one camera's silhouette touches planes through every camera j of the rig: the one with the largest angle
    (k = 0) and the one with the smallest (k = 1).

    angle (n, 2) : radians. part (n, 2, 4) : its derivatives by this camera's unknowns. noise (n, 2) : of the angle, for
    a pixel of noise. told (n, 2) : whether it can be told.
    """

    angle: Array
    part: Array
    noise: Array
    told: npt.NDArray[np.bool_]


class EpipolarTangentFinder:
    """Finds the tangent planes of all pairs of cameras; what depends on the calibration is computed once, here."""

    def __init__(self, rig: Rig, views: RigViews) -> None:
        self._names = views.names
        self._cameras = [rig.camera(name).undistorted_view().camera for name in views.names]
        self._to_ray_world = [np.linalg.inv(c.K).T @ c.R_camera_world for c in self._cameras]
        middle = (np.asarray(rig.volume.low) + np.asarray(rig.volume.high)) / 2
        self._axes = np.array([[_axes(a, b, middle) for b in self._cameras] for a in self._cameras])
        self._uncut = [_away_from_cuts(seen) for seen in views.seen]
        self._second, self._first = np.triu_indices(len(self._cameras), 1)

    def find(self, masks: Mapping[str, npt.NDArray[np.uint8]]) -> Tangents:
        """Those of canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, of some cameras of the rig."""
        found = [self._contacts(i, masks.get(name)) for i, name in enumerate(self._names)]
        angle, part, noise, told = (np.stack(of_all) for of_all in zip(*found, strict=True))
        i, j = self._first, self._second
        both, side = np.nonzero(told[i, j] & told[j, i])
        i, j = i[both], j[both]
        together = np.hypot(noise[i, j, side], noise[j, i, side])
        return Tangents(
            first=i,
            second=j,
            difference_px=(angle[i, j, side] - angle[j, i, side]) / together,
            first_part=part[i, j, side] / together[:, None],
            second_part=-part[j, i, side] / together[:, None],
            angles=np.where(told, angle, np.nan),
        )

    def _contacts(self, camera: int, mask: npt.NDArray[np.uint8] | None) -> _Contacts:
        corners = None if mask is None else _corners(mask)
        if corners is None:
            return _no_contacts(len(self._cameras))
        (rays, uncut), (wide_rays, wide_uncut) = (
            (self._rays(camera, pixels), self._uncut[camera][pixels[:, 1], pixels[:, 0]]) for pixels in corners
        )
        at, angle, across = self._outermost(camera, rays)
        wide_at, wide_angle, _ = self._outermost(camera, wide_rays)
        axes, ray = self._axes[camera][:, None], rays[at]
        sine = np.maximum(np.hypot(across[..., 0], across[..., 1]), 1e-9)
        noise = 1.0 / (sine * self._cameras[camera].K[0, 0])
        # where the angle grows, and what turning the camera about its own axes does to it
        along = (across[..., :1] * axes[..., 1, :] - across[..., 1:] * axes[..., 0, :]) / sine[..., None]
        turn = np.cross(ray, along) @ self._cameras[camera].R_camera_world.T / sine[..., None]
        told = uncut[at] & wide_uncut[wide_at] & (sine > LEAST_SINE)
        told &= np.abs(angle - wide_angle) <= DOUBTFUL_PX * noise
        wide = (wide_angle[:, 0] - wide_angle[:, 1] > WIDEST_RAD) | (np.abs(wide_angle).max(1) > WIDEST_RAD)
        told[wide] = told[camera] = False
        return _Contacts(angle, np.concatenate([turn, (noise * [1, -1])[..., None]], axis=2), noise, told)

    def _rays(self, camera: int, pixels: npt.NDArray[np.int32]) -> Array:
        """(k, 3) directions in the world, of length 1."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ self._to_ray_world[camera]
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _outermost(self, camera: int, rays: Array) -> tuple[npt.NDArray[np.int64], Array, Array]:
        """Of the planes with the largest and the smallest angle about the line to each camera: which ray (n, 2) touches
        it, the angle (n, 2), and where the ray lies across that line (n, 2, 2)."""
        across = np.einsum("kc,nac->nka", rays, self._axes[camera])
        angle = np.arctan2(across[..., 1], across[..., 0])
        at = np.stack([angle.argmax(1), angle.argmin(1)], axis=1)
        of = np.arange(len(angle))[:, None]
        return at, angle[of, at], across[of, at]


def _no_contacts(cameras: int) -> _Contacts:
    shape = cameras, 2
    return _Contacts(np.zeros(shape), np.zeros((*shape, AXES)), np.ones(shape), np.zeros(shape, bool))


def _corners(mask: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.int32]] | None:
    """Corners (k, 2) u, v of the convex hulls of the person alone, and of all that may be the person; None when there
    is nobody."""
    left, top, width, height = cv2.boundingRect(mask)
    part, found = mask[top : top + height, left : left + width], []
    for least in (FOREGROUND, 1):
        ends = np.empty((2 * height, 2), np.int32)
        count = _row_ends(part, least, ends)
        if count < 2 * LEAST_ROWS:
            return None
        corners = cv2.convexHull(ends[:count]).reshape(-1, 2) + np.array([left, top])
        found.append(corners.astype(np.int32))
    return found


def _axes(first: CameraModel, second: CameraModel, middle_world: Array) -> Array:
    """(2, 3) directions across the line between the cameras: to the middle of the volume, and across that."""
    line = second.centre_world - first.centre_world
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    line = line if first.name < second.name else -line  # the same for both
    to_middle = middle_world - first.centre_world
    to_middle = to_middle - to_middle @ line * line
    to_middle = to_middle / max(float(np.linalg.norm(to_middle)), 1e-9)
    return np.stack([to_middle, np.cross(line, to_middle)])


def _away_from_cuts(seen: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    padded = np.pad(seen, MARGIN_PX)
    inner = cv2.erode(padded, np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))
    return np.asarray(inner[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] > 0)


@kernel
def _row_ends(mask, least, points):  # type: ignore[no-untyped-def]
    """Write the first and last pixel (u, v) of ``least`` or more in every row that has one; return their number."""
    count = 0
    for v in range(mask.shape[0]):
        u = 0
        while u < mask.shape[1] and mask[v, u] < least:
            u += 1
        if u < mask.shape[1]:
            points[count, 0], points[count, 1] = u, v
            u = mask.shape[1] - 1
            while mask[v, u] < least:
                u -= 1
            points[count + 1, 0], points[count + 1, 1] = u, v
            count += 2
    return count
