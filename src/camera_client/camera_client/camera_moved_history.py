"""How far the camera had turned when a background was learned: a new background must not make that forgotten.

Learning the background of a bumped camera again repairs its silhouettes, but not its calibration. So each background is
compared with the one before, and tells how far the camera had turned since the first that was learned with the same
calibration. Another calibration of the camera's place begins anew.
"""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from capture_rig.camera import CameraModel

from .background_model import BackgroundModel, Provenance
from .camera_moved import GAINED, TRUSTED
from .camera_moved_alignment import PictureAlignment
from .camera_moved_points import Array
from .rotation import matrix_of, vector_of

TOLD_DEG = 0.2


def place_of(camera: CameraModel) -> str:
    """A short name of where a calibration puts the camera."""
    return f"{zlib.crc32((np.round(camera.T_camera_world, 6) + 0.0).tobytes()):08x}"


def turn_when_learned(about: Provenance, camera: CameraModel) -> Array:
    """(3,) rotation vector, radians, of the camera when this background was learned, from when it was calibrated; zero
    where the background tells of none, or of another calibration."""
    return _turn(about) if about.calibration == place_of(camera) else np.zeros(3)


def _turn(about: Provenance) -> Array:
    try:
        turn_rad = np.array([float(part) for part in about.camera_turn_rad.split()])
    except ValueError:
        return np.zeros(3)
    return turn_rad if turn_rad.shape == (3,) and np.isfinite(turn_rad).all() else np.zeros(3)


def tell_turn(about: Provenance) -> str:
    """A clause for people about a background of a camera that was moved after its calibration; else ""."""
    turn_deg = float(np.degrees(np.linalg.norm(_turn(about))))
    if turn_deg < TOLD_DEG:
        return ""
    return f"; since it was calibrated the camera has turned by {turn_deg:.1f} degrees: calibrate it again"


def succeed(model: BackgroundModel, before: BackgroundModel | None, camera: CameraModel) -> BackgroundModel:
    """``model``, and how far the camera had turned when it was learned, as the background ``before`` it shows."""
    place, turn_rad = place_of(camera), np.zeros(3)
    if before is not None and before.shape == model.shape and before.provenance.calibration in ("", place):
        turn_rad = turn_when_learned(before.provenance, camera)
        step_rad = turn_between(before, model, camera)
        if step_rad is not None:
            turn_rad = vector_of(matrix_of(step_rad) @ matrix_of(turn_rad))
    text = " ".join(f"{angle:.6f}" for angle in turn_rad)
    return replace(model, provenance=replace(model.provenance, calibration=place, camera_turn_rad=text))


def turn_between(before: BackgroundModel, model: BackgroundModel, camera: CameraModel) -> Array | None:
    """(3,) rotation vector by which the camera turned between two backgrounds; None when they do not tell."""
    sigma = float(np.median(before.sigma))
    found = PictureAlignment(camera, before.mean, sigma).align(model.mean)
    if found is None or found.agreeing < TRUSTED:
        return None
    unmoved = found.agreeing - found.agreeing_unmoved < GAINED
    return np.zeros(3) if unmoved and np.linalg.norm(found.turn_rad) < 1e-3 else found.turn_rad
