"""Shows findings to a person: grouped by what was examined, the gravest first, and one line that sums them up."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.text import Text

from .findings import Finding, Severity, summary

STYLES = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}
INDENT, ABOUT_WIDTH = 10, 14
UNBROKEN = 100_000  # columns of a file: lines there are for grep


def show(findings: Sequence[Finding], console: Console, *, all_of_them: bool = False) -> None:
    """Group by group in the order of the findings; what is well is one line a group unless ``all_of_them``."""
    subjects = dict.fromkeys(finding.subject for finding in findings)
    for subject in sorted(subjects, key=lambda subject: subject.startswith("camera ")):  # many alike: after the others
        console.print(Text(subject or "findings", style="bold"))
        for line in _group([finding for finding in findings if finding.subject == subject], console, all_of_them):
            console.print(line, soft_wrap=True)
    gravest = max((finding.severity for finding in findings), default=Severity.OK)
    console.print(Text(f"\n{summary(findings)}", style=STYLES[gravest]), soft_wrap=True)


def _group(findings: Sequence[Finding], console: Console, all_of_them: bool) -> Iterator[Text]:
    width = console.width if console.is_terminal else UNBROKEN
    for finding in sorted(findings, key=lambda finding: -finding.severity):
        if finding.severity > Severity.OK or all_of_them:
            yield from _lines(finding.severity, finding.about, finding.what, finding.remedy, width)
    well = dict.fromkeys(finding.about for finding in findings if finding.severity is Severity.OK)
    if well and not all_of_them:
        yield from _lines(Severity.OK, "", ", ".join(well), "", width)


def _lines(severity: Severity, about: str, what: str, remedy: str, width: int) -> Iterator[Text]:
    name = severity.name if severity is Severity.ERROR else severity.name.lower()
    body = f"{about:{ABOUT_WIDTH}} {what}" if about else what
    indent = INDENT + (ABOUT_WIDTH + 1 if about else 0)
    first, *more = textwrap.wrap(body, max(width - INDENT, 40), subsequent_indent=" " * (indent - INDENT)) or [""]
    yield Text(f"  {name:{INDENT - 2}}", style=STYLES[severity]).append(first, style="default")
    for line in more:
        yield Text(" " * INDENT + line)
    for number, line in enumerate(textwrap.wrap(remedy, max(width - indent - 3, 40))):
        yield Text(" " * indent + ("-> " if number == 0 else "   ") + line, style="italic")
