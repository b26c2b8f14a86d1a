"""Learning the background from the next frames of a running source, and a verdict on what was learned."""

from __future__ import annotations

import threading

from capture_rig.errors import InputError

from .background_files import SOFTWARE
from .background_model import BackgroundLearner, BackgroundModel
from .frame_source import Image

MAX_MOVING_SHARE = 0.02


class LiveLearning:
    """Takes the next ``frames`` images of a source; done when it has a model, or a reason why there is none.

    Images come on one thread, :meth:`cancel` may come on another.
    """

    def __init__(self, frames: int, source: str, **about: str) -> None:
        self._wanted, self._source, self._about = frames, source, about
        self._learner = BackgroundLearner()
        self._lock = threading.Lock()
        self.model: BackgroundModel | None = None
        self.refusal = ""

    @property
    def done(self) -> bool:
        return self.model is not None or bool(self.refusal)

    def add(self, image: Image) -> None:
        """Take one image; the last one completes the model, which is refused when something moved."""
        with self._lock:
            if self.done:
                return
            try:
                self._learner.add(image)
                if self._learner.frames == self._wanted:
                    self._judge(self._learner.model(self._source, software=SOFTWARE, **self._about))
            except InputError as error:
                self.refusal = str(error)

    def cancel(self, reason: str) -> None:
        """Give up."""
        with self._lock:
            if not self.done:
                self.refusal = f"{reason} after {self._learner.frames} of {self._wanted} frames"

    def _judge(self, model: BackgroundModel) -> None:
        if model.moving_share > MAX_MOVING_SHARE:
            self.refusal = f"something moved: {describe(model)}; clear the scene and call again"
        else:
            self.model = model


def describe(model: BackgroundModel) -> str:
    """One line on a background model."""
    about = model.provenance
    noise = "assumed" if about.frames == 1 else "mean"
    return (
        f"{about.frames} frames of {about.source}, {noise} noise {about.mean_noise:.2f} grey levels, "
        f"{100 * model.moving_share:.2f} % of the pixels moved"
    )
