"""Makes several cameras expose at one instant: the sources of triggers, best first.

ptp: cameras in step by PTP run freely, but from a common beginning. line: a cable. action: each camera is told ahead of
time, by an action command of GigE Vision 2.x, when to expose in PTP time. software: a trigger command at an instant of
this host's clock, as late as the network makes it.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from fractions import Fraction

from capture_rig.errors import InputError
from gige_vision.gvcp import PORT, AcknowledgePacket, Action, Command, MalformedPacket, Status

from ..frame_source import POLL_S, RELEASE_S, SourceUnavailable
from ..settings import AravisSettings
from .capture_time import PTP_IN_STEP, SECOND
from .features import Features

FRAME_TRIGGER = "FrameStart"
TIMER_LEAD_NS = SECOND // 5  # from arming a free-run timer to its first exposure
ACTION_GROUP = 1  # key and mask of the one group that all cameras of a rig belong to
PERIODIC_SIGNAL = "PeriodicSignal1"


def switch_triggers_off(features: Features) -> None:
    """Let the camera run freely: no trigger of any kind starts or holds up a frame."""
    if (mode := features.find("TriggerMode")) is None:
        return
    selector = features.find("TriggerSelector")
    for name in features.access.choices(selector) if selector else ("",):
        if selector:
            features.ensure(selector, name, "aravis.sync")
        features.ensure(mode, "Off", "aravis.sync")
    features.switch_off("SyncFreeRunTimerEnable", "aravis.sync")


def synchronise(features: Features, settings: AravisSettings, ptp_now_ns: Callable[[], int]) -> None:
    """Set up the triggers for ``settings.sync``.

    ptp_now_ns : reads the camera's clock; called only where PTP is in use.
    Raises InputError when the camera lacks what the mode needs.
    """
    if settings.sync in ("action", "software", "ptp") and settings.frame_rate <= 0:
        raise InputError(
            f"sync {settings.sync} needs a frame rate",
            where=features.where,
            remedy="Set aravis.frame_rate, to the same for all cameras.",
        )
    if settings.sync == "ptp":
        _free_run_in_step(features, settings, ptp_now_ns)
    elif settings.sync == "line":
        _trigger_by(features, settings, settings.trigger_line)
        features.set("TriggerActivation", settings.trigger_activation, "aravis.trigger_activation")
    elif settings.sync == "action":
        if (selector := features.find("ActionSelector")) is not None:
            lowest = features.access.limits(selector)
            features.set(selector, int(lowest[0]) if lowest else 1, "aravis.sync")
        features.set("ActionDeviceKey", settings.action_device_key, "aravis.action_device_key")
        for name in ("ActionGroupKey", "ActionGroupMask"):
            features.set(name, ACTION_GROUP, "aravis.sync")
        offered = features.access.choices(features.require("TriggerSource", "aravis.sync"))
        signals = sorted(name for name in offered if name.startswith("Action"))  # some cameras count from 0
        _trigger_by(features, settings, signals[0] if signals else "Action1")
    elif settings.sync == "software":
        features.require("TriggerSoftware", "aravis.sync")
        _trigger_by(features, settings, "Software")


def await_ptp(
    features: Features,
    settings: AravisSettings,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Switch PTP on and wait until the camera is in step. SourceUnavailable when it is not, InputError without PTP."""
    needed_by = f"sync {settings.sync}" if settings.sync in ("ptp", "action") else "stamp_source ptp"
    if features.find("PtpEnable") is None:
        remedy = "Choose another aravis.sync or stamp_source."
        raise InputError(f"has no PTP, which {needed_by} needs", where=features.where, remedy=remedy)
    features.switch("PtpEnable", True, "aravis.sync and aravis.stamp_source")
    deadline_s = clock() + settings.ptp_wait_s
    while (status := ptp_status(features)) not in PTP_IN_STEP:
        if clock() >= deadline_s:
            raise SourceUnavailable(
                f"is not in step by PTP after {settings.ptp_wait_s:g} s (status {status}), which {needed_by} needs",
                where=features.where,
                remedy="Is a PTP grandmaster on the network?",
            )
        sleep(POLL_S)


def ptp_status(features: Features) -> str | None:
    """Return the camera's PTP status, such as Slave; None for a camera without PTP, or when it is switched off."""
    latch = features.find("PtpDataSetLatch")
    if latch is not None:
        features.run(latch, "aravis.sync")
    status = features.read("PtpStatus")
    if status is None or str(status) in ("Disabled", "Off"):
        return None
    return str(status)


def _trigger_by(features: Features, settings: AravisSettings, source: str) -> None:
    if (selector := features.find("TriggerSelector")) is not None:
        features.set(selector, FRAME_TRIGGER, "aravis.sync")
    features.set("TriggerSource", source, "aravis.trigger_line" if settings.sync == "line" else "aravis.sync")
    features.set("TriggerMode", "On", "aravis.sync")


def _free_run_in_step(features: Features, settings: AravisSettings, ptp_now_ns: Callable[[], int]) -> None:
    """Exposures at whole multiples of the period of the PTP clock, whenever the cameras are armed."""
    rate_hz = settings.frame_rate
    if features.find("SyncFreeRunTimerEnable") is not None:
        schedule = TriggerSchedule(rate_hz)
        start_ns = schedule.instant_ns(schedule.first_after(ptp_now_ns() + TIMER_LEAD_NS))
        features.set("SyncFreeRunTimerTriggerRateAbs", rate_hz, "aravis.frame_rate")
        features.set("SyncFreeRunTimerStartTimeLow", start_ns & 0xFFFF_FFFF, "aravis.sync")
        features.set("SyncFreeRunTimerStartTimeHigh", start_ns >> 32, "aravis.sync")
        features.run("SyncFreeRunTimerUpdate", "aravis.sync")
        features.switch("SyncFreeRunTimerEnable", True, "aravis.sync")
    elif features.find("BslPeriodicSignalPeriod") is not None:  # counts from the epoch of PTP by itself
        features.set("BslPeriodicSignalPeriod", 1e6 / rate_hz, "aravis.frame_rate")
        if features.find("BslPeriodicSignalDelay") is not None:
            features.set("BslPeriodicSignalDelay", 0.0, "aravis.sync")
        _trigger_by(features, settings, PERIODIC_SIGNAL)
    else:
        features.warn(
            "the camera can be in step by PTP, but not begin at a given time: cameras run at one rate, each in a phase "
            "of its own; aravis.sync action or line would bring them together"
        )


# --- when to trigger: at whole multiples of the period of a common clock, so that camera PCs need no coordinator

FINEST_RATE = 10**6  # the rate is taken as a fraction with at most this denominator: 59.94 is 2997/50


class TriggerSchedule:
    """The instants k / rate of a clock that counts from its epoch (ns), each due ``lead_ns`` before it comes.

    Every computer that knows the rate finds the same instants, to the nanosecond. An instant that is over by half a
    period before it was due here is skipped and counted in ``missed``.
    """

    def __init__(self, rate_hz: float, lead_ns: int = 0) -> None:
        self._rate = Fraction(rate_hz).limit_denominator(FINEST_RATE)
        self._lead_ns = lead_ns
        self._next: int | None = None
        self.missed = 0

    def instant_ns(self, index: int) -> int:
        """Instant number ``index`` since the clock's epoch."""
        return index * SECOND * self._rate.denominator // self._rate.numerator

    def first_after(self, now_ns: int) -> int:
        """Number of the first instant that is not over at ``now_ns``."""
        index = -(-now_ns * self._rate.numerator // (SECOND * self._rate.denominator))
        return index if self.instant_ns(index) >= now_ns else index + 1

    def due(self, now_ns: int) -> list[int]:
        """Instants (ns) to act on now, each given once; the first call begins with the first one still ahead."""
        index, instants = self._next_index(now_ns), []
        while self.instant_ns(index) - self._lead_ns <= now_ns:
            instants.append(self.instant_ns(index))
            index += 1
        self._next = index
        return instants

    def wait_ns(self, now_ns: int) -> int:
        """Time until the next instant is due."""
        return max(self.instant_ns(self._next_index(now_ns)) - self._lead_ns - now_ns, 0)

    def _next_index(self, now_ns: int) -> int:
        """Return the number of the next instant; those that passed are skipped, once."""
        if self._next is not None:
            left_ns = self.instant_ns(self._next) - now_ns
            if left_ns < -self.instant_ns(1) // 2:
                passed, self._next = self._next, self.first_after(now_ns)
                self.missed += self._next - passed
            elif left_ns - self._lead_ns > SECOND:  # the clock was set back
                self._next = None
        if self._next is None:
            self._next = self.first_after(now_ns + self._lead_ns)
        return self._next


class TriggerThread:
    """Calls ``fire(instant_ns)`` for every instant of a schedule when it is due, on a thread of its own, until stop().

    clock : ns, of the clock that the schedule counts on.
    """

    def __init__(self, schedule: TriggerSchedule, clock: Callable[[], int], fire: Callable[[int], None]) -> None:
        self._schedule, self._clock, self._fire = schedule, clock, fire
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="trigger", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; waits for a trigger that is on its way."""
        self._stopping.set()
        self._thread.join(RELEASE_S)

    def _run(self) -> None:
        while not self._stopping.wait(self._schedule.wait_ns(self._clock()) / SECOND):
            for instant_ns in self._schedule.due(self._clock()):
                self._fire(instant_ns)


# --- scheduled action commands to one camera: "expose at this time of your clock"; unicast, nothing is broadcast

ACTION_COUNTERS = ("actions", "actions_late", "actions_refused", "actions_unanswered")
LAST_REQUEST_ID = 0xFFFF


class ActionSender:
    """Sends actions to the camera at ``address`` from ``host`` and takes in its acknowledges, without ever waiting.

    It adds to ``counts``: actions (acknowledged), actions_late (came after their time), actions_refused (anything else,
    such as no room for another one or no PTP time), actions_unanswered, or not yet (:data:`ACTION_COUNTERS`).
    """

    def __init__(self, address: str, host: str, device_key: int, counts: dict[str, int]) -> None:
        self._keys, self._counts = (device_key, ACTION_GROUP, ACTION_GROUP), counts
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, 0))
            self._socket.connect((address, PORT))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._request_id = 0

    def send(self, time_ns: int) -> None:
        """Ask for one action at ``time_ns`` of the camera's clock."""
        self.collect()
        self._request_id = self._request_id % LAST_REQUEST_ID + 1
        self._counts["actions_unanswered"] += 1
        with contextlib.suppress(OSError):  # the port is closed on the camera's side, or the network is down
            self._socket.send(Action(*self._keys, time_ns).command(self._request_id).encode())

    def collect(self) -> None:
        """Take in the acknowledges that have come."""
        while True:
            try:
                answer = AcknowledgePacket.decode(self._socket.recv(2048))
            except (BlockingIOError, ConnectionError):
                return
            except MalformedPacket:
                continue
            if answer.acknowledge == Command.ACTION.acknowledge:
                self._counts["actions_unanswered"] -= 1
                self._counts[_RESULTS.get(answer.status, "actions_refused")] += 1

    def close(self) -> None:
        self._socket.close()


_RESULTS = {int(Status.SUCCESS): "actions", int(Status.ACTION_LATE): "actions_late"}
