"""One frame set's evidence against each camera: what does it deny that the others agree on?

Silhouettes of one body agree when the hull that they make together, seen from each camera, covers each silhouette
(silhouette coherence: Hernandez, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular
motion", PAMI 2007). A camera that lies takes parts of the body away from everybody's hull, and the other silhouettes
are covered again as soon as its veto is ignored. A camera that tells the truth takes nothing away but ghosts, which
hide behind and before the body in the other pictures. So the volume that a camera alone vetoes says little (three
honest cameras veto a half and more of the hulls of the other two), but the pictures tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from capture_rig import Rig

from ..carving.pixel_boxes import block_boxes, pixel_projections, summed_area
from ..grid import VoxelGrid
from ..views import RigViews, min_seeing
from .residual_kernels import (
    BACKGROUND_CELL,
    COARSE_EDGE,
    FINE_EDGE,
    TOO_MANY,
    UNSEEN_CELL,
    Question,
    Room,
    count_cells,
    explain,
    find_shared,
    number_cells,
    project,
)

# --- How far one camera's silhouette lies beside the hull of the others: the sign of a camera that was moved.
#
# A silhouette lies inside the outline of the hull that the others make. When the camera has turned by a degree or two it
# sticks out on one side, and it fits again when it is pushed back: by how many pixels, and how much better? What sticks
# out for other reasons, such as a shadow on the floor, is not cured by pushing.

REACH = 8  # cells, in each direction, by which a silhouette is pushed at most
CLEAR = 0.01  # a gain smaller than this says nothing about where to


@dataclass(frozen=True)
class Misfit:
    """share : of a silhouette, that comes to lie inside the hull's outline when it is pushed to where it fits best.

    silhouette_offset_px : by how many pixels to the right and down; (0, 0) when nothing is gained.
    """

    share: float = 0.0
    silhouette_offset_px: tuple[float, float] = (0.0, 0.0)


def find_misfit(
    room: Room, labels: npt.NDArray[np.int32], camera: int, voxels: npt.NDArray[np.int16], stride: int
) -> Misfit:
    """Push the silhouette of ``camera``, labelled (H, W), over the outline of the ``voxels`` (M, 3) of the hull."""
    height, width = labels.shape
    outline = np.zeros((height + 2 * REACH, width + 2 * REACH), np.uint8)
    _draw(room, camera, voxels, outline)
    outside = np.zeros((2 * REACH + 1, 2 * REACH + 1), np.int64)
    size = room.sizes[camera]
    cells = _push(labels, int(size[0]), int(size[1]), outline, outside)
    share = (outside[REACH, REACH] - outside.min()) / max(cells, 1)
    if share < CLEAR:
        return Misfit()
    down, right = np.nonzero(outside == outside.min())
    nearest = np.argmin(np.hypot(down - REACH, right - REACH))
    return Misfit(float(share), (float(right[nearest] - REACH) * stride, float(down[nearest] - REACH) * stride))


@njit(cache=True, nogil=True)
def _draw(room, camera, voxels, outline):  # type: ignore[no-untyped-def]
    """Set the cells of ``outline``, which has a margin of REACH, that the voxels' pictures touch."""
    width, height = room.sizes[camera, 0], room.sizes[camera, 1]
    for found in range(voxels.shape[0]):
        u, v, w = project(room.projections, camera, voxels[found, 0], voxels[found, 1], voxels[found, 2])
        if w > 0:
            reach = room.reach[camera] / w
            for row in range(int(max(v - reach, 0.0)), int(min(v + reach + 1.0, height))):
                for column in range(int(max(u - reach, 0.0)), int(min(u + reach + 1.0, width))):
                    outline[row + REACH, column + REACH] = 1


@njit(cache=True, nogil=True)
def _push(labels, width, height, outline, outside):  # type: ignore[no-untyped-def]
    """Count the foreground cells that lie outside the outline after each push; return the number of all."""
    cells, pushes = 0, outside.shape[0]
    for row in range(height):
        for column in range(width):
            if labels[row, column] > BACKGROUND_CELL:
                cells += 1
                for down in range(pushes):
                    for right in range(pushes):
                        outside[down, right] += 1 - np.int64(outline[row + down, column + right])
    return cells


MAX_SHARED_VOXELS = 1 << 15  # two cubic metres of 40 mm voxels: more is not a body
LOW_M = 0.15  # floor shadows make hulls up to this height: so low, a veto tells nothing


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one frame set says about each camera heard. Arrays are in the order of ``cameras``, the panel first.

    cameras : indices in the rig. panel : how many of them have a veto.
    denied : (n,) share of the body that a camera denies: of the foreground in the panel's other pictures that the
        hull without its veto explains, the part that the veto leaves unexplained. 0 to 1.
    body_litres : (n,) the hull without this camera's veto. explained_m2 : (n,) how much of this camera's foreground it
        explains, as an area at the distance of the volume's middle.
    excess : (n,) share of the camera's view that is foreground which that hull does not explain.
    coverage : (n,) share of the camera's view that is foreground.
    covered : (n,) share of the camera's foreground that the hull without its veto explains (silhouette coherence); 1
        where it shows nothing.
    conflict : (n,) share of the panel's other foreground that stays unexplained without this camera's veto.
    unexplained : share of the panel's foreground that its common hull leaves unexplained. showing : how many cameras
        of the panel show any foreground.
    """

    cameras: tuple[int, ...]
    panel: int
    denied: npt.NDArray[np.float64]
    body_litres: npt.NDArray[np.float64]
    explained_m2: npt.NDArray[np.float64]
    excess: npt.NDArray[np.float64]
    coverage: npt.NDArray[np.float64]
    covered: npt.NDArray[np.float64]
    conflict: npt.NDArray[np.float64]
    unexplained: float
    showing: int


class Hearing:
    """Finds the evidence of frame sets on a coarse grid; what depends on the calibration is computed once, here.

    Not for two threads at a time.
    """

    def __init__(self, rig: Rig, views: RigViews, voxel_size_m: float, requested_seeing: int = 0) -> None:
        self.names, self._requested_seeing = views.names, requested_seeing
        self.grid = VoxelGrid.covering(rig.volume, voxel_size_m)
        self._voxel_litres = self.grid.voxel_volume_m3 * 1e3
        px_per_m = _focal_px(views) / _depth_of_middle(views, self.grid)
        # a cell is about half as large as the picture of a voxel
        self._stride = max(1, round(float(np.median(px_per_m)) * voxel_size_m / 2))
        self._cell_m2 = (self._stride / px_per_m) ** 2
        self.focal_px = _focal_px(views)
        cells = _decimated(views, self._stride)
        self._room = _room(cells, self.grid)
        self._cells_seen = np.maximum(np.count_nonzero(cells.seen, axis=(1, 2)), 1)
        n, height, width = cells.seen.shape
        self._seen, self._shown = cells.seen, np.zeros_like(cells.seen)
        self._unshown = np.where(cells.seen > 0, BACKGROUND_CELL, UNSEEN_CELL).astype(np.int32)
        self._labels = self._unshown.copy()
        self._tables = np.zeros((n, height + 1, width + 1), np.int32)
        self._voxels = np.empty((MAX_SHARED_VOXELS, 3), np.int16)
        self._vetoes = np.empty(MAX_SHARED_VOXELS, np.int64)
        self._obeyed, self._ignored = (np.zeros((n, height * width), np.int64) for _ in range(2))
        self._counts = np.zeros(n, np.int64)
        self._found = 0

    def open(self, camera: int, mask: npt.NDArray[np.uint8]) -> int:
        """Take one camera's mask; return a number that differs when another mask is seen."""
        first = self._stride // 2
        height, width = self._room.sizes[camera, 1], self._room.sizes[camera, 0]
        shown, labels = self._shown[camera, :height, :width], self._labels[camera, :height, :width]
        np.bitwise_and(mask[first :: self._stride, first :: self._stride], self._seen[camera, :height, :width], shown)
        np.copyto(labels, self._unshown[camera, :height, :width])
        left, top, across, down = cv2.boundingRect(shown)
        box = (left, top, left + across, top + down)
        table = self._tables[camera, : height + 1, : width + 1]
        self._counts[camera], fingerprint = number_cells(shown, box, labels, table)
        return int(fingerprint)

    def coverage(self, camera: int) -> float:
        """Share of the camera's view that is foreground."""
        return float(self._counts[camera] / self._cells_seen[camera])

    def hear(self, panel: tuple[int, ...], others: tuple[int, ...]) -> Evidence | None:
        """The evidence against the cameras of the ``panel``, which have a veto, and the ``others``, which have none.

        None when so much is foreground that it cannot be told (more than two cubic metres).
        """
        cameras = np.array(panel + others, np.int64)
        needed, without = (min_seeing(len(panel) - k, self._requested_seeing) for k in (0, 1))
        question = Question(cameras, len(panel), needed, without)
        # the voxels that at most one camera of the panel vetoes
        found = find_shared(self._room, self._labels, self._tables, question, self._voxels, self._vetoes)
        if found == TOO_MANY:
            return None
        self._found, voxels, vetoes = found, self._voxels[:found], self._vetoes[:found]
        # what they explain in each picture, each camera's veto obeyed and ignored
        cells, n = self._counts[cameras], len(cameras)
        for slot, filled in enumerate(cells):
            self._obeyed[slot, :filled] = 0
            self._ignored[slot, :filled] = 0
        explain(self._room, self._labels, question, voxels, vetoes, self._obeyed, self._ignored)
        explained, denied = np.zeros((n, n), np.int64), np.zeros((n, n), np.int64)
        count_cells(cells, self._obeyed, self._ignored, explained, denied)
        return self._weigh(question, vetoes, cells, explained, denied)

    def misfit(self, evidence: Evidence, slot: int) -> Misfit:
        """Of the camera ``evidence.cameras[slot]``, to the hull without its veto; of the last hearing."""
        camera = evidence.cameras[slot]
        on_panel = self._vetoes[: self._found] & (1 << evidence.panel) - 1
        hull = self._voxels[: self._found][(on_panel & ~(1 << slot)) == 0]
        return find_misfit(self._room, self._labels[camera], camera, hull, self._stride)

    def _weigh(self, question: Question, vetoes, cells, explained, denied) -> Evidence:  # type: ignore[no-untyped-def]
        """Counts to shares. A picture has a say about every camera but its own, and only when it is on the panel."""
        n, panel, cameras = len(cells), question.panel, question.cameras
        say = (np.arange(n)[:, None] < panel) & ~np.eye(n, dtype=bool)
        theirs = (explained * say).sum(0)
        own = np.diagonal(explained)
        on_panel = vetoes & (1 << panel) - 1
        agreed = int(np.count_nonzero(on_panel == 0))
        alone = np.array([np.count_nonzero(on_panel == 1 << slot) if slot < panel else 0 for slot in range(n)])
        return Evidence(
            cameras=tuple(cameras.tolist()),
            panel=panel,
            denied=(denied * say).sum(0) / np.maximum(theirs, 1),
            body_litres=(agreed + alone) * self._voxel_litres,
            explained_m2=own * self._cell_m2[cameras],
            excess=(cells - own) / self._cells_seen[cameras],
            coverage=cells / self._cells_seen[cameras],
            covered=np.where(cells > 0, own / np.maximum(cells, 1), 1.0),
            conflict=1.0 - theirs / np.maximum((cells[:, None] * say).sum(0), 1),
            unexplained=1.0 - float((own - np.diagonal(denied))[:panel].sum() / max(int(cells[:panel].sum()), 1)),
            showing=int(np.count_nonzero(cells[:panel])),
        )


def _room(cells: RigViews, grid: VoxelGrid) -> Room:
    seen_table = summed_area(cells.seen)
    coarse, fine = (block_boxes(cells, grid, edge, seen_table) for edge in (COARSE_EDGE, FINE_EDGE))
    return Room(
        projections=pixel_projections(cells, grid),
        sizes=cells.sizes,
        shape=np.array(grid.shape, np.int64),
        low_layers=max(0, int(np.ceil((LOW_M - grid.origin[2]) / grid.voxel_size))),
        coarse=coarse,
        fine=fine,
        reach=_focal_px(cells) * grid.voxel_size / 2,
    )


def _focal_px(views: RigViews) -> npt.NDArray[np.float64]:
    """(N,) focal lengths in pixels: what a projection's first row has across the view."""
    M = views.P[:, :, :3]
    along = np.einsum("nk,nk->n", M[:, 0], M[:, 2])
    return np.sqrt(np.einsum("nk,nk->n", M[:, 0], M[:, 0]) - along**2)


def _depth_of_middle(views: RigViews, grid: VoxelGrid) -> npt.NDArray[np.float64]:
    """(N,) depth of the volume's middle in front of each camera, metres; at least half a metre."""
    middle = np.append(grid.centres_world(np.array(grid.shape) / 2 - 0.5), 1.0)
    return np.maximum(views.P[:, 2] @ middle, 0.5)


def _decimated(views: RigViews, stride: int) -> RigViews:
    """The views of every ``stride``-th pixel, from pixel stride // 2 on."""
    first = stride // 2
    P = views.P.copy()
    P[:, :2] -= first * P[:, 2:]
    P[:, :2] /= stride
    sizes = (views.sizes - first + stride - 1) // stride
    return RigViews(views.names, P, sizes, np.ascontiguousarray(views.seen[:, first::stride, first::stride]))
