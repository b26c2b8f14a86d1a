"""Silhouettes of a clip by every method of bench/rooms.py, scored: our own chain with its cameras together, and rivals.

Everything is scored on the undistorted canvas. Rivals learn from the same empty room, with the parameters that their
authors chose, once going on to learn and once frozen, with their shadows removed and kept; the best of these counts.
Their masks go through our majority filter and component rules, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product

import cv2
import numpy as np
from room_clips import PERSON_PX, RoomClip

from camera_client.background.model import BackgroundLearner
from camera_client.background.training_verdict import HAND
from camera_client.settings import SilhouetteSettings
from camera_client.silhouettes.components import PeopleRule, keep_people
from camera_client.silhouettes.masks import majority
from hull_server.grid import BrickVolume
from hull_server.hull_pipeline import HullPipeline, HullResult, PendingHull
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import Masks, MocapPipeline

SENT, JUDGED = "ours", "judged"
PERSON_ABOVE = 127
"""Of our sixteen levels those above are the person."""
RIVAL_SHADOW = 127
"""The level by which OpenCV's subtractors mark shadows."""
VISIBLE_SIGMAS = 3.0
LEARNING, FROZEN = -1.0, 1e-6
"""Learning rates: the author's own; and none (at 0 OpenCV's KNN divides by log(1 - rate) and goes on to learn)."""

CV2_RIVALS: Mapping[str, Callable[..., cv2.BackgroundSubtractor]] = {
    "MOG2": cv2.createBackgroundSubtractorMOG2,
    "KNN": cv2.createBackgroundSubtractorKNN,
}


@dataclass
class Score:
    """IoU, recall and false foreground (share of the picture), summed over masks."""

    iou: list[float] = field(default_factory=list)
    recall: list[float] = field(default_factory=list)
    false: list[float] = field(default_factory=list)

    def add(self, found: np.ndarray, truth: np.ndarray) -> None:
        """Take one mask (h, w), foreground where not 0."""
        there, seen = int(np.count_nonzero(truth)), int(np.count_nonzero(found))
        both = int(np.count_nonzero(cv2.bitwise_and(found, truth)))
        self.false.append((seen - both) / truth.size)
        if there >= PERSON_PX:
            self.iou.append(both / (there + seen - both))
            self.recall.append(both / there)

    def figures(self) -> dict[str, float]:
        """Return the means by name, rounded."""
        return dict(zip(("iou", "recall", "false_percent"), (round(v, 4) for v in self.means()), strict=True))

    def means(self) -> tuple[float, float, float]:
        """IoU, recall, and false foreground in percent of the picture."""
        iou, recall = (float(np.mean(values)) if values else np.nan for values in (self.iou, self.recall))
        return iou, recall, 100 * float(np.mean(self.false))


class CanvasTruth:
    """The exact masks of a clip on the canvas, and the score of what is found there."""

    def __init__(self, clip: RoomClip) -> None:
        self.views = {name: clip.rig.camera(name).undistorted_view() for name in clip.scored_cameras}
        self.clip = clip
        self._masks: dict[tuple[str, int], np.ndarray] = {}

    def of(self, camera: str, frame: int) -> np.ndarray:
        """The exact mask (h, w), 0 or 255."""
        key = camera, frame
        if key not in self._masks:
            self._masks[key] = self.views[camera].undistort_mask(self.clip.truth[camera][frame])
        return self._masks[key]


def visible_share(clip: RoomClip) -> float:
    """Return the share of the person's pixels that differ from the room by VISIBLE_SIGMAS times the noise in a channel.

    What does not is seen by nobody, but guessed from what is around it. Light and camera must not have changed.
    """
    seen = there = 0
    for camera in clip.scored_cameras:
        empty = clip.empty[camera].astype(np.float32)
        mean, limit = empty.mean(axis=0), VISIBLE_SIGMAS * float(np.median(empty.std(axis=0)))
        for frame in clip.scored:
            person = clip.truth[camera][frame] > 0
            differs = np.abs(clip.take[camera][frame] - mean) > limit
            seen += int((differs.reshape(*person.shape, -1).any(axis=2) & person).sum())
            there += int(person.sum())
    return seen / max(there, 1)


# --- ours


def segment(pipeline: MocapPipeline, stamp_ns: int, images: Mapping[str, np.ndarray]) -> tuple[Masks, Masks]:
    """Return the masks of one instant as the cameras send them, and as they are after the cameras' joint judgement."""
    sent = pipeline.segment(stamp_ns, images)
    pipeline.carve(stamp_ns, sent)
    assert isinstance(pipeline.hull, WatchedHull) and pipeline.hull.judged is not None
    return sent, {name: pipeline.hull.judged.get(name, mask) for name, mask in sent.items()}


class WatchedHull(HullPipeline):
    """Keeps the masks of the last frame set as all cameras judged them; cameras that were left out are not in it.

    What may be floor in shadow denies no body above it: such foreground is the person where it shows the hull."""

    judged: Masks | None = None

    def finish(self, pending: PendingHull) -> HullResult:
        """Finish as usual."""
        result = super().finish(pending)
        self.judged = dict(result.masks)
        for name, mask in result.masks.items():
            doubted = (pending.frame_set.frames[name] > PERSON_ABOVE) & (mask <= PERSON_ABOVE)
            self.judged[name] = np.where(doubted, self._shown(name, result.volume), mask)
        return result

    def _shown(self, camera: str, hull: BrickVolume) -> np.ndarray:
        """Return the mask (h, w), 0 or 255, of a hull on a camera's canvas."""
        index = self.views.number[camera]
        P, size = self.views.P[index], self.views.sizes[index]
        points = hull.grid.centres_world(hull.voxels()) @ P[:, :3].T + P[:, 3]
        pixels = np.rint(points[:, :2] / points[:, 2:]).astype(int)
        columns, rows = pixels[((pixels >= 0) & (pixels < size)).all(axis=1)].T
        shown = np.zeros(size[::-1], np.uint8)
        shown[rows, columns] = 255
        side = 2 * round(self.views.px_per_m(self._rig.volume)[index] * hull.grid.voxel_size / 2) + 1
        return cv2.dilate(shown, np.ones((side, side), np.uint8))


def our_pipeline(clip: RoomClip, settings: Mapping[str, object]) -> MocapPipeline:
    """Return the whole chain, with backgrounds learned from the clip's empty room."""
    backgrounds = {}
    for camera, frames in clip.empty.items():
        learner = BackgroundLearner()
        for image in frames:
            learner.add(np.ascontiguousarray(image))
        backgrounds[camera] = learner.model(clip.name)
    configuration = Configuration.of({"hull_server.backend": "cpu", **settings})
    pipeline = MocapPipeline(clip.rig, configuration, backgrounds)
    pipeline.hull = WatchedHull(clip.rig, configuration.hull)
    return pipeline


def our_scores(clip: RoomClip, truth: CanvasTruth, settings: Mapping[str, object]) -> dict[str, Score]:
    """Run the whole chain over a clip, every frame; return the score as sent and as judged."""
    pipeline = our_pipeline(clip, settings)
    scores, scored = {SENT: Score(), JUDGED: Score()}, set(clip.scored)
    for frame in range(clip.frames):
        found = segment(pipeline, clip.stamp_ns(frame), clip.images(frame))
        if frame in scored:
            for camera, (score, masks) in product(truth.views, zip(scores.values(), found, strict=True)):
                person = np.where(masks[camera] > PERSON_ABOVE, np.uint8(255), np.uint8(0))
                score.add(person, truth.of(camera, frame))
    return scores


# --- rivals


def rival_scores(clip: RoomClip, truth: CanvasTruth) -> dict[str, Score]:
    """Return the score of OpenCV's own subtractors, each in its best variant."""
    best: dict[str, Score] = {}
    for name, make in CV2_RIVALS.items():
        variants: dict[tuple[float, bool], Score] = {(r, s): Score() for r in (LEARNING, FROZEN) for s in (False, True)}
        for camera, rate in product(truth.views, (LEARNING, FROZEN)):
            subtractor = make()
            for image in clip.empty[camera]:
                subtractor.apply(image)
            scored = set(clip.scored)
            for frame in range(clip.frames):
                raw = subtractor.apply(clip.take[camera][frame], None, rate)
                if frame in scored:
                    for keeps in (False, True):
                        mask = tidy(cv2.compare(raw, 0 if keeps else RIVAL_SHADOW, cv2.CMP_GT))
                        canvas = truth.views[camera].undistort_mask(mask)
                        variants[rate, keeps].add(canvas, truth.of(camera, frame))
        best[name] = max(variants.values(), key=lambda score: score.means()[0])  # mean IoU
    return best


def tidy(mask: np.ndarray) -> np.ndarray:
    """A rival's mask (H, W), 0 or 255, through our majority filter and component rules."""
    settings, height = SilhouetteSettings(), len(mask)
    filtered, area = majority(mask), height * height
    return keep_people(filtered, PeopleRule(HAND * area, settings.near * height, settings.max_hole * area))
