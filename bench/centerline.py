"""Measures the centerline: how near its points lie to the true axes of the limbs, and how much of the limbs they cover.

    python bench/centerline.py --quick      # under a minute
    python bench/centerline.py              # all poses, rigs, sessions and voxel sizes
    python bench/centerline.py --picture docs/images/centerline.png

Built-in body: the virtual studio's person in seven poses, each from several sides, exact silhouettes, 5 cameras and one
on the ceiling, and 7 and one on the ceiling; the true axes are the sticks that the body is modelled on. Rendered
sessions (../shared/data/sessions, where they are): every 15th frame, with their exact masks and with ours, segmented
from the videos; the true axes are the bones of truth.csv, which do not run in the middle of the flesh: `centred` are
the same figures after each limb's mean offset, in a frame that turns with the limb, is taken away.

mean : mm, distance of the centerline points to the nearest axis. outliers : % of points farther than 60 mm.
coverage : % of the limbs' axes, sampled every 20 mm, with a point within 50 mm. points : per frame.
ratio : rms of the points' centred distance, outliers apart, over sigma, per direction across the limb; 1 is right.

The last line is JSON: mean_mm, outliers_percent, coverage_percent, by scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from report import Table, execute, finish, parser

import numpy as np
from centerline_scenes import LIMBS, Frame, Scenes, built_in, rendered
from scenes import shared_sessions
from scipy.spatial import cKDTree

from hull_server.grid import BrickVolume
from hull_server.settings import BlobSettings
from hull_server.slicing.skeletonisation import BlobTable, Centerline, find_centerline, slice_hull

OUTLIER_M, COVERED_M = 0.060, 0.050

NO_RULE = BlobSettings(min_area_m2=0.0, max_elongation=1e9, min_fill=0.0, max_growth=0.0)
THESIS = replace(NO_RULE, min_area_m2=0.002, max_elongation=2.0)
RULES = {
    "every blob": NO_RULE,
    "thesis: area >= 20 cm2, elongation <= 2": THESIS,
    "  and fill >= 0.9": replace(THESIS, min_fill=0.9),
    "    and eroded by a voxel": replace(THESIS, min_fill=0.9, erosion_voxels=1),
    "    and growth <= 3": replace(THESIS, min_fill=0.9, max_growth=3.0),
    "    elongation <= 3 instead": replace(THESIS, min_fill=0.9, max_elongation=3.0),
    "all four, elongation <= 3 (default)": BlobSettings(),
    "  without fill": BlobSettings(min_fill=0.0),
    "  fill >= 0.85": BlobSettings(min_fill=0.85),
    "  growth <= 1.5": BlobSettings(max_growth=1.5),
    "  growth over 40 mm": BlobSettings(growth_step_m=0.04),
    "  area >= 10 cm2": BlobSettings(min_area_m2=0.001),
}


# --- scores ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Score:
    """What a rule finds in some frames.

    distance, offset, sigma : of the n points, metres; offset (n, 3) across the limb, in a frame that turns with it.
    limb : (n,) name of the nearest limb. centred : (n,) distance after the limb's mean offset is taken away.
    covered, centred_covered : (s,) of the samples of the limbs' axes, as they are and moved by the limb's mean offset.
    sample_limb : (s,) names. frames : how many.
    """

    distance: np.ndarray
    centred: np.ndarray
    sigma: np.ndarray
    limb: np.ndarray
    covered: np.ndarray
    centred_covered: np.ndarray
    sample_limb: np.ndarray
    frames: int

    @property
    def figures(self) -> tuple[float, float, float]:
        """Mean in mm, outliers in %, coverage in %."""
        return _figures(self.distance, self.covered)

    @property
    def centred_figures(self) -> tuple[float, float, float]:
        return _figures(self.centred, self.centred_covered)

    @property
    def ratio(self) -> float:
        """Root mean square of centred distance over sigma per direction across the limb; outliers are not counted."""
        good = self.centred <= OUTLIER_M
        return float(np.sqrt((self.centred[good] ** 2 / self.sigma[good] ** 2).mean() / 2))

    def by_limb(self) -> Iterator[str]:
        for limb in LIMBS:
            mine = self.limb == limb
            mean = 1e3 * self.distance[mine].mean() if mine.any() else np.nan
            yield f"{mean:5.1f}/{100 * self.covered[self.sample_limb == limb].mean():3.0f}"


def _figures(distance: np.ndarray, covered: np.ndarray) -> tuple[float, float, float]:
    return 1e3 * float(distance.mean()), 100 * float((distance > OUTLIER_M).mean()), 100 * float(covered.mean())


def score(frames: list[Frame], filters: BlobSettings) -> Score:
    lines = [centerline(frame.volume, filters) for frame in frames]
    found = [frame.axes.nearest(line.points_world) for frame, line in zip(frames, lines, strict=True)]
    keys = [_limbs(frame)[segment] for frame, (_, segment, _) in zip(frames, found, strict=True)]
    bias = _mean_offsets(np.concatenate(keys), np.concatenate([offset for _, _, offset in found]))
    columns = []
    for frame, line, (distance, segment, offset), key in zip(frames, lines, found, keys, strict=True):
        centred = np.linalg.norm(offset - np.array([bias[k] for k in key]).reshape(-1, 3), axis=1)
        samples, of_sample = frame.axes.samples()
        shift = np.array([bias.get(k, np.zeros(3)) for k in _limbs(frame)[of_sample]])
        moved = samples + np.einsum("nij,nj->ni", frame.axes.frames[of_sample], shift)
        covers = [_covered(line.points_world, places) for places in (samples, moved)]
        limb = frame.axes.limb
        columns.append((distance, centred, line.sigma, limb[segment], *covers, limb[of_sample]))
    names = ("distance", "centred", "sigma", "limb", "covered", "centred_covered", "sample_limb")
    whole = {name: np.concatenate(parts) for name, parts in zip(names, zip(*columns, strict=True), strict=True)}
    return Score(**whole, frames=len(frames))


def _limbs(frame: Frame) -> np.ndarray:
    """(k,) limb and side of each segment of the axes."""
    return np.char.add(frame.axes.side, frame.axes.limb)


def _mean_offsets(keys: np.ndarray, offsets: np.ndarray) -> dict[str, np.ndarray]:
    """Mean offset across each limb, outliers left out."""
    good = np.linalg.norm(offsets, axis=1) <= OUTLIER_M
    means = {}
    for key in np.unique(keys):
        mine = offsets[good & (keys == key)]
        means[str(key)] = mine.mean(axis=0) * [0, 1, 1] if len(mine) else np.zeros(3)
    return means


def _covered(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    return cKDTree(points).query(places)[0] < COVERED_M if len(points) else np.zeros(len(places), bool)


_TABLES: dict[tuple[BrickVolume, int, float], BlobTable] = {}


def centerline(volume: BrickVolume, filters: BlobSettings) -> Centerline:
    """The centerline of a hull; what all rules share is computed once."""
    key = volume, filters.erosion_voxels, filters.growth_step_m
    if key not in _TABLES:
        _TABLES[key] = slice_hull(volume, filters.erosion_voxels, filters.growth_step_m).blobs
    return find_centerline(_TABLES[key], volume.grid, filters)


def print_scenes(scenes: dict[str, Score], title: str = "") -> None:
    limbs = f"  by limb, mean / coverage: {', '.join(LIMBS)}"
    columns = {"mean / outliers / coverage": "<26", "": ">17", "centred": ">17", "ratio": ">5.2f", "points": ">6.0f"}
    table = Table({**columns, limbs: "<1"}, title)
    for name, s in scenes.items():
        found, centred = (" / ".join(f"{x:4.1f}" for x in figures) for figures in (s.figures, s.centred_figures))
        table.row(name, found, centred, s.ratio, len(s.distance) / s.frames, f"  {'  '.join(s.by_limb())}")


def print_rules(groups: Scenes) -> None:
    """The ablation: one row a rule, mean / outliers / coverage of each group of frames."""
    table = Table({"rule (mean mm / outliers % / coverage %)": "<40", **dict.fromkeys(groups, ">18")})
    for rule, filters in RULES.items():
        cells = [" / ".join(f"{x:4.1f}" for x in score(frames, filters).figures) for frames in groups.values()]
        table.row(rule, *cells)


def print_voxel_sizes(sizes_mm: tuple[int, ...]) -> None:
    scores = {
        f"{mm} mm": score([f for kind in built_in(6, mm / 1e3, 3).values() for f in kind], BlobSettings())
        for mm in sizes_mm
    }
    print_scenes(scores, "built-in body, 6 cameras, by voxel size")


# --- the picture -----------------------------------------------------------------------------------------------------


def draw(path: str) -> None:
    """One walking frame: all blobs, the thesis's filter, ours; the true sticks behind."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    frame = built_in(6, 0.02, 4)["raising arms"][1]
    figure, panels = plt.subplots(1, 3, figsize=(11, 4.3), sharey=True)
    chosen = {"every blob": NO_RULE, "area and elongation": THESIS, "with fill and growth": BlobSettings()}
    side = frame.axes.frames[0][:, 1]
    for panel, (title, filters) in zip(panels, chosen.items(), strict=True):
        line = centerline(frame.volume, filters)
        for start, end in zip(frame.axes.starts, frame.axes.ends, strict=True):
            panel.plot([start @ side, end @ side], [start[2], end[2]], color="0.8", lw=9, solid_capstyle="round")
        far = frame.axes.nearest(line.points_world)[0] > 0.03
        for axis, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
            mine = line.axis == axis
            panel.scatter(
                line.points_world[mine] @ side,
                line.points_world[mine, 2],
                s=9,
                color=colour,
                zorder=2,
                label=f"slices across {'xyz'[axis]}",
            )
        panel.set_title(f"{title}\n{len(line)} points, {far.sum()} farther than 30 mm", fontsize=9)
        panel.set_aspect("equal")
        panel.set_xlabel("to the left, m")
    panels[0].set_ylabel("up, m")
    panels[0].legend(fontsize=8, loc="lower left")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    print(f"wrote {path}")


def main() -> None:
    given = parser(__doc__, quick="fewer frames, one session, no voxel sizes")
    given.add_argument("--picture", metavar="PNG", help="draw the picture of docs/hull.md instead")
    arguments = given.parse_args()
    if arguments.picture:
        draw(arguments.picture)
        return
    groups: Scenes = {}
    scenes: dict[str, Score] = {}
    for cameras in (6, 8):
        kinds = built_in(cameras, 0.02, 2 if arguments.quick else 6)
        scenes |= {f"{cameras} cameras, {kind}": score(frames, BlobSettings()) for kind, frames in kinds.items()}
        groups[f"{cameras} cameras"] = [frame for frames in kinds.values() for frame in frames]
    sessions = list(shared_sessions())
    for name, session in sessions[1:2] if arguments.quick else sessions:
        for exact in (True, False):
            groups[f"{name.split('_')[0]}, {'exact' if exact else 'own'}"] = rendered(session, exact, 0.02)
    scenes |= {name: score(frames, BlobSettings()) for name, frames in groups.items()}
    print_scenes(scenes)
    print_rules(groups)
    if not arguments.quick:
        print_voxel_sizes((40, 30, 20, 15, 10))
    keys = ("mean_mm", "outliers_percent", "coverage_percent")
    figures = {name: dict(zip(keys, np.round(scenes[name].figures, 2).tolist(), strict=True)) for name in groups}
    finish({key: {name: figures[name][key] for name in figures} for key in keys})


if __name__ == "__main__":
    execute(main)
