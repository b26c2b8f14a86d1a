"""Trains the background: on the next frames of a running camera, or from footage with people in it.

One training runs at a time, and every request gets exactly one report: for the caller, and as one line of JSON in the
diagnostics for programs that miss the answer.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.verdict import REDO, Finding, judge

from ..frame_source import Image
from ..sources.frame_checks import MIN_LIT_LEVEL, grid_sample
from .kernels import BEYOND_NOISE, HALF_MEDIAN, WITHIN_NOISE
from .model import SOFTWARE, BackgroundLearner, BackgroundModel, Provenance
from .training_verdict import describe_background, judge_background, turn_findings

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
        return "" if running is None else f"{running.learner.frames}/{running.frames}"

    def begin(
        self,
        frames: int,
        source: str,
        file: str = "",
        before: BackgroundModel | None = None,
        about: Mapping[str, str] | None = None,
    ) -> Future[TrainingReport]:
        """Learn from the next ``frames`` images of what is described as ``source``. Raises InputError while another
        training is under way.

        file : where to save the background; "" for nowhere. before : the background in use, which it replaces.
        about : further fields of the new background's provenance.
        """
        with self._lock:
            if self._running is not None:
                raise InputError("learning already", remedy="Wait for its end.")
            self._number += 1
            self._running = _Training(self._number, frames, source, file, before, about or {})
            return self._running.over

    def add(self, image: Image) -> None:
        """Learn from one more frame (H, W) or (H, W, 3); the last one ends the training."""
        if self._running is None:
            return
        error = ""
        with self._lock:
            running = self._running
            if running is None:
                return
            try:
                running.learner.add(image)
            except InputError as unfit:
                error = str(unfit)
            if not error and running.learner.frames < running.frames:
                return
            self._running = None
        running.over.set_result(running.report(error) if error else self._conclude(running))

    def cancel(self, reason: str) -> None:
        """End the training under way, if any, because no more frames come."""
        with self._lock:
            running, self._running = self._running, None
        if running is not None:
            taken = f"{running.learner.frames} of {running.frames} frames"
            running.over.set_result(running.report(f"{reason} after {taken}"))

    def _conclude(self, training: _Training) -> TrainingReport:
        """Judge, use and save the learned background."""
        model, findings = None, tuple[Finding, ...]()
        try:
            model = training.learner.model(training.source, software=SOFTWARE, **training.about)
            verdict = judge_background(model, training.learner.brightness, training.before)
            model, findings = model.with_provenance(verdict=str(verdict)), verdict.findings
            if verdict.grade == REDO:
                return training.report(describe_background(model), model, findings)
            used = self._use(model)
        except Exception as error:  # whatever it is, the request gets its report
            text = str(error) if isinstance(error, InputError) else f"the background cannot be used: {error!r}"
            return training.report(text, model, findings)
        findings += turn_findings(used.provenance)
        text, saved = describe_background(used), ""
        if training.file:
            try:
                used.save(training.file)
                text, saved = f"{text}; saved to {training.file}", training.file
            except InputError as error:
                text = f"{text}; in use, but not saved: {error}"
        return training.report(text, model, findings, judge(findings).grade, saved)


@dataclass(frozen=True, eq=False)
class _Training:
    """A training under way; see :meth:`BackgroundTrainer.begin`."""

    number: int
    frames: int
    source: str
    file: str
    before: BackgroundModel | None
    about: Mapping[str, str]
    learner: BackgroundLearner = field(default_factory=BackgroundLearner)
    over: Future[TrainingReport] = field(default_factory=Future)

    def report(
        self,
        text: str,
        model: BackgroundModel | None = None,
        findings: tuple[Finding, ...] = (),
        grade: str = REDO,
        saved: str = "",
    ) -> TrainingReport:
        """Return the report; by default that ``model`` was not taken, or that there is none."""
        if model is None:
            return TrainingReport(self.number, grade, findings, text=text)
        frames, noise = model.provenance.frames, round(model.provenance.mean_noise, 3)
        return TrainingReport(self.number, grade, findings, frames, noise, round(model.moving_share, 5), saved, text)


# --- from footage with people in it: what each pixel shows most of the time, and where that is not known
#
# Of a pixel's grey levels over time, the shortest interval that holds half of them (the shorth: Andrews et al.,
# "Robust Estimates of Location", 1972) is the background's as long as somebody stood there for less than half of the
# time. Where a third of the time something else was seen, or no level came back, nothing is certain: the model's
# noise is as large as the spread of all that was seen, so that a difference there says little.

FEWEST_FRAMES = 20
CERTAIN_SHARE = 2 / 3  # of the time a background that is certain was seen
HALF_OF_NORMAL = 2 / HALF_MEDIAN  # sigmas that the middle half of a normal distribution spans
BAND_ROWS = 64  # processed together, so that memory stays small


def background_of_footage(frames: Sequence[Image], source: str) -> tuple[BackgroundModel, npt.NDArray[np.bool_]]:
    """Return the model of a scene that people walk through, and where (H, W) it is uncertain.

    frames : (H, W) or (H, W, 3) uint8, spread over the footage. Raises InputError for too few of them.
    """
    if len(frames) < FEWEST_FRAMES:
        what = f"{len(frames)} frames are too few to tell a background from the people before it"
        raise InputError(what, where=source, remedy=f"Give footage of at least {FEWEST_FRAMES} frames.")
    gains = _brightness(frames)
    mean, sigma = np.empty((2, *frames[0].shape), np.float32)
    uncertain = np.empty(frames[0].shape[:2], bool)
    for top in range(0, len(mean), BAND_ROWS):
        rows = slice(top, top + BAND_ROWS)
        levels = np.stack([frame[rows] / gain for frame, gain in zip(frames, gains, strict=True)]).astype(np.float32)
        mean[rows], sigma[rows], uncertain[rows] = _most_frequent(levels)
    noise = float(np.median(sigma[~uncertain])) if not uncertain.all() else float(np.median(sigma))
    return BackgroundModel(mean, sigma, Provenance(source, len(frames), noise, software=SOFTWARE)), uncertain


def _brightness(frames: Sequence[Image]) -> npt.NDArray[np.float32]:
    """Return how many times brighter each frame is than the median frame: exposure and white balance wander."""
    samples = np.stack([grid_sample(frame).astype(np.float32).reshape(-1) for frame in frames])
    typical = np.median(samples, axis=0)
    lit = typical >= MIN_LIT_LEVEL
    if not lit.any():
        return np.ones(len(frames), np.float32)
    return np.maximum(np.median(samples[:, lit] / typical[lit], axis=1), 0.1).astype(np.float32)


def _most_frequent(
    levels: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Return mean and standard deviation of what levels (n, h, w[, 3]) show most of the time, and where (h, w) that is
    uncertain."""
    n, half = len(levels), len(levels) // 2
    grey = levels if levels.ndim == 3 else levels.mean(axis=3)
    ordered = np.sort(grey, axis=0)
    widths = ordered[half:] - ordered[: n - half]
    first = widths.argmin(axis=0)[None]
    width = np.take_along_axis(widths, first, axis=0)[0]
    middle = 0.5 * (np.take_along_axis(ordered, first, axis=0) + np.take_along_axis(ordered, first + half, axis=0))[0]
    typical = max(float(np.median(width)) / HALF_OF_NORMAL, 0.5)
    near = np.abs(grey - middle) <= BEYOND_NOISE * np.clip(width / HALF_OF_NORMAL, typical, WITHIN_NOISE * typical)
    uncertain = near.mean(axis=0) < CERTAIN_SHARE
    weight = near.astype(np.float32)
    if levels.ndim == 4:
        weight = weight[..., None]
    count = np.maximum(weight.sum(axis=0), 1.0)
    mean = (weight * levels).sum(axis=0) / count
    sigma = np.sqrt((weight * (levels - mean) ** 2).sum(axis=0) / count)
    spread = levels.std(axis=0)
    unsure = uncertain if levels.ndim == 3 else uncertain[..., None]
    return mean, np.where(unsure, np.maximum(spread, sigma), sigma), uncertain
