"""How exact calibration is, on the studio's rigs, against the truth.

    python bench/calibration.py --quick             # under a minute: corners with noise, few repetitions and rigs
    python bench/calibration.py                     # more of them, and rendered video of boards
    python bench/calibration.py --photographs left='calib/left*.jpg' --board "checkerboard 9x6 25mm"

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path += [str(package) for package in sorted((ROOT / "src").iterdir())]  # runs where nothing is installed

import calibration_extrinsics as extrinsics
import calibration_intrinsics as intrinsics
from rich.console import Console

from capture_rig.errors import InputError
from sagoma_tools.calibration.intrinsics import print_results

WIDTH = 160
NOISES_PX = (0.1, 0.2, 0.3)


def main() -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    options = _parser().parse_args()
    console = Console(width=WIDTH)
    rows = list(intrinsics.corner_rows(NOISES_PX[::2] if options.quick else NOISES_PX, 2 if options.quick else 10))
    if not options.quick:
        rows += intrinsics.video_rows(options.cameras, brief=False)
    console.print(intrinsics.table_of(rows))
    rigs = [*extrinsics.synthetic_rows(options.quick), *([] if options.quick else [extrinsics.rendered_row()])]
    extrinsics.print_rows(console, rigs)
    try:
        if options.photographs:
            print_results(console, list(intrinsics.photograph_results(options.photographs, options.board).values()))
    except InputError as error:
        print(f"bench/calibration.py: {error}", file=sys.stderr)
        return 2
    print(json.dumps(intrinsics.figures_of(rows) | extrinsics.figures(rigs)))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="projected corners only, few repetitions and rigs")
    parser.add_argument("--cameras", type=int, default=2, help="how many lenses are filmed in the full run")
    parser.add_argument("--photographs", nargs="*", help="real photographs, as for sagoma calibrate intrinsics")
    parser.add_argument("--board", default="checkerboard 9x6 25mm", help="the board on the photographs")
    return parser


if __name__ == "__main__":
    sys.exit(main())
