"""Writes a camera client's state into its diagnostics and its log."""

from __future__ import annotations

import time

from rclpy.impl.rcutils_logger import RcutilsLogger

from sagoma_ros.health import NodeHealth

from .camera_chain import CameraChain, FrameResult
from .condition_findings import KEY as FINDINGS_KEY
from .condition_findings import findings_text
from .diagnostics import (
    CameraState,
    Level,
    RecentStatistics,
    assess,
    background_findings,
    background_mismatch,
    background_values,
    frame_values,
    source_values,
)
from .frame_source import Frame, FrameSource
from .settings import CameraClientSettings
from .sources.grab_loop import GrabLoop


class CameraReport:
    """Reports on one activation of a camera client: figures, findings, and one level and line for people."""

    def __init__(self, health: NodeHealth, logger: RcutilsLogger, settings: CameraClientSettings) -> None:
        self._health, self._logger, self._settings = health, logger, settings
        self._recent = RecentStatistics()
        self._logged = ""

    def update(
        self,
        chain: CameraChain,
        source: FrameSource,
        loop: GrabLoop,
        last: tuple[Frame, FrameResult] | None,
        placed: bool,
    ) -> None:
        """Report now; ``last`` : the newest frame and its results, ``placed`` : the camera's pose is known."""
        now_s = time.time()
        values = source_values(source) | (frame_values(*last) if last else {}) | background_values(chain, now_s)
        for key, value in values.items():
            self._health.set(key, value)
        findings = background_findings(chain, source, self._settings, now_s)
        self._health.set(FINDINGS_KEY, findings_text(findings))
        state = CameraState(
            loop.state,
            loop.frames,
            loop.reason,
            source.connection,
            self._recent.update(time.monotonic(), source.statistics),
            calibrated=chain.camera is not None,
            placed=placed,
            has_background=chain.background is not None,
            mismatch=background_mismatch(chain, source),
            refused=chain.refused,
            findings=findings,
        )
        self._say(*assess(state.with_result(last[1]) if last else state))

    def _say(self, level: Level, text: str) -> None:
        """Set the level and line of the diagnostics; log when the kind of trouble changes."""
        self._health.status(bytes([level]), text)
        if level is Level.ERROR:
            self._health.set("last_error", text)
        kind = "".join(letter for letter in text.partition(":")[0] if not letter.isdigit())
        if kind == self._logged:
            return
        self._logged = kind
        if level is Level.OK:
            self._logger.info(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)
