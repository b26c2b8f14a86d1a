"""Measures how far each camera's silhouette disagrees with the hull of the others, on a coarse voxel grid.

Silhouettes of one body agree when the hull that they make together, seen from each camera, covers each silhouette
(silhouette coherence: Hernandez, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular
motion", PAMI 2007). A faulty camera removes parts of the body from the hull, and the other silhouettes are covered
again as soon as its veto is ignored. A sound camera removes nothing but phantom volume, which hides behind and in front
of the body in the other images. So the volume that one camera alone vetoes says little (three sound cameras veto half
and more of each other's hulls), but the images show the difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig import Rig

from ..carving.carve_blocks import voxel_steps
from ..carving.pixel_boxes import block_boxes, pixel_projections, summed_area
from ..grid import VoxelGrid
from ..views import RigViews, min_seeing
from .residual_kernels import (
    BACKGROUND_CELL,
    COARSE_EDGE,
    FINE_EDGE,
    TOO_MANY,
    UNSEEN_CELL,
    CoarseViews,
    VotingSet,
    Work,
    count_explained,
    find_shared_voxels,
    mark_denied,
    mark_explained,
    number_cells,
)

# Thresholds: measured by python bench/camera_faults.py.
MAX_SHARED_VOXELS = 1 << 15  # two cubic metres of 40 mm voxels: more is not a body
FLOOR_M = 0.15  # floor shadows make hulls up to this height, so vetoes below are ignored

Floats = npt.NDArray[np.float64]


class CameraResiduals(NamedTuple):
    """One camera's residuals of a frame set; see :class:`Residuals`."""

    veto_fraction: float = 0.0
    excess: float = 0.0
    coverage: float = 0.0
    consistency: float = 1.0

    def moved(self, target: CameraResiduals, share: float) -> CameraResiduals:
        """Return the residuals moved by ``share`` of the way to ``target``: one step of a running mean."""
        return CameraResiduals(*(old + share * (new - old) for old, new in zip(self, target, strict=True)))


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of one frame set. Arrays (n,) are in the order of ``cameras``, the voters first.

    cameras : indices in the rig. voters : how many of them can veto.
    veto_fraction : share of the body that a camera vetoes: of the foreground in the voters' other images that the hull
        without its veto explains, the part that the veto leaves unexplained. 0 to 1.
    body_litres : volume of the hull without this camera's veto. explained_m2 : how much of this camera's foreground it
        explains, as an area at the distance of the volume's middle.
    excess : share of the camera's view that is foreground which that hull does not explain.
    coverage : share of the camera's view that is foreground. explained_share : of it, what that hull explains.
    consistency : share of the camera's foreground that the hull without its veto explains (silhouette coherence; 1
        where it shows nothing), times the share of the body that it does not veto.
    unexplained : share of the voters' foreground that their common hull leaves unexplained.
    """

    cameras: tuple[int, ...]
    voters: int
    veto_fraction: Floats
    body_litres: Floats
    explained_m2: Floats
    excess: Floats
    coverage: Floats
    explained_share: Floats
    consistency: Floats
    unexplained: float

    def of(self, slot: int) -> CameraResiduals:
        """Return those of the camera ``cameras[slot]``."""
        shares = self.veto_fraction, self.excess, self.coverage, self.consistency
        return CameraResiduals(*(float(share[slot]) for share in shares))


class ResidualEstimator:
    """Estimates the residuals of frame sets; tables of the calibration are computed once. One thread at a time."""

    def __init__(self, rig: Rig, views: RigViews, voxel_size_m: float, requested_seeing: int = 0) -> None:
        self._requested_seeing = requested_seeing
        grid = VoxelGrid.covering(rig.volume, voxel_size_m)
        self._voxel_litres = grid.voxel_volume_m3 * 1e3
        px_per_m = _focal_px(views) / _depth_of_middle(views, grid)
        # a cell is about half as large as a voxel in the image
        self.stride = max(1, round(float(np.median(px_per_m)) * voxel_size_m / 2))
        self._cell_m2 = (self.stride / px_per_m) ** 2
        cells = _decimated(views, self.stride)
        self._views = _coarse_views(cells, grid)
        self._cells_seen = np.maximum(np.count_nonzero(cells.seen, axis=(1, 2)), 1)
        n, height, width = cells.seen.shape
        unshown = np.full((n, height + 1, width), UNSEEN_CELL, np.int32)  # a row more, for all that is outside
        unshown[:, :-1][cells.seen > 0] = BACKGROUND_CELL
        self.labels = unshown.copy()
        self._work = Work(np.empty(64, np.int32), np.empty(n, np.uint64))
        self._tables = np.zeros((n, height + 1, width + 1), np.int32)
        self._boxes = np.zeros((n, 4), np.int64)
        self._cells = [
            (cells.seen[c, :h, :w], unshown[c, :h, :w], self.labels[c, :h, :w], self._tables[c, : h + 1, : w + 1])
            for c, (w, h) in enumerate(cells.sizes.tolist())
        ]
        self._voxels = np.empty((MAX_SHARED_VOXELS, 3), np.int16)
        self._vetoes = np.empty(MAX_SHARED_VOXELS, np.int64)
        self._with_veto, self._without_veto = (np.zeros((n, height * width), np.int64) for _ in range(2))
        self._counts = np.zeros(n, np.int64)
        self._found = 0

    def set_mask(self, camera: int, mask: npt.NDArray[np.uint8]) -> None:
        """Set one camera's mask (h, w)."""
        mask = np.ascontiguousarray(mask)
        words, cells, box = mask.view(np.uint64), self._cells[camera], self._boxes[camera]
        self._counts[camera] = number_cells(mask, words, self.stride, cells, box)

    def coverage(self, camera: int) -> float:
        """Return the share of the camera's view that is foreground."""
        return float(self._counts[camera] / self._cells_seen[camera])

    def estimate(self, voters: tuple[int, ...], others: tuple[int, ...]) -> Residuals | None:
        """Estimate the residuals of the ``voters``, which can veto, and of the ``others``, which cannot.

        None when too much is foreground: more than two cubic metres.
        """
        cameras = np.array(voters + others, np.int64)
        needed, without = (min_seeing(len(voters) - k, self._requested_seeing) for k in (0, 1))
        voting = VotingSet(cameras, len(voters), needed, without)
        # the voxels that at most one voter vetoes
        labels = self.labels.reshape(len(self.labels), -1)
        shared = self._voxels, self._vetoes
        found = find_shared_voxels(self._views, labels, self._tables, voting, *shared, self._work)
        if found == TOO_MANY:
            return None
        self._found, voxels, vetoes = found, self._voxels[:found], self._vetoes[:found]
        # the foreground that they explain in each image, with and without each camera's veto
        cells, n = self._counts[cameras], len(cameras)
        for slot, filled in enumerate(cells):
            self._with_veto[slot, :filled] = 0
            self._without_veto[slot, :filled] = 0
        mark_explained(self._views, self.labels, voting, voxels, vetoes, self._with_veto, self._without_veto)
        explained, vetoed = np.zeros((n, n), np.int64), np.zeros((n, n), np.int64)
        count_explained(cells, self._with_veto, self._without_veto, explained, vetoed)
        return self._shares(voting, vetoes, cells, explained, vetoed)

    def denied_cells(self, residuals: Residuals, slot: int) -> npt.NDArray[np.bool_]:
        """Return the cells (H, W) in which ``residuals.cameras[slot]`` alone denies what two others need.

        Need: the volume there explains foreground of theirs that nothing else explains. The hull is that of the last
        call of :meth:`estimate`.
        """
        voting = VotingSet(np.array(residuals.cameras, np.int64), residuals.voters, 0, 0)
        denied = np.zeros(self.labels.shape[1:], np.bool_)
        found = self._voxels[: self._found], self._vetoes[: self._found]
        mark_denied(self._views, self.labels, voting, slot, *found, self._with_veto, denied)
        return denied

    def _shares(self, voting: VotingSet, vetoes, cells, explained, vetoed) -> Residuals:  # type: ignore[no-untyped-def]
        """Convert counts to shares. A camera is compared with the images of the voters other than itself."""
        n, voters, cameras = len(cells), voting.voters, voting.cameras
        compared = (np.arange(n)[:, None] < voters) & ~np.eye(n, dtype=bool)
        theirs, own = (explained * compared).sum(0), np.diagonal(explained)
        by_voters = vetoes & (1 << voters) - 1
        agreed = int(np.count_nonzero(by_voters == 0))
        alone = np.array([np.count_nonzero(by_voters == 1 << slot) if slot < voters else 0 for slot in range(n)])
        veto_fraction = (vetoed * compared).sum(0) / np.maximum(theirs, 1)
        return Residuals(
            cameras=tuple(cameras.tolist()),
            voters=voters,
            veto_fraction=veto_fraction,
            body_litres=(agreed + alone) * self._voxel_litres,
            explained_m2=own * self._cell_m2[cameras],
            excess=(cells - own) / self._cells_seen[cameras],
            coverage=cells / self._cells_seen[cameras],
            explained_share=own / np.maximum(cells, 1),
            consistency=np.where(cells > 0, own / np.maximum(cells, 1), 1.0) * (1.0 - veto_fraction),
            unexplained=1.0 - float((own - np.diagonal(vetoed))[:voters].sum() / max(int(cells[:voters].sum()), 1)),
        )


def _coarse_views(cells: RigViews, grid: VoxelGrid) -> CoarseViews:
    seen_table = summed_area(cells.seen)
    coarse, fine = (block_boxes(cells, grid, edge, seen_table) for edge in (COARSE_EDGE, FINE_EDGE))
    projections = pixel_projections(cells, grid)
    return CoarseViews(
        projections=projections,
        voxel_steps=voxel_steps(projections),
        sizes=cells.sizes,
        stride=cells.seen.shape[2],
        shape=np.array(grid.shape, np.int64),
        floor_layers=max(0, int(np.ceil((FLOOR_M - grid.origin[2]) / grid.voxel_size))),
        coarse=coarse,
        fine=fine,
        reach=_focal_px(cells) * grid.voxel_size / 2,
    )


def _focal_px(views: RigViews) -> Floats:
    """Return focal lengths (N,) in pixels: the part of a projection's first row across the optical axis."""
    M = views.P[:, :, :3]
    along = np.einsum("nk,nk->n", M[:, 0], M[:, 2])
    return np.sqrt(np.einsum("nk,nk->n", M[:, 0], M[:, 0]) - along**2)


def _depth_of_middle(views: RigViews, grid: VoxelGrid) -> Floats:
    """Return the depth (N,) of the volume's middle in front of each camera, metres; at least half a metre."""
    middle = np.append(grid.centres_world(np.array(grid.shape) / 2 - 0.5), 1.0)
    return np.maximum(views.P[:, 2] @ middle, 0.5)


def _decimated(views: RigViews, stride: int) -> RigViews:
    """Keep every ``stride``-th pixel of the views, from pixel stride // 2 on."""
    first = stride // 2
    P = views.P.copy()
    P[:, :2] -= first * P[:, 2:]
    P[:, :2] /= stride
    sizes = (views.sizes - first + stride - 1) // stride
    return RigViews(views.names, P, sizes, np.ascontiguousarray(views.seen[:, first::stride, first::stride]))
