"""Findings of the doctor's checks; they are printed by subject, the gravest first.

A check is a function that reads a fact, judges it, and returns findings with the remedy: none, one or several.
A finding's code, "ABOUT.CONDITION" ("mtu.too_large", "clock.off"), is stable: scripts and tests match it, not the text.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from functools import partial

from rich.console import Console
from rich.text import Text

from capture_rig.errors import InputError


class Severity(IntEnum):
    """How grave a finding is: passed, good to know, costs quality or may stop working, does not work."""

    OK = 0
    NOTE = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True)
class CheckResult:
    """One finding; ``remedy`` is empty where nothing is to be done; ``subject`` : the examined thing ("graph")."""

    severity: Severity
    code: str
    what: str
    remedy: str = ""
    subject: str = ""

    @property
    def about(self) -> str:
        """The code without its condition: "rmem_max" of "rmem_max.small"."""
        return self.code.partition(".")[0]

    def as_dict(self) -> dict[str, str]:
        """Return the finding as plain data for JSON."""
        return {**asdict(self), "severity": self.severity.name.lower(), "about": self.about}


note, warning, error = (partial(CheckResult, severity) for severity in list(Severity)[1:])


def ok(about: str, what: str) -> CheckResult:
    """Return a check that passed; its code is "ABOUT.ok"."""
    return CheckResult(Severity.OK, f"{about}.ok", what)


Case = tuple[bool, Callable[[str, str, str], CheckResult], str, str]
"""Whether it applies, the severity's function, the condition and its remedy."""


def result_of(about: str, what: str, *cases: Case) -> CheckResult:
    """Return one text, graded by the first of the ``cases`` that applies; ok when none does."""
    for applies, severity, condition, remedy in cases:
        if applies:
            return severity(f"{about}.{condition}", what, remedy)
    return ok(about, what)


CheckResults = CheckResult | Iterator[CheckResult] | None


def about(subject: str, *checks: CheckResults) -> Iterator[CheckResult]:
    """Yield the findings of a subject's checks, with the subject unless they have one; an InputError of a check is an
    error by the check's name: "footage.unusable" of ``check_footage``."""
    for found in checks:
        try:
            for finding in [found] if isinstance(found, CheckResult) else found or ():
                yield finding if finding.subject else replace(finding, subject=subject)
        except InputError as problem:
            code = f"{getattr(found, '__name__', '').partition('_')[2]}.unusable"
            what = f"{problem.where}: {problem.what}" if problem.where else problem.what
            yield replace(error(code, what, problem.remedy), subject=subject)


def exit_status(findings: Sequence[CheckResult]) -> int:
    """0 fine (or notes only), 1 warnings, 2 errors."""
    return max((max(finding.severity - Severity.NOTE, 0) for finding in findings), default=0)


def summary(findings: Sequence[CheckResult]) -> str:
    """Return one line: the number of each, and the first of the gravest ones."""
    counts = Counter(finding.severity for finding in findings)
    if not counts[Severity.ERROR] + counts[Severity.WARNING]:
        return f"no errors, no warnings ({counts[Severity.OK]} passed)"
    first = max(findings, key=lambda finding: finding.severity)
    where = f"{first.subject}: " if first.subject else ""
    return f"errors: {counts[Severity.ERROR]}, warnings: {counts[Severity.WARNING]}; first: {where}{first.what}"


STYLES = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}
NAMES = {**{severity: severity.name.lower() for severity in Severity}, Severity.ERROR: "ERROR"}
ABOUT_WIDTH = 14


def show(findings: Sequence[CheckResult], console: Console) -> None:
    """Print the findings by subject, and the summary; passed checks share one line."""
    subjects = dict.fromkeys(finding.subject for finding in findings)
    for subject in sorted(subjects, key=lambda subject: subject.startswith("camera ")):  # cameras last
        console.print(Text(subject or "findings", style="bold"))
        mine = sorted((f for f in findings if f.subject == subject), key=lambda finding: -finding.severity)
        for finding in (f for f in mine if f.severity > Severity.OK):
            text = f"{finding.about:{ABOUT_WIDTH}} {finding.what}"
            console.print(Text.assemble((f"  {NAMES[finding.severity]:8}", STYLES[finding.severity]), text))
            if finding.remedy:
                console.print(Text(f"{'':10}-> {finding.remedy}", style="italic"))
        passed = ", ".join(dict.fromkeys(f.about for f in mine if f.severity is Severity.OK))
        if passed:
            console.print(Text.assemble((f"  {NAMES[Severity.OK]:8}", STYLES[Severity.OK]), passed))
    gravest = max((finding.severity for finding in findings), default=Severity.OK)
    console.print(Text(f"\n{summary(findings)}", style=STYLES[gravest]))
