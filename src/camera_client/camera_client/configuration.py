"""Makes the parts of a camera client that its settings name: calibration and source; all or nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import load_camera_info, read_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import Volume, load_rig
from capture_rig.visibility import may_be_halved, of_shape

from .frame_source import FrameSource
from .settings import CameraClientSettings
from .sources.aravis_source import AravisSource
from .sources.footage_source import FootageSource, SharedClock
from .sources.supervised_source import SupervisedSource
from .sources.webcam_source import WebcamSource


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of the camera ``name``: nothing, its lens, or its lens and its pose in the room.

    ``camera`` is None while the lens is unknown: silhouettes cannot be undistorted then. ``volume`` is the rig's
    capture volume, metres, map frame; it is None while the camera's pose is unknown, and ``camera``'s pose then means
    nothing.
    """

    name: str
    camera: CameraModel | None = None
    volume: Volume | None = None

    @property
    def placed(self) -> bool:
        """Whether the camera's pose in the room is known."""
        return self.volume is not None


def unplaced_camera(name: str, width: int, height: int) -> CameraModel:
    """Return a camera of which only name and image size, px, are known, to be given its intrinsics."""
    return CameraModel(name, width, height, np.eye(3), "plumb_bob", np.zeros(5), np.eye(4))


Accept = Callable[[FrameSource], None]

# Thresholds: judgement, no measurement.
STALL_PERIODS = 5  # a camera that is slow has not stalled


def load_calibration(settings: CameraClientSettings, name: str) -> Calibration:
    """What the settings say of the camera ``name``: all with a rig, else the intrinsics of camera_info_file, if any.

    Raises InputError naming the file: one that cannot be read, or does not know this camera.
    """
    path = settings.camera_info_file
    has_info = bool(path) and Path(path).exists()
    if not settings.rig_file:
        return Calibration(name, read_camera_info(path, name) if has_info else None)
    try:
        rig = load_rig(settings.rig_file)
        camera = rig.camera(name)
    except InputError as error:
        raise InputError(error.what, where=error.where or settings.rig_file, remedy=error.remedy) from None
    return Calibration(name, load_camera_info(path, camera) if has_info else camera, rig.volume)


def connect_source(
    settings: CameraClientSettings,
    calibration: Calibration,
    accept: Accept,
    clock: SharedClock,
    topic: Callable[[], FrameSource],
) -> FrameSource:
    """Return the source that ``settings.source`` names, connected, and looked at by ``accept``. Raises InputError.

    A live camera that is not there is no error: it is awaited once the source runs, and looked at when it comes.
    ``clock`` : the one that footage shares with the other cameras; ``topic`` : makes the source of source: topic.
    """
    if settings.source != "footage":
        halve = not settings.publish_raw and may_be_halved(calibration.camera, calibration.volume)
        source: FrameSource = live_source(settings, accept, topic, halve)
        source.connect()
        return source
    if not settings.footage.path:
        remedy = "Give a video or stills, or set source: aravis."
        raise InputError("is empty", where="parameter footage.path", remedy=remedy)
    with ExitStack() as stack:
        source = stack.enter_context(FootageSource(settings.footage, settings.channels, shared=clock))
        accept(source)
        stack.pop_all()
    return source


def live_source(
    settings: CameraClientSettings,
    accept: Accept,
    topic: Callable[[], FrameSource] | None = None,
    halve_mosaics: bool = False,
) -> SupervisedSource:
    """Return the live camera of ``settings`` under supervision, not connected yet. Raises InputError.

    ``halve_mosaics``: images of Bayer cameras at half of the size are fine enough.
    """
    makers: dict[str, Callable[[], FrameSource] | None] = {
        "aravis": lambda: AravisSource(settings.aravis, settings.channels, halve_mosaics),
        "webcam": lambda: WebcamSource(settings.webcam, settings.channels),
        "topic": topic,
    }
    make = makers[settings.source] if settings.source in makers else plugin(settings)
    assert make is not None
    return SupervisedSource(make, accept, lambda source: stall_timeout_s(settings, source))


def plugin(settings: CameraClientSettings) -> Callable[[], FrameSource]:
    """Return what makes a user's own source, ``MODULE:CLASS`` called with plugin.options. Raises InputError."""
    where, name = "parameter plugin.source", settings.plugin.source
    module_name, _, class_name = name.partition(":")
    try:
        kind = getattr(import_module(module_name), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        remedy = "Name it as MODULE:CLASS, its module on PYTHONPATH (docs/how-to/camera_pcs.md has an example)."
        raise InputError(f"'{name}' cannot be imported: {error}", where=where, remedy=remedy) from None
    if not (isinstance(kind, type) and issubclass(kind, FrameSource)):
        raise InputError(f"'{name}' is no FrameSource", where=where, remedy="Derive it from FrameSource.")
    options = {name: value for name, _, value in (option.partition("=") for option in settings.plugin.options)}
    return lambda: kind(**options)


def stall_timeout_s(settings: CameraClientSettings, source: FrameSource) -> float:
    """Return how long the connected ``source`` may be silent before it counts as stalled; infinite for never."""
    supervision, aravis = settings.supervision, settings.aravis
    is_aravis = settings.source == "aravis"
    if is_aravis and aravis.sync == "line":  # when the line is pulsed is not known here
        return supervision.triggered_stall_timeout_s or math.inf
    given_hz = aravis.frame_rate if is_aravis and aravis.frame_rate > 0 else float(source.details.get("frame_rate", 0))
    rate_hz = given_hz * aravis.clock_speed if is_aravis else given_hz
    return max(supervision.stall_timeout_s, STALL_PERIODS / rate_hz if rate_hz > 0 else 0.0)


def check_size(source: FrameSource, camera: CameraModel) -> None:
    """Raises InputError when the source's images are not as large as the camera was calibrated for."""
    height, width = source.shape[:2]
    given = of_shape(camera, source.shape) if source.halved else camera
    if (width, height) != (given.width, given.height):
        raise InputError(
            f"gives images of {width} x {height} pixels, camera {camera.name} was calibrated at "
            f"{camera.width} x {camera.height}",
            where=source.description,
            remedy="Set the camera's region, or use the rig file that belongs to this footage.",
        )
