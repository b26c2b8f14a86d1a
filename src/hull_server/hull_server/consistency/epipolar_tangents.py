"""Epipolar tangents: the planes through two cameras' centres that touch the body.

All planes through two camera centres contain the baseline. The two outermost ones that touch the body do so at frontier
points, which both cameras see on their contours (Rieger 1986; Cipolla, Astrom and Giblin, "Motion from the frontier of
curved surfaces", ICCV 1995). So both cameras must measure the same two angles about the baseline, whatever the body's
shape. A difference indicates a calibration error (Sinha, Pollefeys and McMillan, "Camera network calibration from
dynamic silhouettes", CVPR 2004) or a contour error. The thresholds are checked by bench/camera_movement.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import CameraModel, Rig
from capture_rig.kernel import kernel

from ..bitset import FIRST_BITS, highest_bit, lowest_bit, nonzero_bytes, nonzero_span
from ..views import RigViews

Array = npt.NDArray[np.float64]

# Thresholds: measured by python bench/camera_movement.py.
MARGIN_PX = 4  # a contour nearer than this to unseen pixels may be cut off
LEAST_ROWS = 10  # silhouettes with fewer rows are not a body
LEAST_SINE = 0.2  # rays nearer to the baseline measure the angle badly
WIDEST_RAD = np.radians(150.0)  # a body seen over a wider angle contains the baseline
UNCERTAIN_PX = 3.0  # a tangent that moves by more when possible-shadow pixels are counted is not used
UNKNOWNS = 4  # of a camera: three rotation angles, and how much larger its silhouette is all around


class Tangents(NamedTuple):
    """The m tangent planes measured by two cameras each.

    first, second (m,) : indices of the cameras. difference_px (m,) : first minus second angle about the baseline, over
    its change for one pixel of noise in both images. first_part, second_part (m, 4) : derivatives of that difference by
    rotations of each camera about its own axes (x right, y down, z forward; radians) and by a silhouette that is larger
    by a pixel all around. angles (n, n, 2) : of the tangent planes that each camera measures about the baseline to each
    other camera, radians; NaN where it cannot.
    """

    first: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    difference_px: Array
    first_part: Array
    second_part: Array
    angles: Array


class _Contacts(NamedTuple):
    """One camera's tangent planes about the baseline to each camera j: largest angle (k = 0) and smallest (k = 1).

    angle (n, 2) : radians. part (n, 2, 4) : its derivatives by this camera's unknowns. noise (n, 2) : of the angle, for
    a pixel of noise. valid (n, 2) : whether it could be measured.
    """

    angle: Array
    part: Array
    noise: Array
    valid: npt.NDArray[np.bool_]


class EpipolarTangentFinder:
    """Measures the tangent planes of all pairs of cameras; tables of the calibration are computed once."""

    def __init__(self, rig: Rig, views: RigViews) -> None:
        self._names = views.names
        self._cameras = [rig.camera(name).undistorted_view().camera for name in views.names]
        self._to_ray_world = [np.linalg.inv(c.K).T @ c.R_camera_world for c in self._cameras]
        middle = (np.asarray(rig.volume.low) + np.asarray(rig.volume.high)) / 2
        self._axes = np.array([[_axes(a, b, middle) for b in self._cameras] for a in self._cameras])
        self._uncut = [_away_from_cuts(seen) for seen in views.seen]
        self._second, self._first = np.triu_indices(len(self._cameras), 1)

    def find(self, masks: Mapping[str, npt.NDArray[np.uint8]]) -> Tangents:
        """Measure canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, of some cameras of the rig."""
        found = [self._contacts(i, masks.get(name)) for i, name in enumerate(self._names)]
        angle, part, noise, valid = (np.stack(of_all) for of_all in zip(*found, strict=True))
        i, j = self._first, self._second
        both, side = np.nonzero(valid[i, j] & valid[j, i])
        i, j = i[both], j[both]
        together = np.hypot(noise[i, j, side], noise[j, i, side])
        return Tangents(
            first=i,
            second=j,
            difference_px=(angle[i, j, side] - angle[j, i, side]) / together,
            first_part=part[i, j, side] / together[:, None],
            second_part=-part[j, i, side] / together[:, None],
            angles=np.where(valid, angle, np.nan),
        )

    def _contacts(self, camera: int, mask: npt.NDArray[np.uint8] | None) -> _Contacts:
        corners = None if mask is None else _corners(mask)
        if corners is None:
            n = len(self._cameras), 2
            return _Contacts(np.zeros(n), np.zeros((*n, UNKNOWNS)), np.ones(n), np.zeros(n, bool))
        (rays, uncut), (wide_rays, wide_uncut) = (
            (self._rays(camera, pixels), self._uncut[camera][pixels[:, 1], pixels[:, 0]]) for pixels in corners
        )
        at, angle, across = self._outermost(camera, rays)
        wide_at, wide_angle, _ = self._outermost(camera, wide_rays)
        axes, ray = self._axes[camera][:, None], rays[at]
        sine = np.maximum(np.hypot(across[..., 0], across[..., 1]), 1e-9)
        noise = 1.0 / (sine * self._cameras[camera].K[0, 0])
        # direction in which the angle grows, and its derivative by rotations about the camera's axes
        along = (across[..., :1] * axes[..., 1, :] - across[..., 1:] * axes[..., 0, :]) / sine[..., None]
        turn = np.cross(ray, along) @ self._cameras[camera].R_camera_world.T / sine[..., None]
        valid = uncut[at] & wide_uncut[wide_at] & (sine > LEAST_SINE)
        valid &= np.abs(angle - wide_angle) <= UNCERTAIN_PX * noise
        wide = (wide_angle[:, 0] - wide_angle[:, 1] > WIDEST_RAD) | (np.abs(wide_angle).max(1) > WIDEST_RAD)
        valid[wide] = valid[camera] = False
        return _Contacts(angle, np.concatenate([turn, (noise * [1, -1])[..., None]], axis=2), noise, valid)

    def _rays(self, camera: int, pixels: npt.NDArray[np.int32]) -> Array:
        """Convert pixels (k, 2) to unit directions (k, 3) in the map frame."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ self._to_ray_world[camera]
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _outermost(self, camera: int, rays: Array) -> tuple[npt.NDArray[np.int64], Array, Array]:
        """Find the rays with the largest and smallest angle about each baseline.

        Returns index (n, 2) and angle (n, 2) of the ray, and its coordinates (n, 2, 2) across the baseline.
        """
        across = np.einsum("kc,nac->nka", rays, self._axes[camera])
        angle = np.arctan2(across[..., 1], across[..., 0])
        at = np.stack([angle.argmax(1), angle.argmin(1)], axis=1)
        of = np.arange(len(angle))[:, None]
        return at, angle[of, at], across[of, at]


def _corners(mask: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.int32]] | None:
    """Find corners (k, 2) u, v of the convex hulls of the sure foreground, and of all nonzero pixels; None if empty."""
    words, found = np.ascontiguousarray(mask).view(np.uint64), []
    ends = np.empty((2 * len(words), 2), np.int32)
    for certain in (True, False):
        count = _row_ends(words, certain, ends)
        if count < 2 * LEAST_ROWS:
            return None
        found.append(np.asarray(cv2.convexHull(ends[:count]), np.int32).reshape(-1, 2))
    return found


def _axes(first: CameraModel, second: CameraModel, middle_world: Array) -> Array:
    """Return two unit directions (2, 3) across the baseline: to the middle of the volume, and perpendicular to that."""
    line = second.centre_world - first.centre_world
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    line = line if first.name < second.name else -line  # the same for both cameras
    to_middle = middle_world - first.centre_world
    to_middle = to_middle - to_middle @ line * line
    to_middle = to_middle / max(float(np.linalg.norm(to_middle)), 1e-9)
    return np.stack([to_middle, np.cross(line, to_middle)])


def _away_from_cuts(seen: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Find the pixels (H, W) farther than MARGIN_PX from unseen ones."""
    padded = np.pad(seen, MARGIN_PX)
    inner = cv2.erode(padded, np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))
    return np.asarray(inner[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] > 0)


@kernel
def _row_ends(words, certain, points):  # type: ignore[no-untyped-def]
    """Write the first and last nonzero pixel (u, v) of each row of a mask to ``points``; return their number.

    words (h, w / 8) : of the mask, eight pixels a word. certain : only FOREGROUND counts.
    """
    count = 0
    for v in range(words.shape[0]):
        first, last = nonzero_span(words[v])
        while first < last and _marks(words[v, first], certain) == 0:
            first += 1
        if first < last:
            while _marks(words[v, last - 1], certain) == 0:
                last -= 1
            ones, others = _marks(words[v, first], certain), _marks(words[v, last - 1], certain)
            points[count, 0], points[count, 1] = 8 * first + lowest_bit(ones) // 8, v
            points[count + 1, 0], points[count + 1, 1] = 8 * last - 8 + highest_bit(others) // 8, v
            count += 2
    return count


@kernel
def _marks(word, certain):  # type: ignore[no-untyped-def]
    """Return a word with 1 in every byte that is not zero or, where only ``certain`` counts, that is FOREGROUND."""
    return nonzero_bytes(~word) ^ FIRST_BITS if certain else nonzero_bytes(word)
