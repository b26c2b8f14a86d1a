"""Drills of the detectors of camera movement (bench/camera_faults.py --moved): which one notices, how soon?

Each camera of the studio in turn films a walking person from where it stands, and after three seconds from where it was
moved to. Every frame goes through the camera client's chain, so that moved backgrounds become foreground. Columns:

picture : drills in which the camera client named itself, of all; median and worst seconds from the movement.
bodies : in which the tracker named the camera ("people 12 mm beside ..."), by exact silhouettes, as with a
    background learned since; dashes where the hull server had left it out before.
left out : in which that camera was left out, or suspected, because it contradicts the others, by what the chain makes
    of the moved camera's picture.
system : in which any of them named it. wrong : drills in which another camera was named.
kept : after the background was learned anew, the camera client still reports that the camera was moved.

Then silhouettes of recorded footage, one camera's turned, 12 s each; and everything unmoved: false alarms among its
updates. Figures: seconds are medians, *_named shares of drills, *_ms per frame or set.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from report import Table

import cv2
import numpy as np
from camera_movement_scenes import (
    EVERY,
    FPS,
    SESSIONS,
    Displacement,
    Mask,
    Studio,
    displacements,
    seen_by,
    session_clips,
    stamp_ns,
)
from clips import Clip
from scenes import shared_sessions

from camera_client.background.model import read_background
from camera_client.movement import CameraMovedDetector, MovementState
from capture_rig import Rig
from capture_rig.video import Video
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews
from icp_tracker.extrinsic_monitor import ENOUGH_CAMERAS
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import Masks, MocapPipeline

MOVED_AT = 30  # frames that are looked at: three seconds, in which the person is found
CLIP_LOOKS, KEPT_LOOKS = 120, 20
GROWN_PX = 2  # of good silhouettes
DETECTORS = ("picture", "bodies", "left out", "system")


@dataclass
class Drill:
    """Frames from the displacement until each detector named the camera."""

    named: dict[str, int] = field(default_factory=dict)
    wrong: set[str] = field(default_factory=set)
    kept: bool = False

    def note(self, detector: str, since: int, camera: str, names: Iterable[str]) -> None:
        names = set(names)
        self.wrong |= names - {camera}
        if camera in names and since >= 0:
            self.named.setdefault(detector, since)
            self.named.setdefault("system", since)


@dataclass
class FalseAlarms:
    """What was looked at when no camera was moved, and how often a camera was named."""

    false_alarms_pictures: int = 0
    pictures: int = 0
    false_alarms_sets: int = 0
    sets: int = 0


@dataclass(frozen=True, eq=False)
class Footage:
    """Every camera's pictures, our silhouettes and the exact ones, when no camera is moved."""

    pictures: list[dict[str, Mask]]
    ours: list[Masks]
    exact: list[Masks]
    alarms: int
    looks: int
    client_ms: float


def footage_of(studio: Studio) -> Footage:
    """All cameras in their places; false alarms of the camera clients, and what the detector costs a frame."""
    chains = {camera.name: studio.processor(camera) for camera in studio.rig.cameras}
    watches = {
        camera.name: CameraMovedDetector(camera, chains[camera.name].background) for camera in studio.rig.cameras
    }
    pictures, ours, exact = list[dict[str, Mask]](), list[Masks](), list[Masks]()
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
    return Footage(pictures, ours, exact, alarms, frames, 1e3 * spent_s / frames / EVERY)


class TrackedBodies:
    """Whoever is tracked; ``start`` : settings of the first pose."""

    def __init__(self, rig: Rig, start: Mapping[str, Any]) -> None:
        self._pipeline = MocapPipeline(rig, Configuration.of({"hull_server.backend": "cpu", **start}))

    def update(self, masks: Masks, at_ns: int) -> Iterable[str]:
        """Track a set's silhouettes; return the cameras that are suspected."""
        self._pipeline.step_masks(at_ns, masks)
        return self._pipeline.body.tracker.extrinsic_errors.suspects


def drill(studio: Studio, unmoved: Footage, camera: str, displacement: Displacement, sign: float) -> Drill:
    """One camera films from its place for three seconds, and then from where the displacement has put it."""
    result, model, views = Drill(), studio.rig.camera(camera), RigViews.from_rig(studio.rig)
    processor, moved, view = studio.processor(model), displacement.moved(model, sign), model.undistorted_view()
    bodies = TrackedBodies(studio.rig, {})
    dissent = CameraFaultDetector(studio.rig, views, CameraFaultSettings())
    for frame in range(len(studio.capsules)):
        since = frame - MOVED_AT
        picture, mask = unmoved.pictures[frame][camera], unmoved.exact[frame][camera]
        if since >= 0:
            picture, raw = studio.film(moved, frame)
            mask = view.undistort_mask(raw)
        seen = seen_by(processor, picture, frame)
        assert seen.movement is not None and seen.silhouette is not None
        if seen.movement.state in (MovementState.MOVED, MovementState.LOST):
            result.note("picture", since, camera, [camera])
        masks = unmoved.ours[frame] | {camera: seen.silhouette.mask}
        verdict = dissent.update(masks, stamp_ns(frame))
        result.note("left out", since, camera, verdict.left_out + verdict.suspects)
        exact = unmoved.exact[frame] | {camera: mask}
        result.note("bodies", since, camera, bodies.update(exact, stamp_ns(frame)))
    processor.use_learned_background(studio.empty(moved))
    for frame in range(len(studio.capsules) - KEPT_LOOKS, len(studio.capsules)):
        seen = seen_by(processor, studio.film(moved, frame)[0], frame + len(studio.capsules))
    result.kept = seen.movement is not None and seen.movement.state is MovementState.MOVED
    return result


def play_studio(studio: Studio, unmoved: Footage, quick: bool) -> dict[str, list[Drill]]:
    table = Table({"movement": "<16", **dict.fromkeys(DETECTORS, ">19"), "wrong": ">6d", "kept": ">5d"})
    drills: dict[str, list[Drill]] = {}
    for displacement in displacements(quick):
        names = studio.rig.names[:: 3 if quick else 1]
        runs = [
            drill(studio, unmoved, name, displacement, 1.0 if number % 2 else -1.0) for number, name in enumerate(names)
        ]
        drills[displacement.name] = runs
        wrong, kept = sum(bool(run.wrong) for run in runs), sum(run.kept for run in runs)
        table.row(displacement.name, *(_cell(runs, detector) for detector in DETECTORS), wrong, kept)
    return drills


def _cell(runs: list[Drill], detector: str) -> str:
    after_s = _seconds(runs, detector)
    times = f"{np.median(after_s):.1f}, {max(after_s):.1f} s" if after_s else "-"
    return f"{len(after_s)} of {len(runs)}  {times}"


def _seconds(runs: list[Drill], detector: str) -> list[float]:
    return [run.named[detector] * EVERY / FPS for run in runs if detector in run.named]


def play_clip(clip: Clip) -> dict[str, list[Drill]]:
    """Recorded silhouettes, one camera's turned: the tracker alone."""
    drills = {}
    for displacement in displacements(quick=True):
        if not displacement.turn_deg:
            continue
        runs = []
        for number, camera in enumerate(clip.rig.names):
            run, watch = Drill(), TrackedBodies(clip.rig, clip.start)
            K = clip.rig.camera(camera).undistorted_view().camera.K
            H = displacement.homography(K, 1.0 if number % 2 else -1.0)
            for look in range(CLIP_LOOKS):
                masks = clip.masks(look)
                masks[camera] = _warped(masks[camera], H)
                named = watch.update(masks, stamp_ns(look))
                if camera in named and len(clip.rig.cameras) < ENOUGH_CAMERAS:
                    named = [camera]  # it is said to be one of several
                run.note("bodies", look, camera, named)
            runs.append(run)
        drills[displacement.name] = runs
        wrong = sum(bool(run.wrong) for run in runs)
        print(f"  {displacement.name:16s}{_cell(runs, 'bodies'):>24s}   wrong {wrong}", flush=True)
    return drills


def _warped(mask: Mask, H: np.ndarray) -> Mask:
    return cv2.warpPerspective(mask, H, mask.shape[::-1], flags=cv2.INTER_NEAREST)


def unmoved_sets(
    unmoved: FalseAlarms, name: str, rig: Rig, start: Mapping[str, Any], frames: list[Masks], quick: bool
) -> None:
    """Sets as they are, and with one camera's silhouettes too large or too small."""
    plain = _alarms(rig, start, frames)
    report, total, looked = [f"as it is {plain}"], plain, len(frames)
    kernel = np.ones((2 * GROWN_PX + 1,) * 2, np.uint8)
    for camera in rig.names[:: 3 if quick else 2]:
        for word, change in (("grown", cv2.dilate), ("shrunk", cv2.erode)):
            changed = [masks | {camera: change(masks[camera], kernel)} for masks in frames]
            found = _alarms(rig, start, changed)
            total, looked = total + found, looked + len(frames)
            report += [f"{camera} {word} by {GROWN_PX} px {found}"] if found else []
    print(f"{name}: false alarms: {', '.join(report)}; {looked} sets", flush=True)
    unmoved.false_alarms_sets += total
    unmoved.sets += looked


def _alarms(rig: Rig, start: Mapping[str, Any], frames: list[Masks]) -> int:
    watch = TrackedBodies(rig, start)
    return sum(bool(watch.update(masks, stamp_ns(look))) for look, masks in enumerate(frames))


def unmoved_pictures(unmoved: FalseAlarms, only: str) -> None:
    """The camera clients on recorded footage."""
    for name, session in shared_sessions(SESSIONS, only):
        found = 0
        for camera, path in session.videos.items():
            frame = 0
            watch: CameraMovedDetector | None = None
            for image in Video(path):
                if watch is None:
                    grey = bool((image[..., 0] == image[..., 1]).all())
                    shape = image.shape[:2] if grey else image.shape
                    background = read_background(session.backgrounds[camera], shape)
                    watch = CameraMovedDetector(session.rig.camera(camera), background)
                picture = np.ascontiguousarray(image[..., 0]) if grey else image
                movement = watch.update(picture, round(frame / session.fps * 1e9))
                found += movement.state in (MovementState.MOVED, MovementState.LOST)
                frame += 1
            unmoved.pictures += frame
        print(f"{name}: {found} false alarms of the camera clients", flush=True)
        unmoved.false_alarms_pictures += found


def summary(drills: dict[str, list[Drill]]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for kind in ("0.5 degrees", "1 degrees", "2 degrees", "5 cm"):
        runs = [run for name, of_it in drills.items() if kind in name for run in of_it]
        for detector in ("picture", "bodies", "system") if runs else ():
            after_s = _seconds(runs, detector)
            key = f"{kind.replace(' ', '_').replace('.', '')}_{detector}"
            figures[f"{key}_named"] = round(len(after_s) / len(runs), 3)
            figures[f"{key}_s"] = round(float(np.median(after_s)), 2) if after_s else -1.0
    everything = [run for runs in drills.values() for run in runs]
    figures["kept_share"] = round(sum(run.kept for run in everything) / len(everything), 3)
    figures["wrong"] = sum(bool(run.wrong) for run in everything)
    return figures


def movements(quick: bool, only: str) -> dict[str, float]:
    """Print the tables; ``only`` : "studio", or a part of the name of recorded footage."""
    figures: dict[str, float] = {"wrong": 0}
    unmoved = FalseAlarms()
    if only in "studio":
        figures |= at_the_studio(unmoved, quick)
    if not quick and only != "studio":
        figures["wrong"] += on_footage(unmoved, only)
    return figures | asdict(unmoved)


def at_the_studio(unmoved: FalseAlarms, quick: bool) -> dict[str, float]:
    studio = Studio()
    filmed = footage_of(studio)
    print(
        f"studio, 6 cameras: {filmed.looks} unmoved pictures, {filmed.alarms} false alarms of the camera clients, "
        f"{filmed.client_ms:.2f} ms a frame"
    )
    unmoved.false_alarms_pictures, unmoved.pictures = filmed.alarms, filmed.looks
    drills = play_studio(studio, filmed, quick)
    print()
    for name, masks in (("studio, ours", filmed.ours), ("studio, exact", filmed.exact)):
        unmoved_sets(unmoved, name, studio.rig, {}, masks, quick)
    return summary(drills) | {"picture_ms": round(filmed.client_ms, 3)}


def on_footage(unmoved: FalseAlarms, only: str) -> int:
    """Recorded footage; returns in how many drills a wrong camera was named."""
    wrong = 0
    for clip in session_clips(only):
        masks = [clip.masks(look) for look in range(CLIP_LOOKS)]
        unmoved_sets(unmoved, clip.name, clip.rig, clip.start, masks, False)
        wrong += sum(bool(run.wrong) for runs in play_clip(clip).values() for run in runs)
    unmoved_pictures(unmoved, only)
    return wrong
