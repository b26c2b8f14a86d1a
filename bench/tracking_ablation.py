"""What each part of the tracker is worth: the whole chain, videos in, once a row and a session.

    python bench/tracking_ablation.py SESSION [SESSION ...] [--exact]
    python bench/tracking_ablation.py output/people/walk_ring5top.pkl ...     # hulls that bench/people.py has carved

The first rows go from the thesis's method to ours, one part more in each (`sagoma evaluate SESSION --ablation`); the
others take one thing away from ours, or change it. Every session is segmented and carved once, for all rows. A cell is
the mean error of the 15 points in mm / the share of frames with a point more than 200 mm off / the share of point
errors inside the track's own 95 % ellipsoid. --exact takes the sessions' exact silhouettes instead of segmenting their
footage. The last line is JSON: {row: {session: {"mean_mm", "over_200mm", "inside_95"}}}.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import numpy as np
from products import load
from scenes import session_with_truth

from capture_rig.session import Session, Truth
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_bringup.first_pose import start_settings
from sagoma_tools.evaluation.in_process import OURS, SOLVE, ablation_rows, track_variants
from sagoma_tools.evaluation.scores import Scores, score
from sagoma_tools.evaluation.track import Track

CHANGES: dict[str, dict[str, object]] = {
    "ours without the hull's surface": {SOLVE + "volume.weight": 0.0},
    "ours without contour rays": {SOLVE + "contour.weight": 0.0},
    "ours without the search for better poses": {"icp_tracker.recovery.search": False},
    "ours without refined sizes": {"icp_tracker.refinement.keyframes": 0},
    "ours, build of the average": {"icp_tracker.refinement.build_sd": 1e-6},
    "ours, a rigid trunk": {SOLVE + "contour.bend": 0.0, "ekf_tracker.filter.bend": 0.0},
    "ours, hands and feet stiff": {SOLVE + "contour.turn_sd": 0.0},
    "ours, joint centres of the figure": {SOLVE + "contour.joint_centres": False},
    "ours, loose prior": {SOLVE + "prior": 4.0},
    "ours, identity model": {"ekf_tracker.motion_model": "identity"},
    "ours, every error new in every set": {"ekf_tracker.filter.measurement_bias.share": 0.0},
    "ours, joints known for certain": {"ekf_tracker.filter.measurement_bias.joints": 0.0},
}
KEYS = ("mean_mm", "over_200mm", "inside_95")


def rows_of(start: Mapping[str, Any]) -> dict[str, Configuration]:
    """Every row's configuration, ours first."""
    settings = {**start, "hull_server.backend": "cpu"}
    rows = ablation_rows(settings)
    rows |= {name: Configuration.of(settings | change) for name, change in CHANGES.items()}
    return {OURS: rows[OURS]} | rows


def scores_of(session: Session, exact: bool) -> dict[str, Scores | None]:
    """Every row's scores; None where it found no body."""
    assert session.truth is not None
    tracks = track_variants(session, rows_of(start_settings(session, "auto")), exact_masks=exact)
    return {name: score(track, session.truth) if len(track) else None for name, track in tracks.items()}


def scores_on_hulls(path: Path) -> dict[str, Scores | None]:
    """The same over the hulls of a set of bench/people.py, scored against its first person."""
    what, found = load(path), {}
    known = np.flatnonzero(np.isfinite(what.truths[0]).any(axis=(1, 2)))
    truth = Truth(known, what.truths[0][known], None, 1.0, path)
    for name, configuration in rows_of(what.start).items():
        follower, rows = BodyFollower.of(configuration, what.rig), []
        for frame, products in enumerate(what.products):
            state = follower.step(products).state
            if state is not None:
                rows.append((frame, state))
        found[name] = score(Track.of_states(rows), truth) if rows else None
    return found


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("sessions", nargs="+", type=Path, help="session folders with a reference")
    given.add_argument("--exact", action="store_true", help="exact silhouettes instead of segmented footage")
    arguments = given.parse_args()
    columns = {
        path.stem: scores_on_hulls(path)
        if path.suffix == ".pkl"
        else scores_of(session_with_truth(path), arguments.exact)
        for path in arguments.sessions
    }
    shown = Table({"mm / over 200 mm / inside 95 %": "", **dict.fromkeys(columns, "")}, markdown=True)
    table: dict[str, dict[str, dict[str, float] | None]] = {}
    for row in [*ablation_rows({}), *CHANGES]:
        found = {name: column[row] for name, column in columns.items()}
        shown.row(row, *(cell(scores) for scores in found.values()))
        table[row] = {
            name: scores and {key: round(float(getattr(scores, key)), 4) for key in KEYS}
            for name, scores in found.items()
        }
    finish(table)


def cell(scores: Scores | None) -> str:
    """A cell of the table."""
    if scores is None:
        return "no body"
    return f"{scores.mean_mm:.1f} / {scores.over_200mm:.2f} / {scores.inside_95:.2f}"


if __name__ == "__main__":
    execute(main)
