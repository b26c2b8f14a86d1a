"""Camera models, rig calibration and session folders of a multi-camera capture rig."""

from .camera import CameraModel, UndistortedView
from .errors import InputError
from .rig import Rig, Volume, load_rig, save_rig
from .session import Session, Truth, footage_stamp_ns, load_session, load_truth
from .settings import build_settings, setting

__all__ = [
    "CameraModel",
    "InputError",
    "Rig",
    "Session",
    "Truth",
    "UndistortedView",
    "Volume",
    "build_settings",
    "footage_stamp_ns",
    "load_rig",
    "load_session",
    "load_truth",
    "save_rig",
    "setting",
]
