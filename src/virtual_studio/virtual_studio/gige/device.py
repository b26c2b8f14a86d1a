"""One simulated camera: its settings, the faults that can be switched on, and the state that its parts share."""

from __future__ import annotations

import dataclasses
import ipaddress
import random
import socket
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_rig.errors import InputError
from capture_rig.settings import LARGEST_INT, setting
from gige_vision.gvcp import PORT

from .loop import EventLoop
from .registers import Registers


@dataclass(frozen=True)
class CameraSettings:
    """A simulated GigE Vision camera. Settings that are features, too, are the values after power-on.

    nominal_exposure_us : at this exposure and 0 dB the picture has the scene's brightness. max_packet_size :
    bytes of the largest stream packet, IP header included. ptp_offset_ns : typical offset from the master once in step.
    seed : of noise, clock offset and packet loss.
    """

    serial: str = setting("SIM00001", "Serial number, 15 bytes at most")
    user_id: str = setting("", "User-defined name at first power-on, 15 bytes at most")
    frame_rate: float = setting(60.0, "Frame rate", unit="Hz", low=0.1, high=1000)
    exposure_us: float = setting(4000.0, "Exposure time", unit="us", low=10, high=1e6)
    nominal_exposure_us: float = 4000.0
    pixel_format: str = setting("auto", "Pixel format; auto: Mono8, or BayerRG8 where the scene has colour")
    noise: float = setting(
        0.0, "Sensor noise added to every picture (standard deviation)", unit="grey levels", low=0, high=50
    )
    max_packet_size: int = 16000
    drift_ppm: float = setting(
        12.0, "How much faster the free-running clock is than UTC", unit="ppm", low=-1000, high=1000
    )
    ptp_settle_s: float = setting(0.4, "Time from PtpEnable to status Slave", unit="s", low=0, high=600)
    ptp_offset_ns: int = 80
    seed: int = 1


@dataclass
class Faults:
    """The faults of one camera; assigning to a field takes effect with the next packet, frame or command.

    packet_loss : probability that a stream packet (resent ones too) is never sent.
    stall : no frames leave, while control goes on answering.
    unplugged : the cable is out: nothing is answered and nothing is sent, but the camera keeps its state.
    frozen : the picture does not change any more; stamps and ids go on.
    light : a factor on the light of the scene; 0.06: the lamps are off, 0: the lens is covered.
    stamp_jump_ns : added to the camera's clock.
    wrong_format : leaders announce another pixel format than the one that was set.
    no_resend : the camera neither offers nor answers packet resends.
    ptp_lost : there is no grandmaster on the network (any more): the status is Listening.
    """

    packet_loss: float = 0.0
    stall: bool = False
    unplugged: bool = False
    frozen: bool = False
    light: float = 1.0
    stamp_jump_ns: int = 0
    wrong_format: bool = False
    no_resend: bool = False
    ptp_lost: bool = False

    def update(self, changes: Mapping[str, Any], where: str = "faults") -> None:
        """Sets several faults by name, all or none. Raises InputError for an unknown name or an impossible value."""
        for name, value in changes.items():
            if name not in NO_FAULTS:
                remedy = f"Known faults: {', '.join(NO_FAULTS)}."
                raise InputError(f"there is no fault '{name}'", where=where, remedy=remedy)
            low, high = _LIMITS.get(name, (False, True))
            if not isinstance(value, int | float) or not low <= value <= high:
                raise InputError(f"{name} = {value!r} is not possible", where=where, remedy=f"Give {low} to {high}.")
        for name, value in changes.items():
            setattr(self, name, type(NO_FAULTS[name])(value))

    def clear(self) -> None:
        self.update(NO_FAULTS)

    def active(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in NO_FAULTS if getattr(self, name) != NO_FAULTS[name]}


@dataclass(frozen=True, eq=False)
class Device:
    """What the parts of a powered camera share. Only used from within the loop."""

    address: str
    settings: CameraSettings
    registers: Registers
    faults: Faults
    counters: Counter[str]
    loop: EventLoop


NO_FAULTS = dataclasses.asdict(Faults())
_LIMITS = {"packet_loss": (0, 1), "light": (0, 10), "stamp_jump_ns": (-LARGEST_INT, LARGEST_INT)}


# --- Loopback addresses.


def free_address() -> str:
    """Finds a loopback address whose GVCP port is free, mostly another one at each call.

    Raises InputError without a free one.
    """
    for _ in range(1000):
        address = ipaddress.IPv4Address(random.randint(0x7F00_2001, 0x7FFF_FFC8))  # 127.0.32.1 to 127.255.255.200
        if address.packed[3] not in (0, 255) and is_free(str(address)):
            return str(address)
    remedy = "Simulated cameras need the whole of 127.0.0.0/8 on the loopback interface."
    raise InputError("found no free loopback address", where=f"port {PORT}", remedy=remedy)


def is_free(address: str) -> bool:
    """Returns whether a camera can bind to this address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, PORT))
        except OSError:
            return False
        return True


def consecutive_addresses(first: str, count: int) -> list[str]:
    """Lists ``count`` addresses from ``first`` on. Raises InputError unless all are unicast loopback addresses."""
    try:
        addresses = [ipaddress.IPv4Address(first) + i for i in range(count)]
    except ipaddress.AddressValueError:
        addresses = []
    if not addresses or not all(a.is_loopback and a.packed[3] not in (0, 255) for a in addresses):
        raise InputError(
            f"{count} cameras from address {first!r} on are not on the loopback interface",
            where="--address",
            remedy="Give an address such as 127.0.1.1.",
        )
    return [str(a) for a in addresses]
