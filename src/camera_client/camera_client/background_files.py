"""A background model from whatever the user has: a saved model, one still, a video or stills of the empty scene."""

from __future__ import annotations

from pathlib import Path

from . import __version__
from .background_model import BackgroundLearner, BackgroundModel, background_from_still, check_shape, load_background
from .footage_reader import FootageReader, open_footage
from .frame_source import UndecodableFrame
from .settings import BackgroundSettings

SOFTWARE = f"sagoma camera_client {__version__}"


def read_background(path: str | Path, shape: tuple[int, ...], settings: BackgroundSettings) -> BackgroundModel:
    """The background at ``path`` for images of ``shape``. Raises InputError naming the file.

    A ``.npz`` is loaded; several images are learned from; a single one is taken as the mean, with the noise that
    ``settings.still_sigma`` assumes.
    """
    path = Path(path)
    if path.suffix == ".npz":
        model = load_background(path)
    else:
        reader = open_footage(path, "mono" if len(shape) == 2 else "colour")
        try:
            model = _learned(reader, settings)
        finally:
            reader.close()
    check_shape(model, shape, str(path))
    return model


def _learned(reader: FootageReader, settings: BackgroundSettings) -> BackgroundModel:
    reader.probe()
    learner, last = BackgroundLearner(), None
    while True:
        try:
            image = reader.read()
        except UndecodableFrame:
            continue
        if image is None:
            break
        last = image
        learner.add(image)
    if last is not None and learner.frames == 1:
        return background_from_still(last, settings.still_sigma, str(reader.path), software=SOFTWARE)
    return learner.model(str(reader.path), software=SOFTWARE)
