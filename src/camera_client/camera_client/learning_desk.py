"""One background lesson at a time, and an answer to whoever asked for it, come what may."""

from __future__ import annotations

import threading
from collections.abc import Callable

from capture_rig.errors import InputError

from .background_model import BackgroundModel
from .frame_source import Image
from .live_learning import LiveLearning

Verdict = tuple[bool, str]


class LearningDesk:
    """Feeds frames to the lesson under way.

    keep : takes the learned model into use and says so in a line; InputError when it cannot be used.
    Frames come on one thread, requests and cancellations on others; each request is answered exactly once.
    """

    def __init__(self, keep: Callable[[BackgroundModel], str]) -> None:
        self._keep = keep
        self._lock = threading.Lock()
        self._lesson: tuple[LiveLearning, Callable[[Verdict], object]] | None = None

    @property
    def busy(self) -> bool:
        """Is a lesson under way?"""
        return self._lesson is not None

    @property
    def progress(self) -> str:
        """Frames taken and wanted by the lesson under way, "57/100"; "" without one."""
        lesson = self._lesson
        return "" if lesson is None else lesson[0].progress

    def begin(self, learning: LiveLearning, answer: Callable[[Verdict], object]) -> None:
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

    def _verdict(self, learning: LiveLearning) -> Verdict:
        if learning.model is None:
            return False, learning.refusal
        try:
            return True, self._keep(learning.model)
        except InputError as error:
            return False, str(error)
