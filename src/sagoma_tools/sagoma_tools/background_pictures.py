"""Pictures of a background model: its mean, and its noise with the places where something moved."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from camera_client.background_model import BackgroundModel
from camera_client.places import find_places
from capture_rig.errors import InputError

BRIGHTEST_SIGMA = 10.0  # grey levels; as much noise and more has the brightest colour
FRAME_BGR = (0, 0, 255)


def mean_picture(model: BackgroundModel) -> np.ndarray:
    """(H, W) or (H, W, 3) uint8: the empty room."""
    return np.rint(model.mean).clip(0, 255).astype(np.uint8)


def sigma_picture(model: BackgroundModel) -> np.ndarray:
    """(H, W, 3) uint8: dark where the pixel was steady, yellow at BRIGHTEST_SIGMA; boxes where something moved."""
    sigma = model.sigma if model.sigma.ndim == 2 else model.sigma.max(axis=2)
    levels = np.rint(sigma * (255 / BRIGHTEST_SIGMA)).clip(0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    for place in find_places(model.moving_pixels):
        cv2.rectangle(picture, (place.left, place.top), (place.right, place.bottom), FRAME_BGR)
    return picture


def write_pictures(model: BackgroundModel, folder: Path, name: str) -> list[Path]:
    """NAME_mean.png and NAME_sigma.png in ``folder``. Raises InputError when they cannot be written."""
    written = []
    for kind, picture in (("mean", mean_picture(model)), ("sigma", sigma_picture(model))):
        path = folder / f"{name}_{kind}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror})", where=str(path), remedy="Choose another folder with --output."
            ) from None
        written.append(path)
    return written
