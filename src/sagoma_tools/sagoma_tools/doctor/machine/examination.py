"""The examination of this machine: collect, judge."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..findings import Finding, on
from .checks import check_machine
from .collect import collect_machine

SUBJECT = "this machine"


def examine_machine(bags: Path) -> Iterator[Finding]:
    """Findings on this machine; ``bags`` is where recordings go."""
    yield from on(SUBJECT, check_machine(collect_machine(bags)))
