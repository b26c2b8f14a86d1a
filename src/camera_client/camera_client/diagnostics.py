"""What a camera client says of itself: one level and line for whoever looks, and the figures behind it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from enum import IntEnum

from .background.watch import age_h, concerns, other_camera
from .camera_chain import CameraChain, FrameResult
from .frame_source import Connection, ConnectionState, Frame, FrameSource, FrameStatistics
from .settings import CameraClientSettings
from .sources.frame_checks import LIGHTS, REMEDIES
from .sources.grab_loop import GrabState

LOSS_WINDOW_S = 3.0  # frames lost within this degrade the camera's level
CONNECTION_COUNTERS = ("reconnects", "stalls", "control_losses", "failed_attempts")
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
    place. ``mismatch`` says why the picture cannot look like the background, if that is known; ``concerns`` what else
    speaks against the background, the gravest first; ``moved`` how the camera was moved since its calibration, if it
    was, and ``severe`` whether that much makes its silhouettes useless.
    """

    grab: GrabState
    frames: int = 0
    failure: str = ""
    link: Connection | None = None
    recent: FrameStatistics = field(default_factory=FrameStatistics)
    calibrated: bool = True
    placed: bool = True
    has_background: bool = True
    mismatch: str = ""
    concerns: tuple[str, ...] = ()
    frame_flags: tuple[str, ...] = ()
    mask_flags: tuple[str, ...] = ()
    moved: str = ""
    severe: bool = False

    def with_result(self, seen: FrameResult) -> CameraState:
        """The same with the flags of the newest frame."""
        silhouette = seen.silhouette
        seen_so = replace(self, frame_flags=seen.flags, mask_flags=() if silhouette is None else silhouette.flags)
        if seen.movement is None or seen.canvas is None:
            return seen_so
        return replace(seen_so, moved=seen.movement.describe(seen.canvas.name), severe=seen.movement.severe)


def assess(state: CameraState) -> tuple[Level, str]:
    """Level and text of what the camera is doing: the gravest trouble alone, with its remedy where there is one."""
    if state.grab is GrabState.FAILED:
        return Level.ERROR, state.failure
    if state.grab is not GrabState.RUNNING:
        text = state.grab.value
        return Level.OK, f"{text} after {state.frames} frames" if state.frames else text
    if state.link is not None and state.link.state is not ConnectionState.STREAMING:
        return Level.ERROR, _absence(state.link)
    if state.moved and state.severe:
        return Level.ERROR, state.moved
    if state.mismatch and LIGHTS in state.frame_flags:
        return Level.WARN, state.mismatch
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


def _absence(link: Connection) -> str:
    since = f", nothing for {link.down_s:.0f} s" if link.down_s >= 1 else ""
    if link.state in (ConnectionState.STALLED, ConnectionState.CONTROL_LOST):
        return f"{link.state.value}: {link.reason}; connecting anew{since}"
    what = "the camera cannot be used as it is set" if link.refused else "no camera"
    when = f"next attempt in {link.next_try_s:.1f} s" if link.state is ConnectionState.WAITING else "connecting"
    return f"{what}: {link.reason or 'not connected yet'} ({when}{since})"


def frame_statistics_values(account: FrameStatistics) -> dict[str, object]:
    """The frames' account: expected = delivered + incomplete + lost."""
    return {
        "expected": account.expected,
        "delivered": account.delivered,
        "incomplete": account.incomplete,
        "lost": account.lost,
        "repeated": account.repeated,
    }


def connection_values(link: Connection) -> dict[str, object]:
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
        counted = {**dict.fromkeys(CONNECTION_COUNTERS, 0), **counted, **connection_values(link)}
    return {**source.details, **counted, **frame_statistics_values(source.account)}


def frame_values(frame: Frame, seen: FrameResult) -> dict[str, object]:
    """The newest frame's stamp and silhouette."""
    values = stamp_values(frame)
    if seen.silhouette is not None:
        values["mask_fraction"] = seen.silhouette.foreground_fraction
        values["candidate_fraction"] = seen.silhouette.candidate_fraction
        values["light_gain"] = seen.gain
    if seen.movement is not None:
        values |= seen.movement.values()
    return values


class RecentStatistics:
    """What became of the frames of the last few seconds, from totals looked at now and then."""

    def __init__(self, window_s: float = LOSS_WINDOW_S) -> None:
        self._window_s = window_s
        self._totals: deque[tuple[float, FrameStatistics]] = deque()

    def update(self, now_s: float, total: FrameStatistics) -> FrameStatistics:
        """Take note of the totals; returns the difference to those of a window ago."""
        self._totals.append((now_s, total.snapshot()))
        while len(self._totals) > 1 and self._totals[1][0] <= now_s - self._window_s:
            self._totals.popleft()
        then = self._totals[0][1]
        return FrameStatistics(
            total.expected - then.expected,
            total.delivered - then.delivered,
            total.incomplete - then.incomplete,
            total.lost - then.lost,
            total.repeated - then.repeated,
        )


# --- What a camera client says of its background: whether it still fits, and the figures behind that.


def background_concerns(
    chain: CameraChain, source: FrameSource, settings: CameraClientSettings, now_s: float
) -> tuple[str, ...]:
    """What speaks against the background in use, the gravest first; ``now_s`` is the system's clock.

    Footage is as old as its background, whatever the clock says.
    """
    background, watch = chain.background, chain.watch
    if background is None or watch is None:
        return ()
    return concerns(
        background.provenance,
        source.details,
        watch.found,
        settings.background_watch,
        background.shape,
        now_s=None if source.link is None else now_s,
        followed=settings.background_model.drift.mode == "slow",
    )


def background_mismatch(chain: CameraChain, source: FrameSource) -> str:
    """Why the picture must look unlike the background in use: another camera or setting than it was learned with."""
    if chain.background is None:
        return ""
    return next(iter(other_camera(chain.background.provenance, source.details)), "")


def background_values(chain: CameraChain, now_s: float) -> dict[str, object]:
    """How well the background still fits: its age, the drift of the light, and what stands in the room."""
    background, watch = chain.background, chain.watch
    if background is None or watch is None:
        return {}
    found, age = watch.found, age_h(background.provenance, now_s)
    values: dict[str, object] = {"background_static_foreground": round(found.static_share, 4)}
    if age is not None:
        values["background_age_h"] = round(age, 2)
    if found.gain_drift is not None:
        values["background_gain_drift"] = round(found.gain_drift, 4)
    return values
