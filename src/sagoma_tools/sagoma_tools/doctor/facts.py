"""Facts about this machine and one camera that the doctor checks, as plain data. None means unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class InterfaceFacts:
    """The network interface on the way to the camera. ``speed_mbit`` is 0 where the driver does not tell."""

    name: str
    address: str
    netmask: str
    mtu: int
    speed_mbit: int
    up: bool = True
    loopback: bool = False


@dataclass(frozen=True)
class DeviceFacts:
    """A camera's answers to unicast requests, which disturb no program that uses it.

    ``error`` says why there is no answer. ``controller`` is the address of the program in control ("" for none, None
    where the camera does not report it); ``controlled`` whether there is one.
    """

    address: str
    error: str = ""
    name: str = ""
    serial: str = ""
    user_id: str = ""
    own_address: str = ""
    subnet_mask: str = ""
    controlled: bool | None = None
    controller: str | None = None
    can_ptp: bool | None = None
    can_resend: bool | None = None


@dataclass(frozen=True)
class BackgroundFacts:
    """The background file: why it cannot be used, or its age and its provenance."""

    path: str
    error: str = ""
    age_s: float = 0.0
    shape: tuple[int, ...] = ()
    summary: str = ""
    exposure_us: str = ""


@dataclass(frozen=True)
class ClockFacts:
    """Synchronisation of the system's clock: by which service, in step or not, and its offset at most (seconds)."""

    keeper: str = ""
    in_step: bool | None = None
    offset_s: float | None = None
    unknown_because: str = ""


@dataclass(frozen=True)
class HostFacts:
    """This machine. ``governors`` of its cores, empty where the system does not tell (a virtual machine); ``rmem_max``
    (bytes) is None where it does not either (a container)."""

    rmem_max: int | None
    cores: int
    load: float
    available_bytes: int
    governors: tuple[str, ...] = ()
    clock: ClockFacts = field(default_factory=ClockFacts)
    environment: Mapping[str, str] = field(default_factory=dict)
    aravis_error: str = ""


@dataclass(frozen=True)
class Stream:
    """What one camera sends: its name, payload and rate. ``frame_rate`` is 0 where the settings leave it open."""

    camera: str
    payload_bytes: int
    frame_rate: float


@dataclass(frozen=True)
class SoftwareFacts:
    """The distribution ("debian", "12"), Python, and the ROS that is loaded; ``rmw_error`` says why there is none."""

    system: str
    system_version: str
    python: tuple[int, int]
    ros_distro: str = ""
    rmw: str = ""
    rmw_error: str = ""


@dataclass(frozen=True)
class GraphicsFacts:
    """The OpenGL that the hull server would find: a hardware device, a software renderer, or why there is none."""

    error: str = ""
    renderer: str = ""
    version: str = ""
    hardware: bool = False


@dataclass(frozen=True)
class KernelFacts:
    """numba's cache: how many compiled kernels, whether it may be written, and whether it is of today's sources."""

    folder: str
    compiled: int
    writable: bool
    fresh: bool | None = None


@dataclass(frozen=True)
class DiskFacts:
    """Where bags are written: free space, and how fast a few MiB reach the disk."""

    folder: str
    error: str = ""
    free_bytes: int = 0
    write_bytes_per_s: float | None = None


@dataclass(frozen=True)
class SharedMemoryFacts:
    """/dev/shm, through which nodes of one machine talk: its size, what is free, and files of processes that died."""

    size_bytes: int
    free_bytes: int
    abandoned: int = 0


@dataclass(frozen=True)
class LimitFacts:
    """What this user may have: open files, real-time priority, locked memory (bytes; -1 without limit)."""

    open_files: int
    rtprio: int
    memlock_bytes: int


@dataclass(frozen=True)
class NetworkFacts:
    """Interfaces (without loopback), send buffer limit (bytes), active firewalls, and the Fast DDS profile named."""

    interfaces: tuple[InterfaceFacts, ...]
    wmem_max: int | None
    firewalls: tuple[str, ...] = ()
    profile: str = ""
    profile_exists: bool = True
    domains_here: tuple[int, ...] = ()


@dataclass(frozen=True)
class MachineFacts:
    """All facts about this machine."""

    host: HostFacts
    software: SoftwareFacts
    graphics: GraphicsFacts
    kernels: KernelFacts
    disk: DiskFacts
    shared_memory: SharedMemoryFacts
    limits: LimitFacts
    network: NetworkFacts = field(default_factory=lambda: NetworkFacts((), 0))
    total_bytes: int = 0
