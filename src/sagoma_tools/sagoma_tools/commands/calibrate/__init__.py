"""``sagoma calibrate``: boards to print, each camera's lens, the rig."""

from __future__ import annotations

import argparse

from . import board, extrinsics, intrinsics


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """The command and its own subcommands."""
    parser = subparsers.add_parser("calibrate", help="calibrate cameras and rig with a printed board")
    steps = parser.add_subparsers(title="steps", required=True, metavar="STEP")
    for step in (board, intrinsics, extrinsics):
        step.add_parser(steps)
