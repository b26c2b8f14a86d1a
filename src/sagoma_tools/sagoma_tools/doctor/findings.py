"""One finding of the doctor: how grave, about what, and what to do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum


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
