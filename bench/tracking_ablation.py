"""What each part of the tracker is worth: the whole chain, videos in, once a row and a session.

    python bench/tracking_ablation.py SESSION [SESSION ...] [--exact]

The first rows go from the thesis's method to ours, one part more in each (`sagoma evaluate SESSION --ablation`); the
others take one thing away from ours, or change it. Every session is segmented and carved once, for all rows. A cell is
the mean error of the 15 points in mm / the share of frames with a point more than 200 mm off / the share of point
errors inside the track's own 95 % ellipsoid. --exact takes the sessions' exact silhouettes instead of segmenting their
footage. The last line is JSON: {row: {session: {"mean_mm", "over_200mm", "inside_95"}}}.
"""

from __future__ import annotations

from pathlib import Path

from report import Table, execute, finish, parser

from scenes import session_with_truth

from capture_rig.session import Session
from mocap_pipeline.configuration import Configuration
from sagoma_tools.evaluation.in_process import OURS, SOLVE, ablation_rows, track_variants
from sagoma_tools.evaluation.live_run import start_settings
from sagoma_tools.evaluation.scores import Scores, score

CHANGES: dict[str, dict[str, object]] = {
    "ours without sticks inside the hull": {SOLVE + "volume.inside_weight": 0.0},
    "ours without the hull's surface": {SOLVE + "volume.weight": 0.0},
    "ours without contour rays": {SOLVE + "contour.weight": 0.0},
    "ours without the search for better poses": {"icp_tracker.recovery.search": False},
    "ours without refined sizes": {"icp_tracker.refinement.keyframes": 0},
    "ours, loose prior": {
        SOLVE + "prior.position_sd_m": 1.0,
        SOLVE + "prior.rotation_sd": 1.0,
        SOLVE + "prior.ball_sd": 0.7,
        SOLVE + "prior.hinge_sd": 0.7,
    },
    "ours, arms may cross the torso": {SOLVE + "volume.clearance_weight": 0.0},
    "ours, identity model": {"ekf_tracker.motion_model": "identity"},
}
KEYS = ("mean_mm", "over_200mm", "inside_95")


def rows_of(session: Session) -> dict[str, Configuration]:
    """Every row's configuration, ours first."""
    settings = start_settings(session, "auto") | {"hull_server.backend": "cpu"}
    rows = ablation_rows(settings)
    rows |= {name: Configuration.of(settings | change) for name, change in CHANGES.items()}
    return {OURS: rows[OURS]} | rows


def scores_of(session: Session, exact: bool) -> dict[str, Scores | None]:
    """Every row's scores; None where it found no body."""
    assert session.truth is not None
    tracks = track_variants(session, rows_of(session), exact_masks=exact)
    return {name: score(track, session.truth) if len(track) else None for name, track in tracks.items()}


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("sessions", nargs="+", type=Path, help="session folders with a reference")
    given.add_argument("--exact", action="store_true", help="exact silhouettes instead of segmented footage")
    arguments = given.parse_args()
    sessions = {path.name: session_with_truth(path) for path in arguments.sessions}
    columns = {name: scores_of(session, arguments.exact) for name, session in sessions.items()}
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
    return f"{scores.mean_mm:.0f} / {scores.over_200mm:.2f} / {scores.inside_95:.2f}"


if __name__ == "__main__":
    execute(main)
