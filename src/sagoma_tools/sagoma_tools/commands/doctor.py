"""``sagoma doctor camera PARAMS.yaml``: what may keep this camera PC from working, with remedies."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..doctor.camera import examine
from ..doctor.findings import Finding, Severity, exit_status

STYLES = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}
WIDTH = 140


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "doctor", help="examine a camera PC: file, background, network, camera, clock, cores",
        description="Exit status: 0 all is well (or notes only), 1 warnings, 2 errors.",
    )  # fmt: skip
    parser.add_argument("what", choices=["camera"], help="what to examine")
    parser.add_argument("parameters", metavar="PARAMS.yaml", type=Path, help="the camera's parameter file")
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of a table")
    parser.add_argument("--open", action="store_true", help="take control of the camera for a moment, as its client would")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine and print; the exit status says how grave the gravest finding is."""
    findings = list(examine(args.parameters, args.open))
    if args.json:
        status = exit_status(findings)
        print(json.dumps({"status": status, "findings": [finding.as_dict() for finding in findings]}))
    else:
        show(findings, Console() if Console().is_terminal else Console(width=WIDTH))
    return exit_status(findings)


def show(findings: Sequence[Finding], console: Console) -> None:
    """A table, the gravest findings last, where the eye is."""
    table = Table(box=None, pad_edge=False)
    for heading in ("", "about", "finding", "remedy"):
        table.add_column(heading, overflow="fold")
    for finding in sorted(findings, key=lambda finding: finding.severity):
        severity = Text(finding.severity.name, style=STYLES[finding.severity])
        table.add_row(severity, finding.about, Text(finding.what), Text(finding.remedy))
    console.print(table)
