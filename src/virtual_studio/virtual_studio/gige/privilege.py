"""Who controls a camera: one application at a time, as long as its heartbeat comes."""

from __future__ import annotations

import ipaddress
import time
from collections import Counter
from collections.abc import Callable

from gige_vision.bootstrap import Privilege
from gige_vision.gvcp import Status

from .loop import EventLoop, Timer
from .registers import RegisterError, Registers

Peer = tuple[str, int]


class ControlPrivilege:
    """The control channel privilege: given to the first who asks, taken back when its owner falls silent.

    on_release is called whenever nobody controls the camera any more.
    """

    def __init__(
        self, registers: Registers, counters: Counter[str], loop: EventLoop, on_release: Callable[[], None]
    ) -> None:
        self._registers, self._counters, self._loop, self._on_release = registers, counters, loop, on_release
        self.owner: Peer | None = None
        self._heard_ns = 0
        self._timer: Timer | None = None

    @property
    def exclusive(self) -> bool:
        return bool(self._registers.integer("ControlPrivilege") & Privilege.EXCLUSIVE)

    def may_write(self, peer: Peer) -> bool:
        return self.owner == peer

    def may_read(self, peer: Peer) -> bool:
        return self.owner in (None, peer) or not self.exclusive

    def hear(self, peer: Peer) -> None:
        """Any command of the owner is a heartbeat."""
        if peer == self.owner:
            self._heard_ns = time.monotonic_ns()

    def request(self, peer: Peer, value: int) -> None:
        """A write to the privilege register. Raises RegisterError (access denied) while another one is the owner."""
        if self.owner not in (None, peer):
            self._counters["control_denied"] += 1
            raise RegisterError(Status.ACCESS_DENIED)
        if not value & (Privilege.CONTROL | Privilege.EXCLUSIVE):
            if self.owner is not None:
                self.release()
            return
        self._registers["ControlPrivilege"] = value & (Privilege.CONTROL | Privilege.EXCLUSIVE)
        self._registers["PrimaryPort"] = peer[1]
        self._registers["PrimaryAddress"] = int(ipaddress.IPv4Address(peer[0]))
        self.owner = peer
        self.hear(peer)
        self._watch()

    def release(self) -> None:
        """Nobody controls the camera any more, and its stream goes nowhere."""
        self.owner = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for key in ("ControlPrivilege", "PrimaryPort", "PrimaryAddress", "GevSCPHostPort", "GevSCDA"):
            self._registers[key] = 0
        self._on_release()

    def _watch(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self.owner is None:
            return
        left_ns = self._registers.integer("GevHeartbeatTimeout") * 1_000_000 - (time.monotonic_ns() - self._heard_ns)
        if left_ns <= 0:
            self._counters["heartbeats_lost"] += 1
            self.release()
            return
        self._timer = self._loop.call_at(time.time_ns() + left_ns, self._watch)
