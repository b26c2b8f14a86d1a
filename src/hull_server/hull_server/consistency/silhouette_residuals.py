"""Measures how far each camera's silhouette disagrees with the hull of the others, on a coarse voxel grid.

Silhouettes of one body agree when the hull that they make together, seen from each camera, covers each silhouette
(silhouette coherence: Hernandez, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular
motion", PAMI 2007). A faulty camera removes parts of the body from the hull, and the other silhouettes are covered
again as soon as its veto is ignored. A sound camera removes nothing but phantom volume, which lies behind and in front
of the body in the other images. So the size of the volume that one camera alone vetoes is no measure (three sound
cameras veto half and more of each other's hulls); the foreground that it explains in the other images is.

The voters' hull and those without each of them are carved on every ``stride``-th pixel (the *cells*) of the silhouettes
and projected back into every image, to separate the foreground that they explain with a camera's veto from the
foreground that they explain only without it. In words of bits, bit s is the camera ``cameras[s]``; the voters come
first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig import Rig
from capture_rig.kernel import kernel
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, UNCERTAIN

from ..bitset import fill_bits, lowest_bit, popcount
from ..carving.cpu_carver import CpuCarver
from ..carving.pixel_boxes import pixel_projections, project
from ..floor_shadows import FLOOR_M
from ..grid import VoxelGrid
from ..views import RigViews, min_seeing

# Thresholds: measured by python bench/camera_faults.py.
MAX_SHARED_VOXELS = 1 << 15  # two cubic metres of 40 mm voxels: more is not a body
NEEDED_BY = 2  # cameras whose foreground stays unexplained without a voxel: one may show a thing, or noise
SKIPPED = -1  # instead of the bits of the vetoing cameras, for a voxel that is in no hull

Floats = npt.NDArray[np.float64]


class CameraResiduals(NamedTuple):
    """One camera's residuals of a frame set. Shares are 0 to 1.

    veto_fraction : share of the body that the camera vetoes: of the foreground in the voters' other images that the
        hull without its veto explains, the part that the veto leaves unexplained.
    excess : share of the camera's view that is foreground which that hull does not explain.
    coverage : share of the camera's view that is foreground.
    consistency : share of the camera's foreground that the hull without its veto explains (silhouette coherence; 1
        where it shows nothing), times the share of the body that it does not veto.
    """

    veto_fraction: float = 0.0
    excess: float = 0.0
    coverage: float = 0.0
    consistency: float = 1.0

    def moved(self, target: CameraResiduals, share: float) -> CameraResiduals:
        """Return the residuals moved by ``share`` of the way to ``target``: one step of a running mean."""
        return CameraResiduals(*(old + share * (new - old) for old, new in zip(self, target, strict=True)))


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of one frame set. Arrays (n,) and lists are in the order of ``cameras``, the voters first.

    cameras : indices in the rig. voters : the number of them that can veto. own : of each camera.
    body_litres : volume of the hull without a camera's veto. explained_share : of its foreground, by that hull.
    unexplained : share of the voters' foreground that their common hull leaves unexplained.
    """

    cameras: tuple[int, ...]
    voters: int
    own: list[CameraResiduals]
    body_litres: Floats
    explained_share: Floats
    unexplained: float


class CellViews(NamedTuple):
    """projections (N, 3, 4) : voxel index to cell, such that the cell is floor(u / w), floor(v / w). reach (N,) : half
    the size of a voxel in the image, in cells times depth. floor_layers : of the grid, where shadows lie."""

    projections: Floats
    reach: Floats
    floor_layers: int


class ResidualEstimator:
    """Estimates the residuals of frame sets; tables of the calibration are computed once. One thread at a time.

    cells (N, H, W) : of the last frame set, FOREGROUND, BACKGROUND, or UNCERTAIN, also where a camera does not see.

    Cells that hulls explain are bits of words. by_hull (N, H, W / 64) : cells of each image that the voters' hull
    explains. by_own (N, N, H, W / 64) [image, camera] : of a voter, cells that the voxels explain which it alone
    vetoes; of another camera, cells that the voters' hull explains without the voxels that it vetoes.
    """

    def __init__(self, rig: Rig, views: RigViews, voxel_size_m: float, requested_seeing: int = 0) -> None:
        self._requested_seeing = requested_seeing
        self._grid = grid = VoxelGrid.covering(rig.volume, voxel_size_m)
        # a cell is about half as large as a voxel in the image
        self.stride = max(1, round(float(np.median(views.px_per_m(rig.volume))) * voxel_size_m / 2))
        cells = _decimated(views, self.stride)
        self._unseen = cells.seen == 0
        self._cells_seen = np.maximum(np.count_nonzero(cells.seen, axis=(1, 2)), 1)
        floor_layers = max(0, int(np.ceil((FLOOR_M - grid.origin[2]) / grid.voxel_size)))
        self._views = CellViews(pixel_projections(cells, grid), cells.focal_px * grid.voxel_size / 2, floor_layers)
        self._carver, self._names = CpuCarver(cells, grid), views.names
        self.cells = np.full_like(cells.seen, UNCERTAIN)
        self._counts = np.zeros(len(views.names), np.int64)
        cameras, height, width = self.cells.shape
        self._by_hull = np.zeros((cameras, height, width // 64), np.uint64)
        self._by_own = np.zeros((cameras, *self._by_hull.shape), np.uint64)
        self._pixels = np.zeros((len(views.names), 6), np.int64)
        self._voxels, self._vetoes = np.zeros((0, 3), np.int64), np.zeros(0, np.int64)

    def set_mask(self, camera: int, mask: npt.NDArray[np.uint8]) -> None:
        """Set one camera's mask (h, w)."""
        self._counts[camera] = sample(mask, self._unseen[camera], self.stride, self.cells[camera])

    def shows(self, camera: int) -> bool:
        """Return whether anything in the camera's view is foreground."""
        return bool(self._counts[camera])

    def estimate(self, voters: tuple[int, ...], others: tuple[int, ...]) -> Residuals | None:
        """Estimate the residuals of the ``voters``, which can veto, and of the ``others``, which cannot.

        None when too much is foreground: more than two cubic metres.
        """
        cameras, n, needed = np.array(voters + others, np.int64), len(voters + others), self._needed(len(voters))
        # the voxels that at most one voter vetoes, and enough of the others show
        silhouettes = {self._names[c]: self.cells[c] for c in voters}
        volume = self._carver.carve(silhouettes, self._needed(len(voters) - 1), vetoes=1)
        if volume.count > MAX_SHARED_VOXELS:
            return None
        self._voxels = volume.voxels()
        # the foreground that they explain in each image, with and without each camera's veto
        self._vetoes, voting = np.empty(len(self._voxels), np.int64), (len(voters), needed)
        found, marks = (self._voxels, self._vetoes), (self._by_hull, self._by_own)
        mark_explained(self._views, self.cells, cameras, voting, *found, *marks, self._pixels)
        explained, vetoed = np.zeros((n, n), np.int64), np.zeros((n, n), np.int64)
        shown = np.packbits(self.cells == FOREGROUND, axis=2, bitorder="little").view(np.uint64)
        count_explained(shown, cameras, len(voters), *marks, explained, vetoed)
        return self._shares(cameras, len(voters), explained, vetoed)

    def _needed(self, voters: int) -> int:
        return min_seeing(voters, self._requested_seeing)

    def denied_cells(self, residuals: Residuals, slot: int) -> npt.NDArray[np.bool_]:
        """Return the cells (H, W) in which ``residuals.cameras[slot]`` alone vetoes volume that two others need.

        They need it if it explains foreground of theirs that no other volume explains. The hull is that of the last
        call of :meth:`estimate`.
        """
        cameras, denied = np.array(residuals.cameras, np.int64), np.zeros(self.cells.shape[1:], np.bool_)
        explained = self._by_hull if slot < residuals.voters else self._by_own[:, slot]
        alone = self._vetoes & ((1 << residuals.voters) - 1 | 1 << slot) == 1 << slot
        mark_denied(self._views, self.cells, cameras, slot, self._voxels[alone], explained, denied, self._pixels)
        return denied

    def _shares(self, cameras, voters, explained, vetoed) -> Residuals:  # type: ignore[no-untyped-def]
        """Convert counts to shares. A camera is compared with the images of the voters other than itself."""
        n, cells = len(cameras), self._counts[cameras]
        compared = (np.arange(n)[:, None] < voters) & ~np.eye(n, dtype=bool)
        theirs, own = (explained * compared).sum(0), np.diagonal(explained)
        by_voters = self._vetoes[self._vetoes != SKIPPED] & (1 << voters) - 1
        agreed = int(np.count_nonzero(by_voters == 0))
        alone = np.array([np.count_nonzero(by_voters == 1 << slot) if slot < voters else 0 for slot in range(n)])
        veto_fraction = (vetoed * compared).sum(0) / np.maximum(theirs, 1)
        explained_share, seen = own / np.maximum(cells, 1), self._cells_seen[cameras]
        consistency = np.where(cells > 0, explained_share, 1.0) * (1.0 - veto_fraction)
        shares = np.column_stack([veto_fraction, (cells - own) / seen, cells / seen, consistency])
        return Residuals(
            cameras=tuple(cameras.tolist()),
            voters=voters,
            own=[CameraResiduals(*row) for row in shares.tolist()],
            body_litres=(agreed + alone) * self._grid.voxel_volume_m3 * 1e3,
            explained_share=explained_share,
            unexplained=1.0 - float((own - np.diagonal(vetoed))[:voters].sum() / max(int(cells[:voters].sum()), 1)),
        )


def _decimated(views: RigViews, stride: int) -> RigViews:
    """Keep every ``stride``-th pixel of the views, from pixel stride // 2 on; all canvases become as large as the
    largest."""
    first = stride // 2
    P = views.P.copy()
    P[:, :2] -= first * P[:, 2:]
    P[:, :2] /= stride
    kept = views.seen[:, first::stride, first::stride]
    n, height, width = kept.shape
    seen = np.zeros((n, height, -(-width // 64) * 64), np.uint8)
    seen[:, :, :width] = kept
    return RigViews(views.names, P, np.tile([seen.shape[2], height], (n, 1)), seen)


@kernel
def sample(mask, unseen, stride, cells):  # type: ignore[no-untyped-def]
    """Write the cells (H, W) of a mask (h, w); return the number of foreground cells."""
    found = 0
    for row in range((mask.shape[0] - stride // 2 + stride - 1) // stride):
        for column in range((mask.shape[1] - stride // 2 + stride - 1) // stride):
            level = mask[stride // 2 + row * stride, stride // 2 + column * stride]
            if unseen[row, column] or level == UNCERTAIN:
                cells[row, column] = UNCERTAIN
            else:
                cells[row, column] = FOREGROUND if level else BACKGROUND
                found += level > 0
    return found


@kernel
def _project(views, cells, cameras, voxel, pixels):  # type: ignore[no-untyped-def]
    """Write to pixels (n, 6) the cells that a voxel (3,) covers in each image, and that of its centre.

    These are the first and last (exclusive) row and column, and the centre's row and column; all 0 behind the camera,
    and the centre's -1 outside.
    """
    _, height, width = cells.shape
    for slot in range(cameras.size):
        own = pixels[slot]
        u, v, w = project(views.projections, cameras[slot], voxel[0], voxel[1], voxel[2])
        reach = views.reach[cameras[slot]] / w
        own[0], own[1] = int(max(v - reach, 0.0)), int(min(v + reach + 1.0, height)) if w > 0 else 0
        own[2], own[3] = int(max(u - reach, 0.0)), int(min(u + reach + 1.0, width))
        inside = u >= 0 and v >= 0 and u < width and v < height
        own[4], own[5] = int(v) if inside else -1, int(u)


@kernel
def _centre_level(cells, camera, own):  # type: ignore[no-untyped-def]
    """Return the cell of a camera at a voxel's centre."""
    return cells[camera, own[4], own[5]] if own[4] >= 0 else np.uint8(UNCERTAIN)


@kernel
def mark_explained(views, cells, cameras, voting, voxels, vetoes, by_hull, by_own, pixels):  # type: ignore[no-untyped-def]
    """Mark in every camera's cells which hulls lie behind them.

    voting : number of cameras that vote, and must show a voxel. voxels (M, 3) : of the hulls of all voters, and of all
    but one. vetoes (M,) : the bits of the vetoing cameras; SKIPPED next to the floor. pixels (n, 6) : scratch memory.
    """
    (voters, needed), n = voting, cameras.size
    by_voters = (1 << voters) - 1
    by_hull[:n] = 0
    by_own[:n, :n] = 0
    for found in range(voxels.shape[0]):
        _project(views, cells, cameras, voxels[found], pixels)
        vetoes[found], vetoed, showing = SKIPPED, 0, 0
        for slot in range(n):
            level = _centre_level(cells, cameras[slot], pixels[slot])
            vetoed |= (level == BACKGROUND) << slot
            showing += level == FOREGROUND and slot < voters
        against = vetoed & by_voters
        next_to_floor = voxels[found, 2] < views.floor_layers
        if against & (against - 1) or (showing < needed if against == 0 else next_to_floor):
            continue
        vetoes[found] = 0 if next_to_floor else vetoed
        for image in range(n):
            if against:
                _mark(by_own[image, lowest_bit(np.uint64(against))], pixels[image])
                continue
            _mark(by_hull[image], pixels[image])
            for slot in range(voters, n):
                if not vetoes[found] >> slot & 1:
                    _mark(by_own[image, slot], pixels[image])


@kernel
def _mark(bits, own):  # type: ignore[no-untyped-def]
    """Set the bits (H, W / 64) of the cells that a voxel covers, as :func:`_project` wrote them."""
    if own[2] < own[3]:
        for row in range(own[0], own[1]):
            fill_bits(bits[row], own[2], own[3])


@kernel
def mark_denied(views, cells, cameras, slot, voxels, explained, denied, pixels):  # type: ignore[no-untyped-def]
    """Mark a camera's background cells (H, W) of the voxels that two others' foreground needs.

    voxels (M, 3) : those that it alone vetoes. explained (N, H, W / 64) : bits of the cells that the hull with its veto
    explains in each image.
    """
    for found in range(voxels.shape[0]):
        _project(views, cells, cameras, voxels[found], pixels)
        needed_by = 0
        for other in range(cameras.size):
            own = pixels[other]
            if other != slot and _centre_level(cells, cameras[other], own) == FOREGROUND:
                needed_by += explained[other, own[4], own[5] >> 6] >> np.uint64(own[5] & 63) & np.uint64(1) == 0
        if needed_by >= NEEDED_BY:
            own = pixels[slot]
            for row in range(own[0], own[1]):
                for column in range(own[2], own[3]):
                    denied[row, column] |= cells[cameras[slot], row, column] == BACKGROUND


@kernel
def count_explained(shown, cameras, voters, by_hull, by_own, explained, vetoed):  # type: ignore[no-untyped-def]
    """Count foreground cells (n, n) [image, camera whose veto is ignored]; shown (N, H, W / 64) : bits of them.

    explained : by the hull without that camera's veto. vetoed : of these, those that the hull with its veto leaves.
    """
    for image in range(cameras.size):
        for row in range(by_hull.shape[1]):
            for word in range(by_hull.shape[2]):
                hull, here = by_hull[image, row, word], shown[cameras[image], row, word]
                for slot in range(cameras.size):
                    own = by_own[image, slot, row, word]
                    lost = own & ~hull if slot < voters else hull & ~own
                    explained[image, slot] += popcount((hull | lost) & here)
                    vetoed[image, slot] += popcount(lost & here)
