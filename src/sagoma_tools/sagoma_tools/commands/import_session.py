"""``sagoma import``: recordings of others as session folders."""

from __future__ import annotations

import argparse
from typing import Protocol

from ..importers.humaneva import command as humaneva

# --- Every importer by the name that ``sagoma import NAME`` knows it by.


class Importer(Protocol):
    """What an importer's ``command`` module offers."""

    HELP: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare what it needs to know."""
        ...

    def run(self, args: argparse.Namespace) -> int:
        """Write the session folder and say what is in it; InputError for files it cannot use."""
        ...


IMPORTERS: dict[str, Importer] = {"humaneva": humaneva}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand, with a subcommand of its own for each importer."""
    parser = subparsers.add_parser("import", help="make a session folder of a public data set's recording")
    kinds = parser.add_subparsers(title="data sets", required=True, metavar="DATASET")
    for name, importer in IMPORTERS.items():
        kind = kinds.add_parser(name, help=importer.HELP)
        importer.add_arguments(kind)
        kind.set_defaults(run=importer.run)
