"""Learning the background from the next frames of a running source, and a verdict on what was learned."""

from __future__ import annotations

import datetime
import json
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from rclpy.task import Future
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, judge
from sagoma_ros.health import NodeHealth

from ..frame_source import FrameSource, Image
from ..movement.detector import describe_turn
from .model import SOFTWARE, BackgroundLearner, BackgroundModel
from .verdict import LearningJudge


class TrainingRun:
    """Takes the next ``frames`` images of a source; done when it has a model, or a reason why there is none.

    ``verdict`` says what is to be thought of what was ``learned``, also when it was refused and is no ``model``; the
    model carries its text.
    Images come on one thread, :meth:`cancel` may come on another.
    """

    def __init__(self, frames: int, source: str, before: BackgroundModel | None = None, **about: str) -> None:
        """``before``: the background in use; ``about`` fills further fields of the model's provenance."""
        self._wanted, self._source, self._before, self._about = frames, source, before, about
        self._learner, self._judge = BackgroundLearner(), LearningJudge()
        self._lock = threading.Lock()
        self.model: BackgroundModel | None = None
        self.learned: BackgroundModel | None = None
        self.refusal = ""
        self.verdict: Verdict | None = None

    @property
    def progress(self) -> str:
        """Frames taken and wanted, "57/100"."""
        return f"{self._learner.frames}/{self._wanted}"

    @property
    def done(self) -> bool:
        return self.model is not None or bool(self.refusal)

    def add(self, image: Image) -> None:
        """Take one image; the last one completes the model, which is refused when it is of no use."""
        with self._lock:
            if self.done:
                return
            try:
                self._learner.add(image)
                self._judge.add(image)
                if self._learner.frames == self._wanted:
                    self._conclude(self._learner.model(self._source, software=SOFTWARE, **self._about))
            except InputError as error:
                self.refusal = str(error)

    def cancel(self, reason: str) -> None:
        """Give up."""
        with self._lock:
            if not self.done:
                self.refusal = f"{reason} after {self._learner.frames} of {self._wanted} frames"

    def _conclude(self, model: BackgroundModel) -> None:
        self.verdict = self._judge.verdict(model, self._before)
        judged = BackgroundModel(model.mean, model.sigma, replace(model.provenance, verdict=str(self.verdict)))
        self.learned = judged
        if self.verdict.grade == REDO:
            self.refusal = describe(judged)
        else:
            self.model = judged


def describe(model: BackgroundModel) -> str:
    """One line on a background model: the verdict on it, if there was one, and where it comes from."""
    about = model.provenance
    noise = "assumed" if about.frames == 1 else "mean"
    verdict = f"{about.verdict}; " if about.verdict else ""
    return (
        f"{verdict}{about.frames} frames of {about.source}, {noise} noise {about.mean_noise:.2f} grey levels, "
        f"{100 * model.moving_share:.2f} % of the pixels moved{describe_turn(about)}"
    )


# --- One background lesson at a time, and an answer to whoever asked for it, come what may.

Outcome = tuple[bool, str]


class BackgroundTrainer:
    """Feeds frames to the lesson under way.

    keep : takes the learned model into use and says so in a line; InputError when it cannot be used.
    Frames come on one thread, requests and cancellations on others; each request is answered exactly once.
    """

    def __init__(self, keep: Callable[[BackgroundModel], str]) -> None:
        self._keep = keep
        self._lock = threading.Lock()
        self._lesson: tuple[TrainingRun, Callable[[Outcome], object]] | None = None

    @property
    def busy(self) -> bool:
        """Is a lesson under way?"""
        return self._lesson is not None

    @property
    def progress(self) -> str:
        """Frames taken and wanted by the lesson under way, "57/100"; "" without one."""
        lesson = self._lesson
        return "" if lesson is None else lesson[0].progress

    def begin(self, learning: TrainingRun, answer: Callable[[Outcome], object]) -> None:
        """Learn from the next frames, then call ``answer``. Raises InputError while another lesson is under way."""
        with self._lock:
            if self._lesson is not None:
                raise InputError("learning already", remedy="Wait for its end.")
            self._lesson = (learning, answer)

    def add(self, image: Image) -> None:
        """One more frame; the last one ends the lesson."""
        if self._lesson is None:
            return
        with self._lock:
            lesson = self._lesson
            if lesson is None:
                return
            lesson[0].add(image)
            if not lesson[0].done:
                return
            self._lesson = None
        learning, answer = lesson
        answer(self._verdict(learning))

    def cancel(self, reason: str) -> None:
        """Frames come no more: the request is answered with ``reason``."""
        with self._lock:
            lesson, self._lesson = self._lesson, None
        if lesson is not None:
            learning, answer = lesson
            learning.cancel(reason)
            answer((False, learning.refusal))

    def _verdict(self, learning: TrainingRun) -> Outcome:
        if learning.model is None:
            return False, learning.refusal
        try:
            return True, self._keep(learning.model)
        except InputError as error:
            return False, str(error)


# --- What became of a request to learn the background, as one line of JSON in the diagnostics: the service's own answer is
# text for people.

KEY = "background_training"  # of the diagnostics
PROGRESS_KEY = "background_training_progress"  # frames taken and wanted, "57/100", while a lesson is under way


@dataclass(frozen=True)
class TrainingReport:
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
    def from_json(cls, text: str) -> TrainingReport:
        """Raises ValueError for what :meth:`to_json` did not write."""
        try:
            values = json.loads(text)
            findings = tuple(Finding(**finding) for finding in values.pop("findings"))
            return cls(findings=findings, **values)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"no report of a lesson: {error}") from None


def training_report(
    learning: TrainingRun, number: int, answer: str, used: BackgroundModel | None = None, saved: str = ""
) -> TrainingReport:
    """On a lesson that is over: ``answer`` says what became of it, ``used`` is the background that is now in use, None
    where it was not taken, and ``saved`` the file that holds it."""
    verdict, model = learning.verdict, learning.learned
    findings = () if verdict is None else verdict.findings
    if used is not None:
        findings += _turned(used)
    grade = judge(findings).grade if used is not None else REDO
    if model is None:
        return TrainingReport(number, grade, findings, text=answer)
    return TrainingReport(
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
    what, _, remedy = describe_turn(model.provenance).removeprefix("; ").partition(": ")
    return (Finding(USABLE, what, remedy),) if what else ()


# --- The service ~/learn_background: one lesson at a time, its outcome for people and for programs.

PROVENANCE = ("camera_serial", "camera_model", "exposure_us", "gain", "pixel_format", "temperature_c")  # of its details


class BackgroundTrainingService:
    """Answers requests to learn the background of the frames that :meth:`add` brings.

    use : takes a learned model into use, and returns it as it is to be saved; InputError when it cannot be used.
    The diagnostics tell how far a lesson is, and what became of the last one.
    """

    def __init__(self, health: NodeHealth, use: Callable[[BackgroundModel], BackgroundModel]) -> None:
        self._health, self._use = health, use
        self._desk = BackgroundTrainer(self._keep)
        self._lessons, self._file, self._saved = 0, "", ""
        self._used: BackgroundModel | None = None

    @property
    def busy(self) -> bool:
        """Is a lesson under way?"""
        return self._desk.busy

    def add(self, image: Image) -> None:
        """One more frame."""
        self._desk.add(image)

    def cancel(self, reason: str) -> None:
        """Frames come no more: who asked is told so."""
        self._desk.cancel(reason)

    def report(self) -> None:
        """Tell the diagnostics how far the lesson under way is."""
        self._health.set(PROGRESS_KEY, self._desk.progress)

    async def train(
        self, response: Trigger.Response, source: FrameSource, frames: int, before: BackgroundModel | None, file: str
    ) -> None:
        """Learn from the next ``frames``, save the model to ``file`` (if any), and fill in ``response``."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        about = {key: value for key, value in source.details.items() if key in PROVENANCE}
        learning, over = TrainingRun(frames, source.description, before, created=now, **about), Future()
        try:
            self._desk.begin(learning, over.set_result)
        except InputError as error:
            response.message = str(error)
            return
        self._file, self._saved, self._used = file, "", None
        response.success, response.message = await over
        self._lessons += 1
        report = training_report(learning, self._lessons, response.message, self._used, self._saved)
        self._health.set(KEY, report.to_json())
        self.report()
        self._health.publish()  # before the answer, for programs that wait for both

    def _keep(self, model: BackgroundModel) -> str:
        """Use a learned background and save it; says so in a line."""
        model = self._used = self._use(model)
        if not self._file:
            return describe(model)
        try:
            model.save(self._file)
        except InputError as error:
            return f"{describe(model)}; in use, but not saved: {error}"
        self._saved = self._file
        return f"{describe(model)}; saved to {self._file}"
