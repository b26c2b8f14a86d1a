"""Diagnostics of a camera client: one level and line for people, and the figures behind it.

:func:`assess` gives the level and the line: the worst trouble alone, with its remedy. The ``..._values`` give the keys
of diagnostic_msgs.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum

from capture_rig.verdict import GOOD, Finding

from .background.causes import age_h, find_causes
from .frame_processor import FrameProcessor, FrameResult
from .frame_source import LASTING_S, Connection, ConnectionState, Frame, FrameSource, FrameStatistics
from .settings import CameraClientSettings
from .sources.frame_checks import REMEDIES
from .sources.grab_loop import GrabState

CONNECTION_COUNTERS = ("reconnects", "stalls", "control_losses", "failed_attempts")
UNCALIBRATED = "uncalibrated: no silhouettes; run sagoma calibrate"
NO_BACKGROUND = "no background: run sagoma background (or call ~/learn_background while the scene is empty)"
UNPLACED = "the camera's place is unknown: shadows stay in the silhouettes; give it a rig_file"


NO_RESULT = FrameResult(None, ())


class Level(IntEnum):
    """Level of a status, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class CameraState:
    """A camera client at one instant.

    ``connection`` is None for footage. ``recent`` counts the frames of the last seconds. ``calibrated``: its lens is
    known, and ``placed``: its pose. ``findings`` say what speaks against the background, the worst first, and
    ``refused`` why there is one that is not in use. ``result`` is the newest frame's.
    """

    grab: GrabState
    frames: int = 0
    failure: str = ""
    connection: Connection | None = None
    recent: FrameStatistics = field(default_factory=FrameStatistics)
    calibrated: bool = True
    placed: bool = True
    has_background: bool = True
    refused: Finding | None = None
    findings: tuple[Finding, ...] = ()
    result: FrameResult = NO_RESULT


def assess(state: CameraState) -> tuple[Level, str]:
    """Return level and text of what the camera is doing: the worst trouble alone, with its remedy if there is one."""
    if state.grab is GrabState.FAILED:
        return Level.ERROR, state.failure
    if state.grab is not GrabState.RUNNING:
        text = state.grab.value
        return Level.OK, f"{text} after {state.frames} frames" if state.frames else text
    if state.connection is not None and state.connection.state is not ConnectionState.STREAMING:
        return Level.ERROR, _absence(state.connection)
    result = state.result
    if result.movement is not None and result.canvas is not None:
        moved = result.movement.describe(result.canvas.name)
        if moved:
            return Level.ERROR, moved
    if result.flags:
        return Level.WARN, "; ".join(f"{flag}: {REMEDIES[flag]}" for flag in result.flags)
    bad = state.recent.lost + state.recent.incomplete
    if bad and state.connection is not None:
        return Level.WARN, f"{bad} of the last {state.recent.expected} frames were lost or incomplete: see the network"
    if not state.calibrated:
        return Level.WARN, UNCALIBRATED
    if not state.has_background:
        return Level.WARN, NO_BACKGROUND if state.refused is None else state.refused.line
    if state.findings and state.findings[0].grade != GOOD:
        return Level.WARN, state.findings[0].line
    if not state.placed:
        return Level.WARN, UNPLACED
    if result.silhouette is not None and result.silhouette.flags:
        return Level.WARN, f"the mask is {' and '.join(result.silhouette.flags)}"
    return Level.OK, state.grab.value


def _absence(connection: Connection) -> str:
    since = f", nothing for {connection.down_s:.0f} s" if connection.down_s >= 1 else ""
    if connection.state in (ConnectionState.STALLED, ConnectionState.CONTROL_LOST):
        return f"{connection.state.value}: {connection.reason}; connecting anew{since}"
    what = "the camera cannot be used as it is set" if connection.refused else "no camera"
    waiting = connection.state is ConnectionState.WAITING
    when = f"next attempt in {connection.next_try_s:.1f} s" if waiting else "connecting"
    return f"{what}: {connection.reason or 'not connected yet'} ({when}{since})"


def source_values(source: FrameSource) -> dict[str, object]:
    """Return all figures of a source: details, counters, connection, frames; what a live one counts is there from 0."""
    connection, counted = source.connection, dict[str, object](source.counters)
    if connection is not None:
        counted = dict.fromkeys(CONNECTION_COUNTERS, 0) | counted
        counted |= {"link": connection.state.value, "downtime_s": round(connection.downtime_s, 2)}
        if connection.last_outage_s is not None:
            counted["last_outage_s"] = round(connection.last_outage_s, 3)
    return {**source.details, **counted, **source.statistics.counts()}


def frame_values(frame: Frame, result: FrameResult) -> dict[str, object]:
    """Return the newest frame's stamp (whose clock it is, and how far it may be from the truth) and silhouette."""
    values: dict[str, object] = {
        "stamp_source": frame.clock,
        "stamp_uncertainty_us": round(frame.uncertainty_ns / 1e3, 1),
    }
    if result.silhouette is not None:
        values["mask_fraction"] = result.silhouette.foreground_fraction
        values["candidate_fraction"] = result.silhouette.candidate_fraction
    if result.movement is not None:
        values |= result.movement.values()
    return values


class RecentStatistics:
    """Statistics of the frames of the last few seconds, from totals sampled now and then."""

    def __init__(self, window_s: float = LASTING_S) -> None:
        self._window_s = window_s
        self._totals: deque[tuple[float, FrameStatistics]] = deque()

    def update(self, now_s: float, total: FrameStatistics) -> FrameStatistics:
        """Add a sample of the totals; returns the difference to those of a window ago."""
        self._totals.append((now_s, total.snapshot()))
        while len(self._totals) > 1 and self._totals[1][0] <= now_s - self._window_s:
            self._totals.popleft()
        return total - self._totals[0][1]


# --- whether the background in use still fits


def background_findings(
    processor: FrameProcessor, source: FrameSource, settings: CameraClientSettings, now_s: float
) -> tuple[Finding, ...]:
    """Return what speaks against the background in use, the worst first; ``now_s`` is the system's clock.

    Footage is as old as its background, whatever the clock says.
    """
    background, limit_h = processor.background, settings.background_age_h
    if background is None:
        return () if processor.refused is None else (processor.refused,)
    figures, age = processor.condition.figures(), age_h(background.provenance, now_s)
    if age is not None and limit_h > 0 and source.connection is not None:
        figures |= {"age_h": age, "age_over_h": age - limit_h}
    return find_causes(figures)


def background_values(processor: FrameProcessor, now_s: float) -> dict[str, object]:
    """Return how well the background still fits: its age, what changed since, and how sure silhouettes are."""
    background, values = processor.background, processor.condition.values()
    if background is None:
        return values
    age = age_h(background.provenance, now_s)
    values["background_learned"] = background.provenance.created
    values["background_serial"] = background.provenance.camera_serial
    if age is not None:
        values["background_age_h"] = round(age, 2)
    return values
