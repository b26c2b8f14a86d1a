"""What the doctor looks at, as plain data: a test can make up any machine. None means unknown."""

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
    """What the camera itself answers to unicast questions that take nothing from whoever uses it.

    ``error`` says why there is no answer. ``controller`` is the address of the program in control ("" for nobody,
    None where the camera does not tell which); ``controlled`` whether there is one.
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
    """The background file: why it cannot be used, or its age and what is written in it."""

    path: str
    error: str = ""
    age_s: float = 0.0
    shape: tuple[int, ...] = ()
    summary: str = ""
    exposure_us: str = ""


@dataclass(frozen=True)
class ClockFacts:
    """How the system's clock is kept: by whom, in step or not, and how far off at most (seconds)."""

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
