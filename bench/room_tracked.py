"""Tracked drills of bench/rooms.py. --holes: a person of whom cameras miss a third, and things that stand in their way.
--lab: two men in an ordinary laboratory, against points clicked by hand.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from time import process_time
from typing import Any

from report import Table

import cv2
import numpy as np
from scenes import SHARED, shared_sessions

from capture_rig.mask_levels import BACKGROUND, UNCERTAIN
from capture_rig.rig import load_rig
from capture_rig.session import Session, footage_stamp_ns, load_session
from mocap_packets.frame_set import FrameSet
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from mocap_pipeline.session_footage import EPOCH_NS, exact_silhouettes, frame_sets, pipeline_of
from stick_figure.skeleton import POINT_NAMES

SESSION, FRAMES = "walk_ring5top", 160
CAMERAS, HOLES = (6, 4, 3), (0, 1, 2)
TRUNK = 0.2, 0.53  # shares of a silhouette's height from the top on: from the shoulders to the hips
KINDS = {"denied": BACKGROUND, "uncertain": UNCERTAIN}
KNEES, DESK_REACH, PILLAR_HALF = 0.72, 1.0, 0.12  # of a silhouette's height: how far down, and how wide things are
LEARN_S = 3.0  # things in the way are scored after that
BAD_MM = 200.0
FOLDER = SHARED / "lab_two_men"
REFINED = "rig.yaml"
WAYS = {
    "refined": (REFINED, 0, 1.0),
    "from frame 3": (REFINED, 3, 1.0),
    "from frame 7": (REFINED, 7, 1.0),
    "from frame 12": (REFINED, 12, 1.0),
    "from frame 20": (REFINED, 20, 1.0),
    "7 % darker": (REFINED, 0, 0.93),
    "5 % brighter": (REFINED, 0, 1.05),
    "as found": ("rig_as_found.yaml", 0, 1.0),
}
"""The rig, the first frame that is seen, and how much brighter pictures are: small causes decide when a first pose is
sure."""
MEN = ("1", "2")
NEAR_M = 0.6  # whoever is followed so near to where a man stands is he: places are known to 0.1 or 0.2 m
FEWEST_CAMERAS = 3
WRIST = 0.58  # of the forearm's stick, which ends at the finger tips (Drillis & Contini 1966)
ENDS = {"ankle": "foot", "wrist": "hand"}

Track = dict[int, np.ndarray]  # reference points (15, 3) m by frame


def holes() -> dict[str, Any]:
    """Print the table and return its figures: rows by cameras, of how many something is missing, and what it is."""
    table, rows = Table("cameras:>7d | of these:>8d | miss:<10 | tracked:>7.2f | mean mm:>7.1f | over 200:>8.3f"), []
    for _, session in shared_sessions([f"sessions/{SESSION}"]):
        frames = list(islice(exact_silhouettes(session), FRAMES))
        for cameras, count in ((c, h) for c in CAMERAS for h in HOLES):
            for kind in (*KINDS, "desk", "pillar") if count else ("nothing",):
                row = {"cameras": cameras, "holes": count, "as": kind, **track(session, frames, cameras, count, kind)}
                table.row(*(row[key] for key in ("cameras", "holes", "as", "tracked", "mean_mm", "over_200mm")))
                rows.append(row)
    return {"rows": rows}


def track(session: Session, frames: list[dict[str, np.ndarray]], cameras: int, count: int, kind: str) -> dict[str, Any]:
    """Track with the rig's first cameras, of which ``count`` miss something; shares and millimetres."""
    names, truth = session.rig.names[:cameras], session.truth
    assert truth is not None
    points = dict(zip(truth.frames.tolist(), truth.stick_figure_points(), strict=True))
    rig = replace(session.rig, cameras=tuple(session.rig.camera(name) for name in names))
    hidden = {name: in_the_way(kind, [masks[name] for masks in frames]) for name in names[:count]}
    pipeline, errors, tracked = MocapPipeline(rig, Configuration.of({})), [], 0
    first = round(LEARN_S * session.fps) if kind in ("desk", "pillar") else 0
    clip = frames if first == 0 else [*frames, *frames[::-1]]  # there and back: time to learn
    for frame, masks in enumerate(clip):
        seen = {name: masks[name] for name in names}
        for name in hidden:
            if kind in KINDS:
                seen[name] = with_hole(masks[name], KINDS[kind])
            else:
                seen[name] = np.where(hidden[name], np.uint8(BACKGROUND), masks[name])
        step = pipeline.step_masks(footage_stamp_ns(EPOCH_NS, frame, session.fps), seen)
        if step.state is not None and frame >= first:
            tracked += 1
            of_truth = frame if frame < len(frames) else 2 * len(frames) - 1 - frame
            errors += list(_errors_mm(step.fit.reference_points_world, points.get(of_truth)))
    found = np.array(errors or [np.nan])
    over = float((found > BAD_MM).mean()) if errors else float("nan")
    return {"tracked": tracked / (len(clip) - first), "mean_mm": float(found.mean()), "over_200mm": over}


def in_the_way(kind: str, masks: list[np.ndarray]) -> np.ndarray:
    """Return the pixels (h, w) bool (bool) hidden where the person walks: by a desk up to the knees, or a pillar."""
    boxes = np.array([cv2.boundingRect(mask) for mask in masks if mask.any()])
    left, top, width, height = np.median(boxes, axis=0)
    hidden = np.zeros(masks[0].shape, bool)
    reach = (DESK_REACH if kind == "desk" else PILLAR_HALF) * height
    columns = slice(max(round(left + 0.5 * width - reach), 0), round(left + 0.5 * width + reach))
    hidden[round(top + KNEES * height) if kind == "desk" else 0 :, columns] = True
    return hidden


def with_hole(mask: np.ndarray, level: int) -> np.ndarray:
    """Return a silhouette (h, w) whose trunk is of another level."""
    rows, holed = np.flatnonzero(mask.any(axis=1)), mask.copy()
    if len(rows):
        top, height = rows[0], rows[-1] - rows[0]
        part = holed[int(top + TRUNK[0] * height) : int(top + TRUNK[1] * height)]
        part[part > 0] = level
    return holed


def _errors_mm(points_world: np.ndarray, truth_world: np.ndarray | None) -> Iterator[float]:
    if truth_world is not None:
        apart = 1e3 * np.linalg.norm(points_world - truth_world, axis=1)
        yield from apart[np.isfinite(apart)]


# --- the laboratory


def laboratory() -> dict[str, Any]:
    """Print the table and return its figures, a row for each of WAYS."""
    if not FOLDER.is_dir():
        print(f"{FOLDER} is not there: no laboratory")
        return {"rows": []}
    table = Table("rig:<13 | tracked:<16 | first:<10 | switches:>8d | median mm:>9.0f | ms:>5.1f | of head, ...:<60")
    rows = []
    for name, way in WAYS.items():
        tracks, warning, ms = follow(*way)
        row = {"rig": name, **score(tracks), "warning": warning, "hull_ms": ms[0], "fit_ms": ms[1]}
        shares = ", ".join(f"{found} of {all_}" for found, all_ in row["tracked"])
        parts = " ".join(f"{part} {mm:.0f}" for part, mm in row["median_mm_of"].items())
        table.row(name, shares, str(row["first_frames"]), row["switches"], row["median_mm"], sum(ms), parts)
        rows.append(row)
        if warning:
            print(f"  {warning}")
    return {"rows": rows}


def follow(rig_file: str, first: int, brighter: float) -> tuple[dict[int, Track], str, list[float]]:
    """Track the clip with defaults; everybody who is not lost, by number, the last warning about cameras, and the
    medians of the server's processor time a set, ms: hull, and tracker with filter."""
    session = replace(load_session(FOLDER), rig=load_rig(FOLDER / rig_file))
    pipeline, tracks, warning = pipeline_of(session, Configuration.of({})), defaultdict[int, Track](dict), ""
    ms: list[tuple[float, float]] = []
    for frame, (stamp_ns, taken) in islice(enumerate(frame_sets(session)), first, None):
        images = {name: np.clip(brighter * image, 0.0, 255.0).astype(np.uint8) for name, image in taken.items()}
        masks, began = pipeline.segment(stamp_ns, images), process_time()
        hull, carved = pipeline.hull.run(FrameSet.of_instant(stamp_ns, masks)), process_time()
        step = pipeline.body.step(hull.products)
        ms.append((1e3 * (carved - began), 1e3 * (process_time() - carved)))
        pipeline.report_support(hull.support)
        for person in step.people:
            if person.fit.state in ("tracking", "doubtful"):
                tracks[person.person][frame] = np.array(person.fit.reference_points_world)
        suspects = pipeline.body.tracker.extrinsic_errors.suspects
        warning = "; ".join(dict.fromkeys((*hull.camera_faults.reasons.values(), *suspects.values()))) or warning
    return tracks, warning, np.median(ms, axis=0).tolist()


def score(tracks: dict[int, Track]) -> dict[str, Any]:
    """Compare with where the men stand, and with the points clicked by hand."""
    found, expected, numbers = dict.fromkeys(MEN, 0), dict.fromkeys(MEN, 0), defaultdict[str, list[int]](list)
    places, first = dict[tuple[int, str], np.ndarray](), dict[str, int | None](dict.fromkeys(MEN))
    for row in _rows("places.csv"):
        frame, man = int(row["frame"]), row["person"]
        places[frame, man] = np.array([float(row["x"]), float(row["y"])])
        if row["in_volume"] == "1" and len(row["cams_seeing_body"]) >= FEWEST_CAMERAS:
            expected[man] += 1
            number = _who(tracks, frame, places[frame, man])
            if number is not None:
                found[man] += 1
                numbers[man].append(number)
                first[man] = min(tracks[number]) if first[man] is None else first[man]
    errors = defaultdict[str, list[float]](list)
    for row in _rows("hand_points.csv"):
        frame, (part, _, side) = int(row["frame"]), row["point"].partition("_")
        number = _who(tracks, frame, places[frame, row["person"]])
        if number is not None:
            apart = _point(tracks[number][frame], part, side) - [float(row[axis]) for axis in "xyz"]
            errors[part].append(1e3 * float(np.linalg.norm(apart)))
    every = [mm for part in errors.values() for mm in part]
    return {
        "tracked": [(found[man], expected[man]) for man in MEN],
        "first_frames": [first[man] for man in MEN],
        "switches": sum(a != b for man in MEN for a, b in zip(numbers[man], numbers[man][1:], strict=False)),
        "points": len(every),
        "median_mm": float(np.median(every or [np.nan])),
        "median_mm_of": {part: float(np.median(mm)) for part, mm in errors.items()},
    }


def _who(tracks: dict[int, Track], frame: int, place: np.ndarray) -> int | None:
    """Return the number of whoever is followed at a place (2,) m."""
    apart = [(float(np.linalg.norm(t[frame][0, :2] - place)), n) for n, t in tracks.items() if frame in t]
    nearest = min(apart, default=(np.inf, 0))
    return nearest[1] if nearest[0] < NEAR_M else None


def _point(points_world: np.ndarray, part: str, side: str) -> np.ndarray:
    """Return the place (3,) m of a point clicked by hand on a figure's points (15, 3)."""
    if part == "head":
        return np.asarray(points_world[POINT_NAMES.index("head")])
    body_side = {"l": "left", "r": "right"}[side]
    end = points_world[POINT_NAMES.index(f"{body_side}_{ENDS.get(part, part)}")]
    if part != "wrist":
        return np.asarray(end)
    elbow = points_world[POINT_NAMES.index(f"{body_side}_elbow")]
    return np.asarray(elbow + WRIST * (end - elbow))


def _rows(name: str) -> list[dict[str, str]]:
    with (Path(FOLDER) / name).open(newline="") as file:
        return list(csv.DictReader(file))
