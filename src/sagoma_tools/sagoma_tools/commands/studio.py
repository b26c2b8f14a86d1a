"""``sagoma studio``: simulated GigE Vision cameras to run the graph on, and to break."""

from __future__ import annotations

import argparse

from virtual_studio.gige import command


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("studio", help="serve simulated GigE Vision cameras, or talk to those that run")
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)
