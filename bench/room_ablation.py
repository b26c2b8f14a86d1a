"""What each part of the silhouettes is worth: the whole chain, videos in, with one part off in every row.

``python bench/rooms.py --ablation [SESSION ...]``. A cell is the mean error of the 15 points in mm / the share of
frames with a point more than 200 mm off / the IoU of the silhouettes as sent (what is above 127 is the person; blank
where there are no exact ones). Parts that no setting switches off are replaced for the row by what does nothing. "the
thesis's rule" is background_model.rule: tail, which follows nothing and asks no neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import PropertyMock, patch

from report import Table

import numpy as np
from clips import session_with_truth
from scenes import SHARED

from camera_client.background.kernels import SCALE
from camera_client.background.light import LightEstimator
from camera_client.background.shift import ShiftEstimator
from camera_client.silhouettes.evidence import EvidenceFilter
from camera_client.silhouettes.masks import majority
from capture_rig.errors import InputError
from capture_rig.session import Session
from capture_rig.video import Video
from hull_server.consistency.occluders import OccluderMap
from hull_server.floor_shadows import ShadowResolver
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from sagoma_bringup.launch_arguments import start_settings
from sagoma_tools.evaluation.in_process import track_session
from sagoma_tools.evaluation.scores import score

EVERY = 10  # frames whose masks are scored
CLEAR2 = 15.1  # squared distance of the test of a single pixel: a risk of 1e-4
CAMERAS = "cameras."


@dataclass(frozen=True)
class Row:
    """A part that is off: by settings, or by what replaces it."""

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    replaced: AbstractContextManager[Any] = field(default_factory=nullcontext)


def no_light(self: LightEstimator, samples: Any, *_: Any) -> Any:
    """Keep the light that the background was learned in."""
    return samples[0] - samples[1]


def each_pixel(self: EvidenceFilter, part: Any) -> Any:
    """Decide pixel by pixel, and by the majority around it."""
    return majority(np.where(part.distance > SCALE * CLEAR2, np.uint8(255), np.uint8(0)), 5)


def nothing(*_: Any) -> None:
    """Do nothing, know nothing."""


def as_it_is(self: Any, given: Any, *_: Any) -> Any:
    """Change nothing."""
    return given


ROWS = (
    Row("everything"),
    Row("without following the light", replaced=patch.object(LightEstimator, "update", no_light)),
    Row(
        "without measuring the noise",
        replaced=patch("camera_client.background.noise.measured_noise", lambda *_, **__: None),
    ),
    Row(
        "without following the camera",
        replaced=patch.object(ShiftEstimator, "measurable", PropertyMock(return_value=False)),
    ),
    Row("without the neighbourhood", replaced=patch.object(EvidenceFilter, "decide", each_pixel)),
    Row("without things moved", {CAMERAS + "background_model.moved_things": False}),
    Row("without shadow tests", {CAMERAS + "silhouette.shadow": "keep"}),
    Row("without trimming the outline", {CAMERAS + "silhouette.outline_contrast": 0.0}),
    Row("without codec errors", replaced=patch("camera_client.silhouettes.evidence.codec_error_sigma", nothing)),
    Row("without the others' support", replaced=patch.object(MocapPipeline, "report_support", nothing)),
    Row("without occluders", replaced=patch.object(OccluderMap, "applied", as_it_is)),
    Row("without shadows in the hull", replaced=patch.object(ShadowResolver, "without_shadows", as_it_is)),
    Row("without leaving out cameras", {"hull_server.camera_fault.enabled": False}),
    Row("the thesis's rule", {CAMERAS + "background_model.rule": "tail"}),
)


def figures(session: Session, row: Row) -> dict[str, float | None]:
    """Track a session under a row; None where no body was found, or where there are no exact masks."""
    assert session.truth is not None
    settings = start_settings(session, "auto") | {"hull_server.backend": "cpu"} | dict(row.settings)
    ious: list[float] = []
    with row.replaced, patch.object(MocapPipeline, "segment", scored(session, ious)):
        try:
            track = track_session(session, Configuration.of(settings))
            found = score(track, session.truth)
        except InputError:
            return {"mean_mm": None, "over_200mm": None, "iou": float(np.mean(ious)) if ious else None}
    return {
        "mean_mm": round(found.mean_mm, 2),
        "over_200mm": round(float(found.all_points.over_200mm), 4),
        "iou": round(float(np.mean(ious)), 4) if ious else None,
    }


def scored(session: Session, ious: list[float]) -> Any:
    """Return ``MocapPipeline.segment`` that also scores every tenth frame's masks against the exact ones."""
    segment, exact = MocapPipeline.segment, exact_masks(session)

    def segment_and_score(self: MocapPipeline, stamp_ns: int, images: Any) -> Any:
        masks = segment(self, stamp_ns, images)
        for name, truth in next(exact, {}).items():
            person = masks[name] > 127
            ious.append(float((person & truth).sum() / max((person | truth).sum(), 1)))
        return masks

    return segment_and_score


def exact_masks(session: Session) -> Iterator[dict[str, Any]]:
    """Yield each frame's exact canvas masks by camera: none but for every tenth frame."""
    if not session.masks:
        return
    views = {camera.name: camera.undistorted_view() for camera in session.rig.cameras}
    videos = {name: iter(Video(path)) for name, path in session.masks.items()}
    for k in range(10**6):
        images = {name: next(video, None) for name, video in videos.items()}
        if any(image is None for image in images.values()):
            return
        if k % EVERY:
            yield {}
            continue
        yield {
            n: views[n].undistort_mask(np.where(i[..., 0] > 127, np.uint8(255), np.uint8(0))) > 0
            for n, i in images.items()
        }  # type: ignore[index]


def ablation(folders: list[Path], quick: bool) -> dict[str, Any]:
    """Print the table of these sessions, or of every session of the test data with one person; return its figures."""
    rendered = sorted((SHARED / "sessions").glob("*")) if (SHARED / "sessions").is_dir() else []
    folders = folders or [SHARED / "real_4cam", *(f for f in rendered if not (f / "truth_2.csv").exists())]
    sessions = {folder.name: session_with_truth(folder) for folder in folders if folder.is_dir()}
    table = Table({"row": "<30"} | {name[-18:]: "<22" for name in sessions})
    found: dict[str, Any] = {}
    for row in ROWS[:2] + ROWS[-1:] if quick else ROWS:
        found[row.name] = {name: figures(session, row) for name, session in sessions.items()}
        table.row(row.name, *(cell(each) for each in found[row.name].values()))
    return found


def cell(each: Mapping[str, float | None]) -> str:
    """Return a session's figures as one cell."""
    mm, over, iou = each["mean_mm"], each["over_200mm"], each["iou"]
    error = "no body" if mm is None or over is None else f"{mm:.1f} / {100 * over:.0f} %"
    return error if iou is None else f"{error} / {iou:.3f}"
