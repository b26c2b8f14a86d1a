"""One finding of the doctor: how grave, about what, and what to do."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from rich.console import Console
from rich.text import Text


class Severity(IntEnum):
    """The exit status follows from the gravest one: 0 for OK and NOTE, 1 for WARNING, 2 for ERROR."""

    OK = 0
    NOTE = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True)
class Finding:
    """``about`` is a short name ("rmem_max"); ``remedy`` is empty where nothing is to be done.

    ``subject`` is what was examined ("this machine", "camera cam01"): findings are shown grouped by it.
    """

    severity: Severity
    about: str
    what: str
    remedy: str = ""
    subject: str = ""

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return {
            "severity": self.severity.name.lower(),
            "subject": self.subject,
            "about": self.about,
            "what": self.what,
            "remedy": self.remedy,
        }


def ok(about: str, what: str) -> Finding:
    """All is well."""
    return Finding(Severity.OK, about, what)


def note(about: str, what: str, remedy: str = "") -> Finding:
    """Worth knowing; also what could not be found out, with the reason."""
    return Finding(Severity.NOTE, about, what, remedy)


def warning(about: str, what: str, remedy: str) -> Finding:
    """It works, but not as well as it should, or not for long."""
    return Finding(Severity.WARNING, about, what, remedy)


def error(about: str, what: str, remedy: str) -> Finding:
    """It cannot work like this."""
    return Finding(Severity.ERROR, about, what, remedy)


def on(subject: str, findings: Iterable[Finding]) -> Iterator[Finding]:
    """The findings, said of ``subject``."""
    for finding in findings:
        yield replace(finding, subject=subject)


def exit_status(findings: Sequence[Finding], strict: bool = False) -> int:
    """0 fine (or notes only), 1 warnings, 2 errors; with ``strict`` warnings are as bad as errors."""
    gravest = max((finding.severity for finding in findings), default=Severity.OK)
    if strict and gravest is Severity.WARNING:
        gravest = Severity.ERROR
    return max(gravest - Severity.NOTE, 0)


def summary(findings: Sequence[Finding]) -> str:
    """One line: how many of each, and the first of the gravest ones."""
    counts = Counter(finding.severity for finding in findings)
    told = [_counted(counts[kind], kind.name.lower()) for kind in (Severity.ERROR, Severity.WARNING) if counts[kind]]
    if not told:
        return f"no errors, no warnings ({_counted(counts[Severity.OK], 'check')} passed)"
    gravest = max(finding.severity for finding in findings)
    first = next(finding for finding in findings if finding.severity is gravest)
    where = f"{first.subject}: " if first.subject else ""
    return f"{', '.join(told)}; first: {where}{first.what}"


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


# --- Shows findings to a person: grouped by what was examined, the gravest first, and one line that sums them up.

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
