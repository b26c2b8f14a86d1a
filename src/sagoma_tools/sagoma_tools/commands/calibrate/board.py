"""``sagoma calibrate board``: a board to print, true to scale."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig_calibration.boards.drawing import print_size_m, save_for_print
from rig_calibration.boards.printing import PAPER_MM
from rig_calibration.boards.specification import board_text, read_board


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the step."""
    parser = subparsers.add_parser("board", help="write a calibration board as SVG or PDF to print true to scale")
    parser.add_argument(
        "board",
        help='a YAML file (config/board/...), or "checkerboard 9x6 25mm" (inner corners), '
        '"charuco 8x11 20mm 15mm DICT_5X5_100" (fields)',
    )
    parser.add_argument(
        "--output", type=Path, default=Path("board.pdf"), metavar="FILE", help=".pdf or .svg (default: board.pdf)"
    )
    parser.add_argument(
        "--paper",
        choices=sorted(PAPER_MM, reverse=True),
        default="A4",
        help="larger boards are laid over several pages (default: A4)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the board, and say what to do with it."""
    board = read_board(args.board)
    files = save_for_print(board, args.output, args.paper)
    width, height = (1e3 * side for side in print_size_m(board))
    print(f"{board_text(board)}: {width:g} x {height:g} mm, written to {', '.join(map(str, files))}")
    print("Print at 100 % (actual size), measure the 100 mm line, and glue the print flat onto a stiff plate.")
    print(f'For the other steps: --board "{board_text(board)}"')
    return 0
