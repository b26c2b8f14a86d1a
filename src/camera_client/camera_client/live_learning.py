"""Learning the background from the next frames of a running source, and a verdict on what was learned."""

from __future__ import annotations

import threading
from dataclasses import replace

from capture_rig.errors import InputError
from capture_rig.verdict import REDO, Verdict

from .background_files import SOFTWARE
from .background_model import BackgroundLearner, BackgroundModel
from .camera_moved_history import tell_turn
from .frame_source import Image
from .learning_verdict import LearningJudge


class LiveLearning:
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
        f"{100 * model.moving_share:.2f} % of the pixels moved{tell_turn(about)}"
    )
