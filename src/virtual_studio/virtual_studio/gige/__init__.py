"""A studio of simulated GigE Vision cameras on loopback: they speak the real protocol to any GenICam client."""

from .acquisition import TriggerWire
from .camera import SimulatedCamera
from .device import CameraSettings, Faults, free_address
from .loop import EventLoop
from .scenes import CameraScene, PatternScene, Playback
from .studio import Studio, StudioSettings

__all__ = [
    "CameraScene",
    "CameraSettings",
    "EventLoop",
    "Faults",
    "PatternScene",
    "Playback",
    "SimulatedCamera",
    "Studio",
    "StudioSettings",
    "TriggerWire",
    "free_address",
]
