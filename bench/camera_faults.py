"""Drills of the camera fault detector: is the faulty camera found, how soon, at what cost, and is no other one named?

    python bench/camera_faults.py --quick      # under a minute: one built-in clip, two cameras
    python bench/camera_faults.py              # every clip, every camera: a quarter of an hour
    python bench/camera_faults.py --only walk  # clips with this in their name
    python bench/camera_faults.py --moved [--quick]  # a camera that is moved: who notices (camera_movement.py); half an
                                                     # hour, --quick two cameras, 1 degree and 5 cm, no recorded footage

Each camera in turn is sound for a second, faulty for four, and sound again, at 60 frame sets a second. The clips are
the virtual studio's walking person and the rendered sessions of the test data, with exact silhouettes and with ours. A
camera that is turned is turned about an axis at random, several times. Columns:

found : drills in which the faulty camera was left out, of all; named : or only named, where too few would remain.
after : seconds from the fault until then, median and worst. wrong : drills in which another camera was named.
missing : litres of the sound hull that the fault takes away, and with the camera left out. extra : litres that are too
    many then. back : seconds from the fault's end until the camera is taken back, worst.

The last line is JSON: found_FAULT, after_FAULT_s (rigs of five cameras and more, worst clip's median), wrong (drills),
false_alarms_per_1000 (frame sets of sound clips), update_ms and set_ms (median of a frame set that is evaluated, mean
of all).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from report import Table, execute, finish, parser

import cv2
import numpy as np
from camera_movement import movements
from clips import Clip, canvas_masks
from scenes import STATURE_M, STUDIO_FPS, shared_sessions, studio_masks

from hull_server.carving import CarveBackend, make_backend
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.grid import VoxelGrid
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews, min_seeing
from stick_figure.body import Body
from virtual_studio.motions.catalogue import walk
from virtual_studio.rig import ring

SESSIONS = ("sessions/walk_ring5top", "sessions/charleston_ring5top", "sessions/zombie_he3")
STUDIOS = {"studio, 5 + ceiling": ring(5), "studio, 7 + ceiling": ring(7), "studio, 3": ring(3, ceiling=False)}
WALK_S, QUICK_S = 5.0, 3.0
FPS = STUDIO_FPS
SOUND, FAULTY, AFTER = 60, 240, 180  # frame sets
START = 60  # of the clip: after the T-pose
TURNS = 2
VOXEL_M = 0.02
ENOUGH = 5  # cameras from which every fault should be found

Mask = np.ndarray
Fault = Callable[[Mask, np.random.Generator], Callable[[Mask], Mask]]


# --- clips and faults


def clips(quick: bool, only: str = "") -> Iterator[Clip]:
    """The walking person of the virtual studio, and the rendered sessions; those named like ``only``."""
    body = Body.from_stature(STATURE_M)
    for name, rig in list(STUDIOS.items())[: 1 if quick else None]:
        if only in name:
            poses = walk(body, QUICK_S if quick else WALK_S, FPS).poses
            yield Clip.of(name, rig, FPS, studio_masks(rig, body, poses))
    for name, session in () if quick else shared_sessions(SESSIONS):
        for kind, exact in (("exact", True), ("from video", False)):
            if only in f"{name}, {kind}":
                yield Clip.of(f"{name}, {kind}", session.rig, FPS, canvas_masks(session, exact))


def faults(K: np.ndarray) -> dict[str, Fault]:
    """Each fault by name: from the last sound mask (and chance) to what becomes of every mask after it."""
    return {
        "blank": lambda last, rng: np.zeros_like,
        "lower half cut": lambda last, rng: lambda mask: _cut(mask, lower=True),
        "upper half cut": lambda last, rng: lambda mask: _cut(mask, lower=False),
        "turned 2 degrees": lambda last, rng: _turn(K, rng, 2.0),
        "turned 1 degree": lambda last, rng: _turn(K, rng, 1.0),
        "frozen": lambda last, rng: lambda mask: last,
        "all foreground": lambda last, rng: lambda mask: np.full_like(mask, 255),
        "mirrored": lambda last, rng: lambda mask: np.ascontiguousarray(mask[:, ::-1]),
    }


def _cut(mask: Mask, lower: bool) -> Mask:
    rows = np.flatnonzero(mask.any(1))
    half = slice((rows[0] + rows[-1]) // 2, None) if lower else slice((rows[0] + rows[-1]) // 2)
    cut = mask.copy()
    cut[half] = 0
    return cut


def _turn(K: np.ndarray, rng: np.random.Generator, degrees: float) -> Callable[[Mask], Mask]:
    """The picture after the camera has turned about a random axis: pixels move by K R K^-1."""
    axis = rng.normal(size=3)
    R = cv2.Rodrigues(np.radians(degrees) * axis / np.linalg.norm(axis))[0]
    H = K @ R @ np.linalg.inv(K)
    return lambda mask: cv2.warpPerspective(mask, H, mask.shape[::-1], flags=cv2.INTER_NEAREST)


# --- drills


@dataclass
class Drill:
    """What came of one fault of one camera. Times in frame sets; litres are means over three sets of the fault."""

    found: int | None = None
    named: int | None = None
    back: int | None = None
    wrong: set[str] = field(default_factory=set)
    missing: float = 0.0
    missing_left_out: float = 0.0
    extra: float = 0.0


def drill(
    clip: Clip, views: RigViews, carver: CarveBackend, faulty: str, fault: Fault, rng: np.random.Generator
) -> Drill:
    """Sound, faulty, sound again."""
    result, start = Drill(), START + 17 * clip.rig.names.index(faulty)  # another instant for every camera
    detector = CameraFaultDetector(clip.rig, views, CameraFaultSettings())
    becomes = fault(clip.mask(start + SOUND - 1, faulty), rng)
    for frame in range(SOUND + FAULTY + AFTER):
        since = frame - SOUND
        is_faulty = 0 <= since < FAULTY
        masks = dict(clip.masks(start + frame))
        if is_faulty:
            masks[faulty] = becomes(masks[faulty])
        verdict = detector.update(masks, round(frame / FPS * 1e9))
        result.wrong |= {name for name in verdict.left_out + verdict.suspects if name != faulty}
        if since >= 0 and result.named is None and faulty in verdict.left_out + verdict.suspects:
            result.named = since
        if since >= 0 and result.found is None and faulty in verdict.left_out:
            result.found = since
        if since >= FAULTY and result.found is not None and result.back is None and faulty not in verdict.left_out:
            result.back = since - FAULTY
        if since in (FAULTY - 60, FAULTY - 30, FAULTY - 1):
            _compare(carver, clip.masks(start + frame), masks, verdict.left_out, result)
    return result


def _compare(
    carver: CarveBackend, sound: dict[str, Mask], seen: dict[str, Mask], left_out: tuple[str, ...], result: Drill
) -> None:
    used = {name: mask for name, mask in seen.items() if name not in left_out}
    hulls = []
    for masks in (sound, seen, used):
        volume = carver.carve(masks, min_seeing(len(masks)))
        litres = volume.grid.voxel_volume_m3 * 1e3
        hulls.append(volume.to_dense())
    truth, cut, mended = hulls
    result.missing += np.count_nonzero(truth & ~cut) * litres / 3
    result.missing_left_out += np.count_nonzero(truth & ~mended) * litres / 3
    result.extra += np.count_nonzero(mended & ~truth) * litres / 3


def without_fault(clip: Clip, views: RigViews, sets: int = 10**6) -> tuple[int, list[float], list[float]]:
    """The clip as it is: frame sets with a camera named, and milliseconds of those evaluated and of all."""
    detector = CameraFaultDetector(clip.rig, views, CameraFaultSettings())
    alarms, update_ms, all_ms = 0, [], []
    for frame in range(min(len(clip), sets)):
        masks = clip.masks(frame)
        begin = time.thread_time()
        verdict = detector.update(masks, round(frame / FPS * 1e9))
        all_ms.append((time.thread_time() - begin) * 1e3)
        update_ms += [all_ms[-1]] if verdict.updated else []
        alarms += bool(verdict.left_out or verdict.suspects or verdict.warning)
    return alarms, update_ms, all_ms


def play(clip: Clip, views: RigViews, carver: CarveBackend, quick: bool) -> dict[str, list[Drill]]:
    """Every fault of every camera."""
    rng, drills = np.random.default_rng(7), {}
    table = Table(
        "fault:<18 | found:>9 | named:>6d | after s:>7.2f | worst:>5.2f | wrong:>6d | missing l:>9.1f | "
        "left out:>9.1f | extra l:>8.1f | back s:>7.2f"
    )
    for kind in faults(np.eye(3)):
        drills[kind] = []
        for camera in clip.rig.names[:: 3 if quick else 1]:
            fault = faults(clip.rig.camera(camera).undistorted_view().camera.K)[kind]
            for _ in range(TURNS if kind.startswith("turned") else 1):
                drills[kind].append(drill(clip, views, carver, camera, fault, rng))
        table.row(kind, *cells(drills[kind]))
    return drills


def cells(runs: list[Drill]) -> tuple[object, ...]:
    """A row of the table."""
    named = [run.named for run in runs if run.named is not None]
    back = [run.back for run in runs if run.back is not None]
    litres = np.mean([(run.missing, run.missing_left_out, run.extra) for run in runs], axis=0)
    return (
        f"{sum(run.found is not None for run in runs)} of {len(runs)}",
        len(named),
        seconds(named, np.median),
        seconds(named, max),
        sum(bool(run.wrong) for run in runs),
        *litres,
        seconds(back, max),
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
        after_s = max((seconds(frames, np.median) for frames in found if frames), default=-1)
        figures[f"after_{key}_s"] = round(after_s, 2)
    return figures


def main() -> None:
    """Print a table a clip and the line of JSON."""
    given = parser(__doc__, quick="one clip, two cameras")
    given.add_argument("--only", default="", help="play only the clips with this in their name")
    given.add_argument("--moved", action="store_true", help="cameras that are moved, by every detector of that")
    options = given.parse_args()
    if options.moved:
        finish(movements(options.quick, options.only))
        return
    played, wrong, alarms, update_ms, all_ms = [], 0, 0, [], []
    for clip in clips(options.quick, options.only):
        views, cameras = RigViews.from_rig(clip.rig), len(clip.rig.names)
        carver = make_backend("cpu", views, VoxelGrid.covering(clip.rig.volume, VOXEL_M))[0]
        without_fault(clip, views, 30)  # compiles
        false, evaluated, spent = without_fault(clip, views)
        print(
            f"\n{clip.name}: {len(spent)} sound frame sets of {cameras} cameras, {false} false alarms; "
            f"{np.median(evaluated):.2f} ms an evaluation, {np.mean(spent):.2f} ms a frame set"
        )
        alarms, update_ms, all_ms = alarms + false, update_ms + evaluated, all_ms + spent
        drills = play(clip, views, carver, options.quick)
        wrong += sum(bool(run.wrong) for runs in drills.values() for run in runs)
        played += [drills] if cameras >= ENOUGH else []
    finish(
        summary(played)
        | {
            "wrong": wrong,
            "false_alarms_per_1000": round(1000 * alarms / len(all_ms), 2),
            "update_ms": round(float(np.median(update_ms)), 2),
            "set_ms": round(float(np.mean(all_ms)), 3),
        }
    )


if __name__ == "__main__":
    execute(main)
