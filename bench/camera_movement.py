"""Drills for the calibration watchdog: who notices that a camera was bumped, how soon, and who cries wolf?

    python bench/camera_movement.py --quick        # two cameras, 1 degree and 5 cm, no recorded footage
    python bench/camera_movement.py                # every camera, 0.5, 1 and 2 degrees, recorded footage: ten minutes
    python bench/camera_movement.py --only studio  # or a part of the name of recorded footage

Each camera of the studio in turn films a walking person from where it stands, and after a second from where a bump has
put it. Every frame goes through the camera client's chain, so that the silhouettes flood as they would. Columns:

picture : drills in which the camera client named itself, of all; median and worst seconds from the bump.
silhouettes : in which the hull server named the camera ("stands 1.0 degrees from ..."), by silhouettes as they would be
    with a background learned since: exact ones. flooded : the same with what the chain makes of the bumped picture.
left out : in which that camera was left out, or suspected, because it contradicts the others.
system : in which any of picture, flooded and left out named it. wrong : drills in which another camera was named.
kept : after the background was learned anew, the camera client still says that the camera was moved.

Then silhouettes of recorded footage, one camera's turned, 12 s each; and everything that is as it should be: false
alarms among its looks. The last line is JSON: seconds are medians, *_named shares of drills, *_ms per frame or set.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from camera_movement_scenes import (
    EVERY,
    FPS,
    Bump,
    Clip,
    Mask,
    Masks,
    Studio,
    bumps,
    seen_by,
    session_clips,
    sessions,
    stamp_ns,
)

from camera_client.background.model import read_background
from camera_client.movement.detector import CameraMovedDetector, MovementState
from camera_client.settings import BackgroundSettings
from capture_rig import Rig
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.consistency.extrinsic_monitor import ExtrinsicMonitor
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews

BUMPED_AT = 10  # frames that are looked at: a second
CLIP_LOOKS = 120
ERRORS_DEG, GROWN_PX = 0.2, 2  # of honest calibrations and silhouettes
WITNESSES = ("picture", "silhouettes", "flooded", "left out", "system")


@dataclass
class Drill:
    """Frames from the bump until each witness named the camera."""

    named: dict[str, int] = field(default_factory=dict)
    wrong: set[str] = field(default_factory=set)
    kept: bool = False

    def note(self, witness: str, since: int, camera: str, names: Iterable[str]) -> None:
        names = set(names)
        self.wrong |= names - {camera}
        if camera in names and since >= 0:
            self.named.setdefault(witness, since)
            if witness != "silhouettes":
                self.named.setdefault("system", since)


@dataclass
class Honest:
    """What was looked at when nobody touched a camera, and how often somebody was named."""

    false_alarms_pictures: int = 0
    pictures: int = 0
    false_alarms_sets: int = 0
    sets: int = 0


@dataclass(frozen=True, eq=False)
class Film:
    """Every camera's pictures, our silhouettes and the exact ones, when nobody touches a camera."""

    pictures: list[dict[str, Mask]]
    ours: list[Masks]
    exact: list[Masks]
    alarms: int
    looks: int
    client_ms: float


def film(studio: Studio) -> Film:
    """All cameras, honest; how often a camera client cries wolf, and what its watch costs a frame."""
    chains = {camera.name: studio.chain(camera) for camera in studio.rig.cameras}
    watches = {
        camera.name: CameraMovedDetector(camera, chains[camera.name].background) for camera in studio.rig.cameras
    }
    pictures: list[dict[str, Mask]] = []
    ours: list[Masks] = []
    exact: list[Masks] = []
    alarms, spent_s = 0, 0.0
    for frame in range(len(studio.capsules)):
        shot = {camera.name: studio.film(camera, frame) for camera in studio.rig.cameras}
        seen = {name: seen_by(chains[name], picture, frame) for name, (picture, _) in shot.items()}
        begin = time.thread_time()
        for name, (picture, _) in shot.items():
            watches[name].update(picture, stamp_ns(frame))
        spent_s += time.thread_time() - begin
        alarms += sum(
            s.movement is not None and s.movement.state in (MovementState.MOVED, MovementState.LOST)
            for s in seen.values()
        )
        pictures.append({name: picture for name, (picture, _) in shot.items()})
        ours.append({name: s.silhouette.mask for name, s in seen.items() if s.silhouette is not None})
        exact.append({c.name: c.undistorted_view().undistort_mask(shot[c.name][1]) for c in studio.rig.cameras})
    frames = len(pictures) * len(chains)
    return Film(pictures, ours, exact, alarms, frames, 1e3 * spent_s / frames / EVERY)


def drill(studio: Studio, honest: Film, camera: str, bump: Bump, sign: float) -> Drill:
    """One camera films honestly for a second, and then from where the bump has put it."""
    result, model, views = Drill(), studio.rig.camera(camera), RigViews.from_rig(studio.rig)
    chain, moved, view = studio.chain(model), bump.moved(model, sign), model.undistorted_view()
    by_exact, by_ours = ExtrinsicMonitor(studio.rig, views), ExtrinsicMonitor(studio.rig, views)
    dissent = CameraFaultDetector(studio.rig, views, CameraFaultSettings())
    for frame in range(len(studio.capsules)):
        since = frame - BUMPED_AT
        picture, mask = honest.pictures[frame][camera], honest.exact[frame][camera]
        if since >= 0:
            picture, raw = studio.film(moved, frame)
            mask = view.undistort_mask(raw)
        seen = seen_by(chain, picture, frame)
        assert seen.movement is not None and seen.silhouette is not None
        if seen.movement.state in (MovementState.MOVED, MovementState.LOST):
            result.note("picture", since, camera, [camera])
        masks = honest.ours[frame] | {camera: seen.silhouette.mask}
        verdict = dissent.update(masks, stamp_ns(frame))
        result.note("left out", since, camera, verdict.left_out + verdict.suspects)
        result.note("flooded", since, camera, by_ours.update(masks, stamp_ns(frame)).suspects)
        exact = honest.exact[frame] | {camera: mask}
        result.note("silhouettes", since, camera, by_exact.update(exact, stamp_ns(frame)).suspects)
    chain.use_learned_background(studio.empty(moved))
    for frame in range(len(studio.capsules) - 2 * BUMPED_AT, len(studio.capsules)):
        seen = seen_by(chain, studio.film(moved, frame)[0], frame + len(studio.capsules))
    result.kept = seen.movement is not None and seen.movement.state is MovementState.MOVED
    return result


def play_studio(studio: Studio, honest: Film, quick: bool, every: int) -> dict[str, list[Drill]]:
    print(f"\n{'':16s}" + "".join(f"{witness:>20s}" for witness in WITNESSES) + f"{'wrong':>7s}{'kept':>6s}")
    drills: dict[str, list[Drill]] = {}
    for bump in bumps(quick):
        names = studio.rig.names[::3] if quick else studio.rig.names[::every]
        runs = [drill(studio, honest, name, bump, 1.0 if number % 2 else -1.0) for number, name in enumerate(names)]
        drills[bump.name] = runs
        cells = "".join(f"{_cell(runs, witness):>20s}" for witness in WITNESSES)
        wrong, kept = sum(bool(run.wrong) for run in runs), sum(run.kept for run in runs)
        print(f"{bump.name:16s}{cells}{wrong:7d}{kept:6d}", flush=True)
    return drills


def _cell(runs: list[Drill], witness: str) -> str:
    after_s = _seconds(runs, witness)
    times = f"{np.median(after_s):.1f}, {max(after_s):.1f} s" if after_s else "-"
    return f"{len(after_s)} of {len(runs)}  {times}"


def _seconds(runs: list[Drill], witness: str) -> list[float]:
    return [run.named[witness] * EVERY / FPS for run in runs if witness in run.named]


def play_clip(clip: Clip) -> dict[str, list[Drill]]:
    """Recorded silhouettes, one camera's turned: the hull server alone."""
    views, drills = RigViews.from_rig(clip.rig), {}
    for bump in bumps(quick=False):
        if bump.turn_deg < 1.0:
            continue
        runs = []
        for number, camera in enumerate(clip.rig.names):
            run, watch = Drill(), ExtrinsicMonitor(clip.rig, views)
            K = clip.rig.camera(camera).undistorted_view().camera.K
            H = bump.homography(K, 1.0 if number % 2 else -1.0)
            for look in range(0, CLIP_LOOKS, 2):
                masks = clip.masks(look)
                masks[camera] = _warped(masks[camera], H)
                run.note("silhouettes", look, camera, watch.update(masks, stamp_ns(look)).suspects)
            runs.append(run)
        drills[bump.name] = runs
        wrong = sum(bool(run.wrong) for run in runs)
        print(f"  {bump.name:16s}{_cell(runs, 'silhouettes'):>24s}   wrong {wrong}", flush=True)
    return drills


def _warped(mask: Mask, H: np.ndarray) -> Mask:
    return cv2.warpPerspective(mask, H, mask.shape[::-1], flags=cv2.INTER_NEAREST)


def honest_sets(honest: Honest, name: str, rig: Rig, frames: list[Masks], quick: bool) -> float:
    """Sets as they are, with small errors of all calibrations, with one camera's silhouettes too large or too small;
    returns milliseconds a frame set."""
    views = RigViews.from_rig(rig)
    plain, sets, spent_ms = _alarms(rig, views, frames)
    report = [f"as it is {plain}"]
    total, looked = plain, sets
    for seed in range(1 if quick else 3):
        rng, turned = np.random.default_rng(seed), {}
        for camera in rig.cameras:
            axis = rng.normal(size=3)
            R = cv2.Rodrigues(np.radians(ERRORS_DEG) * axis / np.linalg.norm(axis))[0]
            K = camera.undistorted_view().camera.K
            turned[camera.name] = K @ R @ np.linalg.inv(K)
        found, sets, _ = _alarms(rig, views, [{n: _warped(m, turned[n]) for n, m in masks.items()} for masks in frames])
        total, looked = total + found, looked + sets
        report.append(f"all turned by {ERRORS_DEG} degrees {found}")
    kernel = np.ones((2 * GROWN_PX + 1,) * 2, np.uint8)
    for camera in rig.names[:: 3 if quick else 2]:
        for word, change in (("grown", cv2.dilate), ("shrunk", cv2.erode)):
            changed = [masks | {camera: change(masks[camera], kernel)} for masks in frames]
            found, sets, _ = _alarms(rig, views, changed)
            total, looked = total + found, looked + sets
            report += [f"{camera} {word} by {GROWN_PX} px {found}"] if found else []
    print(f"{name}: false alarms: {', '.join(report)}; {looked} sets, {spent_ms:.2f} ms a frame set", flush=True)
    honest.false_alarms_sets += total
    honest.sets += looked
    return spent_ms


def _alarms(rig: Rig, views: RigViews, frames: list[Masks]) -> tuple[int, int, float]:
    watch, alarms, spent_s = ExtrinsicMonitor(rig, views), 0, 0.0
    for look, masks in enumerate(frames):
        begin = time.thread_time()
        alarms += bool(watch.update(masks, stamp_ns(2 * look)).suspects)
        spent_s += time.thread_time() - begin
    return alarms, len(frames), 1e3 * spent_s / len(frames) / (2 * EVERY)


def honest_pictures(honest: Honest, only: str) -> None:
    """The camera clients on recorded footage."""
    for name, session in sessions(only):
        found = 0
        for camera, path in session.videos.items():
            capture, frame = cv2.VideoCapture(str(path)), 0
            watch: CameraMovedDetector | None = None
            while (image := capture.read()[1]) is not None:
                if watch is None:
                    grey = bool((image[..., 0] == image[..., 1]).all())
                    shape = image.shape[:2] if grey else image.shape
                    background = read_background(session.backgrounds[camera], shape, BackgroundSettings())
                    watch = CameraMovedDetector(session.rig.camera(camera), background)
                picture = np.ascontiguousarray(image[..., 0]) if grey else image
                movement = watch.update(picture, round(frame / session.fps * 1e9))
                found += movement.state in (MovementState.MOVED, MovementState.LOST)
                frame += 1
            honest.pictures += frame
        print(f"{name}: {found} false alarms of the camera clients", flush=True)
        honest.false_alarms_pictures += found


def summary(drills: dict[str, list[Drill]]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for kind in ("0.5 degrees", "1 degrees", "2 degrees", "5 cm"):
        runs = [run for name, of_it in drills.items() if kind in name for run in of_it]
        for witness in ("picture", "silhouettes", "system") if runs else ():
            after_s = _seconds(runs, witness)
            key = f"{kind.replace(' ', '_').replace('.', '')}_{witness}"
            figures[f"{key}_named"] = round(len(after_s) / len(runs), 3)
            figures[f"{key}_s"] = round(float(np.median(after_s)), 2) if after_s else -1.0
    everything = [run for runs in drills.values() for run in runs]
    figures["kept_share"] = round(sum(run.kept for run in everything) / len(everything), 3)
    figures["wrong"] = sum(bool(run.wrong) for run in everything)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two cameras of the studio, one size of bump")
    parser.add_argument("--only", default="", help="'studio', or a part of the name of recorded footage")
    parser.add_argument("--every", type=int, default=1, help="every so many-th camera of the studio")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    figures: dict[str, float] = {"wrong": 0}
    honest = Honest()
    if options.only in "studio":
        figures |= at_the_studio(honest, options.quick, options.every)
    if not options.quick and options.only != "studio":
        figures["wrong"] += on_footage(honest, options.only)
    print(json.dumps(figures | asdict(honest)))


def at_the_studio(honest: Honest, quick: bool, every: int) -> dict[str, float]:
    studio = Studio()
    filmed = film(studio)
    print(
        f"studio, 6 cameras: {filmed.looks} honest pictures, {filmed.alarms} false alarms of the camera clients, "
        f"{filmed.client_ms:.2f} ms a frame"
    )
    honest.false_alarms_pictures, honest.pictures = filmed.alarms, filmed.looks
    drills = play_studio(studio, filmed, quick, every)
    print()
    for name, masks in (("studio, ours", filmed.ours), ("studio, exact", filmed.exact)):
        sets_ms = honest_sets(honest, name, studio.rig, masks[::2], quick)
    return summary(drills) | {"picture_ms": round(filmed.client_ms, 3), "silhouettes_ms": round(sets_ms, 3)}


def on_footage(honest: Honest, only: str) -> int:
    """Recorded footage; returns in how many drills a wrong camera was named."""
    wrong = 0
    for clip in session_clips(only):
        honest_sets(honest, clip.name, clip.rig, [clip.masks(look) for look in range(0, CLIP_LOOKS, 2)], False)
        wrong += sum(bool(run.wrong) for runs in play_clip(clip).values() for run in runs)
    honest_pictures(honest, only)
    return wrong


if __name__ == "__main__":
    main()
