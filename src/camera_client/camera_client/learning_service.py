"""The service ~/learn_background: one lesson at a time, its outcome for people and for programs."""

from __future__ import annotations

import datetime
from collections.abc import Callable

from rclpy.task import Future
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from sagoma_ros.health import NodeHealth

from .background_model import BackgroundModel
from .frame_source import FrameSource, Image
from .learning_desk import LearningDesk
from .lesson_report import KEY, PROGRESS_KEY, report_of
from .live_learning import LiveLearning, describe

PROVENANCE = ("camera_serial", "camera_model", "exposure_us", "gain", "pixel_format", "temperature_c")  # of its details


class LearningService:
    """Answers requests to learn the background of the frames that :meth:`add` brings.

    use : takes a learned model into use, and returns it as it is to be saved; InputError when it cannot be used.
    The diagnostics tell how far a lesson is, and what became of the last one.
    """

    def __init__(self, health: NodeHealth, use: Callable[[BackgroundModel], BackgroundModel]) -> None:
        self._health, self._use = health, use
        self._desk = LearningDesk(self._keep)
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

    async def teach(
        self, response: Trigger.Response, source: FrameSource, frames: int, before: BackgroundModel | None, file: str
    ) -> None:
        """Learn from the next ``frames``, save the model to ``file`` (if any), and fill in ``response``."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        about = {key: value for key, value in source.details.items() if key in PROVENANCE}
        learning, over = LiveLearning(frames, source.description, before, created=now, **about), Future()
        try:
            self._desk.begin(learning, over.set_result)
        except InputError as error:
            response.message = str(error)
            return
        self._file, self._saved, self._used = file, "", None
        response.success, response.message = await over
        self._lessons += 1
        report = report_of(learning, self._lessons, response.message, self._used, self._saved)
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
