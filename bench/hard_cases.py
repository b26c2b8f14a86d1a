"""The hard cases by name: each motion of the virtual studio that trackers fail at, from the T-pose on.

    python bench/hard_cases.py [CASE ...] [--cameras 6 8] [--stature 1.75] [--build 1.0] [--video] [--set NODE.PARAM=X]

Every case starts in a T-pose, is carved, and tracked with automatic start and default settings, with exact silhouettes
or (--video) those that the camera client makes of rendered footage with shadow, noise and flicker. Printed are the mean
error of the 15 points, the share of frames with a point more than 200 mm off, the worst point and when, the seconds
until the first track, and when the track was lost and recovered (good: all points < 200 mm and their mean < 60 mm for
0.2 s). A frame counts while the whole person is inside the capture volume. For each case with a frame over 200 mm a
picture of its worst frame lands in output/hard_cases (white: truth). The last line is JSON.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import cv2
import numpy as np
from drills import Outcome, good_spells, play
from scenes import Clip, inside_volume, session_clip, studio_clip

from capture_rig.errors import InputError
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.live_run import distort_mask
from sagoma_tools.overlays.drawing import montage, overlay
from stick_figure.body import Body
from stick_figure.skeleton import POINT_NAMES
from virtual_studio.motions.catalogue import HARD_CASES
from virtual_studio.people import person_of
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

PICTURES = Path("output/hard_cases")
FAR_M = 0.200


@dataclass(frozen=True)
class Figures:
    """One case: see the module's docstring; None where there is nothing to say."""

    mean_mm: float | None
    over_200mm: float
    worst_mm: float | None
    worst_point: str
    worst_s: float | None
    time_to_track_s: float | None
    lost_s: tuple[float, ...]
    recovered_s: tuple[float, ...]


def judged(clip: Clip, outcome: Outcome) -> tuple[Figures, int]:
    """The figures of an undisturbed track, and its worst frame."""
    inside = inside_volume(clip.rig, clip.truth)
    tracked = np.flatnonzero(np.isfinite(outcome.errors_m).any(axis=1))
    if len(tracked) == 0:
        return Figures(None, 1.0, None, "", None, None, (), ()), 0
    counted = inside & (np.arange(len(clip)) >= tracked[0])
    errors = np.where(counted[:, None], outcome.errors_m, np.nan)
    frame, point = np.unravel_index(np.nanargmax(errors), errors.shape)
    lost, recovered = good_spells(errors[counted], np.flatnonzero(counted) / clip.fps)
    return Figures(
        mean_mm=round(float(1e3 * np.nanmean(errors)), 1),
        over_200mm=round(float((errors[counted].max(axis=1) > FAR_M).mean()), 4),
        worst_mm=round(float(1e3 * errors[frame, point]), 0),
        worst_point=POINT_NAMES[point],
        worst_s=round(float(frame / clip.fps), 2),
        time_to_track_s=round(float(tracked[0] / clip.fps), 3),
        lost_s=tuple(round(t, 2) for t in lost),
        recovered_s=tuple(round(t, 2) for t in recovered),
    ), int(frame)


def filmed_clip(case: str, cameras: int, body: Body, build: float) -> Clip:
    """The case as footage, segmented by the camera client."""
    with tempfile.TemporaryDirectory() as folder:
        session = write_session(
            Path(folder) / case,
            ring(cameras - 1),
            body,
            case,
            seconds=HARD_CASES[case].duration_s,
            settings=RenderSettings(build=build),
        )
        return session_clip(session, exact=False)


def draw(clip: Clip, outcome: Outcome, frame: int, path: Path) -> None:
    """The worst frame in every camera: silhouette, truth in white, track in colour."""
    pictures = []
    for name, mask in clip.masks(frame).items():
        camera = clip.rig.camera(name)
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        silhouette = distort_mask(camera, mask)
        pictures.append(overlay(camera, image, silhouette, outcome.points_world[frame], clip.truth[frame]))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), montage(pictures, columns=3))


def cells(figures: Figures) -> tuple[str, ...]:
    """A row's cells after case and cameras."""
    if figures.mean_mm is None:
        return ("not found", "", "", "", "")
    lost = ", ".join(f"{t:.1f}" for t in figures.lost_s) or "-"
    found = ", ".join(f"{t:.1f}" for t in figures.recovered_s) or "-"
    worst = f"{figures.worst_mm:.0f} ({figures.worst_point.replace('_', ' ')}, {figures.worst_s:.1f} s)"
    return (f"{figures.mean_mm:.0f}", f"{100 * figures.over_200mm:.0f} %", worst, lost, found)


def track_case(case: str, cameras: int, arguments: argparse.Namespace, settings: dict[str, Any]) -> Figures:
    """Make, track and judge one case."""
    body = person_of(arguments.stature, arguments.arms, arguments.legs)
    if arguments.video:
        clip = filmed_clip(case, cameras, body, arguments.build)
    else:
        clip = studio_clip(case, HARD_CASES[case].duration_s, cameras, body, arguments.build)
    outcome = play(clip, clip.carved(settings), settings)
    figures, worst = judged(clip, outcome)
    if figures.over_200mm > 0.0:
        draw(clip, outcome, worst, PICTURES / f"{case}_{cameras}{'_video' if arguments.video else ''}.png")
    return figures


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("cases", nargs="*", help="default: all", default=[])
    given.add_argument("--cameras", nargs="+", type=int, default=[6, 8], help="sizes of the rig")
    given.add_argument("--stature", type=float, default=1.75, help="m")
    given.add_argument("--build", type=float, default=1.0, help="thickness over the average's")
    given.add_argument("--arms", type=float, default=1.0, help="length over the average's")
    given.add_argument("--legs", type=float, default=1.0, help="length over the average's")
    given.add_argument("--video", action="store_true", help="footage and own silhouettes instead of exact ones")
    add_settings(given)
    arguments = given.parse_args()
    cases, settings = arguments.cases or list(HARD_CASES), parse_settings(arguments.settings)
    for case in cases:
        if case not in HARD_CASES:
            raise InputError(f"there is no hard case '{case}'", remedy=f"Known: {', '.join(HARD_CASES)}.")
    columns = ("case", "cameras", "mean mm", "over 200 mm", "worst mm (point, time)", "lost at s", "recovered at s")
    shown = Table(dict.fromkeys(columns, ""), markdown=True)
    table: dict[str, dict[str, Any]] = {}
    for case in cases:
        for cameras in arguments.cameras:
            figures = track_case(case, cameras, arguments, settings)
            shown.row(case, cameras, *cells(figures))
            table[f"{case}_{cameras}"] = asdict(figures)
    finish(table)


if __name__ == "__main__":
    execute(main)
