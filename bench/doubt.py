"""Whether doubt is right: wrong limbs that are called, clear ones that are not, and ellipsoids of doubtful limbs.

    python bench/doubt.py [NAME ...] [--products FOLDER] [--set NODE.PARAMETER=VALUE ...]

Tracks the sets of `bench/people.py` with one person in them (those with a NAME in theirs) as it does. A part of the
body (trunk, arms, legs) is wrong in a frame with one of its points more than 200 mm off; a frame is clear with all
points under 100 mm. A part is called when its published state is doubtful or lost.

Columns: frames with a part over 200 mm, %; parts wrong, of them called, %; of them with all points inside their own
95 % ellipsoids, %; clear frames, and those with any part called, %; parts called with all points inside, %; processor
time of fit and filter, ms a set. The second table is the curve behind the choice of DOUBTFUL_MARGIN: what would be
called if the margin of the other place of a limb alone decided, at that margin. The last line is JSON.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from people import BAD_MM, GOOD_MM, KEPT, recorded
from products import Recorded

from mocap_packets.fit import GOOD, PART_NAMES, PART_POINTS
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.scores import INSIDE_95, squared_distances

SHOWN = (
    *("wrong_frames", "wrong_parts", "wrong_called", "wrong_inside"),
    *("clear_frames", "clear_called", "called_inside", "ms"),
)
MARGINS = (-6.0, -4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 10.0)


@dataclass(frozen=True, eq=False)
class Calls:
    """What is said of the parts (F, 5) of the body in the frames that have a truth and a track.

    wrong, called, inside : bool; margins : of the best other place. clear (F,) : frames with all points right.
    """

    wrong: np.ndarray
    called: np.ndarray
    inside: np.ndarray
    margins: np.ndarray
    clear: np.ndarray

    def figures(self) -> dict[str, Any]:
        """Shares, None where there is nothing of the kind."""
        return {
            "frames": len(self.clear),
            "wrong_frames": _share(self.wrong.any(axis=1)),
            "wrong_parts": int(self.wrong.sum()),
            "wrong_called": _share(self.called[self.wrong]),
            "wrong_inside": _share(self.inside[self.wrong]),
            "clear_frames": int(self.clear.sum()),
            "clear_called": _share(self.called[self.clear].any(axis=1)),
            "called_inside": _share(self.inside[self.called]),
        }

    @classmethod
    def together(cls, several: Sequence[Calls]) -> Calls:
        """The frames of several sets as one."""
        names = ("wrong", "called", "inside", "margins", "clear")
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in names))


def calls_of(what: Recorded, settings: dict[str, Any]) -> tuple[Calls, float]:
    """Track a set; also the processor time of fit and filter, ms a set."""
    follower = BodyFollower.of(Configuration.of({"hull_server.backend": "cpu", **what.start, **settings}), what.rig)
    truth, rows = what.truths[0], []
    began = time.process_time()
    steps = [follower.step(products) for products in what.products]
    ms = 1e3 * (time.process_time() - began) / max(len(steps), 1)
    for points, step in zip(truth, steps, strict=False):
        if step.state is None or not np.isfinite(points).all():
            continue
        error = step.state.points_world - points
        off_mm = 1e3 * np.linalg.norm(error, axis=1)
        inside = squared_distances(error[None], step.state.point_covariance[None])[0] <= INSIDE_95
        own = [list(part) for part in PART_POINTS]
        rows.append(
            (
                [off_mm[part].max() > BAD_MM for part in own],
                [state != GOOD for state in step.state.parts],
                [inside[part].all() for part in own],
                step.fit.quality.margins,
                off_mm.max() < GOOD_MM,
            )
        )
    width = len(PART_NAMES)
    columns = [list(column) for column in zip(*rows, strict=True)] or [[]] * 5
    wrong, called, inside = (np.array(column, bool).reshape(-1, width) for column in columns[:3])
    return Calls(wrong, called, inside, np.array(columns[3]).reshape(-1, width), np.array(columns[4], bool)), ms


def curve(calls: Calls) -> list[dict[str, float | None]]:
    """What margins alone would call."""
    return [
        {
            "margin_rays": margin,
            "wrong_called": _share((calls.margins > margin)[calls.wrong]),
            "clear_called": _share((calls.margins > margin)[calls.clear].any(axis=1)),
        }
        for margin in MARGINS
    ]


def _share(chosen: np.ndarray) -> float | None:
    return round(float(chosen.mean()), 4) if chosen.size else None


def main() -> None:
    """Print the tables and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("names", nargs="*", help="parts of the names of the sets")
    given.add_argument("--products", type=Path, default=KEPT, help="folder of the carved sets")
    add_settings(given)
    arguments = given.parse_args()
    arguments.products.mkdir(parents=True, exist_ok=True)
    settings = parse_settings(arguments.settings)
    table = Table(
        "set:<40 | > 200:>7.1% | wrong:>6d | called:>7.0% | inside:>7.0% | clear:>6d | also called:>12.2%"
        " | called inside:>14.0% | ms:>5.2f"
    )
    every, sets = list[Calls](), dict[str, dict[str, Any]]()
    for what in recorded(arguments.products, arguments.names):
        if len(what.truths) != 1:
            continue
        calls, ms = calls_of(what, settings)
        every.append(calls)
        sets[what.name] = {**calls.figures(), "ms": round(ms, 2)}
        table.row(what.name, *[sets[what.name][key] for key in SHOWN])
    if not every:
        finish({})
        return
    whole = Calls.together(every)
    figures = {**whole.figures(), "ms": round(float(np.mean([one["ms"] for one in sets.values()])), 2)}
    table.row("all", *[figures[key] for key in SHOWN])
    points, shown = curve(whole), Table("margin, rays:>12.0f | wrong called:>12.0% | clear called:>12.2%")
    for point in points:
        shown.row(*point.values())
    finish({"all": figures, "curve": points, "sets": sets})


if __name__ == "__main__":
    execute(main)
