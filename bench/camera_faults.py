"""Drills for the watch over lying cameras: is the liar found, how soon, at what cost, and is nobody else blamed?

    python bench/camera_faults.py --quick      # under a minute: one built-in clip, two cameras
    python bench/camera_faults.py              # every clip, every camera: a quarter of an hour
    python bench/camera_faults.py --only walk  # clips with this in their name

Each camera in turn tells the truth for a second, lies for four, and tells the truth again, at 60 frame sets a second.
The clips are the virtual studio's walking body and the rendered sessions of ../shared/data/sessions, where they are,
with exact silhouettes and with ours. A camera that is turned is turned about an axis at random, several times. Columns:

found : drills in which the liar was left out, of all (or only named: too few cameras would have remained).
after : seconds from the first lie until then, median and worst. wrong : drills in which another camera was named.
missing : litres of the honest hull that the lie takes away, and with the liar left out. extra : litres that are too
    many then. back : seconds of truth until the camera is taken back, worst.

The last line is JSON: found_LIE, after_LIE_s (rigs of five cameras and more, worst clip's median), wrong (drills),
false_alarms_per_1000 (frame sets of honest clips), hearing_ms and set_ms (median of a frame set heard, mean of all).
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from camera_faults_clips import FPS, Clip, Lie, Mask, clips, lies

from hull_server.carve_backends import CarveBackend, make_backend
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.grid import VoxelGrid
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews, min_seeing

HONEST, LYING, AFTER = 60, 240, 180  # frame sets
START = 60  # of the clip: after the T-pose
TURNS = 2
VOXEL_M = 0.02
ENOUGH = 5  # cameras from which every lie should be found


class Masks(Mapping[str, Mask]):
    """The masks of one frame set, unpacked and falsified only when they are asked for."""

    def __init__(self, clip: Clip, frame: int, liar: str = "", lie: Callable[[Mask], Mask] = lambda mask: mask) -> None:
        self._clip, self._frame, self._liar, self._lie = clip, frame, liar, lie
        self._known: dict[str, Mask] = {}

    def __getitem__(self, camera: str) -> Mask:
        if camera not in self._known:
            mask = self._clip.mask(self._frame, camera)
            self._known[camera] = self._lie(mask) if camera == self._liar else mask
        return self._known[camera]

    def __contains__(self, camera: object) -> bool:
        return camera in self._clip.rig.names

    def __iter__(self) -> Iterator[str]:
        return iter(self._clip.rig.names)

    def __len__(self) -> int:
        return len(self._clip.rig.names)


@dataclass
class Drill:
    """What came of one lie of one camera. Times in frame sets; litres are means over three sets of the lie."""

    found: int | None = None
    named: int | None = None
    back: int | None = None
    wrong: set[str] = field(default_factory=set)
    missing: float = 0.0
    missing_left_out: float = 0.0
    extra: float = 0.0


def drill(
    clip: Clip, watch: CameraFaultDetector, carver: CarveBackend, liar: str, lie: Lie, rng: np.random.Generator
) -> Drill:
    """Truth, lie, truth."""
    result, start = Drill(), START + 17 * clip.rig.names.index(liar)  # another moment, and phase, for every camera
    falsified = lie(clip.mask(start + HONEST - 1, liar), rng)
    for frame in range(HONEST + LYING + AFTER):
        since = frame - HONEST
        masks = Masks(clip, start + frame, liar if 0 <= since < LYING else "", falsified)
        verdict = watch.update(masks, round(frame / FPS * 1e9))
        result.wrong |= {name for name in verdict.left_out + verdict.suspects if name != liar}
        if since >= 0 and result.named is None and liar in verdict.left_out + verdict.suspects:
            result.named = since
        if since >= 0 and result.found is None and liar in verdict.left_out:
            result.found = since
        if since >= LYING and result.found is not None and result.back is None and liar not in verdict.left_out:
            result.back = since - LYING
        if since in (LYING - 60, LYING - 30, LYING - 1):
            _compare(carver, Masks(clip, start + frame), masks, verdict.left_out, result)
    return result


def _compare(carver: CarveBackend, honest: Masks, lying: Masks, left_out: tuple[str, ...], result: Drill) -> None:
    believed = {name: mask for name, mask in lying.items() if name not in left_out}
    hulls = []
    for masks in (dict(honest), dict(lying), believed):
        volume = carver.carve(masks, min_seeing(len(masks)))
        litres = volume.grid.voxel_volume_m3 * 1e3
        hulls.append(volume.to_dense())
    truth, cut, mended = hulls
    result.missing += np.count_nonzero(truth & ~cut) * litres / 3
    result.missing_left_out += np.count_nonzero(truth & ~mended) * litres / 3
    result.extra += np.count_nonzero(mended & ~truth) * litres / 3


def honest(clip: Clip, watch: CameraFaultDetector) -> tuple[int, list[float], list[float]]:
    """The clip as it is: frame sets with anybody named, and milliseconds of those heard and of all."""
    alarms, heard_ms, all_ms = 0, [], []
    for frame in range(len(clip.packed)):
        masks = dict(Masks(clip, frame))
        begin = time.thread_time()
        verdict = watch.update(masks, round(frame / FPS * 1e9))
        all_ms.append((time.thread_time() - begin) * 1e3)
        heard_ms += [all_ms[-1]] if verdict.updated else []
        alarms += bool(verdict.left_out or verdict.suspects or verdict.warning)
    return alarms, heard_ms, all_ms


def play(clip: Clip, views: RigViews, carver: CarveBackend, quick: bool) -> dict[str, list[Drill]]:
    """Every lie of every camera."""
    rng, drills = np.random.default_rng(7), {}
    print(
        f"{'':18s} {'found':>10s} {'named':>6s} {'after s':>12s} {'wrong':>6s} {'missing l':>13s} {'extra l':>8s} "
        f"{'back s':>7s}"
    )
    for kind in lies(np.eye(3)):
        drills[kind] = []
        for camera in clip.rig.names[:: 3 if quick else 1]:
            lie = lies(clip.rig.camera(camera).undistorted_view().camera.K)[kind]
            for _ in range(TURNS if kind.startswith("turned") else 1):
                watch = CameraFaultDetector(clip.rig, views, CameraFaultSettings())
                drills[kind].append(drill(clip, watch, carver, camera, lie, rng))
        print(f"{kind:18s} {row(drills[kind])}", flush=True)
    return drills


def row(runs: list[Drill]) -> str:
    """One line of the table."""
    named = [run.named for run in runs if run.named is not None]
    back = [run.back for run in runs if run.back is not None]
    wrong = sum(bool(run.wrong) for run in runs)
    litres = np.mean([(run.missing, run.missing_left_out, run.extra) for run in runs], axis=0)
    median_s, worst_s = (seconds(named, pick) for pick in (np.median, max))
    return (
        f"{sum(run.found is not None for run in runs):4d} of {len(runs):2d} {len(named):6d} {median_s:6.2f} "
        f"{worst_s:5.2f} {wrong:6d} {litres[0]:6.1f} {litres[1]:6.1f} {litres[2]:8.1f} "
        f"{seconds(back, max):7.2f}"
    )


def seconds(frames: list[int], pick: Callable[[list[int]], float]) -> float:
    return float(pick(frames)) / FPS if frames else float("nan")


def summary(played: list[dict[str, list[Drill]]]) -> dict[str, float]:
    """Figures of the clips with enough cameras, for the line of JSON."""
    figures: dict[str, float] = {}
    for kind in played[0] if played else ():
        found = [[run.found for run in clip[kind] if run.found is not None] for clip in played]
        key = kind.replace(" ", "_")
        figures[f"found_{key}"] = round(sum(map(len, found)) / sum(len(clip[kind]) for clip in played), 3)
        figures[f"after_{key}_s"] = round(
            max((seconds(frames, np.median) for frames in found if frames), default=-1), 2
        )
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one clip, two cameras")
    parser.add_argument("--only", default="", help="play only the clips with this in their name")
    options = parser.parse_args()
    quick = options.quick
    played, wrong, alarms, heard_ms, all_ms = [], 0, 0, [], []
    for clip in clips(quick, options.only):
        views, cameras = RigViews.from_rig(clip.rig), len(clip.rig.names)
        carver = make_backend("cpu", views, VoxelGrid.covering(clip.rig.volume, VOXEL_M)).backend
        honest(
            Clip(clip.name, clip.rig, clip.packed[:30]), CameraFaultDetector(clip.rig, views, CameraFaultSettings())
        )  # compile
        false, heard, spent = honest(clip, CameraFaultDetector(clip.rig, views, CameraFaultSettings()))
        print(
            f"\n{clip.name}: {len(spent)} honest frame sets of {cameras} cameras, {false} false alarms; "
            f"{np.median(heard):.2f} ms a hearing, {np.mean(spent):.2f} ms a frame set"
        )
        alarms, heard_ms, all_ms = alarms + false, heard_ms + heard, all_ms + spent
        drills = play(clip, views, carver, quick)
        wrong += sum(bool(run.wrong) for runs in drills.values() for run in runs)
        played += [drills] if cameras >= ENOUGH else []
    figures = summary(played) | {
        "wrong": wrong,
        "false_alarms_per_1000": round(1000 * alarms / len(all_ms), 2),
        "hearing_ms": round(float(np.median(heard_ms)), 2),
        "set_ms": round(float(np.mean(all_ms)), 3),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
