"""How exact calibration is, on the studio's rigs, against the truth.

    python bench/calibration.py --quick             # under a minute: corners with noise, few repetitions and rigs
    python bench/calibration.py                     # more of them, and rendered video of boards
    python bench/calibration.py --photographs left='calib/left*.jpg' --board "checkerboard 9x6 25mm"

The last line is JSON.
"""

from __future__ import annotations

from report import execute, finish, parser

import calibration_extrinsics as extrinsics
import calibration_intrinsics as intrinsics
from rich.console import Console

from sagoma_tools.calibration.intrinsics import print_results

WIDTH = 160
NOISES_PX = (0.1, 0.2, 0.3)


def main() -> None:
    """Print the tables and the line of JSON."""
    given = parser(__doc__, quick="projected corners only, few repetitions and rigs")
    given.add_argument("--cameras", type=int, default=2, help="how many lenses are filmed in the full run")
    given.add_argument("--photographs", nargs="*", help="real photographs, as for sagoma calibrate intrinsics")
    given.add_argument("--board", default="checkerboard 9x6 25mm", help="the board on the photographs")
    options = given.parse_args()
    rows = list(intrinsics.corner_rows(NOISES_PX[::2] if options.quick else NOISES_PX, 2 if options.quick else 10))
    if not options.quick:
        rows += intrinsics.video_rows(options.cameras, brief=False)
    intrinsics.print_rows(rows)
    rigs = [*extrinsics.synthetic_rows(options.quick), *([] if options.quick else [extrinsics.rendered_row()])]
    extrinsics.print_rows(rigs)
    if options.photographs:
        results = intrinsics.photograph_results(options.photographs, options.board)
        print_results(Console(width=WIDTH), list(results.values()))
    finish(intrinsics.figures_of(rows) | extrinsics.figures(rigs))


if __name__ == "__main__":
    execute(main)
