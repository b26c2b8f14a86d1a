"""Scores and times the silhouettes of a camera client, beside OpenCV's own background subtractors.

    python bench/silhouette.py --quick      # under a minute: fewer cameras and frames
    python bench/silhouette.py              # everything
    python bench/silhouette.py --picture docs/images/silhouettes.png    # the picture of docs/silhouettes.md, no tables

Four tables: does the fast form of the background test agree with the float64 definition (thesis eq. 6.3); how much of
the exact silhouette is found (IoU, precision, recall) on the built-in studio and on the rendered sessions of
../shared/data/sessions, where they are; what each stage costs; and milliseconds a frame beside MOG2 and KNN on the
same frames, in turns, in one run on one thread. MOG2 and KNN learn from the same frames of the empty room and then stay
as they are; their masks go through our majority filter and component rules, too. The last line is JSON:

disagreements : grey levels, of all pixels tried, on which fast form and float64 differ.
mono_ms, colour_ms : median of the whole chain from image to undistorted mask; .._mog2_ratio, .._knn_ratio: what the
    other one takes for its subtraction alone, over our whole chain; .._subtract_mog2_ratio: over our subtraction.
iou, recall : mean over cameras of each clip with shadow candidates taken for background; iou_candidates_person: taken
    for the person; iou_no_shadow_test, iou_mog2, iou_mog2_shadow, iou_knn : the same clips without our shadow test, and
    with the others.
png_bytes, png_ms : the message of one silhouette.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import cv2
import numpy as np
from scenes import SHARED, shared_sessions
from scipy.stats import norm

from camera_client.background.adaptation.adaptive import AdaptiveBackground
from camera_client.background.model import BackgroundModel, Provenance, read_background
from camera_client.settings import BackgroundSettings, SilhouetteSettings
from camera_client.silhouettes.components import PeopleRule, keep_people
from camera_client.silhouettes.masks import BLOCK_PX, majority
from camera_client.silhouettes.pipeline import MIN_AREA, SilhouettePipeline, outline
from camera_client.sources.footage_reader import open_footage
from camera_client.sources.frame_checks import FrameChecks
from capture_rig.camera import CameraModel
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE
from capture_rig.session import Session, load_session
from sagoma_ros.images import silhouette_message
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

TRAINING_FRAMES = 90
MOG2_SHADOW = 127
FROZEN = 1e-6
"""Learning rate of a rival that stays as it is: at 0 OpenCV's KNN divides by log(1 - rate) and goes on to learn."""
RULES = ("adaptive", "tail")
TINT = np.array([0.7, 0.9, 1.0], np.float32)  # makes a colour image of a grey one


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames of one camera, with exact masks (or none), its background and the frames it was learned from."""

    camera: CameraModel
    background: BackgroundModel
    empty: list[np.ndarray]
    frames: list[np.ndarray]
    truth: list[np.ndarray]


# --- exactness -------------------------------------------------------------------------------------------------------


def disagreements(quick: bool) -> int:
    """All 256 grey levels on random backgrounds, both rules, three risks: fast form against float64."""
    rng, wrong, tried = np.random.default_rng(0), 0, 0
    side = 60 if quick else 200
    for rule in ("tail", "pdf"):
        for risk in (1e-6, 1e-4, 1e-2):
            mean = rng.uniform(0, 255, (side, side)).astype(np.float32)
            sigma = rng.exponential(3.0, (side, side)).astype(np.float32)
            settings = BackgroundSettings(rule=rule, risk=risk)
            limits = BackgroundModel(mean, sigma, Provenance("bench", 90, 3.0)).limits(settings)
            m, s = mean.astype(float), np.maximum(sigma.astype(float), settings.sigma_floor)
            for grey in range(256):
                p = norm.pdf(grey, m, s) if rule == "pdf" else 2 * norm.sf(abs(grey - m) / s)
                found = limits.subtract(np.full(mean.shape, grey, np.uint8)) > 0
                wrong += int((found != (p < risk)).sum())
                tried += found.size
    print(f"fast form against float64: {wrong} of {tried} decisions differ")
    return wrong


# --- quality ---------------------------------------------------------------------------------------------------------


def read_clip(session: Session, camera: CameraModel, every: int) -> Clip:
    """Every n-th frame of one camera of a session."""
    shape, path = (camera.height, camera.width), session.backgrounds[camera.name]
    empty = [image for image, _ in zip(_images(path), range(TRAINING_FRAMES), strict=False)]
    background = read_background(path, shape, BackgroundSettings())
    frames, truth = [], []
    for k, (image, mask) in enumerate(
        zip(_images(session.videos[camera.name]), _images(session.masks[camera.name]), strict=False)
    ):
        if k % every == every // 2:
            frames.append(image)
            truth.append(np.where(mask > 127, np.uint8(255), np.uint8(0)))
    return Clip(camera, background, empty, frames, truth)


def _images(path: Path) -> Iterator[np.ndarray]:
    reader = open_footage(path, "mono")
    while (image := reader.read()) is not None:
        yield image
    reader.close()


def trained(subtractor: cv2.BackgroundSubtractor, empty: list[np.ndarray]) -> cv2.BackgroundSubtractor:
    for image in empty:
        subtractor.apply(image, None, 1 / len(empty))
    return subtractor


def opencv(shadows: bool, kind: Callable) -> cv2.BackgroundSubtractor:
    return kind(history=TRAINING_FRAMES, detectShadows=shadows)


def methods(clip: Clip) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Image to mask in the image's own pixels, 0 or 255, by every method."""
    pipeline = SilhouettePipeline(clip.camera, clip.background)
    keep = SilhouettePipeline(clip.camera, clip.background, SilhouetteSettings(shadow="keep"))
    settings = SilhouetteSettings()

    def of(subtractor: cv2.BackgroundSubtractor, image: np.ndarray) -> np.ndarray:
        raw = subtractor.apply(image, None, FROZEN)
        mask = majority(np.where(raw > MOG2_SHADOW, np.uint8(255), np.uint8(0)), settings.median_px)
        area = image.shape[0] ** 2
        return keep_people(mask, PeopleRule(MIN_AREA * area, settings.near * image.shape[0], settings.max_hole * area))

    return {
        "iou": lambda image: np.where(pipeline.run(image).image_mask == FOREGROUND, np.uint8(255), np.uint8(0)),
        "iou_candidates_person": lambda image: pipeline.run(image).image_mask,
        "iou_no_shadow_test": lambda image: keep.run(image).image_mask,
        "iou_mog2": partial(of, trained(opencv(False, cv2.createBackgroundSubtractorMOG2), clip.empty)),
        "iou_mog2_shadow": partial(of, trained(opencv(True, cv2.createBackgroundSubtractorMOG2), clip.empty)),
        "iou_knn": partial(of, trained(opencv(False, cv2.createBackgroundSubtractorKNN), clip.empty)),
    }


def score(found: np.ndarray, truth: np.ndarray) -> tuple[float, float, float]:
    """IoU, precision, recall."""
    both = np.count_nonzero(cv2.bitwise_and(found, truth))
    either, seen, there = (max(int(np.count_nonzero(m)), 1) for m in (cv2.bitwise_or(found, truth), found, truth))
    return both / either, both / seen, both / there


def score_clips(name: str, clips: list[Clip], table: Table) -> dict[str, dict[str, float]]:
    """Add the clip's rows; return IoU by method, and recall of ours."""
    results: dict[str, list[np.ndarray]] = {}
    for clip in clips:
        for method, run in methods(clip).items():
            rows = [score(run(image), truth) for image, truth in zip(clip.frames, clip.truth, strict=True)]
            results.setdefault(method, []).append(np.array(rows))
    for method, cameras in results.items():
        iou, precision, recall = np.mean([rows.mean(axis=0) for rows in cameras], axis=0)
        worst = min(rows[:, 2].min() for rows in cameras)
        each, label = " ".join(f"{rows[:, 0].mean():.2f}" for rows in cameras), method[4:] or "ours"
        table.row(name, label, iou, precision, recall, worst, f" {each}")
    figures = {m: {name: round(float(np.mean([r[:, 0].mean() for r in rows])), 3)} for m, rows in results.items()}
    return figures | {"recall": {name: round(float(np.mean([r[:, 2].mean() for r in results["iou"]])), 3)}}


def quality(studio: Session, quick: bool) -> dict[str, dict[str, float]]:
    figures: dict[str, dict[str, float]] = {}
    table = Table(
        "clip:<27 | method:<18 | IoU:>6.3f | precision:>9.3f | recall:>7.3f | lowest:>7.3f |  IoU of each camera:<1"
    )
    sessions = {"studio": studio, **dict(shared_sessions())}
    for name, session in sessions.items():
        cameras = session.rig.cameras[:: 3 if quick and name != "studio" else 1]
        every = 10 if name == "studio" else 40 if quick else 20
        clips = [read_clip(session, camera, every) for camera in cameras]
        for key, clip in score_clips(name, clips, table).items():
            figures.setdefault(key, {}).update(clip)
    return figures


# --- cost ------------------------------------------------------------------------------------------------------------


def interleaved_ms(works: dict[str, Callable[[np.ndarray], object]], frames: list[np.ndarray], rounds: int) -> dict:
    """Median of each work over all frames; the works take turns on every frame."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for image in frames * rounds:
        for name, work in works.items():
            begin = time.perf_counter()
            work(image)
            times[name].append(time.perf_counter() - begin)
    return {name: 1e3 * float(np.median(values)) for name, values in times.items()}


def cost(kind: str, clip: Clip, rounds: int) -> dict[str, float]:
    """Print the tables of one kind of image; return its figures."""
    pipeline, thesis = (
        SilhouettePipeline(clip.camera, clip.background, None, BackgroundSettings(rule=rule)) for rule in RULES
    )
    background = AdaptiveBackground(clip.background, BackgroundSettings(), BLOCK_PX)
    checks, limits, now_ns = FrameChecks(None, clip.background.mean), clip.background.limits(BackgroundSettings()), [0]
    distance = np.empty(clip.frames[0].shape[:2], np.uint8)

    def follow(image: np.ndarray) -> None:
        now_ns[0] += 16_666_667
        background.follow(image, now_ns[0])

    mog2, knn = (
        trained(opencv(False, make), clip.empty)
        for make in (cv2.createBackgroundSubtractorMOG2, cv2.createBackgroundSubtractorKNN)
    )
    ms = interleaved_ms(
        {
            "whole chain": pipeline.run,
            "  of it: follow light, noise, displacement": follow,
            "  of it: distance from the background": lambda image: background.distance(image, distance),
            "whole chain, the thesis's rule": thesis.run,
            "subtraction alone, the thesis's rule": limits.subtract,
            "MOG2 (subtraction alone)": lambda image: mog2.apply(image, None, FROZEN),
            "KNN (subtraction alone)": lambda image: knn.apply(image, None, FROZEN),
            "frame checks": lambda image: checks.check(image, now_ns[0]),
        },
        clip.frames,
        rounds,
    )
    height, width = clip.frames[0].shape[:2]
    table = Table({"stage": "<44", "ms": ">8.3f"}, f"{kind}, {width} x {height}, one thread, median ms a frame")
    for name, value in ms.items():
        table.row(name, value)
    ours, alone = ms["whole chain"], ms["subtraction alone, the thesis's rule"]
    others = ms["MOG2 (subtraction alone)"], ms["KNN (subtraction alone)"]
    figures = {
        "ms": ours,
        "mog2_ratio": others[0] / ours,
        "knn_ratio": others[1] / ours,
        "subtract_mog2_ratio": others[0] / alone,
    }
    return {f"{kind}_{name}": round(value, 3) for name, value in figures.items()}


def wire(clip: Clip) -> dict[str, float]:
    """Bytes and milliseconds of the silhouettes' messages."""
    masks = [SilhouettePipeline(clip.camera, clip.background).run(image).mask for image in clip.frames]
    sizes = [len(silhouette_message(mask, 0, "").data) for mask in masks]
    ms = interleaved_ms({"png": lambda mask: silhouette_message(mask, 0, "")}, masks, 3)["png"]
    marked = sum(bool((mask == SHADOW_CANDIDATE).any()) for mask in masks)
    print(f"\nmessage: {np.mean(sizes):.0f} bytes, {ms:.2f} ms ({marked} of {len(masks)} have three levels)")
    return {"png_bytes": round(float(np.mean(sizes))), "png_ms": round(ms, 3)}


def tinted(clip: Clip) -> Clip:
    """A mono clip as a colour one."""

    def colour(image: np.ndarray) -> np.ndarray:
        return cv2.convertScaleAbs(cv2.merge([image] * 3) * TINT)

    mean, sigma = (np.asarray(cv2.merge([array] * 3) * TINT) for array in (clip.background.mean, clip.background.sigma))
    background = BackgroundModel(mean, sigma, clip.background.provenance)
    return Clip(clip.camera, background, [colour(i) for i in clip.empty], [colour(i) for i in clip.frames], clip.truth)


def colour_clip(studio: Clip, quick: bool) -> Clip:
    """Real colour footage where it is, else the studio, tinted."""
    folder = SHARED / "real_4cam"
    if not folder.is_dir():
        return tinted(studio)
    session = load_session(folder)
    camera = session.rig.cameras[2]
    reader, frames = open_footage(session.videos[camera.name]), []
    for k in range(41 if quick else 100):
        image = reader.read()
        frames += [image] if image is not None and k % 8 == 0 else []
    reader.close()
    background = read_background(session.backgrounds[camera.name], frames[0].shape, BackgroundSettings())
    still = np.rint(background.mean).astype(np.uint8)
    return Clip(camera, background, [still] * TRAINING_FRAMES, frames, [])


def picture(clip: Clip, path: Path) -> None:
    """The frame with the outlines; how it differs from the background; the mask's three levels."""
    image, k = clip.frames[len(clip.frames) // 2], len(clip.frames) // 2
    levels = SilhouettePipeline(clip.camera, clip.background).run(image).image_mask
    difference = cv2.convertScaleAbs(image.astype(np.float32) - clip.background.mean, alpha=3.0)
    panels = [outline(image, levels)]
    for panel in (difference, levels):
        panels.append(cv2.resize(cv2.cvtColor(panel, cv2.COLOR_GRAY2BGR), panels[0].shape[1::-1]))
    if not cv2.imwrite(str(path), np.hstack(panels)):
        raise SystemExit(f"{path} cannot be written")
    print(f"{path}: frame, difference, levels; IoU {score(np.where(levels == 255, levels, 0), clip.truth[k])[0]:.3f}")


def main() -> None:
    given = parser(__doc__, quick="fewer cameras and frames")
    given.add_argument("--picture", type=Path, metavar="FILE", help="only write the picture")
    arguments = given.parse_args()
    quick = arguments.quick or arguments.picture is not None
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="sagoma_bench_") as folder:
        write_session(
            Path(folder) / "studio",
            ring(2 if quick else 5),
            Body.from_stature(1.75),
            fps=10,
            seconds=8 if quick else 12,
        )
        studio = load_session(Path(folder) / "studio")
        clip = read_clip(studio, studio.rig.cameras[0], 5)
        if arguments.picture is not None:
            picture(clip, arguments.picture)
            return
        figures["disagreements"] = disagreements(quick)
        figures |= quality(studio, quick)
    rounds = 2 if quick else 10
    figures |= cost("mono", clip, rounds) | cost("colour", colour_clip(clip, quick), rounds) | wire(clip)
    finish(figures)


if __name__ == "__main__":
    execute(main)
