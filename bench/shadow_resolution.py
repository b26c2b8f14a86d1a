"""Scores the resolution of floor shadows by all cameras: silhouettes and hulls against exact ones, row by row.

    python bench/shadow_resolution.py --quick      # about a minute: a few frames of each session
    python bench/shadow_resolution.py
    python bench/shadow_resolution.py --picture docs/images/shadow_resolution.jpg [--session FOLDER]

Sessions: the built-in studio, and the rendered ones of ../shared/data/sessions where they are. Each row segments the
same footage and carves at 20 mm; hulls are compared with the hull of the exact silhouettes, voxel by voxel, and again
below 25 cm ("feet"). miss and extra are shares of the exact hull's voxels. Rows:

candidates background : every camera for itself, outline untrimmed (the state before).
candidates person : the same, shadow candidates kept.
outline trimmed : every camera for itself, outline at half contrast.
resolved : by all cameras together, the default.
exact shadows : our masks (trimmed) without anything that is no body: the upper bound of any resolution.

The last line is JSON: feet_iou, feet_miss, feet_extra, hull_iou, mask_iou of the default row and their ``_before``;
resolve_per_carve : cost of the resolution as a share of the carve's, in the same run; png_bytes : a message.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from report import Table, execute, finish, parser

import cv2
import numpy as np
from scenes import shared_sessions

from camera_client.background.model import read_background
from camera_client.settings import BackgroundSettings, SilhouetteSettings
from camera_client.silhouettes.pipeline import SilhouettePipeline
from camera_client.sources.footage_reader import open_footage
from capture_rig import Rig
from capture_rig.session import Session, load_session
from hull_server.carve_backends import make_backend
from hull_server.floor_shadows.resolver import ShadowResolver
from hull_server.grid import VoxelGrid
from hull_server.level_stack import binary_mask
from hull_server.settings import ShadowSettings
from hull_server.views import RigViews, min_seeing
from sagoma_ros.mask_png import encode
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

VOXEL_M, FEET_M = 0.02, 0.25
DEFAULT, BEFORE = "resolved", "candidates background"
Masks = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant: images, untrimmed levels, levels, and exact masks (or none), by camera, masks on the canvas."""

    images: Masks
    untrimmed: Masks
    levels: Masks
    exact: Masks | None


class Scorer:
    """Carves and compares."""

    def __init__(self, rig: Rig) -> None:
        self.views, self.grid = RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, VOXEL_M)
        self.seeing = min_seeing(len(rig.names))
        self.resolver = ShadowResolver(self.views, rig.volume, ShadowSettings())
        self._backend = make_backend("cpu", self.views, self.grid).backend
        self._feet = int(np.ceil((FEET_M - self.grid.origin[2]) / VOXEL_M - 0.5))
        self.seconds: dict[str, list[float]] = {"carve": [], "resolve": []}

    def hull(self, masks: Masks) -> np.ndarray:
        begin = time.thread_time()
        volume = self._backend.carve(masks, self.seeing)
        self.seconds["carve"].append(time.thread_time() - begin)
        return volume.to_dense()

    def resolve(self, levels: Masks) -> Masks:
        begin = time.thread_time()
        masks = self.resolver.resolve(levels, self.seeing)
        self.seconds["resolve"].append(time.thread_time() - begin)
        return masks

    def counts(self, truth: np.ndarray, found: np.ndarray) -> list[int]:
        """Voxels in both, missing, extra; and again below FEET_M."""
        parts = [truth & found, truth & ~found, found & ~truth]
        return [int(p.sum()) for p in parts] + [int(p[..., : self._feet].sum()) for p in parts]

    def rows(self) -> dict[str, Callable[[Frame], Masks]]:
        return {
            BEFORE: lambda f: {n: binary_mask(m) for n, m in f.untrimmed.items()},
            "candidates person": lambda f: {n: np.where(m > 0, np.uint8(255), m) for n, m in f.untrimmed.items()},
            "outline trimmed": lambda f: {n: binary_mask(m) for n, m in f.levels.items()},
            DEFAULT: lambda f: self.resolve(f.levels),
            "exact shadows": lambda f: (
                {
                    n: cv2.bitwise_and(
                        np.where(m > 0, np.uint8(255), m), cv2.dilate(f.exact[n], np.ones((3, 3), np.uint8))
                    )
                    for n, m in f.levels.items()
                }
                if f.exact
                else {}
            ),
        }


def frames(session: Session, every: int) -> Iterator[Frame]:
    """Every n-th frame, segmented with and without the trimmed outline."""
    chains: dict[tuple[str, float], SilhouettePipeline] = {}
    cameras = session.rig.cameras
    channels = "mono" if session.masks else "colour"  # the rendered sessions are grey, the real footage is not
    readers = {c.name: open_footage(session.videos[c.name], channels) for c in cameras}
    exact = {c.name: open_footage(session.masks[c.name], "mono") for c in cameras} if session.masks else {}
    for k in range(10**6):
        images = {name: reader.read() for name, reader in readers.items()}
        truth = {name: reader.read() for name, reader in exact.items()}
        if any(image is None for image in (*images.values(), *truth.values())):
            break
        if k % every != every // 2:
            continue
        levels: dict[float, Masks] = {0.0: {}, SilhouetteSettings().outline_contrast: {}}
        for camera in cameras:
            for rim, masks in levels.items():
                if (camera.name, rim) not in chains:
                    shape = images[camera.name].shape
                    background = read_background(session.backgrounds[camera.name], shape, BackgroundSettings())
                    settings = SilhouetteSettings(outline_contrast=rim)
                    chains[camera.name, rim] = SilhouettePipeline(camera, background, settings)
                masks[camera.name] = chains[camera.name, rim].run(images[camera.name]).mask
        canvas = {c.name: c.undistorted_view() for c in cameras}
        shown = {n: np.where(m > 127, np.uint8(255), np.uint8(0)) for n, m in truth.items()}
        yield Frame(images, *levels.values(), {n: canvas[n].undistort_mask(m) for n, m in shown.items()} or None)
    for reader in (*readers.values(), *exact.values()):
        reader.close()


def mask_scores(found: Masks, exact: Masks) -> np.ndarray:
    """Mean IoU, precision and recall of the cameras."""
    rows = []
    for name, mask in found.items():
        both = np.count_nonzero(cv2.bitwise_and(mask, exact[name]))
        either = np.count_nonzero(cv2.bitwise_or(mask, exact[name]))
        rows.append(
            [both / max(either, 1), both / max(np.count_nonzero(mask), 1), both / max(np.count_nonzero(exact[name]), 1)]
        )
    return np.mean(rows, axis=0)


def score(
    name: str, session: Session, every: int, table: Table
) -> tuple[dict[str, dict[str, float]], Scorer, list[int]]:
    """Add the rows of one session; figures by row, the scorer with its times, and message sizes."""
    scorer, sizes = Scorer(session.rig), []
    counts: dict[str, list[list[int]]] = {row: [] for row in scorer.rows()}
    masks: dict[str, list[np.ndarray]] = {row: [] for row in scorer.rows()}
    for frame in frames(session, every):
        assert frame.exact is not None
        truth = scorer.hull(frame.exact)
        sizes += [len(encode(mask)) for mask in frame.levels.values()]
        for row, make in scorer.rows().items():
            found = make(frame)
            counts[row].append(scorer.counts(truth, scorer.hull(found)))
            masks[row].append(mask_scores(found, frame.exact))
    figures = {}
    for row in scorer.rows():
        iou, precision, recall = np.mean(masks[row], axis=0)
        both, miss, extra, feet, feet_miss, feet_extra = np.sum(counts[row], axis=0)
        figures[row] = {
            "mask_iou": iou,
            "precision": precision,
            "recall": recall,
            "hull_iou": both / (both + miss + extra),
            "hull_miss": miss / (both + miss),
            "hull_extra": extra / (both + miss),
            "feet_iou": feet / (feet + feet_miss + feet_extra),
            "feet_miss": feet_miss / (feet + feet_miss),
            "feet_extra": feet_extra / (feet + feet_miss),
        }
        table.row(name, row, *figures[row].values())
    return figures, scorer, sizes


def picture(session: Session, path: Path, index: int) -> None:
    """Levels above (orange candidate, white person, green to red attenuated), result below (green off, red on)."""
    scorer = Scorer(session.rig)
    frame = next(f for k, f in enumerate(frames(session, 15)) if k == index)
    binary, tiles = scorer.resolve(frame.levels), []
    for name, levels in frame.levels.items():
        image = frame.images[name]
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        grey = session.rig.camera(name).undistorted_view().undistort_image(grey)
        above = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        below = above.copy()
        dark = (levels > 127) & (levels < 255)
        above[(levels > 0) & (levels <= 127)], above[levels == 255] = (0, 160, 255), (255, 255, 255)
        degree = (levels[dark].astype(int) - 135) * 2
        above[dark] = np.stack([0 * degree, degree, 255 - degree], axis=1)
        below[binary[name] > 0] = (200, 200, 200)
        below[(binary[name] == 0) & (levels > 127)] = (0, 200, 0)
        below[(binary[name] > 0) & (levels <= 127)] = (0, 0, 255)
        tiles.append(np.vstack([_feet(panel, levels) for panel in (above, below)]))
    if not cv2.imwrite(str(path), np.hstack(tiles[:4])):
        raise SystemExit(f"{path} cannot be written")


def _feet(panel: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """The lower part of the person, twice as large."""
    rows, columns = np.nonzero(levels > 127)
    bottom, middle = min(rows.max() + 20, len(panel)), int(np.median(columns))
    top, left = max(bottom - 170, 0), min(max(middle - 120, 0), panel.shape[1] - 240)
    part = panel[top : top + 170, left : left + 240]
    return cv2.resize(part, (480, 340), interpolation=cv2.INTER_NEAREST)


def main() -> None:
    given = parser(__doc__, quick="fewer frames")
    given.add_argument("--picture", type=Path, metavar="FILE", help="only draw a picture")
    given.add_argument("--session", type=Path, metavar="FOLDER", help="the picture's session")
    given.add_argument("--frame", type=int, default=4, help="the picture's frame, in fifteenths")
    arguments = given.parse_args()
    if arguments.picture:
        picture(load_session(arguments.session), arguments.picture, arguments.frame)
        return
    result: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory(prefix="sagoma_bench_") as folder:
        write_session(Path(folder) / "studio", ring(5), Body.from_stature(1.75), fps=10, seconds=12)
        sessions = {"studio": load_session(Path(folder) / "studio"), **dict(shared_sessions())}
        heads = ("mask IoU", "precision", "recall", "hull IoU", "miss", "extra", "feet IoU", "feet miss", "feet extra")
        table = Table({"session": "<27", "row": "<22", **dict.fromkeys(heads, ">10.3f")})
        for name, session in sessions.items():
            every = (24 if name == "studio" else 60) if arguments.quick else (6 if name == "studio" else 15)
            figures, scorer, sizes = score(name, session, every, table)
            for key in ("feet_iou", "feet_miss", "feet_extra", "hull_iou", "mask_iou"):
                result.setdefault(key, {})[name] = round(float(figures[DEFAULT][key]), 3)
                result.setdefault(f"{key}_before", {})[name] = round(float(figures[BEFORE][key]), 3)
            times = {what: float(np.median(seconds)) for what, seconds in scorer.seconds.items()}
            result.setdefault("resolve_per_carve", {})[name] = round(times["resolve"] / times["carve"], 2)
            result.setdefault("png_bytes", {})[name] = round(float(np.mean(sizes)))
    finish(result)


if __name__ == "__main__":
    execute(main)
