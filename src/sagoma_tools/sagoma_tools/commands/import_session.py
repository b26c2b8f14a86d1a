"""``sagoma import``: recordings of others as session folders."""

from __future__ import annotations

import argparse

from ..importers.table import IMPORTERS


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand, with a subcommand of its own for each importer."""
    parser = subparsers.add_parser("import", help="make a session folder of a public data set's recording")
    kinds = parser.add_subparsers(title="data sets", required=True, metavar="DATASET")
    for name, importer in IMPORTERS.items():
        kind = kinds.add_parser(name, help=importer.HELP)
        importer.add_arguments(kind)
        kind.set_defaults(run=importer.run)
