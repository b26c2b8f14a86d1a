"""Contour rays: how near the rays of our own silhouettes run to the true outline, how well their sigma covers the
errors, and what they cost.

    python bench/contour_rays.py --quick       # about a minute: a few frames of each session
    python bench/contour_rays.py
    python bench/contour_rays.py --picture docs/images/contour_rays.jpg --session FOLDER [--frame N]

Rendered sessions (../shared/data/sessions): footage segmented as the camera client does, shadows resolved by all
cameras, carved at 20 mm. Each ray is projected back into its camera and compared with the exact silhouette there.

offset : median, px, outward positive. spread : 1.48 times the median distance from the outline, px. far : % of the rays
more than 3 px from it. covered : % of the rays within two sigma. clear, shadow : the same of the rays without and with
pixels around them that may be shadow. ms, slice : CPU time of a set's rays, and of slicing its hull in the same run,
medians.

The last line is JSON: rays, offset_px, spread_px, far_percent, covered_percent, contour_rays_ms, slice_ms, by session.
"""

from __future__ import annotations

import time
from pathlib import Path

from report import Table, execute, finish, parser

import cv2
import numpy as np
from scenes import shared_sessions
from shadow_resolution import VOXEL_M, Frame, Masks, frames

from capture_rig.session import Session, load_session
from hull_server.carve_backends import make_backend
from hull_server.contour_rays.contour_tracer import ContourTracer
from hull_server.floor_shadows.resolver import ShadowResolver
from hull_server.grid import VoxelGrid
from hull_server.settings import ContourSettings, ShadowSettings
from hull_server.slicing.skeletonisation import slice_hull
from hull_server.views import RigViews, min_seeing
from mocap_packets.hull import ContourRays

FAR_PX, CLEAR_PX = 3.0, 0.52  # a ray of a larger sigma has pixels around it that may be shadow
KEYS = ("rays", "offset_px", "spread_px", "far_percent", "covered_percent")
TILE_PX = (400, 600)


class Tracer:
    """From the silhouettes of a frame to its rays."""

    def __init__(self, session: Session) -> None:
        rig = session.rig
        self.views, self.grid = RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, VOXEL_M)
        self.seeing = min_seeing(len(rig.names))
        self._shadows = ShadowResolver(self.views, rig.volume, ShadowSettings())
        self._backend = make_backend("cpu", self.views, self.grid).backend
        self._rims = ContourTracer(self.views, self.grid, ContourSettings())
        self.ms: dict[str, list[float]] = {"slice": [], "contour_rays": []}

    def trace(self, levels: Masks) -> ContourRays:
        masks = self._shadows.resolve(levels, self.seeing)
        volume = self._backend.carve(masks, self.seeing)
        begin = time.thread_time()
        runs = slice_hull(volume).runs
        between = time.thread_time()
        rays = self._rims.trace(masks, runs, levels)
        self.ms["slice"].append((between - begin) * 1e3)
        self.ms["contour_rays"].append((time.thread_time() - between) * 1e3)
        return rays

    def pixels(self, rays: ContourRays, along_normal_m: np.ndarray | float = 0.0) -> np.ndarray:
        """(n, 2) where the rays are in their cameras' canvases, moved along their normals in the world."""
        P, points_world = (
            self.views.P[rays.camera],
            rays.points_world + np.reshape(along_normal_m, (-1, 1)) * rays.normals,
        )
        u, v, depth = (np.einsum("nij,nj->ni", P[:, :, :3], points_world) + P[:, :, 3]).T
        return np.stack([u, v], axis=1) / depth[:, None]

    def sigma_px(self, rays: ContourRays) -> np.ndarray:
        """(n,) the rays' sigma in pixels."""
        return np.linalg.norm(self.pixels(rays, rays.sigma) - self.pixels(rays), axis=1)


def offsets(pixels: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """(n,) signed distance of pixels from the outline of an exact silhouette, outward positive."""
    outside = cv2.distanceTransform(np.where(exact > 0, np.uint8(0), np.uint8(1)), cv2.DIST_L2, 5)
    inside = cv2.distanceTransform(np.where(exact > 0, np.uint8(1), np.uint8(0)), cv2.DIST_L2, 5)
    signed = np.where(exact > 0, 0.5 - inside, outside - 0.5).astype(np.float32)
    u, v = np.ascontiguousarray(pixels.astype(np.float32).T)[:, :, None]
    return np.asarray(cv2.remap(signed, u, v, cv2.INTER_LINEAR)).reshape(-1)


def score(name: str, session: Session, every: int, table: Table) -> dict[str, float]:
    """Add the rows of one session; its figures."""
    tracer, columns, sets = Tracer(session), [], 0
    for frame in frames(session, every):
        assert frame.exact is not None
        rays = tracer.trace(frame.levels)
        pixels, sigma_px = tracer.pixels(rays), tracer.sigma_px(rays)
        for index, camera in enumerate(session.rig.names):
            mine = rays.camera == index
            if mine.any():
                columns.append(np.column_stack([offsets(pixels[mine], frame.exact[camera]), sigma_px[mine]]))
        sets += 1
    distance, sigma = np.concatenate(columns).T
    rows = {"all": sigma > 0, "clear": sigma < CLEAR_PX, "shadow": sigma >= CLEAR_PX}
    figures = {row: _figures(distance[chosen], sigma[chosen], sets) for row, chosen in rows.items()}
    for row, values in figures.items():
        table.row(name, row, *values.values())
    times = {f"{stage}_ms": float(np.median(ms)) for stage, ms in tracer.ms.items()}
    print(f"{name:<27} rays {times['contour_rays_ms']:.2f} ms, slice {times['slice_ms']:.2f} ms")
    return figures["all"] | times


def _figures(distance_px: np.ndarray, sigma_px: np.ndarray, sets: int) -> dict[str, float]:
    away = np.abs(distance_px)
    values = (
        len(away) / sets,
        np.median(distance_px),
        1.48 * np.median(away),
        100 * np.mean(away > FAR_PX),
        100 * np.mean(away < 2 * sigma_px),
    )
    return dict(zip(KEYS, (float(value) for value in values), strict=True))


def picture(session: Session, path: Path, index: int) -> None:
    """The person in three views: silhouette, and a dash along each ray's normal; rays in shadow in orange."""
    tracer = Tracer(session)
    frame = next(f for k, f in enumerate(frames(session, 15)) if k == index)
    rays = tracer.trace(frame.levels)
    ends = np.stack([tracer.pixels(rays), tracer.pixels(rays, 0.04)], axis=1)
    in_shadow = tracer.sigma_px(rays) >= CLEAR_PX
    tiles = []
    for camera, name in list(enumerate(session.rig.names))[:3]:
        mine = rays.camera == camera
        tiles.append(_tile(session, frame, name, ends[mine], in_shadow[mine]))
    if not cv2.imwrite(str(path), np.hstack(tiles)):
        raise SystemExit(f"{path} cannot be written")


def _tile(session: Session, frame: Frame, name: str, ends: np.ndarray, in_shadow: np.ndarray) -> np.ndarray:
    """The surroundings of the rays of one view, large."""
    image = frame.images[name]
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    canvas = cv2.cvtColor(session.rig.camera(name).undistorted_view().undistort_image(grey), cv2.COLOR_GRAY2BGR)
    canvas[frame.levels[name] > 127] = canvas[frame.levels[name] > 127] // 2 + 110
    low, high = ends[:, 0].min(axis=0), ends[:, 0].max(axis=0)
    zoom = TILE_PX[1] * 0.92 / max(high[1] - low[1], (high[0] - low[0]) * TILE_PX[1] / TILE_PX[0])
    shift = np.array(TILE_PX) / 2 - zoom * (low + high) / 2
    tile = cv2.warpAffine(canvas, np.array([[zoom, 0, shift[0]], [0, zoom, shift[1]]]), TILE_PX)
    for (start, end), dark in zip(ends * zoom + shift, in_shadow, strict=True):
        colour = (0, 140, 255) if dark else (80, 220, 0)
        foot, tip = (np.rint(p).astype(int).tolist() for p in (start, end))
        cv2.line(tile, foot, tip, colour, 1, cv2.LINE_AA)
        cv2.circle(tile, foot, 2, colour, -1, cv2.LINE_AA)
    return np.asarray(tile)


def main() -> None:
    given = parser(__doc__, quick="fewer frames")
    given.add_argument("--picture", type=Path, metavar="FILE", help="only draw a picture")
    given.add_argument("--session", type=Path, metavar="FOLDER", help="the picture's session")
    given.add_argument("--frame", type=int, default=8, help="the picture's frame, in fifteenths")
    arguments = given.parse_args()
    if arguments.picture:
        picture(load_session(arguments.session), arguments.picture, arguments.frame)
        return
    heads = ("rays", "offset px", "spread px", "far %", "covered %")
    table = Table({"session": "<27", "pixels": "<10", **dict.fromkeys(heads, ">10.2f")})
    result: dict[str, dict[str, float]] = {}
    for name, session in shared_sessions():
        for key, value in score(name, session, 60 if arguments.quick else 15, table).items():
            result.setdefault(key, {})[name] = round(value, 2)
    finish(result)


if __name__ == "__main__":
    execute(main)
