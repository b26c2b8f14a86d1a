"""How exact calibration is, against the truth.

    python bench/calibration.py [--quick]           # the studio's lenses and rigs, from corners with noise
    python bench/calibration.py --boards [--quick]  # the board detector, on rendered pictures
    python bench/calibration.py --drill [FOLDER]    # rendered films of unknown cameras, to a tracked person

--drill keeps FOLDER (default output/setup_drill) and uses footage that is there already. The studio films boards, the
empty room and a person (python -m virtual_studio setup); from these files alone `sagoma calibrate` makes the rig,
and the person is tracked as in `sagoma evaluate`. The truth is used for scoring only: lenses (focal length, principal
point), camera centres and directions (nothing is aligned: the floor board defines the world, and the truth says where
it lay), and the body: mean error of the 15 points, beside that with the true calibration. The last line is JSON.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from report import Table, execute, finish, parser

import calibration_extrinsics as extrinsics
import calibration_intrinsics as intrinsics
import numpy as np
from calibration_boards import board_figures

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, Truth, load_session, load_truth
from mocap_pipeline.configuration import Configuration
from sagoma_tools.cli import main as sagoma
from sagoma_tools.evaluation.in_process import track_session
from sagoma_tools.evaluation.scores import Scores, score
from virtual_studio.__main__ import main as film
from virtual_studio.recording.footage import TRUTH_RIG_FILE, CameraErrors, camera_errors, read_truth_floor

LENSES, RIG_FILE, TRUTH_FILE = "lenses", "rig.yaml", "truth.csv"
SETTINGS = {"hull_server.backend": "cpu"}
NOISES_PX = (0.1, 0.2, 0.3)


def main() -> None:
    """Print the tables and the line of JSON."""
    given = parser(__doc__, quick="few repetitions and rigs; one blur, one tilt; short films")
    given.add_argument("--boards", action="store_true", help="boards in rendered pictures")
    given.add_argument("--drill", nargs="?", type=Path, const=Path("output/setup_drill"), metavar="FOLDER")
    given.add_argument("--cameras", type=int, default=6, help="of the drill, the last one on the ceiling (default: 6)")
    given.add_argument("--seconds", type=float, help="length of the drill's session (default: 6; quick: 3)")
    options = given.parse_args()
    quick = options.quick
    if options.drill:
        finish(drill(options.drill, options.cameras, options.seconds or (3.0 if quick else 6.0), quick))
    elif options.boards:
        finish(board_figures(quick))
    else:
        rows = list(intrinsics.corner_rows(NOISES_PX[::2] if quick else NOISES_PX, 2 if quick else 10))
        intrinsics.print_rows(rows)
        rigs = list(extrinsics.synthetic_rows(quick))
        extrinsics.print_rows(rigs)
        finish(intrinsics.figures_of(rows) | extrinsics.figures(rigs))


# --- the drill


def calibrate(folder: Path) -> None:
    """Footage to session/rig.yaml, by the commands that a user gives. Raises InputError where one fails."""
    lenses, rig = folder / LENSES, folder / "session" / RIG_FILE
    _run("calibrate", "intrinsics", folder / "intrinsics", "--board", folder / "board.yaml", "--output", lenses)
    pictures = ("--floor", folder / "floor", "--moving", folder / "moving", "--board", folder / "floor_board.yaml")
    _run("calibrate", "extrinsics", "--intrinsics", lenses, *pictures, "--output", rig)


def body_scores(folder: Path) -> tuple[Scores, Scores]:
    """Of the track with the calibration that was found, and with the true one."""
    session, truth = load_session(folder / "session"), load_truth(folder / TRUTH_FILE)
    T_floor_world = np.linalg.inv(read_truth_floor(folder))
    own = _tracked(session, _moved(truth, T_floor_world))
    exact = replace(session, rig=load_rig(folder / TRUTH_RIG_FILE))
    return own, _tracked(exact, truth)


def _run(*words: object) -> None:
    arguments = [str(word) for word in words]
    print(f"\n$ sagoma {' '.join(arguments)}", flush=True)
    if sagoma(arguments) not in (0, None):
        raise InputError("the command failed", where=f"sagoma {arguments[0]} {arguments[1]}", remedy="See above.")


def _moved(truth: Truth, T: np.ndarray) -> Truth:
    return replace(truth, points_world=truth.points_world @ T[:3, :3].T + T[:3, 3])


def _tracked(session: Session, truth: Truth) -> Scores:
    return score(track_session(session, Configuration.of(SETTINGS)), truth)


def report(cameras: list[CameraErrors], own: Scores, exact: Scores) -> dict[str, object]:
    """Prints the tables and returns the figures."""
    formats = {"focal length %": ".3f", "principal point px": ".2f", "centre mm": ".1f", "rotation deg": ".3f"}
    table = Table({"camera": "", **formats}, markdown=True)
    for c in cameras:
        table.row(c.name, c.focal_percent, c.principal_px, c.centre_mm, c.rotation_deg)
    formats = {"mean mm": ".1f", "p95 mm": ".1f", "over 200 mm %": ".1f", "tracked": ""}
    table = Table({"calibration": "", **formats}, markdown=True)
    for name, s in (("found", own), ("true", exact)):
        table.row(name, s.mean_mm, s.all_points.p95_mm, 100 * s.all_points.over_200mm, f"{s.tracked} of {s.frames}")
    keys = ("focal_percent", "principal_px", "centre_mm", "rotation_deg")
    worst = {f"worst_{key}": round(max(getattr(c, key) for c in cameras), 4) for key in keys}
    return {
        "cameras": len(cameras),
        **worst,
        "mean_mm": round(own.mean_mm, 2),
        "tracked": own.tracked,
        "mean_mm_true_calibration": round(exact.mean_mm, 2),
        "frames": own.frames,
    }


def drill(folder: Path, cameras: int, seconds: float, quick: bool) -> dict[str, object]:
    """Film (unless the footage is there), calibrate, track, score."""
    began = time.monotonic()
    if not (folder / "setup.yaml").is_file():
        words = [str(folder), "--cameras", str(cameras), "--seconds", str(seconds)]
        if film(["setup", *words] + ["--quick"] * quick) != 0:
            raise SystemExit(2)
    calibrate(folder)
    found, truth = load_rig(folder / "session" / RIG_FILE), load_rig(folder / TRUTH_RIG_FILE)
    figures = report(camera_errors(found, truth, read_truth_floor(folder)), *body_scores(folder))
    return {**figures, "took_s": round(time.monotonic() - began)}


if __name__ == "__main__":
    execute(main)
