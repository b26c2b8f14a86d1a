"""Every importer by the name that ``sagoma import NAME`` knows it by."""

from __future__ import annotations

import argparse
from typing import Protocol

from .humaneva import command as humaneva


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
