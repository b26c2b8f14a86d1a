"""``sagoma doctor camera PARAMS.yaml``: what may keep this camera PC from working, with remedies."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ..doctor.camera import examine
from ..doctor.findings import Finding, Severity, exit_status

STYLES = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "doctor", help="examine a camera PC: file, background, network, camera, clock, cores",
        description="Exit status: 0 all is well (or notes only), 1 warnings, 2 errors.",
    )  # fmt: skip
    parser.add_argument("what", choices=["camera"], help="what to examine")
    parser.add_argument("parameters", metavar="PARAMS.yaml", type=Path, help="the camera's parameter file")
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of text")
    help_open = "take control of the camera for a moment, as its client would"
    parser.add_argument("--open", action="store_true", help=help_open)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine and print; the exit status says how grave the gravest finding is."""
    findings = list(examine(args.parameters, args.open))
    if args.json:
        status = exit_status(findings)
        print(json.dumps({"status": status, "findings": [finding.as_dict() for finding in findings]}))
    else:
        show(findings, Console())
    return exit_status(findings)


def show(findings: Sequence[Finding], console: Console) -> None:
    """One line a finding, its remedy below; the gravest last, where the eye is."""
    for finding in sorted(findings, key=lambda finding: finding.severity):
        line = Text(f"{finding.severity.name:8}", style=STYLES[finding.severity])
        line.append(f"{finding.about:12} {finding.what}", style="default")
        console.print(line, soft_wrap=True)
        if finding.remedy:
            console.print(Text(f"{'':21} -> {finding.remedy}"), soft_wrap=True)
