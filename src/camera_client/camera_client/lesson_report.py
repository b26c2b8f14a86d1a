"""What became of a request to learn the background, as one line of JSON in the diagnostics: the service's own answer is
text for people."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from capture_rig.verdict import REDO, USABLE, Finding, judge

from .background_model import BackgroundModel
from .camera_moved_history import tell_turn
from .live_learning import LiveLearning

KEY = "background_lesson"  # of the diagnostics
PROGRESS_KEY = "background_learning"  # frames taken and wanted, "57/100", while a lesson is under way


@dataclass(frozen=True)
class LessonReport:
    """The outcome of a lesson.

    number : counts the node's lessons, so that a report can be told from the one before.
    grade : GOOD, USABLE or REDO (capture_rig.verdict); findings : why.
    frames : learned from; noise : mean standard deviation, grey levels; moved : share of the pixels that moved.
    saved : the file that holds it; "" for none.
    text : what the service answered.
    """

    number: int
    grade: str
    findings: tuple[Finding, ...] = ()
    frames: int = 0
    noise: float = 0.0
    moved: float = 0.0
    saved: str = ""
    text: str = ""

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> LessonReport:
        """Raises ValueError for what :meth:`to_json` did not write."""
        try:
            values = json.loads(text)
            findings = tuple(Finding(**finding) for finding in values.pop("findings"))
            return cls(findings=findings, **values)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"no report of a lesson: {error}") from None


def report_of(
    learning: LiveLearning, number: int, answer: str, used: BackgroundModel | None = None, saved: str = ""
) -> LessonReport:
    """On a lesson that is over: ``answer`` says what became of it, ``used`` is the background that is now in use, None
    where it was not taken, and ``saved`` the file that holds it."""
    verdict, model = learning.verdict, learning.learned
    findings = () if verdict is None else verdict.findings
    if used is not None:
        findings += _turned(used)
    grade = judge(findings).grade if used is not None else REDO
    if model is None:
        return LessonReport(number, grade, findings, text=answer)
    return LessonReport(
        number,
        grade,
        findings,
        model.provenance.frames,
        round(model.provenance.mean_noise, 3),
        round(model.moving_share, 5),
        saved,
        answer,
    )


def _turned(model: BackgroundModel) -> tuple[Finding, ...]:
    """A finding on a camera that was moved after its calibration, as far as its backgrounds tell."""
    what, _, remedy = tell_turn(model.provenance).removeprefix("; ").partition(": ")
    return (Finding(USABLE, what, remedy),) if what else ()
