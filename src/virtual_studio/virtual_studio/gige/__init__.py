"""A studio of simulated GigE Vision cameras on loopback: they speak the real protocol to any GenICam client."""

from .acquisition import TriggerWire as TriggerWire
from .device import CameraSettings as CameraSettings
from .device import Faults as Faults
from .device import free_address as free_address
from .loop import EventLoop as EventLoop
from .scenes import PatternScene as PatternScene
from .scenes import Playback as Playback
from .simulated_camera import SimulatedCamera as SimulatedCamera
from .studio import Studio as Studio
from .studio import StudioSettings as StudioSettings
