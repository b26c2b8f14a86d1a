"""How honest the tracker's covariances are: share of the truth inside the 95 % ellipsoids, point by point.

    python bench/covariance_coverage.py SESSION [SESSION ...] [--exact] [--set NODE.PARAMETER=VALUE ...]

One row a point, one column a session. Honest is 85 to 99 %. The last two columns pool the sessions: the share, and the
additional standard deviation (mm, each direction, in quadrature) with which 95 % of the pooled errors would be inside;
a negative one is what could be taken away. They tell how to change `ekf_tracker`'s parameters
filter.measurement_bias.*. The last line is JSON: {session: {point: share}}.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from sagoma_tools.evaluation.chain import Configuration
from sagoma_tools.evaluation.in_process import track_session
from sagoma_tools.evaluation.live_run import start_settings
from stick_figure.skeleton import POINT_NAMES

CHI2_95_3DOF = 7.814727903251179
WANTED = 0.95
LARGEST_M = 0.3


def errors_and_covariances(session: Session, settings: dict[str, object], exact: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors (F, 15, 3) m and covariances (F, 15, 3, 3) m^2 of the frames that are tracked and have a truth."""
    if session.truth is None:
        raise InputError("has no truth.csv or reference*.csv", where=str(session.folder), remedy="Leave it out.")
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="+", type=Path, help="session folders with a reference")
    parser.add_argument("--exact", action="store_true", help="exact silhouettes instead of segmented footage")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE", help="change a setting")
    arguments = parser.parse_args()
    settings = {key: yaml.safe_load(value) for key, _, value in (text.partition("=") for text in arguments.set)}
    found = {
        path.name: errors_and_covariances(load_session(path), settings, arguments.exact) for path in arguments.sessions
    }
    pooled = tuple(np.concatenate(parts) for parts in zip(*found.values(), strict=True))
    print(f"{'inside 95 %':16}" + "".join(f"{name[:14]:>16}" for name in found) + f"{'all':>8}{'sd mm':>8}")
    table: dict[str, dict[str, float]] = {name: {} for name in found}
    for i, point in enumerate(POINT_NAMES):
        for name, (errors, covariances) in found.items():
            table[name][point] = round(share_inside(errors[:, i], covariances[:, i]), 4)
        all_of_it = pooled[0][:, i], pooled[1][:, i]
        cells = "".join(f"{100 * shares[point]:15.0f}%" for shares in table.values())
        print(f"{point:16}{cells}{100 * share_inside(*all_of_it):7.0f}%{missing_sd_mm(*all_of_it):8.0f}")
    print(json.dumps(table))


if __name__ == "__main__":
    main()
