"""One finding of the doctor: how grave, about what, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


class Severity(IntEnum):
    """The exit status follows from the gravest one: 0 for OK and NOTE, 1 for WARNING, 2 for ERROR."""

    OK = 0
    NOTE = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True)
class Finding:
    """``about`` is a short name ("rmem_max"); ``remedy`` is empty where nothing is to be done."""

    severity: Severity
    about: str
    what: str
    remedy: str = ""

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return {
            "severity": self.severity.name.lower(),
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


def exit_status(findings: Sequence[Finding]) -> int:
    """0 fine (or notes only), 1 warnings, 2 errors."""
    gravest = max((finding.severity for finding in findings), default=Severity.OK)
    return max(gravest - Severity.NOTE, 0)
