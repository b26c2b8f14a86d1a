"""Scores silhouettes in rooms that change, beside the background subtractors of the field.

    python bench/rooms.py --quick                  # two minutes: one value of each disturbance
    python bench/rooms.py                          # everything
    python bench/rooms.py --rivals PYTHON          # also codecs, and rivals whose figures are not on record yet
    python bench/rooms.py --long | --jump          # drills: ten minutes, lamp, door, touched cameras; an empty room
    python bench/rooms.py --holes                  # a third of the person missing, a desk, a pillar; tracked
    python bench/rooms.py --lab                    # two men in an ordinary laboratory, against points clicked by hand
    python bench/rooms.py --ablation [SESSION ...] # what each part of the silhouettes is worth; tracked

Rows: sessions of the test data as they are; the studio with clothes and shadows of any kind (room_clips.py); a grey
session and the studio in colour with disturbances added after decoding (room_disturbances.py). Every frame is run, with
the stamps of 15 Hz cameras; every second one of two cameras is scored, on the undistorted canvas. Frames within half a
second of a sudden change of light, and within four seconds of things moved, are not scored.

ours : as each camera sends it, above 127 is the person. judged : without what all cameras judge to be floor in shadow.
visible : the share of the person's pixels that differ from the room by three times the noise in any channel.
MOG2, KNN : of OpenCV, learning on and frozen, shadows removed and kept: the best of these. GSOC, SuBSENSE, PAWCS, ViBe
: see room_rivals.py, which also tells how to make PYTHON. All rivals have our majority filter and component rules.
Of the table, the last line is JSON: rows (each with clip, disturbance, and by method IoU,
recall and false foreground in percent of the picture), worst_iou (of ours as sent), ahead_in_all (is ours as sent ahead
of every rival in every row).
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import numpy as np
import room_rivals
from room_ablation import ablation
from room_clips import LOOKS, of_session, open_clip, studio_clip
from room_disturbances import Disturbance
from room_drills import jumps, long_drills
from room_methods import CV2_RIVALS, JUDGED, SENT, CanvasTruth, our_scores, rival_scores, visible_share
from room_tracked import holes, laboratory
from scenes import shared_sessions

SECONDS = 4.0
SESSIONS = ("walk_ring5top", "walk_ring5top_touched", "charleston2_ring5top_drift", "charleston_ring5top", "zombie_he3")
QUICK_SESSIONS = SESSIONS[:3]
MONO, COLOUR = SESSIONS[0], str(next(look for look in LOOKS if look.colour))
STUDIO = {str(look): look for look in LOOKS}
RIVALS = (*CV2_RIVALS, *room_rivals.METHODS)
LONG_S, QUICK_LONG_S = 600.0, 120.0
STORED_NOISE = 2.0
"""Of the sensor before a codec, grey levels."""


@dataclass(frozen=True)
class Row:
    """A clip under a disturbance."""

    clip: str
    disturbance: Disturbance

    def __str__(self) -> str:
        return f"{self.clip}: {self.disturbance}"


def disturbances(quick: bool, codecs: bool) -> list[Disturbance]:
    """Every disturbance by itself, over its whole range."""
    every = [Disturbance(brightness=share) for share in (-0.2, -0.1, 0.1, 0.2)]
    every += [Disturbance(brightness=share, sudden=True) for share in (-0.2, 0.2)]
    every += [Disturbance(flicker=share) for share in (0.01, 0.02)]
    every += [Disturbance(shift_px=px) for px in (0.3, 1.0, 2.0)]
    every += [Disturbance(things=count) for count in (1, 3, 5)]
    every += [Disturbance(noise=levels) for levels in (1.0, 3.0, 6.0)]
    stored = [("h264", 16), ("h264", 26), ("h264", 35), ("mpeg4", 6), ("mjpeg", 8)] if codecs else []
    every += [Disturbance(noise=STORED_NOISE, codec=codec, quality=quality) for codec, quality in stored]
    chosen = {"slow +10%", "sudden -20%", "flicker 1.0%", "moved 1 px", "3 things", "noise 3", "noise 2, h264 26"}
    return [disturbance for disturbance in every if not quick or str(disturbance) in chosen]


def rows(clips: list[str], wanted: list[Disturbance]) -> list[Row]:
    """Every clip as it is, then the grey and the coloured one with every disturbance."""
    as_they_are = [Row(clip, Disturbance()) for clip in clips]
    return as_they_are + [Row(clip, disturbance) for clip in (MONO, COLOUR) if clip in clips for disturbance in wanted]


def clip_names(quick: bool) -> list[str]:
    """The sessions that are here, and the studio's clips."""
    sessions = [f"sessions/{name}" for name in (QUICK_SESSIONS if quick else SESSIONS)]
    studio = [name for name, look in STUDIO.items() if not quick or name == COLOUR or look.outfit == "room"]
    return [name for name, _ in shared_sessions(sessions)] + studio


def prepare(folder: Path, name: str) -> None:
    """Write a clip into the folder: decoded, or filmed in the studio."""
    if name in STUDIO:
        clip = studio_clip(STUDIO[name], SECONDS)
    else:
        ((_, session),) = shared_sessions([f"sessions/{name}"])
        clip = of_session(name, session, SECONDS)
    clip.save(folder / name)


def measure(folder: Path, python: str, row: Row) -> dict[str, Any]:
    """Return a row's figures by method, and the ``checksum`` of its frames where rivals were measured anew, or None.

    Where the studio's background is that of the take, also which share of the person is visible at all.
    """
    clip = row.disturbance.apply(open_clip(folder / row.clip), python)
    truth = CanvasTruth(clip)
    figures = {method: score.figures() for method, score in our_scores(clip, truth, {}).items()}
    known, scores = room_rivals.recorded(str(row), clip), {}
    if not set(CV2_RIVALS) <= set(known):
        scores |= rival_scores(clip, truth)
    if python and not set(room_rivals.methods_for(clip)) <= set(known):
        scores |= room_rivals.measure_rivals(clip, truth, python)
    number = room_rivals.checksum(clip) if scores else None
    known |= {method: score.figures() for method, score in scores.items()}
    about: dict[str, Any] = {"clip": row.clip, "disturbance": str(row.disturbance), "checksum": number}
    if row.clip in STUDIO and row.disturbance == Disturbance():
        about["visible"] = visible_share(clip)
    return about | figures | known


def table(folder: Path, wanted: list[Row], pool: Executor, python: str) -> list[dict[str, Any]]:
    """Measure and print all rows."""
    heads = {"clip": "<31", "disturbance": "<20"} | {m: ">7.3f" for m in (SENT, JUDGED)} | {m: ">6.3f" for m in RIVALS}
    shown = Table(
        heads | {"recall": ">7.3f", "false %": ">8.2f", "judged %": ">8.2f", "ahead": ">6", "visible": ">8.2f"}
    )
    done = []
    for row, figures in zip(wanted, pool.map(partial(measure, folder, python), wanted), strict=True):
        number = figures.pop("checksum")
        if python and number is not None:
            room_rivals.record(str(row), number, {rival: figures[rival] for rival in RIVALS if rival in figures})
        ious = [figures[m]["iou"] if m in figures else np.nan for m in (SENT, JUDGED, *RIVALS)]
        ours = figures[SENT]
        false = ours["false_percent"], figures[JUDGED]["false_percent"]
        ahead = "yes" if is_ahead(figures) else "no"
        shown.row(row.clip, str(row.disturbance), *ious, ours["recall"], *false, ahead, figures.get("visible"))
        done.append(figures)
    return done


def is_ahead(figures: dict[str, Any]) -> bool:
    """Whether ours as sent has the highest IoU."""
    return all(figures[SENT]["iou"] >= figures[rival]["iou"] for rival in RIVALS if rival in figures)


def main() -> None:
    given = parser(__doc__, quick="one value of each disturbance")
    given.add_argument("--only", default="", help="rows and drills whose clip or disturbance has this in its name")
    given.add_argument("--jobs", type=int, default=1, help="processes")
    given.add_argument(
        "--rivals", default="", metavar="PYTHON", help="interpreter of rivals and codecs (room_rivals.py)"
    )
    given.add_argument("--long", action="store_true", help="drills of minutes instead of the table")
    given.add_argument("--jump", action="store_true", help="a person who is gone from the room instead of the table")
    given.add_argument("--holes", action="store_true", help="a person with holes, tracked, instead of the table")
    given.add_argument("--lab", action="store_true", help="two men in a laboratory instead of the table")
    given.add_argument(
        "--ablation", nargs="*", type=Path, metavar="SESSION", help="parts off in turn, instead of the table"
    )
    arguments = given.parse_args()
    looks = [LOOKS[0]] if arguments.quick else [LOOKS[0], STUDIO[COLOUR]]
    looks = [look for look in looks if arguments.only in str(look)]
    if arguments.long:
        finish(long_drills(looks, QUICK_LONG_S if arguments.quick else LONG_S))
    elif arguments.jump:
        finish(jumps(looks))
    elif arguments.holes:
        finish(holes())
    elif arguments.lab:
        finish(laboratory())
    elif arguments.ablation is not None:
        finish(ablation(arguments.ablation, arguments.quick))
    else:
        whole_table(arguments)


def whole_table(arguments: argparse.Namespace) -> None:
    """Prepare the clips, measure every row."""
    if not arguments.rivals:
        print("no --rivals PYTHON: rows of codecs are left out; of rivals only MOG2 and KNN are there if not on record")
    clips = clip_names(arguments.quick)
    wanted = rows(clips, disturbances(arguments.quick, bool(arguments.rivals)))
    chosen = [row for row in wanted if arguments.only in str(row)]
    with tempfile.TemporaryDirectory(prefix="sagoma_rooms_") as folder, ProcessPoolExecutor(arguments.jobs) as pool:
        list(pool.map(partial(prepare, Path(folder)), dict.fromkeys(row.clip for row in chosen)))
        measured = table(Path(folder), chosen, pool, arguments.rivals)
    worst = min((row[SENT]["iou"] for row in measured), default=np.nan)
    finish({"rows": measured, "worst_iou": worst, "ahead_in_all": all(map(is_ahead, measured))})


if __name__ == "__main__":
    execute(main)
