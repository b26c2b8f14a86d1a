"""The background of a fixed camera, learned: one Gaussian a pixel and channel (thesis 6.2)."""

from __future__ import annotations

import json
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.files import make_folder, replaced_file

from .. import __version__
from ..frame_source import Image, UndecodableFrame
from ..settings import BackgroundSettings
from ..sources.footage_reader import FootageReader, open_footage
from ..sources.frame_checks import MIN_LIT_LEVEL, grid_sample
from .kernels import WITHIN_NOISE

MOST_BACKGROUND_BYTES = 2 << 30  # two images of floats, of the largest sensors in colour (65 megapixels)
FORMAT = "sagoma background 1"
# Thresholds: judgement, no measurement.
NOISIEST = 4.0  # grey levels: no camera is noisier, it moved; of a single still, whose noise is not known, so much is
# assumed


@dataclass(frozen=True)
class Provenance:
    """Where a background model comes from.

    ``mean_noise`` is the mean standard deviation, grey levels; ``verdict`` the one given when it was learned.
    ``created`` is the time in ISO 8601. ``calibration`` is a checksum of the camera's calibrated pose, and
    ``camera_turn_rad`` how far the camera had turned since then (see camera_client.movement). What is unknown is "".
    """

    source: str
    frames: int
    mean_noise: float
    software: str = ""
    created: str = ""
    camera_serial: str = ""
    camera_model: str = ""
    exposure_us: str = ""
    gain: str = ""
    pixel_format: str = ""
    temperature_c: str = ""
    verdict: str = ""
    calibration: str = ""
    camera_turn_rad: str = ""

    @property
    def turn_rad(self) -> npt.NDArray[np.float64]:
        """(3,) rotation vector, radians, of the camera when this was learned, from when it was calibrated; zero where
        that is unknown."""
        try:
            turn_rad = np.array([float(part) for part in self.camera_turn_rad.split()])
        except ValueError:
            return np.zeros(3)
        return turn_rad if turn_rad.shape == (3,) and np.isfinite(turn_rad).all() else np.zeros(3)


@dataclass(frozen=True, eq=False)
class BackgroundModel:
    """Mean and standard deviation of every pixel of the empty scene, grey levels, (H, W) or (H, W, 3) float32."""

    mean: npt.NDArray[np.float32]
    sigma: npt.NDArray[np.float32]
    provenance: Provenance

    @property
    def shape(self) -> tuple[int, ...]:
        return self.mean.shape

    @property
    def channels(self) -> int:
        return 1 if self.mean.ndim == 2 else self.mean.shape[2]

    def with_provenance(self, **changes: Any) -> BackgroundModel:
        """Return the same arrays with some fields of the provenance changed."""
        return BackgroundModel(self.mean, self.sigma, replace(self.provenance, **changes))

    @property
    def moving_pixels(self) -> npt.NDArray[np.bool_]:
        """(H, W) pixels that varied much more than the rest: something moved while the background was learned."""
        spread = self.sigma if self.sigma.ndim == 2 else self.sigma.max(axis=2)
        limit = WITHIN_NOISE * np.clip(float(np.median(spread)), BackgroundSettings.sigma_floor, NOISIEST)
        return np.asarray(spread > limit)

    @cached_property
    def moving_share(self) -> float:
        """Share of the :attr:`moving_pixels`."""
        return float(self.moving_pixels.mean())

    def save(self, path: str | Path) -> None:
        """Write an .npz with the arrays and the provenance. Raises InputError when the file cannot be written."""
        path = Path(path)
        about = json.dumps({"format": FORMAT, "image": shape_text(self.shape), **asdict(self.provenance)})
        make_folder(path.parent)
        with replaced_file(path) as file:
            np.savez_compressed(file, mean=self.mean, sigma=self.sigma, about=np.array(about))


class BackgroundLearner:
    """Accumulates frames of the empty scene (thesis 6.2) with sums in float64, exact for whole grey levels.

    ``brightness`` of each frame relative to the first: the median over a sparse grid of pixels.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.brightness: list[float] = []
        self._first: npt.NDArray[np.float32] | None = None
        self._sum: npt.NDArray[np.float64] | None = None
        self._sum_of_squares: npt.NDArray[np.float64] | None = None

    def add(self, image: Image) -> None:
        """Take one more frame. Raises InputError when its shape differs from the first one's."""
        if self._sum is None or self._sum_of_squares is None:
            self._sum, self._sum_of_squares = np.zeros(image.shape), np.zeros(image.shape)
        if image.shape != self._sum.shape:
            raise InputError(
                f"frame {self.frames} is {shape_text(image.shape)}, the first one was {shape_text(self._sum.shape)}",
                remedy="Learn from frames of one size.",
            )
        cv2.accumulate(image, self._sum)
        cv2.accumulateSquare(image, self._sum_of_squares)
        self.frames += 1
        sample = grid_sample(image).astype(np.float32)
        if self._first is None:
            self._first = sample
        lit = self._first >= MIN_LIT_LEVEL
        self.brightness.append(float(np.median(sample[lit] / self._first[lit])) if lit.any() else 1.0)

    def model(self, source: str, **about: str) -> BackgroundModel:
        """Return the model of the frames so far (two at least); ``about`` fills further fields of the provenance."""
        if self._sum is None or self._sum_of_squares is None or self.frames < 2:
            raise InputError(
                f"{self.frames} frames are too few to learn a background",
                where=source,
                remedy="Give at least 2; 50 to 200 are good.",
            )
        n = self.frames
        mean = self._sum / n
        variance = np.maximum(self._sum_of_squares - n * mean * mean, 0) / (n - 1)
        sigma = np.sqrt(variance).astype(np.float32)
        return BackgroundModel(mean.astype(np.float32), sigma, Provenance(source, n, float(sigma.mean()), **about))


def load_background(path: str | Path) -> BackgroundModel:
    """Read a model that :meth:`BackgroundModel.save` wrote. Raises InputError for anything else."""
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            if sum(member.file_size for member in file.zip.infolist()) > MOST_BACKGROUND_BYTES:
                raise ValueError("too large")
            mean, sigma, about = file["mean"], file["sigma"], json.loads(str(file["about"]))
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})",
            where=str(path),
            remedy="Give the path of a saved background model.",
        ) from None
    except Exception:  # whatever the readers of zip, npy and JSON raise for damaged bytes
        raise InputError("is not a background model", where=str(path), remedy="Learn and save it again.") from None
    known = {field.name for field in fields(Provenance)}
    needed = {field.name for field in fields(Provenance) if field.default is MISSING}
    if isinstance(about, dict):
        about.pop("image", None)  # the arrays say it; written for people who look into the file
    if not isinstance(about, dict) or about.pop("format", None) != FORMAT or not needed <= set(about) <= known:
        raise InputError("was written by another version", where=str(path), remedy="Learn and save it again.")
    sound = mean.shape == sigma.shape and mean.dtype == sigma.dtype == np.float32
    if not sound or not np.isfinite(mean).all() or not (np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise InputError("holds damaged arrays", where=str(path), remedy="Learn and save it again.")
    return BackgroundModel(mean, sigma, Provenance(**about))


def check_shape(model: BackgroundModel, shape: tuple[int, ...], where: str) -> None:
    """Raises InputError when the model was learned at another size or number of channels than ``shape``."""
    if model.shape != tuple(shape):
        raise InputError(
            f"the background is {shape_text(model.shape)}, the camera's images are {shape_text(shape)}",
            where=where,
            remedy="Learn the background again with this camera and setting, or set the parameter 'channels'.",
        )


def shape_text(shape: tuple[int, ...]) -> str:
    """ "640 x 480 mono" for (480, 640)."""
    kind = "mono" if len(shape) == 2 else "colour"
    return f"{shape[1]} x {shape[0]} {kind}"


# --- reading a background from a saved model, one still, a video or stills of the empty scene

SOFTWARE = f"sagoma camera_client {__version__}"


def read_background(path: str | Path, shape: tuple[int, ...]) -> BackgroundModel:
    """Return the background at ``path`` for images of ``shape``. Raises InputError naming the file.

    A ``.npz`` is loaded; several images are learned from; a single one is taken as the mean, with the noise that
    NOISIEST assumes.
    """
    path = Path(path)
    if path.suffix == ".npz":
        model = load_background(path)
    else:
        reader = open_footage(path, "mono" if len(shape) == 2 else "colour")
        try:
            model = _learn(reader)
        finally:
            reader.close()
    check_shape(model, shape, str(path))
    return model


def _learn(reader: FootageReader) -> BackgroundModel:
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
        about = Provenance(str(reader.path), 1, NOISIEST, software=SOFTWARE)
        return BackgroundModel(last.astype(np.float32), np.full(last.shape, NOISIEST, np.float32), about)
    return learner.model(str(reader.path), software=SOFTWARE)
