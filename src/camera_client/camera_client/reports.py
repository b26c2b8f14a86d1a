"""What a camera client says of itself: one level and line for whoever looks, and the figures behind it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from enum import IntEnum

from .account import FrameAccount
from .camera_chain import Seen
from .frame_checks import LIGHTS, REMEDIES
from .frame_source import Frame, FrameSource
from .grab_loop import GrabState
from .link import Link, LinkState

LOSS_WINDOW_S = 3.0  # frames lost within this degrade the camera's level
LINK_COUNTERS = ("reconnects", "stalls", "control_losses", "failed_attempts")
UNCALIBRATED = "uncalibrated: no silhouettes; run sagoma calibrate"
NO_BACKGROUND = "no background: run sagoma background (or call ~/learn_background while the scene is empty)"
UNPLACED = "the camera's place is unknown: shadows stay in the silhouettes; give it a rig_file"


class Level(IntEnum):
    """As in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class CameraState:
    """A camera client at one instant.

    ``link`` is None for footage. ``recent`` is what happened to the frames of the last seconds. ``frame_flags`` and
    ``mask_flags`` are those of the newest frame and silhouette. ``calibrated``: its lens is known, and ``placed``: its
    place. ``misfit`` says why the picture cannot look like the background, if that is known; ``concerns`` what else
    speaks against the background, the gravest first; ``moved`` how the camera was moved since its calibration, if it
    was, and ``grave`` whether that much makes its silhouettes useless.
    """

    grab: GrabState
    frames: int = 0
    failure: str = ""
    link: Link | None = None
    recent: FrameAccount = field(default_factory=FrameAccount)
    calibrated: bool = True
    placed: bool = True
    has_background: bool = True
    misfit: str = ""
    concerns: tuple[str, ...] = ()
    frame_flags: tuple[str, ...] = ()
    mask_flags: tuple[str, ...] = ()
    moved: str = ""
    grave: bool = False

    def with_seen(self, seen: Seen) -> CameraState:
        """The same with the flags of the newest frame."""
        silhouette = seen.silhouette
        seen_so = replace(self, frame_flags=seen.flags, mask_flags=() if silhouette is None else silhouette.flags)
        if seen.movement is None or seen.canvas is None:
            return seen_so
        return replace(seen_so, moved=seen.movement.tell(seen.canvas.name), grave=seen.movement.grave)


def judge(state: CameraState) -> tuple[Level, str]:
    """Level and text of what the camera is doing: the gravest trouble alone, with its remedy where there is one."""
    if state.grab is GrabState.FAILED:
        return Level.ERROR, state.failure
    if state.grab is not GrabState.RUNNING:
        text = state.grab.value
        return Level.OK, f"{text} after {state.frames} frames" if state.frames else text
    if state.link is not None and state.link.state is not LinkState.STREAMING:
        return Level.ERROR, _absence(state.link)
    if state.moved and state.grave:
        return Level.ERROR, state.moved
    if state.misfit and LIGHTS in state.frame_flags:
        return Level.WARN, state.misfit
    if state.frame_flags:
        return Level.WARN, "; ".join(f"{flag}: {REMEDIES.get(flag, flag)}" for flag in state.frame_flags)
    bad = state.recent.lost + state.recent.incomplete
    if bad and state.link is not None:
        return Level.WARN, f"{bad} of the last {state.recent.expected} frames were lost or incomplete: see the network"
    if not state.calibrated:
        return Level.WARN, UNCALIBRATED
    if not state.has_background:
        return Level.WARN, NO_BACKGROUND
    if state.moved:
        return Level.WARN, state.moved
    if state.concerns:
        return Level.WARN, state.concerns[0]
    if not state.placed:
        return Level.WARN, UNPLACED
    if state.mask_flags:
        return Level.WARN, f"the mask is {' and '.join(state.mask_flags)}"
    return Level.OK, state.grab.value


def _absence(link: Link) -> str:
    since = f", nothing for {link.down_s:.0f} s" if link.down_s >= 1 else ""
    if link.state in (LinkState.STALLED, LinkState.CONTROL_LOST):
        return f"{link.state.value}: {link.reason}; connecting anew{since}"
    what = "the camera cannot be used as it is set" if link.refused else "no camera"
    when = f"next attempt in {link.next_try_s:.1f} s" if link.state is LinkState.WAITING else "connecting"
    return f"{what}: {link.reason or 'not connected yet'} ({when}{since})"


def account_values(account: FrameAccount) -> dict[str, object]:
    """The frames' account: expected = delivered + incomplete + lost."""
    return {
        "expected": account.expected,
        "delivered": account.delivered,
        "incomplete": account.incomplete,
        "lost": account.lost,
        "repeated": account.repeated,
    }


def link_values(link: Link) -> dict[str, object]:
    """The connection: where it stands, how long it was away, and how the last outage went."""
    values: dict[str, object] = {"link": link.state.value, "downtime_s": round(link.downtime_s, 2)}
    if link.last_outage is not None:
        values["last_outage_s"] = round(link.last_outage.length_s, 3)
        values["last_outage_noticed_s"] = round(link.last_outage.noticed_s, 3)
        values["last_restart_s"] = round(link.last_outage.restart_s, 3)
    return values


def stamp_values(frame: Frame) -> dict[str, object]:
    """Whose clock the stamps are, and how far they may be from the truth."""
    return {"stamp_source": frame.clock, "stamp_uncertainty_us": round(frame.uncertainty_ns / 1e3, 1)}


def source_values(source: FrameSource) -> dict[str, object]:
    """All figures of a source: details, counters, connection, account. What a live one counts is there from zero."""
    link = source.link
    counted: dict[str, object] = {**source.counters}
    if link is not None:
        counted = {**dict.fromkeys(LINK_COUNTERS, 0), **counted, **link_values(link)}
    return {**source.details, **counted, **account_values(source.account)}


def seen_values(frame: Frame, seen: Seen) -> dict[str, object]:
    """The newest frame's stamp and silhouette."""
    values = stamp_values(frame)
    if seen.silhouette is not None:
        values["mask_fraction"] = seen.silhouette.foreground_fraction
        values["candidate_fraction"] = seen.silhouette.candidate_fraction
        values["light_gain"] = seen.gain
    if seen.movement is not None:
        values |= seen.movement.values()
    return values


class RecentAccount:
    """What became of the frames of the last few seconds, from totals looked at now and then."""

    def __init__(self, window_s: float = LOSS_WINDOW_S) -> None:
        self._window_s = window_s
        self._looks: deque[tuple[float, FrameAccount]] = deque()

    def look(self, now_s: float, total: FrameAccount) -> FrameAccount:
        """Take note of the totals; returns the difference to those of a window ago."""
        self._looks.append((now_s, total.snapshot()))
        while len(self._looks) > 1 and self._looks[1][0] <= now_s - self._window_s:
            self._looks.popleft()
        then = self._looks[0][1]
        return FrameAccount(
            total.expected - then.expected,
            total.delivered - then.delivered,
            total.incomplete - then.incomplete,
            total.lost - then.lost,
            total.repeated - then.repeated,
        )
