"""A studio of simulated GigE Vision cameras on loopback: they speak the real protocol to any GenICam client."""

from .addresses import free_addresses
from .camera import SimulatedCamera
from .faults import Faults
from .loop import EventLoop
from .scenes import CameraScene, PatternScene
from .settings import CameraSettings
from .stage import Stage
from .studio import Studio, StudioSettings
from .trigger_wire import TriggerWire

__all__ = [
    "CameraScene",
    "CameraSettings",
    "EventLoop",
    "Faults",
    "PatternScene",
    "SimulatedCamera",
    "Stage",
    "Studio",
    "StudioSettings",
    "TriggerWire",
    "free_addresses",
]
