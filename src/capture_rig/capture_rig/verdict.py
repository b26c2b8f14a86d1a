"""Verdicts on a trained background or a calibration: good, usable or redo, with findings and remedies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

GOOD, USABLE, REDO = "good", "usable", "redo"


@dataclass(frozen=True)
class Finding:
    """A fault, its gravity and its remedy.

    grade : USABLE or REDO; GOOD for information only. code : "ABOUT.CONDITION", stable, for scripts; "" for none.
    """

    grade: str
    what: str
    remedy: str
    code: str = ""

    @property
    def line(self) -> str:
        """Fault and remedy in one line, as in a client's messages."""
        return f"{self.what}: {self.remedy}"

    def __str__(self) -> str:
        return f"{self.what} ({self.remedy})"


@dataclass(frozen=True)
class Verdict:
    """``grade`` is GOOD, USABLE (works, but worse than it could) or REDO (do not use it); ``findings`` say why."""

    grade: str
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        return "; ".join([self.grade, *map(str, self.findings)]).replace(";", ":", 1)


def judge(findings: Iterable[Finding]) -> Verdict:
    """Return the verdict, as bad as the worst finding; GOOD when there is none."""
    found = tuple(findings)
    grades = {finding.grade for finding in found}
    return Verdict(next((grade for grade in (REDO, USABLE) if grade in grades), GOOD), found)


def graded(value: float, limits: tuple[float, float], what: str, remedy: str) -> Iterator[Finding]:
    """Yield a finding where a value exceeds the first of its limits: USABLE up to the second, REDO beyond (NaN too)."""
    if not value <= limits[0]:
        yield Finding(USABLE if value <= limits[1] else REDO, what, remedy)
