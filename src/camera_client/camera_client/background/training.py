"""Trains the background on the next frames of a running camera.

One training runs at a time, and every request gets exactly one report: for the caller, and as one line of JSON in the
diagnostics for programs that miss the answer.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field

from capture_rig.errors import InputError
from capture_rig.verdict import REDO, Finding, judge

from ..frame_source import Image
from .model import SOFTWARE, BackgroundLearner, BackgroundModel
from .verdict import describe_background, judge_background, turn_findings

KEY = "background_training"  # of the diagnostics: the last report
PROGRESS_KEY = "background_training_progress"  # frames taken and wanted, "57/100", while a training is under way


@dataclass(frozen=True)
class TrainingReport:
    """The outcome of a training.

    number : counts the node's trainings, so that a report can be told from the one before.
    grade : GOOD, USABLE or REDO (capture_rig.verdict); findings : why.
    frames : learned from; noise : mean standard deviation, grey levels; moved : share of the pixels that moved.
    saved : the file that holds the background; "" for none.
    text : the outcome as a sentence.
    """

    number: int
    grade: str
    findings: tuple[Finding, ...] = ()
    frames: int = 0
    noise: float = 0.0
    moved: float = 0.0
    saved: str = ""
    text: str = ""

    @property
    def success(self) -> bool:
        """Whether the new background is in use."""
        return self.grade != REDO

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> TrainingReport:
        """Read what :meth:`to_json` wrote. Raises ValueError for anything else."""
        try:
            values = json.loads(text)
            findings = tuple(Finding(**finding) for finding in values.pop("findings"))
            return cls(findings=findings, **values)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"no report of a background training: {error}") from None


@dataclass(frozen=True, eq=False)
class TrainingRequest:
    """Learn from the next ``frames`` images of the source described as ``source``.

    file : where to save the background; "" for nowhere. before : the background in use, which it replaces.
    about : further fields of the new background's provenance.
    """

    frames: int
    source: str
    file: str = ""
    before: BackgroundModel | None = None
    about: Mapping[str, str] = field(default_factory=dict)


class BackgroundTrainer:
    """Runs one background training at a time; every request gets exactly one report.

    use : takes a learned background into use, and returns it as it is to be saved; InputError when it cannot be used.
    Frames come on one thread, requests and cancellations on others.
    """

    def __init__(self, use: Callable[[BackgroundModel], BackgroundModel]) -> None:
        self._use = use
        self._lock = threading.Lock()
        self._running: _Training | None = None
        self._number = 0

    @property
    def busy(self) -> bool:
        """Whether a training is under way."""
        return self._running is not None

    @property
    def progress(self) -> str:
        """Frames taken and wanted by the training under way, "57/100"; "" without one."""
        running = self._running
        return "" if running is None else f"{running.learner.frames}/{running.request.frames}"

    def begin(self, request: TrainingRequest) -> Future[TrainingReport]:
        """Learn from the next frames. Raises InputError while another training is under way."""
        with self._lock:
            if self._running is not None:
                raise InputError("learning already", remedy="Wait for its end.")
            self._number += 1
            self._running = _Training(self._number, request)
            return self._running.over

    def add(self, image: Image) -> None:
        """Learn from one more frame (H, W) or (H, W, 3); the last one ends the training."""
        if self._running is None:
            return
        error: InputError | None = None
        with self._lock:
            running = self._running
            if running is None:
                return
            try:
                running.learner.add(image)
            except InputError as unfit:
                error = unfit
            if error is None and running.learner.frames < running.request.frames:
                return
            self._running = None
        running.over.set_result(self._conclude(running) if error is None else running.refused(str(error)))

    def cancel(self, reason: str) -> None:
        """End the training under way, if any, because no more frames come."""
        with self._lock:
            running, self._running = self._running, None
        if running is not None:
            taken = f"{running.learner.frames} of {running.request.frames} frames"
            running.over.set_result(running.refused(f"{reason} after {taken}"))

    def _conclude(self, training: _Training) -> TrainingReport:
        """Judge, use and save what was learned."""
        request, model = training.request, None
        findings: tuple[Finding, ...] = ()
        try:
            model = training.learner.model(request.source, software=SOFTWARE, **request.about)
            verdict = judge_background(model, training.learner.brightness, request.before)
            model, findings = model.with_provenance(verdict=str(verdict)), verdict.findings
            if verdict.grade == REDO:
                return training.refused(describe_background(model), model, findings)
            used = self._use(model)
        except Exception as error:  # whatever it is, the request gets its report
            text = str(error) if isinstance(error, InputError) else f"the background cannot be used: {error!r}"
            return training.refused(text, model, findings)
        findings += turn_findings(used.provenance)
        text, saved = describe_background(used), ""
        if request.file:
            try:
                used.save(request.file)
                text, saved = f"{text}; saved to {request.file}", request.file
            except InputError as error:
                text = f"{text}; in use, but not saved: {error}"
        return training.report(judge(findings).grade, text, model, findings, saved)


class _Training:
    """A training under way."""

    def __init__(self, number: int, request: TrainingRequest) -> None:
        self.number, self.request = number, request
        self.learner, self.over = BackgroundLearner(), Future[TrainingReport]()

    def refused(
        self, text: str, model: BackgroundModel | None = None, findings: tuple[Finding, ...] = ()
    ) -> TrainingReport:
        """Return the report that ``model`` was not taken, or that there is none."""
        return self.report(REDO, text, model, findings)

    def report(
        self, grade: str, text: str, model: BackgroundModel | None, findings: tuple[Finding, ...], saved: str = ""
    ) -> TrainingReport:
        if model is None:
            return TrainingReport(self.number, grade, findings, text=text)
        frames, noise = model.provenance.frames, round(model.provenance.mean_noise, 3)
        return TrainingReport(self.number, grade, findings, frames, noise, round(model.moving_share, 5), saved, text)
