"""What the doctor looks at on the machine it runs on, as plain data. None means unknown."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..facts import HostFacts, InterfaceFacts


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
    """Everything about this machine."""

    host: HostFacts
    software: SoftwareFacts
    graphics: GraphicsFacts
    kernels: KernelFacts
    disk: DiskFacts
    shared_memory: SharedMemoryFacts
    limits: LimitFacts
    network: NetworkFacts = field(default_factory=lambda: NetworkFacts((), 0))
    total_bytes: int = 0
