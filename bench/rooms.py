"""Scores silhouettes in rooms that change, beside the background subtractors of the field.

    python bench/rooms.py --quick      # two minutes: one value of each disturbance
    python bench/rooms.py              # everything

Rows: sessions of the test data, as they are and with disturbances added after decoding (bench/room_disturbances.py).
The last line is JSON: rows (each with clip, disturbance, and by method IoU, recall and false foreground in percent of
the picture), worst_iou (of ours as sent), ahead_in_all (is ours as sent ahead of every rival in every row).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import numpy as np
from room_clips import of_session, open_clip
from room_disturbances import Disturbance
from room_methods import CV2_RIVALS, JUDGED, SENT, CanvasTruth, our_scores, rival_scores
from scenes import shared_sessions

SECONDS, QUICK_SECONDS = 5.0, 3.0
MONO, COLOUR = "walk_ring5top", "charleston2_ring5top_drift"
AS_THEY_ARE = (
    "walk_ring5top",
    "charleston_ring5top",
    "zombie_he3",
    "walk_ring5top_touched",
    "charleston2_ring5top_drift",
)


@dataclass(frozen=True)
class Row:
    """A clip under a disturbance."""

    clip: str
    disturbance: Disturbance


def disturbances(quick: bool) -> list[Disturbance]:
    """Every disturbance by itself, over its whole range."""
    if quick:
        return [
            Disturbance(brightness=0.1, flicker=0.01),
            Disturbance(brightness=-0.2, sudden=True),
            Disturbance(shift_px=1.0),
            Disturbance(things=3),
            Disturbance(noise=4.0),
        ]
    made = [Disturbance(brightness=share, sudden=s) for s in (False, True) for share in (-0.2, -0.1, 0.1, 0.2)]
    made += [Disturbance(flicker=share) for share in (0.01, 0.02)]
    made += [Disturbance(shift_px=px) for px in (0.3, 0.7, 1.0, 2.0)]
    made += [Disturbance(things=count) for count in (1, 3, 5)]
    return made + [Disturbance(noise=levels) for levels in (1.0, 2.0, 4.0, 6.0)]


def rows(clips: list[str], quick: bool) -> Iterator[Row]:
    for clip in clips:
        yield Row(clip, Disturbance())
    for clip in (MONO, COLOUR):
        if clip in clips:
            yield from (Row(clip, disturbance) for disturbance in disturbances(quick))


def measure(folder: Path, row: Row) -> dict[str, Any]:
    """One row: the figures of every method."""
    clip = row.disturbance.apply(open_clip(folder / row.clip))
    truth = CanvasTruth(clip)
    scores = our_scores(clip, truth, {}) | rival_scores(clip, truth)
    figures: dict[str, Any] = {"clip": row.clip, "disturbance": str(row.disturbance)}
    for method, score in scores.items():
        figures[method] = dict(zip(("iou", "recall", "false_percent"), np.round(score.means(), 4), strict=True))
    return figures


def table(folder: Path, wanted: list[Row], jobs: int) -> list[dict[str, Any]]:
    """Measure and print all rows."""
    methods = (SENT, JUDGED, *CV2_RIVALS)
    heads = {"clip": "<27", "disturbance": "<20"} | {m: ">7.3f" for m in methods}
    shown = Table(heads | {"recall": ">7.3f", "false %": ">8.2f", "judged %": ">8.2f", "ahead": ">6"})
    done = []
    with ProcessPoolExecutor(jobs) as pool:
        for figures in pool.map(measure, [folder] * len(wanted), wanted):
            ious = [figures[m]["iou"] for m in methods]
            ahead = "yes" if is_ahead(figures) else "no"
            ours = figures[SENT]
            false = ours["false_percent"], figures[JUDGED]["false_percent"]
            shown.row(figures["clip"], figures["disturbance"], *ious, ours["recall"], *false, ahead)
            done.append(figures)
    return done


def is_ahead(figures: dict[str, Any]) -> bool:
    """Whether ours as sent has the highest IoU."""
    return all(figures[SENT]["iou"] >= figures[rival]["iou"] for rival in CV2_RIVALS)


def main() -> None:
    given = parser(__doc__, quick="one value of each disturbance, three seconds of each clip")
    given.add_argument("--only", default="", help="rows whose clip or disturbance has this in its name")
    given.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = given.parse_args()
    with tempfile.TemporaryDirectory(prefix="sagoma_rooms_") as temporary:
        folder, clips = Path(temporary), []
        for name, session in shared_sessions([f"sessions/{name}" for name in AS_THEY_ARE]):
            of_session(name, session, QUICK_SECONDS if arguments.quick else SECONDS).save(folder / name)
            clips.append(name)
        wanted = [row for row in rows(clips, arguments.quick) if arguments.only in f"{row.clip}: {row.disturbance}"]
        measured = table(folder, wanted, arguments.jobs)
    worst = min((row[SENT]["iou"] for row in measured), default=np.nan)
    finish({"rows": measured, "worst_iou": worst, "ahead_in_all": all(map(is_ahead, measured))})


if __name__ == "__main__":
    execute(main)
