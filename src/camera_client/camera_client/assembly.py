"""From settings to the parts of a camera client: which camera of the rig, which source; all or nothing."""

from __future__ import annotations

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import load_rig

from .aravis_source import AravisSource
from .footage_source import FootageSource
from .frame_source import FrameSource
from .settings import CameraClientSettings


def load_camera(rig_file: str, name: str) -> CameraModel:
    """The calibrated camera ``name`` of ``rig_file``. Raises InputError naming the file."""
    if not rig_file:
        raise InputError("is empty", where="parameter rig_file", remedy="Give the path of the rig YAML.")
    try:
        return load_rig(rig_file).camera(name)
    except InputError as error:
        raise InputError(error.what, where=error.where or rig_file, remedy=error.remedy) from None


def make_source(settings: CameraClientSettings) -> FrameSource:
    """The source that ``settings.source`` names, not connected yet."""
    if settings.source == "aravis":
        return AravisSource(settings.aravis, settings.channels)
    if not settings.footage.path:
        raise InputError("is empty", where="parameter footage.path",
                         remedy="Give a video or stills, or set source: aravis.")  # fmt: skip
    return FootageSource(settings.footage, settings.channels)


def connect_source(settings: CameraClientSettings, camera: CameraModel) -> FrameSource:
    """The source, connected, its images as large as the camera was calibrated for. Raises InputError otherwise."""
    source = make_source(settings)
    source.connect()
    height, width = source.shape[:2]
    if (width, height) != (camera.width, camera.height):
        source.close()
        raise InputError(
            f"gives images of {width} x {height} pixels, camera {camera.name} was calibrated at "
            f"{camera.width} x {camera.height}",
            where=source.description,
            remedy="Set the camera's region, or use the rig file that belongs to this footage.",
        )
    return source
