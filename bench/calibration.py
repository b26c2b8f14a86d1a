"""How exact calibration is, against the truth.

    python bench/calibration.py [--quick]           # the studio's lenses and rigs, from corners with noise
    python bench/calibration.py --boards [--quick]  # the board detector, on rendered pictures
    python bench/calibration.py --drill [FOLDER]    # rendered films of unknown cameras, to a tracked person

--drill keeps FOLDER (default output/setup_drill) and uses footage that is there already. The last line is JSON.
"""

from __future__ import annotations

from pathlib import Path

from report import execute, finish, parser

import calibration_extrinsics as extrinsics
import calibration_intrinsics as intrinsics
from calibration_boards import board_figures
from calibration_drill import drill

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


if __name__ == "__main__":
    execute(main)
