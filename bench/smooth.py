"""What `sagoma smooth` makes of a take: error, jitter and coverage of the filter, and of the smoother on the same fits.

    python bench/smooth.py [NAME ...] [--products FOLDER] [--set NODE.PARAMETER=VALUE ...]

The first person of every set of `bench/people.py` (those with a NAME in theirs). Columns, each of the filter and then
of the smoother (+): mean error of the 15 points, mm; jitter: the rms of the error's third difference as white noise an
axis, mm (of real motion it holds nothing that the truth does not); share of the errors inside the track's own 95 %
ellipsoids, all and of the worst point. The last line is JSON.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Recorded
from people import KEPT, recorded

from ekf_tracker.smoother import Set, smooth
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.state import BodyState, NoState
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.scores import covariance_coverage

JUMP_M = 0.1  # a larger third difference is a limb that was found again, and no jitter
FIGURES = ("mean_mm", "jitter_mm", "inside_95", "worst_point_inside_95")


def both(what: Recorded, settings: dict[str, Any]) -> tuple[list[BodyState | NoState], list[BodyState | NoState]]:
    """The filter's answers, and the smoother's to the same fits."""
    configuration = Configuration.of({"hull_server.backend": "cpu", **what.start, **settings})
    follower = BodyFollower.of(configuration, what.rig)
    filtered, sets = [], []
    for products in what.products:
        step = follower.step(products)
        filtered.append(step.answer)
        sets.append(Set(products.stamp_ns, step.fit.reference_points, follower.tracker.body_of(FIRST_PERSON)))
    return filtered, smooth(sets, configuration.ekf)


def figures(answers: list[BodyState | NoState], truth: np.ndarray) -> dict[str, float]:
    """The columns of one track."""
    errors, covariances = np.full((len(truth), 15, 3), np.nan), np.full((len(truth), 15, 3, 3), np.nan)
    for frame, answer in enumerate(answers[: len(truth)]):
        if isinstance(answer, BodyState):
            errors[frame], covariances[frame] = answer.points_world - truth[frame], answer.point_covariance
    coverage = covariance_coverage(errors, covariances)
    third = np.minimum((np.diff(errors, 3, axis=0) ** 2).sum(-1), JUMP_M**2)
    values = (
        1e3 * np.nanmean(np.linalg.norm(errors, axis=2)),
        1e3 * np.sqrt(np.nanmean(third) / 60.0),  # white noise of variance v an axis: 3 (1 + 9 + 9 + 1) v
        coverage.inside_95,
        np.nanmin(coverage.point_inside_95),
    )
    return {name: round(float(value), 4) for name, value in zip(FIGURES, values, strict=True)}


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    given.add_argument("--products", type=Path, default=KEPT, help="where hulls are kept")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    columns = ("mean:>6.1f", "mean+:>6.1f", "jitter:>6.2f", "jitter+:>7.2f", "inside:>7.1%", "inside+:>7.1%")
    shown = Table(" | ".join(("set:<40", *columns, "worst:>6.0%", "worst+:>6.0%")))
    table: dict[str, dict[str, dict[str, float]]] = {}
    for what in recorded(arguments.products, arguments.names):
        answers = both(what, settings)
        if not any(isinstance(answer, BodyState) for answer in answers[0]):
            continue
        before, after = (figures(one, what.truths[0]) for one in answers)
        shown.row(what.name, *[value for name in FIGURES for value in (before[name], after[name])])
        table[what.name] = {"filter": before, "smoother": after}
    finish(table)


if __name__ == "__main__":
    execute(main)
