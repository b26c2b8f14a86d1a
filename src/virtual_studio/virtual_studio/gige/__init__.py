"""A studio of simulated GigE Vision cameras on loopback: they speak the real protocol to any GenICam client."""

from ..live.scenes import CameraScene, PatternScene, Playback
from .addresses import free_addresses
from .server.device import CameraSettings, Faults
from .server.loop import EventLoop
from .simulated_camera.camera import SimulatedCamera
from .simulated_camera.timing import TriggerWire
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
    "free_addresses",
]
