"""What starts an exposure, so that several cameras expose at one instant; best first.

ptp: cameras in step by PTP run freely, but from a common beginning. line: a cable. action: each camera is told ahead of
time, by an action command of GigE Vision 2.x, when to expose in PTP time. software: a trigger command at an instant of
this host's clock, as late as the network makes it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from capture_rig.errors import InputError

from ..settings import AravisSettings
from .capture_time import PTP_IN_STEP
from .features import Features
from .trigger_schedule import SECOND, TriggerSchedule

FRAME_TRIGGER = "FrameStart"
PTP_POLL_S = 0.05
TIMER_LEAD_NS = SECOND // 5  # from arming a free-run timer to its first exposure
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
    timer = features.find("SyncFreeRunTimerEnable")
    if timer is not None and features.read(timer) not in (False, 0, "Off"):
        features.switch(timer, False, "aravis.sync")


def synchronise(features: Features, settings: AravisSettings, ptp_now_ns: Callable[[], int]) -> str:
    """Set up the triggers for ``settings.sync``; returns a warning, "" when there is none.

    ptp_now_ns : the camera's clock, only asked for where PTP is in use.
    Raises InputError when the camera lacks what the mode needs.
    """
    if settings.sync in ("action", "software", "ptp"):
        require_rate(settings, features.where)
    if settings.sync == "ptp":
        return _free_run_in_step(features, settings, ptp_now_ns)
    if settings.sync == "line":
        _trigger_by(features, settings, settings.trigger_line)
        features.set("TriggerActivation", settings.trigger_activation, "aravis.trigger_activation")
    elif settings.sync == "action":
        _listen_to_actions(features, settings)
        _trigger_by(features, settings, _action_source(features))
    elif settings.sync == "software":
        features.require("TriggerSoftware", "aravis.sync")
        _trigger_by(features, settings, "Software")
    return ""


def require_rate(settings: AravisSettings, where: str) -> None:
    """Raises InputError when no frame rate is given."""
    if settings.frame_rate <= 0:
        raise InputError(
            f"sync {settings.sync} needs a frame rate",
            where=where,
            remedy="Set aravis.frame_rate, to the same for all cameras.",
        )


def enable_ptp(
    features: Features,
    wait_s: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> str | None:
    """Switch PTP on and wait until the camera is in step; returns its status, None for a camera without PTP."""
    if features.find("PtpEnable") is None:
        return None
    features.switch("PtpEnable", True, "aravis.sync and aravis.stamp_source")
    deadline_s = clock() + wait_s
    while (status := ptp_status(features)) not in PTP_IN_STEP and clock() < deadline_s:
        sleep(PTP_POLL_S)
    return status


def ptp_status(features: Features) -> str | None:
    """The camera's PTP status, such as Slave; None for a camera without PTP, or when it is switched off."""
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
    if settings.trigger_delay_us >= 0:
        features.set("TriggerDelay", settings.trigger_delay_us, "aravis.trigger_delay_us")
    features.set("TriggerMode", "On", "aravis.sync")


def _action_source(features: Features) -> str:
    """The camera's first action signal: Action1, or Action0 where it counts from 0."""
    offered = features.access.choices(features.require("TriggerSource", "aravis.sync"))
    return next((name for name in sorted(offered) if name.startswith("Action")), "Action1")


def _listen_to_actions(features: Features, settings: AravisSettings) -> None:
    if (selector := features.find("ActionSelector")) is not None:
        lowest = features.access.limits(selector)
        features.set(selector, int(lowest[0]) if lowest else 1, "aravis.sync")
    features.require("ActionDeviceKey", "aravis.sync")
    for name, value, key in (
        ("ActionDeviceKey", settings.action_device_key, "aravis.action_device_key"),
        ("ActionGroupKey", settings.action_group_key, "aravis.action_group_key"),
        ("ActionGroupMask", settings.action_group_mask, "aravis.action_group_mask"),
    ):
        features.set(name, value, key)


def _free_run_in_step(features: Features, settings: AravisSettings, ptp_now_ns: Callable[[], int]) -> str:
    """Exposures at whole multiples of the period of the PTP clock, whoever arms the cameras and when."""
    if features.find("SyncFreeRunTimerEnable") is not None:
        _arm_timer(features, settings.frame_rate, ptp_now_ns())
        return ""
    if features.find("BslPeriodicSignalPeriod") is not None:  # counts from the epoch of PTP by itself
        features.set("BslPeriodicSignalPeriod", 1e6 / settings.frame_rate, "aravis.frame_rate")
        if features.find("BslPeriodicSignalDelay") is not None:
            features.set("BslPeriodicSignalDelay", 0.0, "aravis.sync")
        _trigger_by(features, settings, PERIODIC_SIGNAL)
        return ""
    return (
        "the camera can be in step by PTP, but not begin at a given time: cameras run at one rate, each in a phase of "
        "its own; aravis.sync action or line would bring them together"
    )


def _arm_timer(features: Features, rate_hz: float, ptp_now_ns: int) -> None:
    schedule = TriggerSchedule(rate_hz)
    start_ns = schedule.instant_ns(schedule.first_after(ptp_now_ns + TIMER_LEAD_NS))
    features.set("SyncFreeRunTimerTriggerRateAbs", rate_hz, "aravis.frame_rate")
    features.set("SyncFreeRunTimerStartTimeLow", start_ns & 0xFFFF_FFFF, "aravis.sync")
    features.set("SyncFreeRunTimerStartTimeHigh", start_ns >> 32, "aravis.sync")
    features.run("SyncFreeRunTimerUpdate", "aravis.sync")
    features.switch("SyncFreeRunTimerEnable", True, "aravis.sync")
