"""Hands and feet by how fast they move: error of fit and filter, and how late each is.

    python bench/fast_motion.py [NAME ...] [--products FOLDER] [--set NODE.PARAMETER=VALUE ...]

The first person of every set of `bench/people.py` in which a hand or foot is faster than 5 m/s (those with a NAME in
theirs). A row is a band of speeds. Columns: hands and feet in the band, counted frame by frame; mean error of the
fitted and of the filtered points, mm; lag of both: the median, over the band, of how far the point is behind the truth
along its velocity, divided by the speed, ms (below 1 m/s the error says nothing about time). The last line is JSON.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Recorded
from people import KEPT, recorded

from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_tools.arguments import parse_settings
from stick_figure.skeleton import POINT_NAMES

TIPS = [POINT_NAMES.index(name) for name in ("left_hand", "right_hand", "left_foot", "right_foot")]
BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, 30.0))
"""Speeds, m/s."""
FAST_M_S = 5.0
FEWEST = 10
"""Of a band that is shown."""


def tips_of(what: Recorded, settings: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Fitted and filtered hands and feet (F, 4, 3) m of a set; NaN where there is no state."""
    configuration = Configuration.of({"hull_server.backend": "cpu", **what.start, **settings})
    follower = BodyFollower.of(configuration, what.rig)
    fitted = np.full((len(what.truths[0]), len(TIPS), 3), np.nan)
    filtered = fitted.copy()
    for frame, products in enumerate(what.products[: len(fitted)]):
        step = follower.step(products)
        if step.state is not None:
            fitted[frame] = step.fit.reference_points.points_world[TIPS]
            filtered[frame] = step.state.points_world[TIPS]
    return fitted, filtered


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    given.add_argument("--products", type=Path, default=KEPT, help="where hulls are kept")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    shown = Table(
        "set:<40 | m/s:>6 | tips:>6d | fit mm:>7.1f | filter mm:>9.1f | fit lag ms:>10.2f | filter lag ms:>13.2f"
    )
    table: dict[str, dict[str, list[float]]] = {}
    for what in recorded(arguments.products, arguments.names):
        truth = what.truths[0][:, TIPS]
        velocity = np.gradient(truth, axis=0) * what.fps
        speed = np.linalg.norm(velocity, axis=2)
        if not (np.nan_to_num(speed) > FAST_M_S).any():
            continue
        tracks = tips_of(what, settings)
        known = np.isfinite(tracks[1]).all(axis=2) & np.isfinite(speed)
        for low, high in BANDS:
            band = known & (speed >= low) & (speed < high)
            if band.sum() < FEWEST:
                continue
            errors = [(track - truth)[band] for track in tracks]
            means = [1e3 * np.linalg.norm(error, axis=1).mean() for error in errors]
            behind = [-(error * velocity[band]).sum(axis=1) / speed[band] ** 2 for error in errors] if low else []
            row = [*means, *(1e3 * np.median(late) for late in behind)]
            shown.row(what.name, f"{low:g}-{high:g}", band.sum(), *row, *[None] * (4 - len(row)))
            table.setdefault(what.name, {})[f"{low:g}-{high:g}"] = [round(float(value), 3) for value in row]
    finish(table)


if __name__ == "__main__":
    execute(main)
