"""Coverage of the tracker's covariances: share of the truth inside the 95 % ellipsoids, point by point.

    python bench/covariance_coverage.py SESSION [SESSION ...] [--exact] [--set NODE.PARAMETER=VALUE ...]

One row a point, one column a session; 90 to 99 % is consistent, and a constant offset of a joint is inside always or
never. The columns after them: the least and most of the sessions; pooled over them the share, the mean normalised
squared error (NEES; 3 when covariances are right), and the standard deviation to add (mm, each direction, in
quadrature) so that 95 % of the pooled errors are inside; negative: to take away. They check JOINT_SD_M in
`ekf_tracker/joint_uncertainty.py` and CELLS_OF_A_DATUM in `stick_figure/least_squares/independent_rows.py`. The last
line is JSON: {session: {point: share}}.
"""

from __future__ import annotations

from pathlib import Path

from report import Table, add_settings, execute, finish, parser

import numpy as np
from scenes import session_with_truth

from capture_rig.session import Session
from mocap_pipeline.configuration import Configuration
from sagoma_bringup.first_pose import start_settings
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.in_process import track_session
from sagoma_tools.evaluation.scores import squared_distances
from stick_figure.skeleton import POINT_NAMES

CHI2_95_3DOF = 7.814727903251179
WANTED = 0.95
LARGEST_M = 0.3


def errors_and_covariances(session: Session, settings: dict[str, object], exact: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors (F, 15, 3) m and covariances (F, 15, 3, 3) m^2 of the frames that are tracked and have a truth."""
    assert session.truth is not None
    configuration = Configuration.of(start_settings(session, "auto") | {"hull_server.backend": "cpu"} | settings)
    track = track_session(session, configuration, exact_masks=exact).at(session.truth.frames)
    tracked = np.isfinite(track.points_world).all(axis=(1, 2))
    errors = session.truth.comparable(track.points_world) - session.truth.points_world
    return errors[tracked], track.covariance[tracked]


def share_inside(errors: np.ndarray, covariances: np.ndarray, added_m2: float = 0.0) -> float:
    """Share of the known errors (n, 3) inside the 95 % ellipsoids of their covariances (n, 3, 3), each widened."""
    known = np.isfinite(errors).all(axis=1)
    if not known.any():
        return float("nan")
    variances, axes = np.linalg.eigh(covariances[known])
    along = np.einsum("nij,ni->nj", axes, errors[known])
    widened = np.maximum(variances + added_m2, 1e-6)
    return float((((along**2) / widened).sum(axis=1) < CHI2_95_3DOF).mean())


def missing_sd_mm(errors: np.ndarray, covariances: np.ndarray) -> float:
    """Standard deviation to add in quadrature so that 95 % are inside, by bisection; negative: to take away."""
    low, high = -(LARGEST_M**2), LARGEST_M**2
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if share_inside(errors, covariances, middle) > WANTED else (middle, high)
    return 1e3 * float(np.sign(high) * np.sqrt(abs(high)))


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("sessions", nargs="+", type=Path, help="session folders with a reference")
    given.add_argument("--exact", action="store_true", help="exact silhouettes instead of segmented footage")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    found = {
        path.name: errors_and_covariances(session_with_truth(path), settings, arguments.exact)
        for path in arguments.sessions
    }
    pooled = tuple(np.concatenate(parts) for parts in zip(*found.values(), strict=True))
    last = {"least": ">7.0%", "most": ">7.0%", "all": ">7.0%", "NEES": ">7.1f", "sd mm": ">7.0f"}
    shown = Table({"inside 95 %": "<16", **{n[:14]: ">15.0%" for n in found}, **last})
    table: dict[str, dict[str, float]] = {name: {} for name in found}
    for i, point in enumerate(POINT_NAMES):
        for name, (errors, covariances) in found.items():
            table[name][point] = round(share_inside(errors[:, i], covariances[:, i]), 4)
        shares, all_of_it = [column[point] for column in table.values()], (pooled[0][:, i], pooled[1][:, i])
        squared = squared_distances(*all_of_it)
        pooled_figures = (share_inside(*all_of_it), float(np.nanmean(squared)), missing_sd_mm(*all_of_it))
        shown.row(point, *shares, min(shares), max(shares), *pooled_figures)
    finish(table)


if __name__ == "__main__":
    execute(main)
