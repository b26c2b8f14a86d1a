"""The demo's graph on simulated GigE cameras at several speeds of their clock: the same pictures, the same track?

    python bench/slow_motion.py                      # at full speed, a quarter and a sixteenth
    python bench/slow_motion.py --speeds 1/2 1/8

Every speed is a run of the whole graph as `make demo` starts it, on the same session. Its track is compared with that
of the slowest run at the same camera times: the points' distance, and the root mean square difference of the joint
angles that the truth determines. The sensor's noise differs from run to run. At full speed the graph thins out what
this machine does not hold. The last line is JSON: a record a speed.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from report import Table, execute, finish, parser

import numpy as np

from sagoma_tools.commands.demo import CAMERA_FPS, built_in_session
from sagoma_tools.console import command_console
from sagoma_tools.evaluation.live_run import LiveRun, evaluate_run, run_studio
from stick_figure.skeleton import ANGLE_NAMES
from virtual_studio.gige.command import speed_argument

UNDETERMINED = ("shoulder_y", "hip_z")  # twists of a straight limb: any value fits


def main() -> None:
    """Print the table and the line of JSON."""
    made = parser(__doc__)
    made.add_argument("--speeds", nargs="+", type=speed_argument, default=[1.0, 1 / 4, 1 / 16])
    options = made.parse_args()
    with tempfile.TemporaryDirectory(prefix="slow_motion_") as folder:
        session = built_in_session(Path(folder) / "session", command_console())
        runs = [run_studio(session, Path(folder) / str(k), CAMERA_FPS, s) for k, s in enumerate(options.speeds)]
        table = Table(
            "speed:>7.4g | sets:>5d | answered:>8.1% | incomplete:>10d | mean mm:>8.1f | > 200 mm:>8.1% | "
            "points, mm from slowest:>23.1f | angles, deg:>11.2f"
        )
        records = [_record(run, min(runs, key=lambda run: run.speed)) for run in runs]
    for record in records:
        table.row(*record.values())
    finish({"runs": records})


def _record(run: LiveRun, slowest: LiveRun) -> dict[str, float | None]:
    frames = np.intersect1d(run.track.frames, slowest.track.frames)
    here, there = run.track.at(frames), slowest.track.at(frames)
    determined = [not name.endswith(UNDETERMINED) for name in ANGLE_NAMES]
    apart = here.points_world - there.points_world
    turned = np.angle(np.exp(1j * (here.angles - there.angles)))[:, determined]
    scores = evaluate_run(run).scores if len(run.track) else None
    return {
        "speed": run.speed,
        "sets": run.sets,
        "answered": run.answered / max(run.sets, 1),
        "incomplete": run.incomplete,
        "mean_mm": scores.mean_mm if scores else None,
        "over_200mm": scores.over_200mm if scores else None,
        "points_apart_mm": 1e3 * float(np.linalg.norm(apart, axis=2).mean()) if len(frames) else None,
        "angles_apart_deg": float(np.degrees(np.sqrt(np.mean(turned**2)))) if len(frames) else None,
    }


if __name__ == "__main__":
    execute(main)
