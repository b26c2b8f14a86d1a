"""Drills of bench/rooms.py that take time, in the studio: what happens, in figures.

ten minutes : somebody stands for five minutes, then sits, swaying by millimetres, while the light drifts by 12 % and
one lamp warms up beside the others. lamp : switched on and off. door : opened and closed. touched : each camera in turn
moved by 0.3, 1, 3 px. jump : the person is gone from one frame to the next. Everything goes through the whole chain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from report import Table

import cv2
import numpy as np
from room_clips import EPOCH_NS, SENSOR, Look, RoomClip, Studio
from room_disturbances import moved
from room_methods import JUDGED, PERSON_ABOVE, SENT, Score, our_pipeline, segment
from scenes import STATURE_M

from stick_figure.body import Body
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.rendering.camera import VirtualCamera
from virtual_studio.rig import HALF_WIDTH_M, open_door, view_room

LONG_HZ, DRILL_HZ = 5.0, 15.0
DRIFT, WARMING = 0.12, 0.04
"""Of all light over ten minutes, and of the lamp at one side besides."""
SWAY_M, SWAYS = 0.004, 10
STANDS_AT_S, SITS_AT_S = 1.7, 3.9
"""When the studio's motion "sitting" stands, and sits."""
LAMP = 0.25
"""Share by which a lamp adds to the light near it."""
EMPTY_FRAMES = 45
GONE_PX = 60
"""Masks with fewer pixels are empty."""

Images = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Moment:
    """One instant of a drill: the time, and every camera's light and exact mask before sensor and lens."""

    t_s: float
    light: Images
    truth: Images


@dataclass
class Watch:
    """Scores of one camera or of all, by span of time and by stage."""

    scores: dict[tuple[str, str], Score] = field(default_factory=dict)

    def add(self, span: str, stage: str, found: np.ndarray, truth: np.ndarray) -> None:
        """Take one mask on the canvas, levels, with the exact one."""
        person = np.where(found > PERSON_ABOVE, np.uint8(255), np.uint8(0))
        self.scores.setdefault((span, stage), Score()).add(person, truth)

    def of(self, span: str, stage: str) -> dict[str, float]:
        """Return IoU, recall, false foreground."""
        return self.scores[span, stage].figures() if (span, stage) in self.scores else {}


class Drill:
    """The chain in the studio, fed instant by instant."""

    def __init__(self, look: Look) -> None:
        self.studio = Studio(look)
        self.names = self.studio.rig.names
        empty = {name: self.studio.empty_frames(name, EMPTY_FRAMES) for name in self.names}
        self.clip = RoomClip("a drill", self.studio.rig, DRILL_HZ, empty, {}, {})
        self._views = {camera.name: camera.undistorted_view() for camera in self.studio.rig.cameras}
        self._fields: Images = {}

    def run(
        self,
        moments: Iterable[Moment],
        span: Callable[[float], str],
        disturb: Callable[[str, float, np.ndarray], np.ndarray] = lambda camera, t_s, picture: picture,
        watched: tuple[str, ...] = (),
    ) -> Iterator[tuple[Moment, dict[str, Images]]]:
        """Yield each moment with the masks of every stage on the canvas; score them by the name of their span.

        disturb : what happens to a camera's picture; the exact mask goes with it. watched : the cameras that count.
        """
        pipeline, self.watch = our_pipeline(self.clip, {}), Watch()
        for k, moment in enumerate(moments):
            images = {
                name: disturb(name, moment.t_s, SENSOR.expose(moment.light[name], number, k))
                for number, name in enumerate(self.names)
            }
            stages = segment(pipeline, EPOCH_NS + round(moment.t_s * 1e9), images)
            found = dict(zip((SENT, JUDGED), stages, strict=True))
            for name in watched or self.names:
                exact = self._views[name].undistort_mask(disturb(name, moment.t_s, moment.truth[name]))
                truth = np.where(exact > 127, np.uint8(255), np.uint8(0))
                for stage, masks in found.items():
                    self.watch.add(span(moment.t_s), stage, masks[name], truth)
            yield moment, found

    def scored(
        self, moments: Iterable[Moment], edges: tuple[float, ...], names: tuple[str, ...], *how: Any
    ) -> dict[str, dict[str, dict[str, float]]]:
        """Run, and return the scores of every stage between two edges (s), by the names of these spans."""
        for _ in self.run(moments, lambda t_s: _span(t_s, edges, names), *how):
            pass
        return {name: {stage: self.watch.of(name, stage) for stage in (SENT, JUDGED)} for name in names}

    def walk(self, seconds: float, hz: float = DRILL_HZ) -> Iterator[Moment]:
        """Yield the person walking."""
        for k, pose in enumerate(MOTIONS["walk"](Body.from_stature(STATURE_M), seconds, hz).poses):
            yield self.seen(k / hz, pose)

    def seen(self, t_s: float, pose: Pose) -> Moment:
        """Return what the cameras see of a pose."""
        capsules, shadow = self.studio.shadow(pose)
        seen = {name: self.studio.seen(name, capsules, shadow) for name in self.names}
        return Moment(t_s, {n: light for n, (light, _) in seen.items()}, {n: mask for n, (_, mask) in seen.items()})

    def near_lamp(self, camera: str) -> np.ndarray:
        """Return how near a lamp over +x +y is to what each pixel sees, 0..1: (H, W[, 1])."""
        if camera not in self._fields:
            model = self.studio.rig.camera(camera)
            view = view_room(model)
            with np.errstate(divide="ignore", invalid="ignore"):
                walls = np.abs(HALF_WIDTH_M / np.abs(view.rays[..., :2])).min(axis=2)
            places = model.centre_world[:2] + 0.6 * walls[..., None] * view.rays[..., :2]
            near = 1.0 / (1.0 + ((places - [2.0, 1.5]) ** 2).sum(axis=2) / 6.0)
            near = cv2.GaussianBlur(near.astype(np.float32), (0, 0), 20.0)
            self._fields[camera] = near[..., None] if self.studio.look.colour else near
        return self._fields[camera]

    def lit(self, moment: Moment, everywhere: float, lamp: float) -> Moment:
        """Return the moment under other light: shares by which all of it, and that near the lamp, is more."""
        light = {n: part * (1 + everywhere + lamp * self.near_lamp(n)) for n, part in moment.light.items()}
        return Moment(moment.t_s, {n: part.astype(np.float32) for n, part in light.items()}, moment.truth)


# --- the drills


def ten_minutes(look: Look, seconds: float) -> dict[str, Any]:
    """Score the first and the last minute (tenth) of somebody who stands and then sits."""
    drill = Drill(look)
    poses = MOTIONS["sitting"](Body.from_stature(STATURE_M), SITS_AT_S + 0.1, 20.0).poses
    postures = {}
    for name, at_s in (("stands", STANDS_AT_S), ("sits", SITS_AT_S)):
        pose = poses[round(20.0 * at_s)]
        places = [pose.position_world + SWAY_M * np.array([np.sin(a), np.cos(1.7 * a), 0]) for a in range(SWAYS)]
        postures[name] = [drill.seen(0.0, replace(pose, position_world=place)) for place in places]
    rng = np.random.default_rng(5)

    def moments() -> Iterator[Moment]:
        sway = 0
        for k in range(round(seconds * LONG_HZ)):
            t_s = k / LONG_HZ
            sway = int(np.clip(sway + rng.integers(-1, 2), 0, SWAYS - 1))
            moment = postures["stands" if t_s < seconds / 2 else "sits"][sway]
            share = t_s / seconds
            yield drill.lit(Moment(t_s, moment.light, moment.truth), DRIFT * share, WARMING * share)

    tenth = seconds / 10
    for _ in drill.run(moments(), lambda t_s: f"minute {int(t_s // tenth) + 1}"):
        pass
    return {f"minute {k}": {s: drill.watch.of(f"minute {k}", s) for s in (SENT, JUDGED)} for k in (1, 5, 6, 7, 10)}


def lamp(look: Look) -> dict[str, Any]:
    """Switch a lamp on after 4 s and off after 9 s."""
    drill, edges = Drill(look), (0.0, 4.0, 4.5, 9.0, 9.5, 13.0)
    names = ("before", "half a second on", "on", "half a second off", "off")
    moments = (drill.lit(m, 0.0, LAMP if 4.0 <= m.t_s < 9.0 else 0.0) for m in drill.walk(13.0))
    return drill.scored(moments, edges, names)


def door(look: Look) -> dict[str, Any]:
    """Open a door after 3 s, within one second, and close it after 15 s."""
    drill, edges = Drill(look), (0.0, 3.0, 5.0, 8.0, 15.0, 17.0, 20.0)
    names = ("before", "opens", "open 2 to 5 s", "open 5 to 12 s", "closes", "closed")
    usual = dict(drill.studio.cameras)
    eyes = {
        share: {n: VirtualCamera(e.camera, open_door(e.camera, view_room(e.camera), share)) for n, e in usual.items()}
        for share in (0.25, 0.5, 0.75, 1.0)
    }

    def moments() -> Iterator[Moment]:
        body = Body.from_stature(STATURE_M)
        for k, pose in enumerate(MOTIONS["walk"](body, 20.0, DRILL_HZ).poses):
            t_s = k / DRILL_HZ
            share = np.ceil(4 * min(np.clip(t_s - 3.0, 0, 1), np.clip(16.0 - t_s, 0, 1))) / 4
            drill.studio.cameras = eyes.get(float(share), usual)
            yield drill.seen(t_s, pose)

    return drill.scored(moments(), edges, names)


def touched(look: Look, pixels: float, camera: str) -> dict[str, Any]:
    """Move one camera's picture by so much after 2 s, to the right and a little down; score that camera."""
    drill, edges = Drill(look), (0.0, 2.0, 3.0, 6.0, 9.0)
    names = ("before", "first second", "1 to 4 s", "4 to 7 s")
    offset = pixels * np.array([0.9, 0.436])

    def disturb(name: str, t_s: float, picture: np.ndarray) -> np.ndarray:
        if name != camera or t_s < 2.0:
            return picture
        return np.rint(moved(picture.astype(np.float32), offset)).clip(0, 255).astype(np.uint8)

    return drill.scored(drill.walk(9.0), edges, names, disturb, (camera,))


def jump(look: Look) -> dict[str, Any]:
    """Take the person out of the room after 5 s; return seconds until every camera's mask is empty."""
    drill, gone_at, last = Drill(look), 5.0, dict.fromkeys((SENT, JUDGED), 0.0)
    nothing = {
        n: np.zeros((c.height, c.width), np.uint8) for n, c in zip(drill.names, drill.studio.rig.cameras, strict=True)
    }

    def moments() -> Iterator[Moment]:
        for m in drill.walk(12.0):
            yield m if m.t_s < gone_at else Moment(m.t_s, {n: drill.studio.empty(n) for n in drill.names}, nothing)

    for moment, found in drill.run(moments(), lambda t_s: "there" if t_s < gone_at else "gone"):
        for stage, masks in found.items():
            if any(np.count_nonzero(mask > PERSON_ABOVE) > GONE_PX for mask in masks.values()):
                last[stage] = moment.t_s - gone_at + 1 / DRILL_HZ
    return {stage: {"empty_after_s": round(max(value, 0.0), 2)} for stage, value in last.items()}


def _span(t_s: float, edges: tuple[float, ...], names: tuple[str, ...]) -> str:
    return next((name for (a, b), name in zip(pairwise(edges), names, strict=True) if a <= t_s < b), names[-1])


# --- tables


def print_spans(title: str, spans: dict[str, Any]) -> None:
    """Print a drill's spans of time."""
    table = Table("when:<20 | ours:>7.3f | judged:>7.3f | recall:>7.3f | false %:>8.2f | judged %:>8.2f", title)
    for name, stages in spans.items():
        sent, judged = stages[SENT], stages[JUDGED]
        table.row(name, sent["iou"], judged["iou"], sent["recall"], sent["false_percent"], judged["false_percent"])


def long_drills(looks: Iterable[Look], seconds: float) -> dict[str, Any]:
    """Run and print ten minutes, lamp, door, and every camera touched."""
    figures: dict[str, Any] = {}
    for look in looks:
        for name, drill in (("ten minutes", lambda look: ten_minutes(look, seconds)), ("lamp", lamp), ("door", door)):
            figures[f"{look}: {name}"] = drill(look)
            print_spans(f"{look}: {name}", figures[f"{look}: {name}"])
        cameras = Studio(look).rig.names
        for pixels in (0.3, 1.0, 3.0):
            runs = [touched(look, pixels, camera) for camera in cameras]
            means = {
                span: {
                    s: {k: float(np.mean([r[span][s][k] for r in runs])) for k in runs[0][span][s]}
                    for s in (SENT, JUDGED)
                }
                for span in runs[0]
            }
            figures[f"{look}: touched by {pixels:g} px"] = means
            print_spans(f"{look}: each camera in turn moved by {pixels:g} px, mean", means)
    return figures


def jumps(looks: Iterable[Look]) -> dict[str, Any]:
    """Run and print the jump."""
    table, figures = Table("clip:<34 | sent empty after s:>18.2f | judged empty after s:>20.2f"), {}
    for look in looks:
        figures[f"{look}: jump"] = found = jump(look)
        table.row(str(look), *(found[stage]["empty_after_s"] for stage in (SENT, JUDGED)))
    return figures
