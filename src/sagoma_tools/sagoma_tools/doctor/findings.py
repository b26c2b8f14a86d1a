"""The doctor's findings: how grave, about what, and what to do; printed by subject, the gravest first.

A finding's code, "ABOUT.CONDITION" ("mtu.too_large", "clock.off"), is stable: scripts and tests match it, not the text.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from rich.console import Console
from rich.text import Text


class Severity(IntEnum):
    """How grave a finding is. Exit status of the gravest: 0 for OK and NOTE, 1 for WARNING, 2 for ERROR."""

    OK = 0
    NOTE = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True)
class Finding:
    """One finding; ``remedy`` is empty where nothing is to be done.

    ``subject`` is what was examined ("this machine", "camera cam01"): findings are shown grouped by it.
    """

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
        return {
            "severity": self.severity.name.lower(),
            "subject": self.subject,
            "about": self.about,
            "code": self.code,
            "what": self.what,
            "remedy": self.remedy,
        }


def ok(about: str, what: str) -> Finding:
    """Return a check that passed; its code is "ABOUT.ok"."""
    return Finding(Severity.OK, f"{about}.ok", what)


def note(code: str, what: str, remedy: str = "") -> Finding:
    """Return a fact worth knowing, or one that could not be determined, with the reason."""
    return Finding(Severity.NOTE, code, what, remedy)


def warning(code: str, what: str, remedy: str) -> Finding:
    """Return a fault with which the graph works, but not as well as it should, or not for long."""
    return Finding(Severity.WARNING, code, what, remedy)


def error(code: str, what: str, remedy: str) -> Finding:
    """Return a fault with which the graph cannot work."""
    return Finding(Severity.ERROR, code, what, remedy)


Case = tuple[bool, Callable[[str, str, str], Finding], str, str]
"""Whether it applies, its severity, its condition and its remedy."""


def graded(about: str, what: str, *cases: Case) -> Finding:
    """Return one text, graded by the first of the ``cases`` that applies; ok when none does."""
    for applies, severity, condition, remedy in cases:
        if applies:
            return severity(f"{about}.{condition}", what, remedy)
    return ok(about, what)


def on(subject: str, findings: Iterable[Finding]) -> Iterator[Finding]:
    """Yield the findings with their ``subject`` set."""
    for finding in findings:
        yield replace(finding, subject=subject)


def exit_status(findings: Sequence[Finding], strict: bool = False) -> int:
    """0 fine (or notes only), 1 warnings, 2 errors; with ``strict`` warnings are as bad as errors."""
    gravest = max((finding.severity for finding in findings), default=Severity.OK)
    if strict and gravest is Severity.WARNING:
        gravest = Severity.ERROR
    return max(gravest - Severity.NOTE, 0)


def summary(findings: Sequence[Finding]) -> str:
    """Return one line: how many of each, and the first of the gravest ones."""
    counts = Counter(finding.severity for finding in findings)
    counted = [_counted(counts[kind], kind.name.lower()) for kind in (Severity.ERROR, Severity.WARNING) if counts[kind]]
    if not counted:
        return f"no errors, no warnings ({_counted(counts[Severity.OK], 'check')} passed)"
    gravest = max(finding.severity for finding in findings)
    first = next(finding for finding in findings if finding.severity is gravest)
    where = f"{first.subject}: " if first.subject else ""
    return f"{', '.join(counted)}; first: {where}{first.what}"


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


STYLES = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}
INDENT, ABOUT_WIDTH = 10, 14
UNBROKEN = 100_000  # columns of a file: no line is broken, so that grep finds them


def show(findings: Sequence[Finding], console: Console, *, all_of_them: bool = False) -> None:
    """Print the findings by subject, and the summary; passed checks share one line unless ``all_of_them``."""
    subjects = dict.fromkeys(finding.subject for finding in findings)
    for subject in sorted(subjects, key=lambda subject: subject.startswith("camera ")):  # cameras last
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
    passed = dict.fromkeys(finding.about for finding in findings if finding.severity is Severity.OK)
    if passed and not all_of_them:
        yield from _lines(Severity.OK, "", ", ".join(passed), "", width)


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
